"""The predicted bias of the series-parallel model against matrices made by hand and simulation."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, SvfLeastSquares, TransferFunction, identify, simulate
from tridentify import errors as err
from tridentify.estimation.methods.filtered.asymptotic_bias import asymptotic_bias
from tridentify.estimation.methods.filtered.filter_cascade import filter_cascade
from tridentify.estimation.methods.filtered.noise_through_filters import FilterColumns
from tridentify.numerics.discretize import discretize

pytestmark = pytest.mark.unjudged

PLANT = TransferFunction([3.0], [1.0, 4.0, 3.0])
FILTER = (1.0, 4.0, 4.0)
AT_REST = Structure(2, 0, offset=False, initial_state="rest")
DT = 0.05


def binary(n_samples, hold=8, seed=3):
    signs = np.sign(np.random.default_rng(seed).standard_normal(-(-n_samples // hold)))
    return np.repeat(signs, hold)[:n_samples]


def blank(u, dt=DT, **options):
    return Record(u, u if u.ndim == 1 else u[:, 0], dt=dt, **options)


# ------------------------------------------------------------------------- the noise matrix
def applied(columns, signal, dt):
    """A signal, joined by lines between its samples, through the filters, from rest."""
    step = discretize(columns.c.a, columns.c.b[:, None], dt, "foh")
    current, after = step.from_current[:, 0], step.from_next[:, 0]
    state, states = np.zeros(columns.c.order), []
    for k, value in enumerate(signal):
        if k:
            state = step.transition @ state + current * signal[k - 1] + after * value
        states.append(state)
    return np.array(states) @ columns.rows.T + np.outer(signal, columns.direct)


@pytest.mark.parametrize("coefficients", [(1.0, 2.0), (1.0, 2.0, 5.0), (1.0, 7.0, 15.0, 25.0)])
@pytest.mark.parametrize("n_poles", [1, 2])
def test_noise_matrices_are_those_of_unit_samples(coefficients, n_poles):
    """Every sample's answer, one by one, transients included: equations (6)-(7) spelled out."""
    if len(coefficients) - 1 < n_poles:
        pytest.skip("the filter's degree is too low")
    columns, n = FilterColumns.of(filter_cascade(coefficients, n_poles), n_poles), 25
    answers = np.array([applied(columns, sample, 0.1) for sample in np.eye(n)])
    assert np.allclose(columns.gram(n, 0.1), np.einsum("jki,jkl->il", answers, answers), atol=1e-13)
    q = np.linalg.qr(np.random.default_rng(0).standard_normal((n, 4)))[0]
    along = np.einsum("jki,kr->ijr", answers, q)
    assert np.allclose(columns.taken(q, 0.1), np.einsum("ijr,ljr->il", along, along), atol=1e-13)


def test_noise_matrix_of_a_long_record_is_cut_where_the_answer_has_faded():
    columns = FilterColumns.of(filter_cascade((1.0, 4.0, 4.0), 2), 2)
    later, _ = columns.answers(200_000, DT)
    assert later.shape[0] < 20_000
    per_sample = columns.gram(200_000, DT) - columns.gram(100_000, DT)
    assert np.allclose(per_sample, columns.gram(300_000, DT) - columns.gram(200_000, DT))


# ------------------------------------------------------------------------- the prediction
def by_hand(model, u, variance, coefficients):
    """Expected normal equations of a first-order system, written out with scalar recursions."""
    (b,), (_, a), (_, c) = model.num[0][0], model.den[0][0], coefficients
    record = blank(u)
    clean = simulate(model, record)[:, 0]
    e, phi = np.exp(-c * DT), -np.expm1(-c * DT) / c
    ramp = (DT - phi) / (c * DT)  # the share of the next sample on a straight line

    def lines(y):
        x = np.zeros(y.size)
        for k in range(1, y.size):
            x[k] = e * x[k - 1] + (phi - ramp) * y[k - 1] + ramp * y[k]
        return x

    held = np.zeros(u.size)
    for k in range(1, u.size):
        held[k] = e * held[k - 1] + phi * u[k - 1]
    y1 = lines(clean)
    monic = clean - c * y1
    noise = np.array([lines(sample) for sample in np.eye(u.size)]).T
    monic_noise = np.eye(u.size) - c * noise
    z = held / np.linalg.norm(held)

    def inner(p, q):
        return np.sum(p * q) - np.dot(z @ p, z @ q)

    own = inner(y1, y1) + variance * inner(noise, noise)
    cross = inner(y1, monic) + variance * inner(noise, monic_noise)
    found = -cross / own
    gain = held @ (monic + found * y1) / (held @ held)
    return np.array([found - a, gain - b])


@pytest.mark.parametrize("variance", [0.0, 0.01, 1.0])
def test_first_order_system_written_out(variance):
    model, u = TransferFunction([2.0], [1.0, 1.5]), binary(60)
    expected = by_hand(model, u, variance, (1.0, 3.0))
    found = asymptotic_bias(model, blank(u), variance, (1.0, 3.0))
    assert np.allclose(found, expected, rtol=1e-9, atol=1e-12)


def test_without_noise_the_straight_lines_remain_and_fall_with_dt_squared():
    def remainder(every):
        u = np.repeat(binary(200, hold=1), 16 // every)
        return asymptotic_bias(PLANT, blank(u, dt=0.05 * every / 4), 0.0, FILTER)

    coarse, fine = np.abs(remainder(4)).max(), np.abs(remainder(2)).max()
    assert coarse < 0.05
    assert fine == pytest.approx(coarse / 4, rel=0.15)


def test_bias_is_what_the_estimator_gives_without_noise():
    u = binary(400)
    y = simulate(PLANT, blank(u))
    estimate = identify(Record(u, y, dt=DT), AT_REST, SvfLeastSquares(filter=FILTER))
    predicted = asymptotic_bias(PLANT, blank(u), 0.0, FILTER)
    assert np.allclose(estimate.theta - [4.0, 3.0, 3.0], predicted, rtol=1e-6, atol=1e-10)


@pytest.mark.parametrize("rate", [1e-6, 1e6])
def test_counting_time_in_other_units_scales_the_coefficients_alone(rate):
    u = binary(400)
    scale = np.array([rate, rate**2, rate**2])
    model = TransferFunction([3.0 * rate**2], [1.0, 4.0 * rate, 3.0 * rate**2])
    slow = asymptotic_bias(PLANT, blank(u), 0.01, FILTER)
    record = blank(u, dt=DT / rate)
    fast = asymptotic_bias(model, record, 0.01, (1.0, 4.0 * rate, 4.0 * rate**2))
    assert np.allclose(fast / scale, slow, rtol=1e-7)


def test_small_noise_gives_a_bias_in_proportion_to_its_variance():
    u = binary(800)
    rest = asymptotic_bias(PLANT, blank(u), 0.0, FILTER)
    one, two = (asymptotic_bias(PLANT, blank(u), v, FILTER) - rest for v in (1e-7, 2e-7))
    assert np.allclose(two, 2 * one, rtol=1e-2)
    assert np.all(one < 0)


CASES = {
    "one output": (PLANT, AT_REST, {}, FILTER),
    "a filter of higher degree": (PLANT, AT_REST, {}, (1.0, 6.0, 12.0, 8.0)),
    "offset and free state along": (
        PLANT,
        Structure(2, 0, offset=True, initial_state="free"),
        {"offset": True, "initial_state": "free"},
        FILTER,
    ),
    "two outputs": (
        TransferFunction([[[-7.0, -6.5]], [[-0.1, -5.0]]], [1.0, 2.4, 6.3]),
        Structure(2, 1, offset=False, initial_state="rest"),
        {},
        (1.0, 6.0, 9.0),
    ),
}


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("case", CASES)
def test_mean_of_many_draws_is_truth_plus_prediction(case):
    """8128 samples, so that the finite-sample remainder is far below the sampling error."""
    model, structure, options, coefficients = CASES[case]
    u = binary(8128)
    clean = simulate(model, blank(u))
    sigma = np.std(clean, axis=0) * 10 ** (-10 / 20)
    truth = np.concatenate([model.den[0][0][1:], *(num for row in model.num for num in row)])
    values = []
    for seed in np.random.SeedSequence(5).spawn(200):
        noise = np.random.default_rng(seed).standard_normal(clean.shape)
        record = Record(u, clean + sigma * noise, dt=DT)
        estimate = identify(record, structure, SvfLeastSquares(filter=coefficients), throw=False)
        values.append(estimate.theta)
    values = np.array(values)
    predicted = asymptotic_bias(model, blank(u), sigma**2, coefficients, **options)
    error = values.mean(axis=0) - truth - predicted
    sampling = values.std(axis=0, ddof=1) / np.sqrt(len(values))
    assert np.all(np.abs(error) < 4.0 * sampling), error / sampling
    # and there is something to predict
    assert np.max(np.abs(predicted) / sampling) > 40.0


# ------------------------------------------------------------------------- refusals
REFUSED = {
    "negative variance": (PLANT, -1.0, FILTER, {}, err.OptionError),
    "one variance too many": (PLANT, (1.0, 1.0), FILTER, {}, err.OptionError),
    "unstable filter": (PLANT, 0.1, (1.0, -1.0, 1.0), {}, err.OptionError),
    "no filter": (PLANT, 0.1, None, {}, err.OptionError),
    "filter of too low a degree": (PLANT, 0.1, (1.0, 2.0), {}, err.OptionError),
    "unknown state": (PLANT, 0.1, FILTER, {"initial_state": "auto"}, err.OptionError),
    "delay": (
        TransferFunction([1.0], [1.0, 2.0, 3.0], delay=0.1),
        0.1,
        FILTER,
        {},
        err.UnsupportedError,
    ),
    "two inputs": (
        TransferFunction([[[1.0], [2.0]]], [1.0, 2.0, 3.0]),
        0.1,
        FILTER,
        {},
        err.ChannelCountError,
    ),
    "two denominators": (
        TransferFunction([[[1.0]], [[2.0]]], [[[1.0, 2.0]], [[1.0, 3.0]]]),
        0.1,
        FILTER,
        {},
        err.UnsupportedError,
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refusals_are_one_clear_line(case):
    model, variance, coefficients, options, expected = REFUSED[case]
    with pytest.raises(expected) as caught:
        asymptotic_bias(model, blank(binary(100)), variance, coefficients, **options)
    assert "\n" not in str(caught.value)
    assert "found" in str(caught.value)
    assert "expected" in str(caught.value)
