"""Least squares under inequalities: against the bounded solver of scipy, and its own conditions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from tridentify.estimation.knowledge.bounded import bounded_least_squares


@settings(max_examples=60)
@given(seed=st.integers(0, 10**6), n=st.integers(1, 6), spread=st.floats(0.0, 6.0))
def test_a_box_gives_what_scipy_gives(seed, n, spread):
    rng = np.random.default_rng(seed)
    scale = 10.0 ** rng.uniform(-spread, spread, n)
    matrix = rng.standard_normal((n + 4, n)) * scale
    target = rng.standard_normal(n + 4)
    free = np.linalg.lstsq(matrix / scale, target, rcond=None)[0]
    low = free + np.abs(free) * rng.standard_normal(n)
    high = low + np.abs(free) * rng.uniform(0.1, 2.0, n)
    found = bounded_least_squares(
        matrix,
        target,
        np.vstack([np.eye(n), -np.eye(n)]),
        np.concatenate([low / scale, -high / scale]),
    )
    expected = lsq_linear(matrix / scale, target, (low, high), method="bvls", tol=1e-15).x
    assert found is not None
    assert np.allclose(found.x * scale, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@settings(max_examples=60)
@given(seed=st.integers(0, 10**6), n=st.integers(1, 5), k=st.integers(1, 8))
def test_multipliers_meet_the_first_order_conditions(seed, n, k):
    rng = np.random.default_rng(seed)
    matrix, target = rng.standard_normal((n + 3, n)), rng.standard_normal(n + 3)
    rows = rng.standard_normal((k, n))
    inside = rng.standard_normal(n)
    least = rows @ inside - rng.uniform(0.0, 1.0, k)
    found = bounded_least_squares(matrix, target, rows, least)
    assert found is not None
    slack = rows @ found.x - least
    slope = matrix.T @ (matrix @ found.x - target)
    size = 1.0 + np.abs(slope).max() + np.abs(found.multipliers).max()
    assert np.all(slack > -1e-8)
    assert np.all(found.multipliers >= 0)
    assert np.allclose(slope, rows.T @ found.multipliers, atol=1e-7 * size)
    assert np.all(np.abs(found.multipliers * slack) < 1e-7 * size)


def test_without_an_active_row_it_is_least_squares():
    rng = np.random.default_rng(0)
    matrix, target = rng.standard_normal((9, 3)), rng.standard_normal(9)
    found = bounded_least_squares(matrix, target, np.eye(3), np.full(3, -1e6))
    assert found is not None
    expected = np.linalg.lstsq(matrix, target, rcond=None)[0]
    assert np.allclose(found.x, expected, rtol=1e-13)
    assert not found.multipliers.any()


@pytest.mark.parametrize(
    ("rows", "least"),
    [([[1.0], [-1.0]], [1.0, 0.0]), ([[0.0]], [1.0])],
    ids=["x above 1 and below 0", "nothing above 1"],
)
def test_rows_that_contradict_one_another_have_no_solution(rows, least):
    answer = bounded_least_squares(np.eye(1), np.zeros(1), np.array(rows), np.array(least))
    assert answer is None
