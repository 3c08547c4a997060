"""Score tests of added columns and the moments of a fit's autocorrelation, by dense matrices."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy import stats

from tridentify.judgement.validation.statistics.distribution import distribution
from tridentify.numerics.lagrange import added, holm, span
from tridentify.numerics.portmanteau import autocorrelation_of_fit, portmanteau


def test_the_test_of_added_columns_is_that_of_two_regressions():
    rng = np.random.default_rng(0)
    b, z, y = rng.standard_normal((40, 3)), rng.standard_normal((40, 2)), rng.standard_normal(40)
    z[:, 1] += b @ [1.0, 2.0, 3.0]

    def left(columns):
        return np.linalg.lstsq(columns, y, rcond=None)[1][0]

    small, large = left(b), left(np.hstack([b, z]))
    expected = (small - large) / 2 / (large / 35)
    q = span(b)
    found = added(y, q, span(z, q), 40)
    assert found.statistic == pytest.approx(expected, rel=1e-10)
    assert (found.dimension, found.freedom) == (2, 35)
    assert found.p_value == pytest.approx(stats.f.sf(expected, 2, 35), rel=1e-9)
    assert found.share == pytest.approx(1 - large / small)


def test_columns_that_hold_nothing_new_are_not_tested():
    rng = np.random.default_rng(1)
    b = rng.standard_normal((20, 3))
    q = span(b)
    assert span(b @ rng.standard_normal((3, 2)), q).shape == (20, 0)
    assert added(rng.standard_normal(20), q, np.zeros((20, 0)), 20).p_value == 1.0


def test_holm_stops_at_the_first_that_is_kept():
    assert holm(np.array([0.02, 0.004, 0.9, 0.004]), 0.01).tolist() == [False] * 4
    assert holm(np.array([0.02, 0.002, 0.9, 0.003]), 0.01).tolist() == [False, True, False, True]


@pytest.mark.parametrize("gaps", [False, True])
def test_the_moments_of_the_autocorrelation_are_exact(gaps):
    rng = np.random.default_rng(2)
    sizes = (17, 12)
    seen = [np.ones(n) for n in sizes]
    if gaps:
        seen[0][[3, 4, 9]] = 0.0
    mask = np.concatenate(seen)
    q = span(rng.standard_normal((29, 4)) * mask[:, None])
    m = np.diag(mask) - q @ q.T
    blocks = [np.split(q, [17])[k] for k in range(2)]
    e = m @ rng.standard_normal(29)
    found = autocorrelation_of_fit(np.split(e, [17]), seen, blocks, 5)
    shifts, pairs = [], []
    for k in range(1, 6):
        shift = np.zeros((29, 29))
        for start, n in ((0, 17), (17, 12)):
            for i in range(n - k):
                shift[start + i, start + i + k] = shift[start + i + k, start + i] = 0.5
        shift *= np.outer(mask, mask)
        a = m @ shift @ m
        freedom = mask.sum() - 4
        mean = np.trace(a) / freedom
        second = (np.trace(a) ** 2 + 2 * np.trace(a @ a)) / (freedom * (freedom + 2))
        assert found.value[k - 1] == pytest.approx(e @ shift @ e / (e @ e))
        assert found.mean[k - 1] == pytest.approx(mean)
        assert found.std[k - 1] == pytest.approx(np.sqrt(second - mean**2))
        shifts.append((a, mean))
    if not gaps:
        for (a, one), (b, other) in pairwise(shifts):
            k = len(pairs)
            cov = 2 * np.trace(a @ b) + one * other * freedom**2
            pairs.append(cov / (freedom * (freedom + 2)) - one * other)
            together = found.together[k, k + 1] * found.std[k] * found.std[k + 1]
            assert together == pytest.approx(pairs[-1])


@pytest.mark.slow
def test_a_noise_model_costs_the_statistic_its_degrees_of_freedom():
    rng = np.random.default_rng(3)
    total, none = [], np.zeros((400, 0))
    for _ in range(200):
        v = np.zeros(500)
        for k in range(1, 500):
            v[k] = 0.6 * v[k - 1] + rng.standard_normal()
        v = v[100:]
        a = -(v[1:] @ v[:-1]) / (v[:-1] @ v[:-1])
        e = np.append(v[0], v[1:] + a * v[:-1])
        found = autocorrelation_of_fit([e], [np.ones(400)], [none], 12)
        test = portmanteau(found, np.array([a]))
        assert test.freedom == (1, 4, 11)
        total.append(test.statistics)
    assert np.mean(total, axis=0) == pytest.approx([1.0, 4.0, 11.0], rel=0.2)


@pytest.mark.parametrize("n", [100, 1500])
@pytest.mark.slow
def test_white_noise_is_rejected_as_often_as_stated(n):
    t = np.linspace(0, 15, n)
    slow = np.stack([np.ones(n), np.exp(-t), t * np.exp(-t), np.exp(-2 * t), t**2 * np.exp(-t)])
    q = span(slow.T)
    lags = 25
    found = autocorrelation_of_fit([np.zeros(n)], [np.ones(n)], [q], lags)
    draws = 4000 if n < 500 else 2000
    e = np.random.default_rng(4).standard_normal((draws, n))
    e -= (e @ q) @ q.T
    values = np.stack([np.sum(e[:, k:] * e[:, :-k], axis=1) for k in range(1, lags + 1)], axis=1)
    values /= np.sum(e * e, axis=1, keepdims=True)
    tests = [portmanteau(found._replace(value=v), np.zeros(0)) for v in values]
    rate = 0.01
    p_values = np.array([one.p_values for one in tests])
    rejected = np.sum(p_values < rate, axis=0)
    # within three standard deviations of what is stated
    chance = 3.0 * np.sqrt(draws * rate)
    assert np.all(np.abs(rejected - draws * rate) < chance)
    if n == 100:
        chi_square = stats.chi2.sf([one.statistics[-1] for one in tests], lags)
        assert np.sum(chi_square < rate) > draws * rate + 2 * chance


def test_the_test_of_the_distribution_is_that_of_dagostino_and_pearson():
    rng = np.random.default_rng(11)
    draws = (rng.standard_normal(20), rng.standard_exponential(100), rng.standard_t(3, 1000))
    for values in draws:
        found = distribution("y", [values], [np.arange(values.size, dtype=float)], 0.001)
        assert found.p_value == pytest.approx(stats.normaltest(values).pvalue, rel=1e-9)
        assert found.skewness == pytest.approx(stats.skew(values), rel=1e-12)
