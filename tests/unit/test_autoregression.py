"""Autoregressive noise against dense covariance matrices and against known processes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from tridentify.numerics.autoregression import (
    Whitener,
    burg,
    deviance,
    fit_autoregression,
    most_coefficients,
    whiten,
)
from tridentify.numerics.innovation_slopes import innovations_by
from tridentify.numerics.levinson import autocovariance, polynomial, reflections
from tridentify.numerics.whiteness import input_share, is_white

SETTLING = 3000


def process(a, n, rng, numerator=(1.0,)):
    e = rng.standard_normal(n + SETTLING)
    return lfilter(numerator, np.append(1.0, a), e)[SETTLING:]


def impulse_covariance(a, n_lags):
    """From the impulse response: a route of its own."""
    h = lfilter([1.0], np.append(1.0, a), np.append(1.0, np.zeros(20_000)))
    return np.array([h[: h.size - k] @ h[k:] for k in range(n_lags + 1)])


@given(st.lists(st.floats(-0.95, 0.95), min_size=0, max_size=8))
def test_reflections_undo_the_polynomial(k):
    a = polynomial(np.array(k))
    assert np.allclose(reflections(a), k, atol=1e-6)
    assert np.all(np.abs(np.roots(np.append(1.0, a))) < 1.0)


@pytest.mark.parametrize("k", [[0.5], [-0.9, 0.3], [0.2, -0.4, 0.1, 0.6]])
def test_autocovariance_is_that_of_the_impulse_response(k):
    a = polynomial(np.array(k))
    assert np.allclose(autocovariance(a, 12), impulse_covariance(a, 12), rtol=1e-10)
    # fewer lags than coefficients
    assert np.allclose(autocovariance(a, 1), impulse_covariance(a, 1), rtol=1e-10)


def test_autocovariance_refuses_a_process_that_is_not_stationary():
    with pytest.raises(ValueError, match="not stationary"):
        autocovariance(np.array([-1.0]), 3)


@pytest.mark.parametrize("missing", [0.0, 0.1, 0.6])
@pytest.mark.parametrize("order", [1, 2, 5])
@pytest.mark.parametrize("block", [1, 7, 60])
def test_innovations_are_those_of_the_dense_covariance(order, missing, block):
    rng = np.random.default_rng(order)
    n = 60
    a = polynomial(rng.uniform(-0.9, 0.9, order))
    seen = rng.random(n) >= missing
    rows = rng.standard_normal((3, n))
    covariance = toeplitz(autocovariance(a, n - 1))[np.ix_(seen, seen)]
    expected = np.linalg.solve(np.linalg.cholesky(covariance), rows[:, seen].T).T
    whitener = Whitener(a, 3)
    parts = [
        whitener.apply(rows[:, k : k + block], seen[k : k + block]) for k in range(0, n, block)
    ]
    found = np.hstack(parts)
    assert np.allclose(found[:, seen], expected, rtol=0, atol=1e-9)
    assert not found[:, ~seen].any()
    assert whitener.log_scale == pytest.approx(np.linalg.slogdet(covariance)[1], abs=1e-9)


def test_white_noise_is_left_alone():
    values = np.array([1.0, np.nan, 3.0])
    innovations, log_scale = whiten(values, np.zeros(0))
    assert np.array_equal(innovations, values, equal_nan=True)
    assert log_scale == 0.0


def test_deviance_is_the_likelihood_of_the_dense_covariance():
    rng = np.random.default_rng(1)
    a = np.array([-0.7, 0.2])
    series = [process(a, 80, rng), process(a, 50, rng)]
    series[0][[5, 6, 30]] = np.nan
    energy, log_determinant, count = 0.0, 0.0, 0
    for one in series:
        seen = np.isfinite(one)
        covariance = toeplitz(autocovariance(a, one.size - 1))[np.ix_(seen, seen)]
        energy += one[seen] @ np.linalg.solve(covariance, one[seen])
        log_determinant += np.linalg.slogdet(covariance)[1]
        count += seen.sum()
    expected = count * np.log(energy / count) + log_determinant
    assert deviance(series, a) == pytest.approx(expected, rel=1e-12)


def test_burg_gives_every_order_and_the_power_that_is_left():
    a = np.array([-1.2, 0.6])
    series = process(a, 20_000, np.random.default_rng(2))
    reflection, power = burg([series], 4)
    assert np.allclose(reflection, [*reflections(a), 0.0, 0.0], atol=0.03)
    assert power[0] == pytest.approx(np.mean(series**2))
    assert power[2] == pytest.approx(1.0, abs=0.03)


def test_burg_does_not_predict_across_gaps_or_from_one_series_to_the_next():
    rng = np.random.default_rng(3)
    one, other = rng.standard_normal(50), rng.standard_normal(40)
    joined = np.concatenate([one, [np.nan], other])
    apart, together = burg([one, other], 3), burg([joined], 3)
    assert np.allclose(apart[0], together[0])
    assert not np.allclose(apart[0], burg([np.concatenate([one, other])], 3)[0], atol=1e-4)


def test_order_is_that_of_the_process():
    rng = np.random.default_rng(4)
    found = [fit_autoregression([process([-1.2, 0.6], 2000, rng)], 20).size for _ in range(40)]
    assert min(found) == 2
    assert np.mean(np.array(found) == 2) > 0.5


@pytest.mark.parametrize("missing", [0.0, 0.4])
def test_coefficients_reach_the_asymptotic_spread(missing):
    """AR(1): variance (1 - a^2) / N; missing samples only cost information."""
    rng = np.random.default_rng(5)
    found = []
    for _ in range(60):
        series = process([-0.8], 500, rng)
        series[rng.random(500) < missing] = np.nan
        found.append(fit_autoregression([series], 10, order=1)[0])
    spread = np.sqrt((1 - 0.64) / 500)
    assert np.mean(found) == pytest.approx(-0.8, abs=0.02)
    assert 0.8 * spread < np.std(found) < 1.3 * spread / np.sqrt(1 - missing)


def test_missing_samples_use_the_exact_likelihood():
    """Stretches of three samples: most of what is known lies across the gaps."""
    rng = np.random.default_rng(6)
    series = process([-1.2, 0.6], 6000, rng)
    series[3::4] = np.nan
    found = fit_autoregression([series], 10, order=2)
    assert np.allclose(found, [-1.2, 0.6], atol=0.05)
    rest = deviance([series], found)
    for step in np.vstack([np.eye(2), -np.eye(2)]):
        assert deviance([series], found + 0.01 * step) > rest


def test_whiteness_test_is_rarely_wrong_and_sees_little_colour():
    rng = np.random.default_rng(7)
    alarms = sum(not is_white([rng.standard_normal(400)]) for _ in range(1000))
    # 1 percent, and three binomial standard deviations
    assert 1 <= alarms <= 20
    for a, numerator in (([-0.25], (1.0,)), ([], (1.0, 0.3)), ([0, 0, 0, -0.3], (1.0,))):
        seen = [not is_white([process(a, 1000, rng, numerator)]) for _ in range(50)]
        assert np.mean(seen) > 0.9


def test_whiteness_test_allows_for_missing_samples():
    rng = np.random.default_rng(8)
    alarms = 0
    for _ in range(500):
        series = rng.standard_normal(400)
        series[rng.random(400) < 0.5] = np.nan
        alarms += not is_white([series])
    assert alarms <= 13


@pytest.mark.parametrize(
    ("n", "expected"), [(0, 0), (19, 0), (50, 5), (100, 10), (1000, 30), (10**6, 60)]
)
def test_most_coefficients_grow_slowly(n, expected):
    assert most_coefficients(n) == expected


def test_input_share_tells_a_missed_response_from_coloured_noise():
    rng = np.random.default_rng(9)
    u = np.repeat(rng.choice([-1.0, 1.0], 250), 4)[:, None]
    noise = process([-0.95], 1000, rng)
    a = fit_autoregression([noise], 20)
    share, statistic, dimension = input_share(noise, u, a)
    assert share < 0.05
    assert statistic < 3 * dimension
    response = lfilter([0.1], [1.0, -0.9], u[:, 0])
    assert input_share(response, u, fit_autoregression([response], 20))[0] > 0.5


def test_samples_that_all_stand_alone_are_white_whatever_order_is_asked_for():
    series = np.random.default_rng(1).standard_normal(30)
    series[1::2] = np.nan
    assert fit_autoregression([series], 3, 3).size == 0


@given(st.lists(st.floats(-0.8, 0.8), min_size=1, max_size=6), st.integers(0, 1000))
def test_derivatives_of_the_innovations_hold_at_the_first_samples_too(k, seed):
    a, series = polynomial(np.array(k)), np.random.default_rng(seed).standard_normal(12)
    ways = 1e-6 * np.eye(a.size)
    by_difference = [(whiten(series, a + d)[0] - whiten(series, a - d)[0]) / 2e-6 for d in ways]
    found = innovations_by(a, series, np.ones(series.size, dtype=bool))
    np.testing.assert_allclose(found, np.column_stack(by_difference), rtol=1e-4, atol=1e-4)
