"""The parametric bootstrap and sampled intervals: what a user may rely on and may not do.

What is derived from the draws is computed again here with numpy and scipy, draw by draw.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
import pickle
import random
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.signal import step as step_response

from oracles import binary, by_exponential
from tridentify import (
    Estimate,
    OutputError,
    Record,
    Structure,
    SvfLeastSquares,
    ThreeModel,
    TridentifyError,
    identify,
    uncertainty,
)
from tridentify import errors as err
from tridentify.uncertainty import (
    bootstrap,
    sample,
    sampled_coefficients,
    sampled_derived,
    sampled_poles,
    sampled_response_band,
    sampled_step_band,
    sampled_zeros,
)

pytestmark = pytest.mark.unjudged

REST = {"offset": False, "initial_state": "rest"}
TRUTH = np.array([1.0, 3.0, 0.2, 0.5])
DT = 0.05
KINDS = ("percentile", "basic", "bca")
N_DRAWS = 60


def respond(theta, u, dt=DT):
    return by_exponential(theta[2:], np.append(1.0, theta[:2]), u, dt)


def short_period(noise=0.1, seed=0, n_samples=250):
    u = binary(n_samples)
    y = respond(TRUTH, u)
    y = y + noise * np.std(y) * np.random.default_rng(seed).standard_normal(n_samples)
    return Record(u, y, dt=DT)


@pytest.fixture(scope="module")
def record():
    return short_period()


@pytest.fixture(scope="module")
def estimate(record):
    return identify(record, Structure(2, 1, **REST), OutputError())


@pytest.fixture(scope="module")
def copies(estimate, record):
    return bootstrap(estimate, record, n_draws=N_DRAWS, seed=3)


@pytest.fixture(scope="module")
def draws(estimate):
    return sample(estimate, n_draws=1500, seed=3)


def refused(act, expected, *words):
    with pytest.raises(expected) as caught:
        act()
    message = str(caught.value)
    assert "\n" not in message
    assert "found" in message
    assert "expect" in message
    for word in words:
        assert word in message
    return message


# ------------------------------------------------------------------------------ what it is
def test_signature_is_the_promised_one():
    parameters = inspect.signature(bootstrap).parameters
    assert list(parameters)[:3] == ["estimate", "records", "method"]
    for name, default in {"n_draws": 200, "seed": 0, "progress": None}.items():
        assert parameters[name].kind is inspect.Parameter.KEYWORD_ONLY
        assert parameters[name].default == default
    assert parameters["method"].default is None
    assert uncertainty.bootstrap is bootstrap


@pytest.mark.slow
@pytest.mark.judged
def test_shapes_and_finite_numbers(copies, estimate):
    assert copies.theta.shape == copies.std_draws.shape == (N_DRAWS, 4)
    assert copies.n_draws == N_DRAWS
    assert copies.n_failed == len(copies.failures) == np.isnan(copies.theta).any(axis=1).sum()
    assert copies.seed == 3
    for vector in (copies.std, copies.spread, copies.bias, copies.median_bias):
        assert vector.shape == (4,)
        assert np.all(np.isfinite(vector))
    assert copies.bias_corrected.shape == (4,)
    assert all(name in copies.summary() for name in estimate.names)
    assert str(N_DRAWS) in copies.summary()


def test_numbers_follow_from_the_copies(copies, estimate):
    theta = copies.theta[np.isfinite(copies.theta).all(axis=1)]
    assert np.allclose(copies.bias, theta.mean(axis=0) - estimate.theta, rtol=1e-10)
    assert np.allclose(copies.std, theta.std(axis=0, ddof=1), rtol=1e-10)
    assert np.allclose(copies.median_bias, np.median(theta, axis=0) - estimate.theta, rtol=1e-10)


def test_bias_is_taken_out_on_the_scale_that_keeps_a_system_stable(copies, estimate):
    """Medians of log a1, log a0 and b/a0: every pair of this system's poles is complex."""

    def scale(theta):
        a, b = theta[..., :2], theta[..., 2:]
        return np.concatenate([np.log(a), b / a[..., 1:]], axis=-1)

    phi = 2.0 * scale(estimate.theta) - np.median(scale(copies.theta), axis=0)
    a = np.exp(phi[:2])
    expected = np.concatenate([a, phi[2:] * a[1]])
    assert np.allclose(copies.bias_corrected, expected, rtol=1e-5)


def test_copies_scatter_as_the_estimate_says(copies, estimate):
    ratio = copies.std / estimate.std
    # 60 draws: a standard deviation is known to 9 percent, here at three of those.
    assert np.all((ratio > 0.7) & (ratio < 1.35)), ratio
    assert np.allclose(np.median(copies.std_draws, axis=0), estimate.std, rtol=0.15)
    correlation = np.corrcoef(copies.theta.T)
    expected = estimate.cov / np.outer(estimate.std, estimate.std)
    assert np.all(np.abs(correlation - expected) < 0.45)


def test_copies_are_not_one_copy(copies):
    assert np.unique(copies.theta[:, 0]).size == N_DRAWS


# ------------------------------------------------------------------------ chance and its seed
def test_same_seed_same_draws_other_seed_others(estimate, record):
    one = bootstrap(estimate, record, n_draws=4, seed=11)
    two = bootstrap(estimate, record, n_draws=4, seed=11)
    other = bootstrap(estimate, record, n_draws=4, seed=12)
    assert np.array_equal(one.theta, two.theta)
    assert np.array_equal(one.std_draws, two.std_draws)
    assert not np.any(one.theta == other.theta)


def test_more_draws_begin_with_the_same_ones(estimate, record, copies):
    few = bootstrap(estimate, record, n_draws=3, seed=3)
    assert np.array_equal(few.theta, copies.theta[:3])


def test_workers_do_not_change_the_draws(estimate, record, copies):
    with ThreadPoolExecutor(2) as pool:
        shared = bootstrap(estimate, record, n_draws=5, seed=3, executor=pool)
    assert np.array_equal(shared.theta, copies.theta[:5])


def test_nobody_else_s_random_numbers_are_touched(estimate, record):
    before, plain = np.random.get_state(), random.getstate()  # noqa: NPY002
    bootstrap(estimate, record, n_draws=2)
    sample(estimate, n_draws=10)
    after = np.random.get_state()  # noqa: NPY002
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))
    assert random.getstate() == plain


def test_arguments_stay_as_they_were(estimate, record):
    before = pickle.dumps((estimate.theta, estimate.cov, record.u, record.y))
    bootstrap(estimate, record, n_draws=2)
    assert pickle.dumps((estimate.theta, estimate.cov, record.u, record.y)) == before


def test_result_is_frozen_and_pickles(copies, draws):
    for thing in (copies, draws):
        with pytest.raises(dataclasses.FrozenInstanceError):
            thing.theta = None
        with pytest.raises(ValueError, match="read-only"):
            thing.theta[0, 0] = thing.theta[0, 0]
        again = pickle.loads(pickle.dumps(thing))
        assert np.array_equal(again.theta, thing.theta, equal_nan=True)


def test_progress_is_told_in_words(estimate, record):
    words = []
    bootstrap(estimate, record, n_draws=3, progress=words.append)
    assert words
    assert all(isinstance(word, str) and word.strip() for word in words)


# --------------------------------------------------------------------------------- refusals
NUMBERS = [0, -1, 1.5, math.nan, math.inf, "20", None, True]


@pytest.mark.parametrize("n_draws", NUMBERS, ids=repr)
def test_bad_number_of_draws_is_refused(estimate, record, n_draws):
    refused(lambda: bootstrap(estimate, record, n_draws=n_draws), err.OptionError, "n_draws")
    refused(lambda: sample(estimate, n_draws=n_draws), err.OptionError, "n_draws")


def test_three_model_is_the_method_of_its_own_estimates(record):
    found = identify(record, Structure(2, 1, **REST))
    copies = bootstrap(found, record, n_draws=3)
    assert np.array_equal(copies.theta, bootstrap(found, record, ThreeModel(), n_draws=3).theta)
    assert copies.n_failed == 0


@pytest.mark.parametrize("seed", [-1, 0.5, math.nan, "seed", None], ids=repr)
def test_bad_seed_is_refused(estimate, record, seed):
    refused(lambda: bootstrap(estimate, record, n_draws=2, seed=seed), err.OptionError, "seed")
    refused(lambda: sample(estimate, n_draws=2, seed=seed), err.OptionError, "seed")


def test_one_draw_has_no_spread_and_says_so(estimate, record):
    with pytest.raises((err.OptionError, err.ConvergenceError)) as caught:
        bootstrap(estimate, record, n_draws=1)
    assert "\n" not in str(caught.value)


def test_records_of_something_else_are_refused(estimate, record):
    other = short_period(seed=9)
    two = Record(np.stack([record.u[:, 0]] * 2, 1), record.y, dt=DT)
    for wrong in (other, two, [record, record], record.slice(0.0, 5.0), []):
        refused(lambda w=wrong: bootstrap(estimate, w, n_draws=2), err.DataError)


@pytest.mark.parametrize(
    "records", [None, 3, np.zeros(9), "record"], ids=["none", "number", "array", "word"]
)
def test_what_is_no_record_is_refused(estimate, records):
    with pytest.raises((TridentifyError, TypeError), match=r"[Rr]ecord"):
        bootstrap(estimate, records, n_draws=2)


def test_what_is_no_method_is_refused(estimate, record):
    with pytest.raises((TridentifyError, TypeError), match=r"[Mm]ethod"):
        bootstrap(estimate, record, "output-error", n_draws=2)


@pytest.mark.parametrize("level", [0.0, 1.0, -0.5, 95.0, math.nan, "0.95", None], ids=repr)
def test_level_that_is_no_probability_is_refused(copies, draws, level):
    acts = [
        lambda: copies.intervals(level),
        lambda: sampled_coefficients(draws, level),
        lambda: sampled_derived(draws, level),
        lambda: sampled_poles(draws, level=level),
        lambda: sampled_response_band(draws, [1.0], level=level),
        lambda: sampled_step_band(draws, [1.0], level),
    ]
    for act in acts:
        refused(act, err.OptionError, "level")


def test_kind_of_interval_that_is_not_offered_is_refused(copies, draws):
    for act in (
        lambda: copies.intervals(0.9, "wald"),
        lambda: sampled_coefficients(draws, kind="studentized"),
        lambda: sampled_derived(copies.sample, kind=""),
    ):
        refused(act, err.OptionError, "kind")


# -------------------------------------------------------------------- intervals, by hand
@pytest.mark.parametrize("kind", [*KINDS, "studentized"])
def test_intervals_are_ordered_and_nested(copies, estimate, kind):
    narrow, wide = copies.intervals(0.5, kind), copies.intervals(0.9, kind)
    assert narrow.shape == wide.shape == (4, 2)
    assert np.all(wide[:, 0] <= narrow[:, 0])
    assert np.all(narrow[:, 0] < narrow[:, 1])
    assert np.all(narrow[:, 1] <= wide[:, 1])
    width = (wide[:, 1] - wide[:, 0]) / (2.0 * 1.645 * estimate.std)
    assert np.all((width > 0.6) & (width < 1.6)), width


def test_percentile_and_basic_are_mirror_images(copies, estimate):
    percentile, basic = copies.intervals(0.8, "percentile"), copies.intervals(0.8, "basic")
    assert np.allclose(basic, 2.0 * estimate.theta[:, None] - percentile[:, ::-1], rtol=1e-10)
    expected = np.quantile(copies.theta, [0.1, 0.9], axis=0).T
    assert np.all(np.abs(percentile - expected) < 0.35 * copies.std[:, None])


def between(quantity, values, level=0.9):
    """The interval holds about its share of the values that were computed here."""
    inside = np.mean((values >= quantity.low) & (values <= quantity.high))
    assert abs(inside - level) < 0.02, (quantity.name, inside)


def test_sampled_coefficients_are_the_covariance_again(draws, estimate):
    assert np.all(np.abs(draws.theta.mean(axis=0) - estimate.theta) < 0.1 * estimate.std)
    assert np.allclose(np.cov(draws.theta.T), estimate.cov, atol=0.1 * np.max(estimate.cov))
    rows = sampled_coefficients(draws, 0.9)
    assert [row.name for row in rows] == list(estimate.names)
    for k, row in enumerate(rows):
        assert row.value == estimate.theta[k]
        assert row.spread == pytest.approx(estimate.std[k], rel=0.08)
        between(row, draws.theta[:, k])


def test_sampled_damping_frequency_and_gain_by_hand(draws, estimate):
    rows = {row.name: row for row in sampled_derived(draws, 0.9)}
    a1, a0, _, b0 = draws.theta.T
    assert {"natural frequency", "damping", "dc gain"} <= set(rows)
    between(rows["natural frequency"], np.sqrt(a0))
    between(rows["damping"], a1 / (2.0 * np.sqrt(a0)))
    between(rows["dc gain"], b0 / a0)
    assert rows["dc gain"].value == pytest.approx(estimate.theta[3] / estimate.theta[1])
    exact = {row.name: row for row in uncertainty.derived(estimate)}
    for name, row in rows.items():
        assert row.value == pytest.approx(exact[name].value, rel=1e-9)
        assert row.spread == pytest.approx(exact[name].std, rel=0.15)


def test_sampled_poles_and_zeros_by_hand(draws, estimate):
    found = sampled_poles(draws, level=0.9)
    assert np.allclose(sorted(found.roots.imag), sorted(np.roots([1, *estimate.theta[:2]]).imag))
    upper = np.argmax(found.roots.imag)
    values = np.array([np.roots([1.0, a1, a0]).max() for a1, a0 in draws.theta[:, :2]])
    for part, low, high in (
        (values.real, found.real_low, found.real_high),
        (np.abs(values.imag), found.imag_low, found.imag_high),
    ):
        inside = np.mean((part >= low[upper]) & (part <= high[upper]))
        assert abs(inside - 0.9) < 0.02
    zero = sampled_zeros(draws, level=0.9)
    values = -draws.theta[:, 3] / draws.theta[:, 2]
    inside = np.mean((values >= zero.real_low[0]) & (values <= zero.real_high[0]))
    assert zero.roots[0] == pytest.approx(-estimate.theta[3] / estimate.theta[2])
    assert abs(inside - 0.9) < 0.02


def test_sampled_bode_band_by_hand(draws, estimate):
    omega = np.array([0.3, 1.7, 6.0])
    band = sampled_response_band(draws, omega, level=0.9)
    s = 1j * omega
    a1, a0, b1, b0 = (column[:, None] for column in draws.theta.T)
    response = (b1 * s + b0) / (s**2 + a1 * s + a0)
    centre = np.polyval(estimate.theta[2:], s) / np.polyval([1.0, *estimate.theta[:2]], s)
    assert np.allclose(band.magnitude[:, 0, 0], np.abs(centre), rtol=1e-9)
    phase = np.angle(response / centre) + band.phase[:, 0, 0]
    for k in range(omega.size):
        size = np.abs(response[:, k])
        low, high = band.magnitude_low[k, 0, 0], band.magnitude_high[k, 0, 0]
        assert abs(np.mean((size >= low) & (size <= high)) - 0.9) < 0.02
        low, high = band.phase_low[k, 0, 0], band.phase_high[k, 0, 0]
        assert abs(np.mean((phase[:, k] >= low) & (phase[:, k] <= high)) - 0.9) < 0.02


@pytest.mark.slow
def test_sampled_step_band_by_hand(draws, estimate):
    t = np.array([0.0, 0.4, 1.5, 6.0])
    band = sampled_step_band(draws, t, 0.9)
    fine = np.linspace(0.0, 6.0, 61)
    pick = [0, 4, 15, 60]
    centre = step_response((estimate.theta[2:], [1.0, *estimate.theta[:2]]), T=fine)[1][pick]
    assert np.allclose(band.response[:, 0, 0], centre, atol=1e-8)
    every = draws.theta[::5]
    runs = np.array([step_response((p[2:], [1.0, *p[:2]]), T=fine)[1][pick] for p in every])
    for k in range(1, t.size):
        inside = np.mean((runs[:, k] >= band.low[k, 0, 0]) & (runs[:, k] <= band.high[k, 0, 0]))
        assert abs(inside - 0.9) < 0.05
    assert band.low[0, 0, 0] == band.high[0, 0, 0] == 0.0


def test_everything_sampled_takes_a_bootstrap_too(copies):
    for kind in KINDS:
        assert len(sampled_coefficients(copies.sample, 0.9, kind=kind)) == 4
        assert all(row.low < row.high for row in sampled_derived(copies.sample, 0.9, kind=kind))
        assert np.all(sampled_poles(copies.sample, level=0.9, kind=kind).real_low < 0)
        assert np.isfinite(sampled_response_band(copies.sample, [1.0], kind=kind).phase).all()
        assert np.isfinite(sampled_step_band(copies.sample, [1.0], kind=kind).low).all()
    assert copies.sample.origin == "bootstrap"


# ----------------------------------------------------------------------- other circumstances
def test_method_of_the_estimate_is_used_unless_another_is_given(record):
    structure = Structure(2, 1, **REST)
    biased = identify(record, structure, SvfLeastSquares())
    copies = bootstrap(biased, record, n_draws=3)
    assert copies.estimate is biased
    named = bootstrap(biased, record, SvfLeastSquares(), n_draws=3)
    other = bootstrap(biased, record, OutputError(), n_draws=3)
    assert np.array_equal(copies.theta, named.theta)
    assert not np.array_equal(copies.theta, other.theta)


def test_estimate_that_was_kept_is_as_good(record, tmp_path):
    method = SvfLeastSquares([1.0, 12.0, 36.0])
    biased = identify(record, Structure(2, 1, **REST), method)
    given = bootstrap(biased, record, method, n_draws=3)
    again = bootstrap(
        Estimate.load(biased.save(tmp_path / "model.json")), record, method, n_draws=3
    )
    assert np.array_equal(given.theta, again.theta)


@pytest.mark.slow
def test_offset_free_state_and_two_records():
    first, second = short_period(seed=1), short_period(seed=2, n_samples=200)
    moved = Record(second.u, second.y + 9.0, dt=DT)
    structure = Structure(2, 1, offset=True, initial_state="free")
    found = identify([first, moved], structure, OutputError())
    copies = bootstrap(found, [first, moved], n_draws=25)
    assert copies.n_failed == 0
    ratio = copies.std / found.std
    assert np.all((ratio > 0.55) & (ratio < 1.6)), ratio
    refused(lambda: bootstrap(found, [moved, first], n_draws=2), err.DataError)


def test_choices_left_to_the_data_are_held(record):
    found = identify(record, Structure(2, 1))
    copies = bootstrap(found, record, n_draws=5)
    assert copies.n_failed == 0
    assert copies.estimate.structure == found.structure


@pytest.mark.slow
def test_missing_samples_stay_missing(record):
    """Half of the output is gone: the copies must be as uncertain as the estimate."""
    y = record.y[:, 0].copy()
    y[::2] = np.nan
    holed = Record(record.u, y, dt=DT)
    found = identify(holed, Structure(2, 1, **REST), OutputError())
    copies = bootstrap(found, holed, n_draws=25)
    full = identify(record, Structure(2, 1, **REST), OutputError())
    assert np.all(found.std > 1.2 * full.std)
    assert np.median(copies.std_draws / found.std) == pytest.approx(1.0, abs=0.15)


def test_record_without_noise_has_copies_without_spread(record):
    clean = Record(record.u, respond(TRUTH, record.u[:, 0]), dt=DT)
    found = identify(clean, Structure(2, 1, **REST), OutputError())
    copies = bootstrap(found, clean, n_draws=4)
    assert np.all(copies.std < 1e-6)
    assert np.allclose(copies.theta, TRUTH, rtol=1e-6)


def test_units_scale_the_copies(record, estimate, copies):
    big = Record(record.u, 2.0**20 * record.y, dt=DT)
    found = identify(big, Structure(2, 1, **REST), OutputError())
    scaled = bootstrap(found, big, n_draws=5, seed=3)
    factor = np.array([1.0, 1.0, 2.0**20, 2.0**20])
    assert np.all(np.abs(scaled.theta / factor - copies.theta[:5]) < 0.01 * estimate.std)


@pytest.mark.slow
def test_coloured_noise_is_drawn_coloured():
    """With noise drawn white the copies would scatter far too little here."""
    rng, u = np.random.default_rng(5), binary(600)
    clean = respond(TRUTH, u)
    noise = lfilter([1.0], [1.0, -0.9], rng.standard_normal(1600))[1000:]
    record = Record(u, clean + 0.2 * np.std(clean) * noise / np.std(noise), dt=DT)
    found = identify(record, Structure(2, 1, **REST), ThreeModel(noise="ar"))
    steps = 1e-5 * np.eye(len(TRUTH))
    slopes = np.stack([(respond(TRUTH + h, u) - respond(TRUTH - h, u)) / 2e-5 for h in steps])
    white = 0.2 * np.std(clean) * np.sqrt(np.diag(np.linalg.inv(slopes @ slopes.T)))
    k = int(np.argmax(found.std / white))
    assert found.std[k] > 1.5 * white[k], "the record must show the difference"
    copies = bootstrap(found, record, ThreeModel(noise="ar"), n_draws=40)
    assert copies.std[k] == pytest.approx(found.std[k], rel=0.4)


@pytest.mark.judged
def test_failures_are_counted_and_named_not_hidden():
    """A record at the edge: noise as large as the signal, few samples, one order too many."""
    record = short_period(noise=1.5, n_samples=40, seed=2)
    try:
        found = identify(record, Structure(3, 2, **REST), OutputError(), throw=False)
    except TridentifyError:
        pytest.skip("the record itself is refused")
    try:
        copies = bootstrap(found, record, n_draws=10)
    except err.ConvergenceError as refusal:
        message = str(refusal)
        assert "found" in message
        return
    rows = np.flatnonzero(np.isnan(copies.theta).any(axis=1))
    assert [failure.draw for failure in copies.failures] == rows.tolist()
    assert all(failure.reason.strip() for failure in copies.failures)
    assert copies.n_flagged <= 10 - copies.n_failed
    assert np.all(np.isfinite(copies.intervals(0.5, "percentile")))
    assert copies.summary()
