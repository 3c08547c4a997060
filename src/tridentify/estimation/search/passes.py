"""Steps 2 to 4 repeated with filter and basis re-adapted.

At ``a_hat`` the bank holds its poles three times. Twice is the basis of Step
1: ``span{p^i / a_hat^2}`` contains the model's output and all its derivatives with respect to
``a`` and ``b``, so the order need not grow with the record. Step 2 fits ``a`` and ``b`` to that
noise-free output with ``c = a_hat`` and gives the next ``a_hat``. The passes end when the
output-error cost stops falling.

A fixed point of these passes solves instrumental-variable equations close to, but for a finite
record not equal to, those of the output-error minimum; `minimum.levenberg_marquardt` ends there.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from tridentify.estimation.answer.estimate import Pass, Step
from tridentify.estimation.answer.trace import pairs
from tridentify.estimation.likelihood.charted import Given, given, limits_of
from tridentify.estimation.likelihood.cost import Point, evaluate_variant
from tridentify.estimation.likelihood.fitted_point import FLOOR, ROUNDING_SQUARED
from tridentify.estimation.likelihood.minimum.descent import TOGETHER
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import (
    Recorder,
    at_rounding,
    coefficients,
    mean_square,
)
from tridentify.estimation.likelihood.setup.problem import (
    REFLECTED,
    TOO_FAST,
    TOO_SLOW,
    Problem,
    Variant,
)
from tridentify.estimation.likelihood.thresholds import PASS_HELPED
from tridentify.models.parallel import ParallelFit, fit_parallel
from tridentify.models.series import SeriesFit, fit_series
from tridentify.numerics.arrays import Array, Complex, Indices
from tridentify.numerics.realization import roots_of
from tridentify.numerics.slices import Slices

MOST_ADAPTED = 12
"""Most adapted passes: steps on the cost do the rest."""
NOTES = "", REFLECTED, TOO_FAST, TOO_SLOW
"""What was done to the poles of a pass, as `compiled_roots` counts it."""


def adapting(
    base: Problem, variant: Variant, poles: Complex, recorder: Recorder, most: int = MOST_ADAPTED
) -> Slices[Point]:
    """Adapted passes from given poles; the best point met. In slices, at most two a pass.

    Parameters
    ----------
    base : Problem
        Whose experiments are filtered.
    variant : Variant
        The nuisance terms that are kept.
    poles : (n,) complex array
        Admissible.
    recorder : Recorder
        Is told every pass.
    most : int
        Most passes.
    """
    known = given(base, variant)
    if known is not None:
        return (yield from _in_machine_code(known, base, variant, poles, recorder, most))
    best: Point | None = None
    worse = 0
    note = ""
    for _ in range(most):
        yield
        point = evaluate_variant(base, variant, poles, 3)
        yield
        steps, found = both_steps(point)
        recorder.add(point, steps, np.nan, note)
        gain = np.inf if best is None else best.objective - point.objective
        if best is None or gain > 0:
            best = point
        worse = worse + 1 if gain < PASS_HELPED else 0
        if worse >= 1 + (gain < 0) or at_rounding(point):
            break
        poles, note = base.admissible(found)
    assert best is not None
    return best


def _in_machine_code(
    known: Given, base: Problem, variant: Variant, poles: Complex, recorder: Recorder, most: int
) -> Slices[Point]:
    """`adapting`, many passes a call."""
    from tridentify.estimation.search.compiled_passes import adapted

    scales = scales_of(base)
    state, limits = np.array([np.inf, 0.0]), limits_of(base)
    together = max(1, TOGETHER // sum(e.n_samples for e in base.experiments))
    lowest, best, note, made, is_over = np.inf, poles, "", 0, False
    poles = np.ascontiguousarray(poles, dtype=np.complex128)
    while made < most and not is_over:
        yield
        count = min(together, most - made)
        is_over, count, visited, notes, costs, poles = adapted(
            *known, base.biproper, poles, scales, limits, PASS_HELPED, state, count
        )
        note = record(recorder, base, variant, visited[:count], notes, note)
        for place, cost in zip(visited[:count], costs.tolist(), strict=False):
            if cost < lowest:
                lowest, best = cost, place
        made += count
    yield
    return evaluate_variant(base, variant, best)


def scales_of(base: Problem) -> Array:
    """(3, n_outputs) samples, floors of the variances, and sums of squares that are rounding."""
    flat = base.flat
    assert flat is not None
    exact = ROUNDING_SQUARED * base.size * flat.counts
    return np.stack([flat.counts, FLOOR * base.power, exact])


def record(
    recorder: Recorder,
    base: Problem,
    variant: Variant,
    visited: Complex,
    notes: Indices,
    note: str = "",
) -> str:
    """Tell a recorder the passes of machine code; what was done to the poles after the last."""
    for place, done in zip(visited, notes.tolist(), strict=False):
        recorder.later(partial(_pass_at, base, variant, place, note))
        note = NOTES[done]
    return note


def _pass_at(base: Problem, variant: Variant, poles: Complex, note: str, number: int) -> Pass:
    """A pass for the trace."""
    point = evaluate_variant(base, variant, poles, 3)
    steps, theta = both_steps(point)[0](), coefficients(point)
    return Pass(number, steps, theta, mean_square(point), np.nan, point.gradient, note)


def both_steps(point: Point) -> tuple[Callable[[], tuple[Step, ...]], Complex]:
    """Step 1 on the poles of ``a_hat``, twice each, and Step 2 with ``c = a_hat``.

    Parameters
    ----------
    point : Point
        On a bank with its poles three times.

    Returns
    -------
    steps : callable
        Gives both steps for the trace.
    poles : (n,) complex array
        Roots of the new denominators; not necessarily stable.
    """
    from tridentify.models.compiled_steps import adapted_steps

    problem, triangles, bank = point.problem, point.triangles, point.triangles.bank
    beta, costs, condition, row, numerators, cost, own = adapted_steps(
        triangles.stack,
        triangles.which,
        triangles.targets,
        int(triangles.layout.free),
        triangles.free,
        triangles.nuisance,
        *problem.pattern,
        bank.repeats,
        bank.poles,
        bank.cascade.b,
        bank.basis,
        bank.maps,
        point.weights,
        problem.biproper,
    )
    own_poles = zip(problem.groups, bank.inners, strict=True)
    poles = np.concatenate([roots_of(inner, row[group.poles]) for group, inner in own_poles])

    def steps() -> tuple[Step, ...]:
        samples, used = float(point.counts.sum()), problem.split(bank.poles)
        share, twice = float(costs.sum()) / samples, [np.tile(one, 2) for one in used]
        what = f"{beta.shape[2]} orthonormal functions on the poles of a, twice each"
        operators, filters = pairs(np.concatenate(twice)), pairs(bank.poles)
        found, through = problem.joined(poles, numerators), "filter 1/a of the pass before"
        return (
            Step("parallel", beta.ravel(), share, condition, what, "orthonormal", operators),
            Step("series-parallel", found, cost / samples, own, through, poles=filters),
        )

    return steps, poles


def parallel_model(point: Point) -> ParallelFit:
    """Step 1 on the poles of ``a_hat``, twice each; every channel on those of its own."""
    q, problem = point.bank.order, point.problem
    owner: list[int] = []
    states: list[int] = []
    for g, branch in enumerate(point.branches):
        first, count = branch.states.start, 2 * branch.inner.order
        states += range(first, first + count)
        owner += [g] * count
    rows = np.eye(q)[states]
    direct = np.zeros(len(states))
    has = np.array([branch.channels for branch in point.branches])
    used = np.moveaxis(has, 0, 2)[:, :, owner]
    if problem.biproper:
        rows = np.vstack([rows, np.zeros(q)])
        direct = np.append(direct, 1.0)
        used = np.concatenate([used, np.ones((*used.shape[:2], 1), dtype=bool)], axis=2)
    return fit_parallel(
        point.regressions,
        rows,
        direct,
        free_rows=np.eye(q)[states],
        used=used,
        free_used=np.asarray(has.any(axis=2)).T[:, owner],
    )


def series_model(point: Point) -> SeriesFit:
    """Step 3 with the orthonormal functions on the poles of ``a_hat``."""
    n, q = point.problem.n_poles, point.bank.order
    owner: list[int] = []
    states: list[int] = []
    for g, branch in enumerate(point.branches):
        states += range(branch.own.start, branch.own.stop)
        owner += [g] * branch.inner.order
    outputs = np.array([branch.channels.any(axis=1) for branch in point.branches])
    return fit_series(
        point.regressions,
        point.bank,
        point.response,
        point.bank,
        np.eye(n),
        np.zeros(n),
        free_rows=np.eye(q)[states],
        weights=point.weights,
        parts=[
            part.spread(branch.states, q)
            for part, branch in zip(point.parts, point.branches, strict=True)
        ],
        states=point.score_states,
        free_used=outputs.T[:, owner],
    )


def certify(point: Point, recorder: Recorder) -> None:
    """Add Step 3 at the point that the passes led to: the weights must be (1, 0, ..., 0)."""
    series = series_model(point)
    step = Step(
        "series",
        series.beta.ravel(),
        float(series.cost.sum() / point.counts.sum()),
        series.condition,
        "W_0 = 1 and the orthonormal functions on the poles of a",
        "orthonormal",
        pairs(np.concatenate([branch.inner.poles for branch in point.branches])),
    )
    note = "check of the end: beta is (1, 0, ..., 0) at a stationary point"
    recorder.add(point, lambda: (step,), series.distance, note)
