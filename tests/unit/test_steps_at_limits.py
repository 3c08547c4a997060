"""Steps that leave slow poles at their limit, and steps that know the curvature of the last one."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from tridentify.estimation.likelihood.cost import evaluate
from tridentify.estimation.likelihood.held_poles import at_slow_limit, conditions, left_by, moved
from tridentify.estimation.likelihood.minimum.bend import LEAST_BEND, MOST_BEND, bend_of
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import finish
from tridentify.estimation.likelihood.setup.problem import TOO_SLOW, Problem
from tridentify.estimation.likelihood.step import Bend
from tridentify.models.regression import Experiment
from tridentify.numerics.realization import cascade, roots_of, row_of

DT = 0.1


def made(*, seed=0, n=240, poles=2, zeros=1, **terms) -> Problem:
    """Integrated noise, which no model of the set explains."""
    rng = np.random.default_rng(seed)
    u = np.ascontiguousarray(rng.standard_normal((n, 1)).cumsum(axis=0))
    y = rng.standard_normal((n, 1)).cumsum(axis=0)
    chosen = {"intersample": "zoh", "free": False, "offset": True, "drift": False} | terms
    return Problem.of([Experiment(u, y, DT, noise=(), **chosen)], poles, ((zeros,),))


@pytest.mark.parametrize(
    "poles",
    [[-1.0], [-0.3, -4.0], [-0.5 + 3j, -0.5 - 3j, -1.0], [-2 + 1j, -2 - 1j, -0.1 + 5j, -0.1 - 5j]],
)
def test_row_of_undoes_roots_of(poles):
    bank = cascade(np.array(poles, dtype=complex))
    wanted = np.sort_complex(np.array(poles) * 1.4 - 0.2)
    row = row_of(bank, wanted)
    assert row is not None
    np.testing.assert_allclose(np.sort_complex(roots_of(bank, row)), wanted, rtol=1e-9)


def test_row_of_says_nothing_where_poles_coincide():
    assert row_of(cascade(np.array([-1.0, -1.0 - 1e-7])), np.array([-2.0, -3.0])) is None


@pytest.mark.parametrize("poles", [[-0.2, -1.5], [-0.4 + 2j, -0.4 - 2j], [-0.2, -0.4 + 2j]])
def test_poles_move_as_finite_differences_say(poles):
    given = np.array(poles, dtype=complex)
    if given.size == 2 and given[1].imag == 2:
        given = np.append(given, np.conj(given[1]))
    problem = made(poles=given.size, zeros=0)
    branch = evaluate(problem, given).branches[0]
    slopes = moved(branch)
    assert slopes is not None
    for k in range(given.size):
        step = np.zeros(given.size)
        step[k] = 1e-6
        ends = roots_of(branch.inner, step), roots_of(branch.inner, -step)
        nearest = [[end[np.argmin(np.abs(end - z))] for z in branch.inner.poles] for end in ends]
        slope = (np.array(nearest[0]) - np.array(nearest[1])) / 2e-6
        np.testing.assert_allclose(slopes[:, k], slope, rtol=1e-6, atol=1e-7)


def test_coinciding_poles_are_not_held():
    problem = made()
    branch = evaluate(problem, np.array([-1.0, -1.0 - 1e-7], dtype=complex)).branches[0]
    assert moved(branch) is None
    assert conditions([branch], problem.slowest, 2).shape == (0, 2)


def test_only_slow_poles_are_at_the_limit():
    poles = np.array([-0.01, -0.02, -1e-9 + 5j, -1e-9 - 5j, -400.0])
    assert at_slow_limit(poles, 0.01).tolist() == [True, False, True, False, False]


def test_what_is_left_changes_no_condition():
    rng = np.random.default_rng(3)
    rows, kept = rng.standard_normal((2, 6)), np.array([0, 1, 3, 4, 5])
    basis = left_by(rows, kept)
    assert basis.shape == (6, 3)
    np.testing.assert_allclose(basis.T @ basis, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rows @ basis, 0.0, atol=1e-12)
    np.testing.assert_array_equal(basis[2], 0.0)


def held_point(found: list):
    """A point whose slow pole is pulled out, on a record of no model."""
    for seed in range(40):
        problem = made(seed=seed)
        for fast in (-0.7, -2.0, -6.0, -15.0):
            point = evaluate(problem, np.array([-problem.slowest, fast], dtype=complex))
            if point.held:
                found.append((problem, point))
                return point
    raise AssertionError("no record of forty pulls a slow pole outward")


def test_a_step_leaves_a_pole_at_the_limit_and_still_falls():
    found: list = []
    point = held_point(found)
    problem = found[0][0]
    assert point.held == TOO_SLOW
    proposal = point.step(0.0)
    slow = proposal.poles[np.argmin(np.abs(proposal.poles))]
    change = np.abs(proposal.poles - point.poles).max()
    assert abs(slow + problem.slowest) < 0.05 * change + 1e-9
    assert proposal.decrease > 0
    ahead = point.step(3.0)
    assert evaluate(problem, problem.admissible(ahead.poles)[0]).objective < point.objective


def test_the_slope_is_that_of_finite_differences():
    problem = made(seed=5)
    point = evaluate(problem, np.array([-0.8, -3.0], dtype=complex))
    change = np.array([0.03, -0.05])
    h = 1e-5
    bank = point.branches[0].inner
    ahead, behind = (evaluate(problem, roots_of(bank, s * h * change)) for s in (1, -1))
    total = float(point._scores[1] @ point._scores[1])
    # -2 log L is rows log(total): the slope of the total itself is asked for
    expected = (ahead.objective - behind.objective) / (2 * h) * total / float(point.counts.sum())
    assert point.slope(change) == pytest.approx(expected, rel=1e-5)


def test_the_bend_is_the_curvature_that_gauss_and_newton_leave_out():
    problem = made(seed=5)
    at = partial(evaluate, problem)
    old = finish(at, at(np.array([-0.8, -3.0], dtype=complex)), None, 7)[0]
    assert not old.is_far
    change = 1e-3 * np.array([0.3, -0.5])
    new = evaluate(problem, roots_of(old.branches[0].inner, change))
    bend = bend_of(old, change, new)
    assert bend is not None
    across = new.along(bend.direction)
    # the same direction in the coordinates of the new point moves the outputs alike
    np.testing.assert_allclose(np.linalg.norm(across), np.linalg.norm(old.along(change)), rtol=2e-3)
    h = 1e-4
    bank = new.branches[0].inner
    costs = [
        evaluate(problem, roots_of(bank, s * h * bend.direction / 1e-3)).objective
        for s in (1, 0, -1)
    ]
    total = float(new._scores[1] @ new._scores[1])
    rows = float(new.counts.sum())
    slope = (costs[0] - costs[2]) / (2 * h) / rows
    second = (costs[0] - 2 * costs[1] + costs[2]) / h**2 / rows
    # -2 log L is rows log(total): the curvature of total itself is asked for
    curvature = (second + slope**2) * total
    gauss = 2.0 * float(across @ across) / 1e-6
    expected = np.clip(curvature / gauss - 1.0, LEAST_BEND, MOST_BEND)
    assert bend.excess == pytest.approx(expected, rel=0.05, abs=0.02)


def test_a_bend_shortens_or_stretches_its_own_direction_alone():
    problem = made(seed=5)
    point = evaluate(problem, np.array([-0.8, -3.0], dtype=complex))
    free = point.step(0.0).change
    same = point.step(0.0, Bend(np.array([1.0, 0.0]), 0.0)).change
    np.testing.assert_allclose(same, free, rtol=1e-12)
    direction = np.array([1.0, -0.4])
    across = point.along(direction)
    bent = point.step(0.0, Bend(direction, 1.0)).change
    part = float(point.along(free) @ across)
    assert float(point.along(bent) @ across) == pytest.approx(0.5 * part, rel=1e-9)
    # what is left is along the direction: across it nothing changed
    left = (free - bent) / direction
    assert left[0] == pytest.approx(left[1], rel=1e-9)
