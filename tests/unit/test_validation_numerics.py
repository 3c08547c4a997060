"""Score tests of added columns and the moments of a fit's autocorrelation, by dense matrices."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from tridentify.judgement.validation.distribution import distribution
from tridentify.numerics.lagrange import added, holm, span
from tridentify.numerics.portmanteau import (
    autocorrelation_of_fit,
    portmanteau,
    spread_of_statistics,
)


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


def test_a_short_record_has_a_longer_tail_than_chi_square():
    t = np.linspace(0, 15, 100)
    slow = np.stack([np.ones(100), np.exp(-t), t * np.exp(-t), np.exp(-2 * t), t**2 * np.exp(-t)])
    q = span(slow.T)
    seen = [np.ones(100)]
    found = autocorrelation_of_fit([np.zeros(100)], seen, [q], 10)
    spread = spread_of_statistics(found, np.zeros(0), seen, [q])
    assert spread[:, 0] == pytest.approx([1.0, 4.0, 10.0], rel=0.1)
    assert spread[-1, 1] > 1.2 * 20.0
    e = np.random.default_rng(4).standard_normal((4000, 100))
    e -= (e @ q) @ q.T
    values = np.stack([np.sum(e[:, k:] * e[:, :-k], axis=1) for k in range(1, 11)], axis=1)
    values /= np.sum(e * e, axis=1, keepdims=True)
    short = sum(
        portmanteau(found._replace(value=v), np.zeros(0)).p_values[-1] < 0.003 for v in values
    )
    right = sum(
        portmanteau(found._replace(value=v), np.zeros(0), spread).p_values[-1] < 0.003
        for v in values
    )
    assert short > 22
    assert right < 22


def test_the_test_of_the_distribution_is_that_of_dagostino_and_pearson():
    rng = np.random.default_rng(11)
    draws = (rng.standard_normal(20), rng.standard_exponential(100), rng.standard_t(3, 1000))
    for values in draws:
        found = distribution("y", [values], [np.arange(values.size, dtype=float)], 0.001)
        assert found.p_value == pytest.approx(stats.normaltest(values).pvalue, rel=1e-9)
        assert found.skewness == pytest.approx(stats.skew(values), rel=1e-12)
