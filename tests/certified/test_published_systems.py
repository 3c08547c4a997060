"""Systems whose numbers are published: the paper's aircraft, Rao and Garnier's plant, a relative.

The records are made here, by modes; the bound is computed here, by finite differences, and
compared with the printed one.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter

from oracles import by_modes, register
from tridentify import Record, Status, Structure, ThreeModel, identify
from tridentify import errors as err
from tridentify.models.operators import AllPass, Laguerre, apply_operators

pytestmark = pytest.mark.unjudged


def respond(theta, n, u, dt):
    return by_modes(theta[n:], np.append(1.0, theta[:n]), u, dt)


def bound(theta, n, u, dt, sigma):
    """Cramer-Rao standard deviations for white noise of standard deviation ``sigma``."""
    columns = []
    for k in range(theta.size):
        step = np.zeros(theta.size)
        step[k] = 1e-5 * abs(theta[k])
        difference = respond(theta + step, n, u, dt) - respond(theta - step, n, u, dt)
        columns.append(difference / (2.0 * step[k]))
    scores = np.stack(columns, axis=1)
    return sigma * np.sqrt(np.diag(np.linalg.inv(scores.T @ scores)))


def with_noise(theta, n, u, dt, snr, seed):
    clean = respond(theta, n, u, dt)
    sigma = np.std(clean) * 10 ** (-snr / 20)
    y = clean + sigma * np.random.default_rng(seed).standard_normal(u.size)
    return Record(u, y, dt=dt), sigma


# ------------------------------------------------------------------------------- Rao and Garnier
RAO_GARNIER = np.array([5.0, 408.0, 416.0, 1600.0, -6400.0, 1600.0])
PRINTED = {
    10: [0.0604, 1.062, 3.546, 7.735, 40.40, 71.62],
    0: [0.191, 3.358, 11.21, 24.46, 127.8, 226.5],
}
LONG = register(10, (10, 7), 7161, 7)


def test_the_shift_register_has_full_length():
    words = np.lib.stride_tricks.sliding_window_view(LONG[::7], 10)
    assert np.unique(words, axis=0).shape[0] == 1023 - 9
    assert LONG.size == 7 * 1023


@pytest.mark.parametrize("snr", PRINTED)
def test_rao_garnier_bound_is_the_printed_one(snr):
    sigma = np.std(respond(RAO_GARNIER, 4, LONG, 0.01)) * 10 ** (-snr / 20)
    assert np.allclose(bound(RAO_GARNIER, 4, LONG, 0.01, sigma), PRINTED[snr], rtol=0.02)


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("snr", PRINTED)
@pytest.mark.fast("0-0", "0-1")
def test_rao_garnier(snr, seed):
    record, sigma = with_noise(RAO_GARNIER, 4, LONG, 0.01, snr, seed)
    estimate = identify(record, Structure(4, 1))
    expected = bound(RAO_GARNIER, 4, LONG, 0.01, sigma)
    assert np.all(np.abs(estimate.theta - RAO_GARNIER) < 4.0 * expected)
    # A standard error carries the sampling error of sigma and that of the point it is taken at.
    assert np.allclose(estimate.std, expected, rtol=0.06 if snr == 10 else 0.15)
    assert math.sqrt(estimate.noise_variance[0]) == pytest.approx(sigma, rel=0.04)
    assert estimate.structure.initial_state == "rest"
    assert estimate.structure.offset is False


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("snr", PRINTED)
@pytest.mark.fast("10-0", "10-1", "10-2", "10-3")
def test_rao_garnier_first_thousand_samples(snr, seed):
    u = LONG[:1000]
    record, sigma = with_noise(RAO_GARNIER, 4, u, 0.01, snr, seed)
    estimate = identify(record, Structure(4, 1))
    expected = bound(RAO_GARNIER, 4, u, 0.01, sigma)
    assert np.all(np.abs(estimate.theta - RAO_GARNIER) < 4.5 * expected)


def test_rao_garnier_without_noise():
    u = LONG[:1000]
    record = Record(u, respond(RAO_GARNIER, 4, u, 0.01), dt=0.01)
    assert np.allclose(identify(record, Structure(4, 1)).theta, RAO_GARNIER, rtol=1e-8)


# ----------------------------------------------------------------- 3 / (s^2 + 4 s + 3), 10 dB
SECOND = np.array([4.0, 3.0, 3.0])
SHORT_REGISTER = register(7, (7, 6), 1016, 8)


@pytest.mark.parametrize("seed", range(6))
def test_second_order_benchmark(seed):
    record, sigma = with_noise(SECOND, 2, SHORT_REGISTER, 0.05, 10, seed)
    estimate = identify(record, Structure(2, 0))
    expected = bound(SECOND, 2, SHORT_REGISTER, 0.05, sigma)
    assert np.all(np.abs(estimate.theta - SECOND) < 4.0 * expected)
    assert np.allclose(estimate.std, expected, rtol=0.25)


@pytest.mark.slow
def test_second_order_benchmark_with_coloured_noise_stays_near():
    """Noise with an ARMA spectrum: still consistent, no longer efficient."""
    truth = np.array([4.0, 3.0, 2.0])
    clean = respond(truth, 2, SHORT_REGISTER, 0.05)
    white = np.random.default_rng(3).standard_normal(clean.size + 200)
    noise = lfilter([1.0, 0.9], [1.0, -1.0, 0.2], white)[200:]
    noise *= np.std(clean) / np.std(noise) * 10 ** (-15 / 20)
    estimate = identify(Record(SHORT_REGISTER, clean + noise, dt=0.05), Structure(2, 0))
    assert np.allclose(estimate.theta, truth, rtol=0.35)


# ------------------------------------------------------------------------- the paper's aircraft
AIRCRAFT = np.array([1.0, 3.0, 0.5])
REST = {"offset": False, "initial_state": "rest"}


def aircraft(n_samples=100, duration=5.0):
    u, dt = np.ones(n_samples), duration / n_samples
    return Record(u, respond(AIRCRAFT, 2, u, dt), dt=dt)


def test_the_step_response_is_the_closed_form():
    record = aircraft()
    omega = math.sqrt(2.75)
    t = record.t
    decay = np.exp(-t / 2.0) * (np.cos(omega * t) + np.sin(omega * t) / (2.0 * omega))
    assert np.allclose(record.y[:, 0], (1.0 - decay) / 6.0, atol=1e-13)


@pytest.mark.parametrize(("n_samples", "duration"), [(100, 5.0), (250, 5.0), (1000, 50.0)])
def test_aircraft_table_first_row(n_samples, duration):
    """The row without noise: 3, 1, 0.5, by the default and to full precision."""
    estimate = identify(aircraft(n_samples, duration), Structure(2, 0))
    assert np.allclose(estimate.theta, AIRCRAFT, rtol=1e-8)


@pytest.mark.parametrize("gamma", [1.0, 1.7, 3.0])
@pytest.mark.parametrize("operators", ["allpass", "laguerre"])
def test_printed_steps_converge_to_the_truth_without_noise(gamma, operators):
    method = ThreeModel.paper(gamma, passes=400, tolerance=1e-12, operators=operators)
    estimate = identify(aircraft(), Structure(2, 0, **REST), method)
    assert estimate.status.ok
    assert np.allclose(estimate.theta, AIRCRAFT, rtol=1e-6)
    # Step 4 may end on Step 2, which has no beta of its own.
    distances = [p.beta_distance for p in estimate.trace.passes if math.isfinite(p.beta_distance)]
    assert distances[-1] < 1e-6
    assert distances[-1] < distances[0]


def test_printed_steps_have_a_trace_of_every_pass():
    estimate = identify(aircraft(), Structure(2, 0, **REST), ThreeModel.paper(1.7, passes=15))
    passes = estimate.trace.passes
    assert 2 <= len(passes) <= 16
    assert estimate.trace.stopped
    first = [step for entry in passes[:2] for step in entry.steps]
    assert [step.name for step in first[:3]] == ["parallel", "series-parallel", "series"]
    assert first[0].coefficients.size == 3
    assert np.allclose(first[1].coefficients[-3:], passes[0].theta)
    for entry in passes:
        assert entry.theta.shape == (3,)
        assert math.isfinite(entry.cost)
        names = [step.name for step in entry.steps]
        assert "series-parallel" in names
        for step in entry.steps:
            assert math.isfinite(step.condition)
            assert step.condition >= 1.0
            assert math.isfinite(step.cost)
            if step.name == "series":
                assert step.coefficients.size == 4
                direct = np.max(np.abs(step.coefficients - [1.0, 0.0, 0.0, 0.0]))
                assert entry.beta_distance == pytest.approx(direct, abs=1e-12)
    assert np.array_equal(passes[-1].theta, estimate.theta)


def test_first_step_is_the_least_squares_fit_of_equation_four():
    """Operators ((p - g)/(p + g))^i, i = 1..3, built here from a chain of first-order sections."""
    gamma, dt, n_samples = 1.7, 0.05, 100
    chain = np.zeros((4, 4))
    # w_i' = -gamma w_i + v_i-1 with v_i = v_i-1 - 2 gamma w_i and v_0 = x.
    for i in range(3):
        chain[i, :i] = -2.0 * gamma
        chain[i, i], chain[i, 3] = -gamma, 1.0
    step, w = expm(chain * dt), np.zeros(3)
    rows = np.empty((n_samples, 3))
    for k in range(n_samples):
        rows[k] = 1.0 - 2.0 * gamma * np.cumsum(w)
        w = step[:3, :3] @ w + step[:3, 3]
    record = aircraft()
    y = record.y[:, 0]
    expected = np.linalg.lstsq(rows, y, rcond=None)[0]
    structure = Structure(2, 0, **REST)
    steps = identify(record, structure, ThreeModel.paper(gamma, passes=1), throw=False)
    found = steps.trace.passes[0].steps[0]
    assert np.allclose(found.coefficients, expected, rtol=1e-6)
    assert found.cost == pytest.approx(np.mean((y - rows @ expected) ** 2), rel=1e-6)
    single = ThreeModel.paper(gamma, passes=1, solver="one_at_a_time")
    found = identify(record, structure, single, throw=False).trace.passes[0].steps[0]
    formula = rows.T @ y / np.sum(rows**2, axis=0)
    assert np.allclose(found.coefficients, formula, rtol=1e-9)


@pytest.mark.parametrize("order", [1, 3, 6])
def test_operators_of_equation_four_and_laguerre_functions_span_the_same_space(order):
    """With W_0 = 1 among them the fits are the same and only the conditioning differs."""
    rng = np.random.default_rng(6)
    u = np.repeat(rng.standard_normal(100), 3)
    record = Record(u, rng.standard_normal(300), dt=0.05)
    fits, conditions = [], []
    for bank in (AllPass(1.7, order), Laguerre(1.7, order)):
        columns = np.column_stack([u, apply_operators(bank, record)[:, 0, :]])
        fits.append(columns @ np.linalg.lstsq(columns, record.y[:, 0], rcond=None)[0])
        conditions.append(np.linalg.cond(columns))
    assert np.allclose(fits[0], fits[1], rtol=0, atol=1e-9)
    assert conditions[1] < 1e3


def test_printed_steps_end_at_one_place_with_either_operators():
    record = aircraft()
    y = record.y[:, 0] + 0.02 * np.random.default_rng(6).standard_normal(100)
    noisy, structure = Record(record.u, y, dt=record.dt), Structure(2, 0, **REST)
    ends = []
    for operators in ("allpass", "laguerre"):
        method = ThreeModel.paper(1.7, passes=100, operators=operators)
        ends.append(identify(noisy, structure, method).theta)
    assert np.allclose(ends[0], ends[1], rtol=1e-4)


def test_printed_steps_stop_by_rule_or_by_count():
    structure = Structure(2, 0, **REST)
    short = identify(aircraft(), structure, ThreeModel.paper(1.7, passes=2), throw=False)
    assert len(short.trace.passes) <= 3
    long = identify(aircraft(), structure, ThreeModel.paper(1.7, passes=400), throw=False)
    assert len(long.trace.passes) < 400
    assert long.status.ok
    assert long.trace.stopped != short.trace.stopped


ROOTS = {
    1: np.array([-1.0]),
    2: np.array([-1 + 2j, -1 - 2j]),
    3: np.array([-1.0, -1 + 2j, -1 - 2j]),
    4: np.array([-1.0, -2.0, -1 + 2j, -1 - 2j]),
}
ZEROS = {
    0: np.array([]),
    1: np.array([-4.0]),
    2: np.array([-3 + 1j, -3 - 1j]),
    3: np.array([-4.0, -3 + 1j, -3 - 1j]),
    4: np.array([-4.0, -5.0, -3 + 1j, -3 - 1j]),
}
ORDERS = [(n, m) for n in (1, 2, 3, 4) for m in range(n + 1)]


def example(n, m):
    """A record of 30 s without noise, its truth, and a filter of one degree more than a(p)."""
    num = 2.0 * np.real(np.poly(ZEROS[m])) if m else np.array([2.0])
    truth = np.concatenate([np.real(np.poly(ROOTS[n]))[1:], num])
    u = np.repeat(np.random.default_rng(n + 10 * m).standard_normal(150), 4)
    record = Record(u, respond(truth, n, u, 0.05), dt=0.05)
    return record, truth, tuple(np.poly(-2.0 * np.ones(n + 1)))


@pytest.mark.parametrize(("n", "m"), ORDERS)
def test_printed_steps_of_any_order(n, m):
    """Any n >= m, with operators enough for Step 1 to come near."""
    record, truth, chosen = example(n, m)
    method = ThreeModel.paper(
        2.0, 2 * n + 4, chosen, passes=400, tolerance=1e-11, operators="laguerre"
    )
    estimate = identify(record, Structure(n, m, **REST), method)
    assert np.allclose(estimate.theta, truth, rtol=1e-6)


@pytest.mark.parametrize("operators", ["allpass", "laguerre"])
@pytest.mark.parametrize("n_operators", [3, 6, 10])
@pytest.mark.parametrize(("n", "m"), [(1, 0), (2, 2), (3, 1), (3, 2), (3, 3), (4, 2)])
@pytest.mark.fast("*-laguerre", "2-2-3-allpass", "3-2-10-allpass")
def test_printed_steps_do_not_call_converged_what_is_not(n, m, n_operators, operators):
    """The goal of the repetitions is beta = (1, 0, ..., 0); standing still elsewhere is not it."""
    record, truth, chosen = example(n, m)
    method = ThreeModel.paper(2.0, n_operators, chosen, passes=200, operators=operators)
    estimate = identify(record, Structure(n, m, **REST), method, throw=False)
    assert estimate.theta.shape == truth.shape
    assert np.all(np.isfinite(estimate.theta))
    distances = [p.beta_distance for p in estimate.trace.passes if math.isfinite(p.beta_distance)]
    if estimate.status is Status.CONVERGED:
        assert distances[-1] < 1e-4, estimate.trace.stopped


@pytest.mark.parametrize(
    "options",
    [
        {"gamma": 0.0},
        {"gamma": -1.0},
        {"gamma": math.nan},
        {"gamma": 1.0, "n_operators": 0},
        {"gamma": 1.0, "filter": ()},
        {"gamma": 1.0, "filter": (1.0, math.inf, 1.0, 1.0)},
        {"gamma": 1.0, "filter": (0.0, 0.0, 0.0, 0.0)},
        {"gamma": 1.0, "passes": 0},
        {"gamma": 1.0, "operators": "fourier"},
        {"gamma": 1.0, "solver": "magic"},
    ],
    ids=str,
)
def test_printed_steps_refuse_senseless_options(options):
    with pytest.raises(err.OptionError) as caught:
        ThreeModel.paper(**options)
    assert "\n" not in str(caught.value)


def test_printed_steps_refuse_a_filter_of_too_low_degree():
    method = ThreeModel.paper(1.7, filter=(1.0, 3.0, 2.0))
    with pytest.raises(err.TridentifyError, match=r"filter|degree"):
        identify(aircraft(), Structure(2, 0, **REST), method)


def test_printed_steps_refuse_an_unstable_filter():
    with pytest.raises(err.TridentifyError):
        identify(
            aircraft(),
            Structure(2, 0, **REST),
            ThreeModel.paper(1.7, filter=(1.0, -5.0, 6.0, 7.0)),
        )
