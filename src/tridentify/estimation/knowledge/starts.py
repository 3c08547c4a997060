"""Where the constrained steps begin.

*The free optimum, projected.* Near it the cost is a quadratic, so the constrained optimum is one
convex problem away: least squares in the metric of the information matrix.

*Step 2 with constraints.* The series-parallel model on a noise-free output,

    eps = (a / c) y_M - (b / c) u - (c_0 / c) delta,

is linear in the physical coefficients, so with the equalities put in, bounds kept and priors
added it is still a convex least-squares problem without local minima. ``y_M`` is the parallel
model on the poles of ``c``, twice each, and ``c`` is the denominator of the pass before. Nothing
has to be near a solution for the first pass, and what is known of the coefficients works from the
start.

*A family of plain denominators*, projected onto the constraints, their numerators fitted, where
no other start leads to a minimum; and, as what linear constraints allow is convex, the points on
the way from the best of these to the seeds where stability ends.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from tridentify.estimation.knowledge.affine import Knowledge
from tridentify.estimation.knowledge.bounded import bounded_least_squares
from tridentify.estimation.knowledge.descend import (
    Room,
    cost,
    fit_at,
    is_exact,
    is_stable,
    project,
    step,
)
from tridentify.estimation.knowledge.fixed_denominator import Denominator, HeldFit, place
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.estimation.likelihood.thresholds import PASS_WITHIN
from tridentify.models.response import ColumnBlocks, Response
from tridentify.numerics.arrays import Array
from tridentify.numerics.least_squares import solve
from tridentify.numerics.realization import denominator

MOST_PASSES = 6
"""Steps 1 and 2 in turn at most: they end when they no longer gain, mostly after three."""
STABLE_SHARES = (1e-2, 1e-4, 1e-8)
"""Shares of their sizes that the coefficients of the denominator keep, tried in turn until there is
a point on the constraints."""
RATES = 13
"""Rates of plain denominators, evenly over the band in the logarithm: some four a decade of a
record of a few thousand samples."""
DAMPINGS = (1.0, 0.5, 0.15)
"""Their dampings: equal real poles, medium, and light."""
SHARES = (0.95, 0.8, 0.6, 0.4, 0.2)
"""Where on the way from the best plain denominator to a free optimum stability is looked for, the
farthest first."""


def feasible(theta: Array, known: Knowledge, scale: Array) -> Array | None:
    """The nearest point on the constraints, coefficients of the poles kept positive.

    Parameters
    ----------
    theta : (p,) array
    known : Knowledge
    scale : (p,) array
        Sizes of the coefficients: distances are relative to them.
    """
    size = np.maximum(np.abs(theta), 1e-3 * scale)
    free = ~known.determined
    matrix = known.directions / size[:, None]
    target = (theta - known.origin) / size
    for share in STABLE_SHARES:
        floor = np.full(theta.size, -np.inf)
        floor[known.moving] = share * size[known.moving]
        low = np.maximum(known.low, np.minimum(floor, known.high))
        rows = [known.directions[free & np.isfinite(low)]]
        rows.append(-known.directions[free & np.isfinite(known.high)])
        least = [(low - known.origin)[free & np.isfinite(low)]]
        least.append((known.origin - known.high)[free & np.isfinite(known.high)])
        answer = bounded_least_squares(matrix, target, np.vstack(rows), np.concatenate(least))
        if answer is not None:
            found = known.origin + known.directions @ answer.x
            found[free] = np.clip(found, known.low, known.high)[free]
            return np.asarray(found)
    return None


def starting_points(
    problem: Problem, known: Knowledge, seeds: Sequence[Array], scale: Array
) -> Iterator[tuple[str, Array]]:
    """Points on the constraints with stable poles, the most promising kind first.

    Parameters
    ----------
    problem : Problem
    known : Knowledge
    seeds : sequence of (p,) arrays
        Coefficients of free models; their poles are stable.
    scale : (p,) array
        Sizes of the coefficients.
    """
    for seed in seeds:
        start = feasible(seed, known, scale)
        if start is None:
            continue
        metric = project(_fit_of(problem, known, seed), known, start)
        for name, theta in (("the free optimum, projected", metric), ("nearest point", start)):
            if is_stable(theta[known.moving]):
                yield name, theta
                break
        found = constrained_passes(problem, known, seed[known.moving], start)
        if found is not None:
            yield "Step 2 with constraints", found


def further_points(
    problem: Problem, known: Knowledge, seeds: Sequence[Array], scale: Array, most: int
) -> list[tuple[str, Array]]:
    """Plain denominators, the best by cost, and points between the best and the seeds."""
    plain = [_with_numerators(problem, known, theta) for theta in _plain(problem, known, scale)]
    ranked = sorted(plain, key=lambda theta: cost(fit_at(problem, known, theta), known))[:most]
    found = [("a plain denominator, projected", theta) for theta in ranked]
    for seed in seeds if ranked else ():
        goal = feasible(seed, known, scale)
        if goal is None:
            continue
        for share in SHARES:
            theta = ranked[0] + share * (goal - ranked[0])
            if is_stable(theta[known.moving]):
                found.append(("towards the free optimum", theta))
                break
    return found


def _with_numerators(problem: Problem, known: Knowledge, theta: Array) -> Array:
    """The same denominator with the best numerators that the constraints leave."""
    held = known.directions[known.moving]
    _, s, vt = np.linalg.svd(held / np.maximum(np.abs(theta[known.moving]), 1e-300)[:, None])
    rank = int(np.sum(s > 1e-10 * s[0])) if s.size else 0
    directions = known.directions @ vt[rank:].T
    directions[known.moving] = 0.0
    if not directions.shape[1]:
        return theta
    narrowed = replace(known, directions=directions)
    return step(fit_at(problem, known, theta), narrowed, 0.0).theta


def _plain(problem: Problem, known: Knowledge, scale: Array) -> Iterator[Array]:
    """Denominators of equal real poles and pairs over the whole band, projected."""
    n = known.n_poles - known.integrators
    duration = max(e.duration for e in problem.experiments)
    dt = min(e.dt for e in problem.experiments)
    for rate in np.geomspace(1.0 / duration, 1.0 / dt, RATES):
        for damping in DAMPINGS:
            pair = rate * (-damping + 1j * np.sqrt(1.0 - damping**2))
            poles = [pair, np.conj(pair)] * (n // 2) + [complex(-rate)] * (n % 2)
            theta = np.zeros(scale.size)
            theta[known.moving] = denominator(np.array(poles))[1:]
            start = feasible(theta, known, np.maximum(scale * 1e-3, np.abs(theta)))
            if start is not None and is_stable(start[known.moving]):
                yield start


def _fit_of(problem: Problem, known: Knowledge, theta: Array) -> HeldFit:
    """The fit of a free model: zeros at the origin for the integrators."""
    seen = theta.copy()
    seen[known.n_poles - known.integrators : known.n_poles] = 0.0
    return fit_at(problem, known, seen)


def constrained_passes(problem: Problem, known: Knowledge, a: Array, start: Array) -> Array | None:
    """Steps 1 and 2 in turn, with the constraints; the best coefficients met.

    Parameters
    ----------
    problem : Problem
    known : Knowledge
    a : (n - k,) array
        Denominator to begin with, stable.
    start : (p,) array
        A point on the constraints.
    """
    best, lowest = None, np.inf
    room = Room.around(problem, a)
    for _ in range(MOST_PASSES):
        here = place(problem, a, known.integrators, 3)
        theta = _step_two(here, known, start)
        if theta is None or not is_stable(theta[known.moving]):
            break
        if not room.holds(theta[known.moving]):
            break
        reached = fit_at(problem, known, theta)
        value = cost(reached, known)
        worse = value > lowest - PASS_WITHIN
        if value < lowest:
            best, lowest = theta, value
        if worse or is_exact(reached):
            break
        a = theta[known.moving]
    return best


def _step_two(here: Denominator, known: Knowledge, start: Array) -> Array | None:
    """Coefficients from the noise-free output of the parallel model; None where there are none."""
    problem = here.problem
    response, variance = _parallel(here)
    n, p = here.inner.order, start.size
    matrices, targets = [], []
    at = known.n_poles
    for i in range(problem.n_outputs):
        zeros = problem.n_zeros[i]
        width = sum(m + 1 for m in zeros)
        for e, regression in enumerate(here.regressions):
            filtered = here.filtered(response, e, i)
            matrix = np.zeros((filtered.shape[0], p))
            matrix[:, :n] = -filtered
            blocks = [here.numerator_columns(e, i, j, m) for j, m in enumerate(zeros)]
            matrix[:, at : at + width] = np.hstack(blocks)
            target = response.signal(regression, e, i) - filtered @ here.a
            if regression.layout.free:
                own = regression.nuisance_signals(i).shape[1]
                nuisance = here.nuisance_columns(e, i)
                nuisance = nuisance[:, : nuisance.shape[1] - own]
                basis = solve(nuisance, target).basis
                matrix = matrix - basis @ (basis.T @ matrix)
                target = target - basis @ (basis.T @ target)
            weight = 1.0 / np.sqrt(variance[i])
            matrices.append(weight * matrix)
            targets.append(weight * target)
        at += width
    matrix, target = np.vstack(matrices), np.concatenate(targets)
    return _within(matrix, target, known, start)


def _within(matrix: Array, target: Array, known: Knowledge, start: Array) -> Array | None:
    held, pull = known.prior_rows(known.directions, start)
    free = ~known.determined
    low = known.low.copy()
    low[known.moving] = np.maximum(low[known.moving], 1e-3 * start[known.moving])
    least, most = np.isfinite(low) & free, np.isfinite(known.high) & free
    rows = np.vstack([known.directions[least], -known.directions[most]])
    bottom = np.concatenate([(low - start)[least], (start - known.high)[most]])
    answer = bounded_least_squares(
        np.vstack([matrix @ known.directions, held]),
        np.concatenate([target - matrix @ start, pull]),
        rows,
        np.minimum(bottom, 0.0),
    )
    if answer is None:
        return None
    found = start + known.directions @ answer.x
    found[free] = np.clip(found, known.low, known.high)[free]
    return np.asarray(found)


def _parallel(here: Denominator) -> tuple[Response, Array]:
    """Step 1: every state of the bank but those of the last repetition, and the noise variance."""
    problem = here.problem
    order, q = here.bank.order, here.orthonormal.order
    used = list(range(q - here.inner.order)) + list(range(q, order))
    rows = np.zeros((problem.n_outputs, problem.n_inputs, order))
    direct = np.zeros((problem.n_outputs, problem.n_inputs))
    free = np.zeros((len(here.regressions), problem.n_outputs, order))
    variance = np.zeros(problem.n_outputs)
    select = np.eye(order)[:, used]
    for i in range(problem.n_outputs):
        counts = sum(regression.counts[i] for regression in here.regressions)
        columns = _parallel_columns(here, i, select)
        matrix, target = columns.assemble()
        solution = solve(np.ascontiguousarray(matrix), np.ascontiguousarray(target))
        variance[i] = solution.cost / counts + 1e-30 * problem.power[i]
        at = 0
        for j, m in enumerate(problem.n_zeros[i]):
            rows[i, j, used] = solution.x[at : at + len(used)]
            at += len(used)
            if m == problem.n_poles:
                direct[i, j] = solution.x[at]
                at += 1
        for e in range(len(here.regressions)):
            free[e, i] = here.free_row(e, columns.pick(solution.x, e))
    return Response(rows, direct, free), variance


def _parallel_columns(here: Denominator, i: int, select: Array) -> ColumnBlocks:
    """Columns and target of one output over all experiments; nuisance terms of each its own."""
    found = ColumnBlocks()
    for e, regression in enumerate(here.regressions):
        blocks = []
        for j, m in enumerate(here.problem.n_zeros[i]):
            blocks.append(regression.input_signal(i, j, select))
            if m == here.problem.n_poles:
                blocks.append(regression.signals[i][:, [regression.layout.direct(j)]])
        own = {"inputs": np.hstack(blocks), e: here.nuisance_columns(e, i)}
        found.add(own, regression.targets[i])
    return found
