"""Quantiles beside numpy's, and where numpy has none: between infinite samples."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify.estimation.answer.parameter import Parameter
from tridentify.numerics.quantiles import around, median, quantiles


@pytest.mark.parametrize("n", [1, 2, 7, 100])
def test_they_are_those_of_numpy(n: int) -> None:
    values, shares = np.random.default_rng(n).standard_normal(n), (0.0, 0.025, 0.5, 0.9, 1.0)
    assert np.array_equal(quantiles(values, shares), np.quantile(values, shares))
    assert median(values) == np.median(values)


def test_between_infinite_samples_the_nearer_counts() -> None:
    values = np.array([-np.inf, -np.inf, 0.0, 1.0, np.inf, np.inf])
    found = quantiles(values, (0.05, 0.28, 0.32, 0.5, 0.68, 0.75, 0.95))
    assert found.tolist() == [-np.inf, -np.inf, 0.0, 0.5, 1.0, np.inf, np.inf]


def test_draws_without_bound_have_an_interval_without_bound() -> None:
    draws = np.array([-np.inf] * 20 + [1.0] * 60 + [np.inf] * 20)
    assert Parameter("dc gain", 1.0, np.inf, "", draws).interval() == (-np.inf, np.inf)


SKEWED = np.exp(1.5 * np.random.default_rng(4).standard_normal(2001))
PLACES = [0.001, 0.02, 0.1, 0.5, 0.8, 0.999]


@pytest.mark.parametrize("share", PLACES)
def test_a_value_divides_its_interval_as_it_divides_the_draws(share):
    value = np.quantile(SKEWED, share)
    low, high = around(SKEWED, np.array(value), 0.95)
    inside = SKEWED[(low <= SKEWED) & (high >= SKEWED)]
    assert inside.size / SKEWED.size == pytest.approx(0.95, abs=0.002)
    assert np.mean(inside < value) == pytest.approx(np.mean(value > SKEWED), abs=0.002)


@pytest.mark.parametrize("value", [1e-4, 0.05, 0.3, 1.0, 20.0, 1e4])
def test_intervals_of_powers_are_powers_of_the_interval(value):
    """A natural frequency and its square, a pole and its time constant, also beyond all draws."""
    low, high = around(SKEWED, np.array(value), 0.9)
    assert 0.0 < low < value < high
    root = around(np.sqrt(SKEWED), np.array(value**0.5), 0.9)
    assert root == pytest.approx((low**0.5, high**0.5), rel=0.05)
    inverse = around(-1.0 / SKEWED, np.array(-1.0 / value), 0.9)
    assert inverse == pytest.approx((-1.0 / low, -1.0 / high), rel=0.1)


def test_there_is_room_between_a_value_and_both_ends():
    draws = np.linspace(-1.0, 3.0, 101)
    for value in (-30.0, -1.0, -0.99, 1.0, 2.99, 3.0, 50.0):
        low, high = around(draws, np.array(value), 0.95)
        assert min(value - low, high - value) >= 0.09 * (high - low)


def test_many_intervals_at_once_are_those_one_by_one():
    rng = np.random.default_rng(7)
    draws = rng.standard_normal((300, 2, 3))
    draws[:40, 0, 1], draws[:, 1, 1], draws[:3, 1, 2] = np.nan, np.nan, np.inf
    at = np.array([[0.0, 1.0, -5.0], [2.0, 0.0, np.inf]])
    low, high = around(draws, at, 0.9)
    assert np.isnan([low[1, 1], high[1, 1]]).all()
    for i, j in ((0, 0), (0, 1), (0, 2), (1, 0), (1, 2)):
        own = draws[:, i, j]
        alone = around(own[~np.isnan(own)], at[i, j], 0.9)
        assert np.array([low[i, j], high[i, j]]) == pytest.approx(np.array(alone))
    central = np.quantile(draws[3:, 1, 2], [0.05, 0.95])
    assert (low[1, 2], high[1, 2]) == pytest.approx(central, abs=0.1)


def test_draws_that_are_all_one_value_have_no_room():
    low, high = around(np.full(50, 3.0), np.array(3.0), 0.95)
    assert low == high == 3.0


def test_an_end_that_is_infinite_keeps_the_value_inside() -> None:
    draws = np.append(np.linspace(1.0, 2.0, 60), np.full(40, np.inf))
    low, high = around(draws, np.array(0.5), 0.95)
    assert low <= 0.5
    assert high == np.inf
