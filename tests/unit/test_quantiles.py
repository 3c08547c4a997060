"""Quantiles beside numpy's, and where numpy has none: between infinite samples."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify.estimation.answer.parameter import Parameter
from tridentify.numerics.quantiles import median, quantiles


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
