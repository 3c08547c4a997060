"""Sampled intervals: against the delta method where that is right, and where it is not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tridentify import TransferFunction, uncertainty
from tridentify.errors import OptionError, UnsupportedError
from tridentify.structure import Structure
from tridentify.uncertainty import draws
from tridentify.uncertainty.intervals import intervals

OMEGA = np.array([0.3, 2.0, 10.0])
T = np.array([0.2, 1.0, 4.0])


def shrunk(case, factor):
    """The same estimate with standard errors so small that everything is linear."""
    return dataclasses.replace(case.estimate, cov=np.asarray(case.estimate.cov) * factor**2)


def test_small_errors_agree_with_the_delta_method(double):
    estimate = shrunk(double, 1e-3)
    sample = uncertainty.sample(estimate, 20000)
    assert sample.n_unstable == 0
    pairs = []
    for q, p in zip(
        uncertainty.sampled_coefficients(sample), estimate.parameters.values(), strict=True
    ):
        pairs.append(((q.low, q.high), p.interval()))
        assert q.name == p.name
    for q, p in zip(
        uncertainty.sampled_derived(sample), uncertainty.derived(estimate), strict=True
    ):
        pairs.append(((q.low, q.high), p.interval()))
        assert (q.name, q.unit) == (p.name, p.unit)
        assert q.spread == pytest.approx(p.std, rel=0.04)
    roots = uncertainty.sampled_poles(sample)
    region = uncertainty.poles(estimate)
    for k in range(2):
        real, imag = region.interval(k)
        pairs.append(((roots.real_low[k], roots.real_high[k]), real))
        pairs.append(((roots.imag_low[k], roots.imag_high[k]), imag))
    zero = uncertainty.sampled_zeros(sample, 1, 0)
    pairs.append(
        ((zero.real_low[0], zero.real_high[0]), uncertainty.zeros(estimate, 1, 0).interval(0)[0])
    )
    for found, expected in pairs:
        width = expected[1] - expected[0]
        assert found == pytest.approx(expected, abs=0.03 * width)


@pytest.mark.slow
def test_small_errors_agree_with_the_bands(double):
    estimate = shrunk(double, 1e-3)
    sample = uncertainty.sample(estimate, 20000)
    found = uncertainty.sampled_response_band(sample, OMEGA, level=0.9)
    expected = uncertainty.response_band(estimate, OMEGA, level=0.9)
    steps = uncertainty.sampled_step_band(sample, T, 0.9)
    exact = uncertainty.step_band(estimate, T, 0.9)
    for low, high, own_low, own_high in (
        (
            found.magnitude_low,
            found.magnitude_high,
            expected.magnitude_low,
            expected.magnitude_high,
        ),
        (found.phase_low, found.phase_high, expected.phase_low, expected.phase_high),
        (steps.low, steps.high, exact.low, exact.high),
    ):
        width = own_high - own_low
        assert np.all(np.abs(low - own_low) < 0.04 * width)
        assert np.all(np.abs(high - own_high) < 0.04 * width)


def test_draws_follow_the_covariance_and_the_seed(double):
    sample = uncertainty.sample(double.estimate, 20000, seed=4)
    std = double.estimate.std
    expected = double.estimate.cov / np.outer(std, std)
    found = np.cov((sample.theta - double.estimate.theta) / std, rowvar=False)
    assert np.abs(found - expected).max() < 0.05
    again = uncertainty.sample(double.estimate, 20000, seed=4)
    assert np.array_equal(sample.theta, again.theta)
    other = uncertainty.sample(double.estimate, 20000, seed=5)
    assert not np.array_equal(sample.theta, other.theta)


def test_posterior_draws_are_taken_where_there_are_some(single):
    theta = np.asarray(single.estimate.theta)
    own = theta * np.linspace(0.9, 1.2, 50)[:, None]
    estimate = dataclasses.replace(single.estimate, draws=own)
    sample = uncertainty.sample(estimate, 50)
    assert sample.origin == "posterior"
    assert np.array_equal(np.sort(sample.theta[:, 0]), own[:, 0])
    assert len(uncertainty.sample(estimate, 400).theta) == 400
    (a1, *_) = uncertainty.sampled_coefficients(sample, 0.9)
    assert 0.9 * theta[0] < a1.low < a1.value < a1.high < 1.2 * theta[0]
    damping = uncertainty.derived(estimate)[1]
    drawn = own[:, 0] / (2.0 * np.sqrt(own[:, 1]))
    assert damping.name == "damping"
    share = np.mean(drawn < damping.value)
    ends = np.quantile(drawn, [0.1 * share, 0.9 + 0.1 * share])
    assert damping.interval(0.9) == pytest.approx(ends)
    every = uncertainty.sampled_derived(sample, 0.9)
    assert (every[1].low, every[1].high) == pytest.approx(ends)


def loose(single, theta, std):
    """A hand-made second-order estimate with independent errors."""
    channels = {
        "input_names": single.estimate.input_names,
        "output_names": single.estimate.output_names,
    }
    model = TransferFunction([theta[2]], [1.0, theta[0], theta[1]], **channels)
    return dataclasses.replace(
        single.estimate,
        model=model,
        theta=np.array(theta, float),
        cov=np.diag(np.square(std)),
    )


def test_unstable_draws_are_kept_and_counted(single):
    estimate = loose(single, (0.2, 4.0, 1.0), (0.2, 0.01, 0.01))
    sample = uncertainty.sample(estimate, 4000)
    share = 0.1587  # a1 below zero by one standard deviation
    assert sample.n_unstable == pytest.approx(4000 * share, rel=0.1)
    assert len(sample.theta) == 4000
    damping = uncertainty.sampled_derived(sample)[1]
    assert damping.low == pytest.approx(0.05 - 1.96 * 0.05, abs=0.01)
    stable = sample.stable()
    assert len(stable.theta) == 4000 - sample.n_unstable
    assert stable.n_unstable == sample.n_unstable
    assert uncertainty.sampled_derived(stable)[1].low > 0
    band = uncertainty.sampled_step_band(sample, T)
    assert np.all(np.isfinite(band.low))


def test_a_pair_that_becomes_real_keeps_its_damping(single):
    estimate = loose(single, (3.8, 4.0, 1.0), (0.3, 0.01, 0.01))
    sample = uncertainty.sample(estimate, 4000)
    frequency, damping, _ = uncertainty.sampled_derived(sample)
    assert damping.high == pytest.approx(0.95 + 1.96 * 0.075, abs=0.01)
    assert frequency.value == pytest.approx(2.0)
    assert frequency.high - frequency.low < 0.02
    roots = uncertainty.sampled_poles(sample)
    assert roots.imag_low[0] == 0.0
    assert np.all(roots.draws[:, 0].real == roots.draws[:, 1].real)


def test_repeated_pole_has_an_interval(single):
    estimate = loose(single, (4.0, 4.0, 1.0), (0.02, 0.02, 0.01))
    rows = uncertainty.sampled_derived(uncertainty.sample(estimate))
    for row in rows:
        assert np.isfinite([row.low, row.high, row.spread]).all()
        assert row.low < row.high


def test_roots_are_followed_through_a_crowd():
    reference = np.array([-1.0, -1.2 + 3j, -1.2 - 3j, -3.3, -40.0 + 1j, -40.0 - 1j])
    rng = np.random.default_rng(0)
    rows = []
    for _ in range(50):
        moved = reference * (1 + 0.02 * rng.standard_normal(6))
        moved[2], moved[5] = np.conj(moved[1]), np.conj(moved[4])
        moved[[0, 3]] = moved[[0, 3]].real
        rows.append(moved)
    expected = np.array(rows)
    shuffled = np.array([rng.permutation(row) for row in expected])
    assert draws.matched(shuffled, reference) == pytest.approx(expected)
    few = draws.matched(shuffled[:, :0], reference[:0])
    assert few.shape == (50, 0)


def test_step_values_match_the_simulation(double):
    estimate = double.estimate
    theta = uncertainty.sample(estimate, 20).theta
    values = draws.step_values(estimate, theta, T)
    num, den = Structure(2, 1).split(theta[7], 2, 1)
    model = TransferFunction(num, den)
    poles = np.roots(den[0][0])
    for i in range(2):
        residues = np.polyval(num[i][0], poles) / np.polyval(np.polyder(den[i][0]), poles)
        expected = ((residues / poles) * np.expm1(np.outer(T, poles))).sum(axis=1).real
        assert values[7, :, i, 0] == pytest.approx(expected, rel=1e-9)
    found = draws.frequency_values(estimate, theta, OMEGA)[7]
    assert found == pytest.approx(model.frequency_response(OMEGA), rel=1e-12)


def test_no_covariance_no_draws(single):
    estimate = dataclasses.replace(single.estimate, cov=np.full((3, 3), np.nan))
    with pytest.raises(UnsupportedError, match="bootstrap"):
        uncertainty.sample(estimate)


@pytest.mark.parametrize(("n_draws", "seed"), [(0, 0), (2.5, 0), (True, 0), (10, -1)])
def test_numbers_that_make_no_sense_are_refused(single, n_draws, seed):
    with pytest.raises(OptionError, match="whole number"):
        uncertainty.sample(single.estimate, n_draws, seed)


# ------------------------------------------------------------------------------ interval kinds
def test_bca_is_exact_under_a_change_of_scale():
    """Normal draws with a shifted median; the interval is the same after an exponential."""
    rng = np.random.default_rng(1)
    values = rng.standard_normal((200000, 1)) + 0.3
    low, high = intervals(values, [0.0], 0.95, "bca")
    assert (low[0], high[0]) == pytest.approx((0.3 - 1.96 - 0.6, 0.3 + 1.96 - 0.6), abs=0.03)
    bent = intervals(np.exp(values), [1.0], 0.95, "bca")
    assert (bent[0][0], bent[1][0]) == pytest.approx((np.exp(low[0]), np.exp(high[0])), rel=1e-3)


def test_draws_that_are_missing_or_infinite():
    values = np.array([[np.nan, 1.0], [1.0, np.inf], [2.0, 2.0], [3.0, 3.0]])
    low, high = intervals(values, [2.0, 2.0], 0.5)
    assert low.tolist() == [1.0, 1.25]
    assert high[0] == 3.0
    assert high[1] == np.inf
    nothing = intervals(np.full((3, 1), np.nan), [0.0], 0.5)
    assert np.isnan(nothing).all()


def test_all_draws_on_one_side_stay_within_the_draws():
    low, high = intervals(np.arange(1.0, 101.0)[:, None], [0.0], 0.95, "bca")
    assert 1.0 <= low[0] <= high[0] <= 100.0


def test_unknown_kind_is_refused():
    with pytest.raises(OptionError, match="percentile"):
        intervals(np.zeros((2, 1)), [0.0], 0.9, "exact")
