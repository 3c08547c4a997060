"""Triangles and small solves against numpy."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify.numerics.kernels.robust_fit import robustly
from tridentify.numerics.lagrange import span
from tridentify.numerics.least_squares import Accumulator, least, solve, triangle


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def gram(rows):
    return rows.T @ rows


def accumulate(rows, block, first_at=()):
    """Feed rows in blocks; ``first_at`` says from which row on how many columns are zero."""
    accumulator = Accumulator(rows.shape[1], block)
    for start in range(0, rows.shape[0], block):
        part = rows[start : start + block]
        first = max((columns for row, columns in first_at if start >= row), default=0)
        accumulator.buffer[first:, : len(part)] = part.T[first:]
        accumulator.absorb(len(part), first)
    return accumulator.r


@pytest.mark.parametrize(("m", "n"), [(10, 4), (4, 4), (3, 6)])
def test_triangle_keeps_all_inner_products(rng, m, n):
    rows = rng.standard_normal((m, n))
    r = triangle(rows)
    assert r.shape == (min(m, n), n)
    assert not np.tril(r, -1).any()
    assert gram(r) == pytest.approx(gram(rows))


@pytest.mark.parametrize("n", [1, 2, 9, 30])
@pytest.mark.parametrize("block", [1, 7, 64, 200])
def test_blocks_add_up_to_the_triangle_of_the_whole(rng, n, block):
    rows = rng.standard_normal((200, n))
    r = accumulate(rows, block)
    assert r.shape == (n, n)
    assert not np.tril(r, -1).any()
    expected = np.linalg.qr(rows, mode="r")
    assert np.abs(r) == pytest.approx(np.abs(expected), rel=1e-9, abs=1e-12)
    assert gram(r) == pytest.approx(gram(rows), abs=1e-10)


def test_fewer_rows_than_columns_leave_zeros(rng):
    rows = rng.standard_normal((3, 6))
    r = accumulate(rows, 8)
    assert r.shape == (6, 6)
    assert gram(r) == pytest.approx(gram(rows), abs=1e-12)


def test_columns_known_to_be_zero_may_be_left_out(rng):
    rows = rng.standard_normal((90, 7))
    rows[30:, :3] = 0.0
    assert accumulate(rows, 10, [(30, 3)]) == pytest.approx(accumulate(rows, 10), abs=1e-12)


def test_what_lies_in_columns_left_out_is_not_read(rng):
    rows = rng.standard_normal((40, 5))
    rows[20:, :2] = 0.0
    accumulator = Accumulator(5, 20)
    accumulator.buffer[:] = rows[:20].T
    accumulator.absorb(20)
    accumulator.buffer[:2] = np.nan
    accumulator.buffer[2:] = rows[20:, 2:].T
    accumulator.absorb(20, 2)
    assert gram(accumulator.r) == pytest.approx(gram(rows), abs=1e-12)


def test_residuals_of_any_combination_follow_from_the_triangle(rng):
    rows, pick = rng.standard_normal((500, 6)), rng.standard_normal((5, 2))
    r = accumulate(rows, 128)
    direct = solve(rows[:, :5] @ pick, rows[:, 5])
    reduced = solve(r[:, :5] @ pick, r[:, 5])
    assert reduced.x == pytest.approx(direct.x, rel=1e-11)
    assert reduced.cost == pytest.approx(direct.cost, rel=1e-11)
    assert reduced.condition == pytest.approx(direct.condition, rel=1e-11)


def test_solution_is_that_of_numpy(rng):
    matrix, target = rng.standard_normal((40, 6)), rng.standard_normal(40)
    found = solve(matrix, target)
    x, (cost,), *_ = np.linalg.lstsq(matrix, target, rcond=None)
    assert found.x == pytest.approx(x)
    assert found.cost == pytest.approx(cost)
    assert found.basis.T @ found.basis == pytest.approx(np.eye(6), abs=1e-13)
    assert found.basis @ (found.basis.T @ matrix) == pytest.approx(matrix, abs=1e-12)


def test_condition_is_that_of_unit_columns_whatever_the_units(rng):
    matrix, target = rng.standard_normal((40, 3)), rng.standard_normal(40)
    units = np.array([1e-12, 1.0, 1e9])
    plain, scaled = solve(matrix, target), solve(matrix * units, target)
    unit = matrix / np.linalg.norm(matrix, axis=0)
    assert plain.condition == pytest.approx(np.linalg.cond(unit))
    assert scaled.condition == pytest.approx(plain.condition)
    assert scaled.x * units == pytest.approx(plain.x)


def test_a_column_of_zeros_gets_nothing_and_says_so(rng):
    matrix, target = rng.standard_normal((20, 3)), rng.standard_normal(20)
    matrix[:, 1] = 0.0
    found = solve(matrix, target)
    expected = np.linalg.lstsq(matrix[:, [0, 2]], target, rcond=None)[0]
    assert found.x[[0, 2]] == pytest.approx(expected)
    assert found.x[1] == 0.0
    assert found.condition == np.inf
    assert found.basis.shape == (20, 2)


def test_dependent_columns_share_and_the_cost_is_still_the_least(rng):
    matrix, target = rng.standard_normal((20, 2)), rng.standard_normal(20)
    found = solve(np.column_stack([matrix, matrix[:, 0]]), target)
    assert found.cost == pytest.approx(solve(matrix, target).cost)
    assert found.x[0] == pytest.approx(found.x[2])
    assert found.condition > 1e13


def test_no_columns_leave_the_target(rng):
    target = rng.standard_normal(5)
    found = solve(np.zeros((5, 0)), target)
    assert (found.x.size, found.cost) == (0, pytest.approx(target @ target))


@pytest.mark.parametrize("size", [1.0, 1e-6, 1e-11])
def test_what_stands_in_for_a_singular_value_is_never_above_it(rng, size):
    """The bound from the inverse, also where a column is all but a combination of the others."""
    for _ in range(20):
        rows = rng.standard_normal((30, 5))
        rows[:, 4] = rows[:, :4] @ rng.standard_normal(4) + size * rows[:, 4]
        of = triangle(rows)
        smallest = np.linalg.svd(of, compute_uv=False)[-1]
        assert 0.1 * smallest < least(of) <= smallest


@pytest.mark.parametrize("size", [1.0, 1e-5, 1e-12, 0.0])
def test_what_a_fit_leaves_is_what_lstsq_leaves_whatever_the_rank(rng, size):
    rows, target = rng.standard_normal((30, 5)), rng.standard_normal(30)
    rows[:, 4] = rows[:, :4] @ rng.standard_normal(4) + size * rows[:, 4]
    wanted, left = target - rows @ np.linalg.lstsq(rows, target, rcond=1e-9)[0], np.empty(30)
    robustly(np.ascontiguousarray(span(rows, cutoff=1e-9).T), target, 1, 0.0, left)
    assert np.linalg.norm(left - wanted) <= 1e-9 * np.linalg.norm(target)
