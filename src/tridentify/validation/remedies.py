"""What would explain a residual that follows an input: delay or order; tried, not guessed.

From the poles of the estimate a few candidates take a handful of Levenberg-Marquardt steps on the
output error (`output_error.finish`): every coefficient kept and one input later by a few samples;
one or two more poles; another zero. The one of lowest AICc is named. This is no order selection,
only the direction in which to look.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tridentify.errors import TridentifyError
from tridentify.estimate import Estimate
from tridentify.numerics.realization import Complex, sort_poles
from tridentify.output_error.finish import finish
from tridentify.output_error.nuisance import Nuisances, build
from tridentify.output_error.point import Point, evaluate
from tridentify.output_error.problem import Problem
from tridentify.structure import Structure
from tridentify.validation.view import View

Array = NDArray[np.float64]

STEPS = 25
CLEARLY = 6.0
MOST_POLES = 20
GRID = 14
SPACING = 1.5


@dataclass(frozen=True, eq=False)
class Remedy:
    """The candidate that explains most.

    Attributes
    ----------
    kind : str
        ``"delay"``, ``"order"`` or ``""``.
    text : str
        What it is, in words.
    advice : str
        How to ask for it.
    input : str
        The input that is late.
    share : float
        By how much the sum of squares falls with it.
    point : Point or None
        Where its fit ended.
    """

    kind: str
    text: str = ""
    advice: str = ""
    input: str = ""
    share: float = 0.0
    point: Point | None = None


@dataclass(frozen=True, eq=False)
class _Tried:
    remedy: Remedy
    point: Point
    criterion: float
    energy: float


def best_remedy(view: View, estimate: Estimate, noises: Sequence[Array]) -> Remedy:
    """Try candidates on the records that are looked at.

    Parameters
    ----------
    view : View
    estimate : Estimate
    noises : sequence of (p,) arrays
        Model of each output's noise.
    """
    given = estimate.structure
    nuisances = _nuisances(view)
    delay = np.array(estimate.model.delay)
    base = Structure(given.poles, given.zeros, delay=delay.tolist())
    poles = view.point.poles
    none = Remedy("")
    here = _try(view, base, nuisances, noises, [poles], none)
    if here is None:
        return none
    paths = [(slice(None), j) for j in range(delay.shape[1])]
    if delay.shape[0] > 1:
        paths += [(slice(i, i + 1), j) for i, j in np.ndindex(*delay.shape)]
    tried = [_try_delay(view, base, delay, path, nuisances, noises) for path in paths]
    tried += [
        _try(view, structure, nuisances, noises, starts, remedy)
        for structure, starts, remedy in _orders(view, base, poles)
    ]
    found = [one for one in tried if one is not None]
    if not found:
        return none
    lowest = min(one.criterion for one in found)
    # of candidates that are as good, the one with the fewest coefficients
    best = min(
        (one for one in found if one.criterion < lowest + CLEARLY),
        key=lambda one: (one.point.problem.n_coefficients, one.criterion),
    )
    if best.criterion > here.criterion - CLEARLY:
        return none
    share = 1.0 - best.energy / here.energy if here.energy > 0 else 0.0
    return replace(best.remedy, share=share, point=best.point)


def _nuisances(view: View) -> Nuisances:
    one = view.point.problem.experiments[0]
    if one.free:
        return Nuisances("free", one.offset, one.drift)
    # an input that counts from another value than recorded started in equilibrium
    moved = not np.array_equal(one.u, view.records[0].u)
    return Nuisances("equilibrium" if moved else "rest", one.offset, one.drift)


def _problem(
    view: View, structure: Structure, nuisances: Nuisances, noises: Sequence[Array]
) -> Problem:
    given = Structure(
        structure.poles,
        structure.zeros,
        delay=structure.delay,
        offset=nuisances.offset,
        drift=nuisances.drift,
        initial_state=nuisances.initial_state,  # type: ignore[arg-type]
    )
    problem = build(view.records, given, nuisances)
    coloured = not view.uneven and any(a.size for a in noises)
    return problem.whitened(tuple(noises)) if coloured else problem


def _criterion(point: Point, view: View) -> float:
    """AICc as if every candidate had the samples of the first."""
    n = np.array([output.count for output in view.outputs], dtype=np.float64)
    problem = point.problem
    k = problem.n_coefficients + problem.n_nuisance + problem.n_outputs
    likelihood = float(n @ np.log(point.variance))
    return likelihood + 2.0 * k + 2.0 * k * (k + 1.0) / max(float(n.sum()) - k - 1.0, 0.5)


def _energy(point: Point, view: View) -> float:
    """Geometric mean of the residual's mean squares over the outputs."""
    n = np.array([output.count for output in view.outputs], dtype=np.float64)
    return float(np.exp(n @ np.log(point.variance) / n.sum()))


def _try(
    view: View,
    structure: Structure,
    nuisances: Nuisances,
    noises: Sequence[Array],
    starts: Sequence[Complex],
    remedy: Remedy,
) -> _Tried | None:
    """Finish the most promising of several starts; None where a candidate cannot be had."""
    try:
        problem = _problem(view, structure, nuisances, noises)
        points = [evaluate(problem, problem.admissible(one)[0]) for one in starts]
        start = min(points, key=lambda one: one.objective - one.step(0.0).decrease)
        point = finish(partial(evaluate, problem), start, None, STEPS)[0]
    except (TridentifyError, np.linalg.LinAlgError, FloatingPointError):
        return None
    return _Tried(remedy, point, _criterion(point, view), _energy(point, view))


def _try_delay(
    view: View,
    base: Structure,
    delay: Array,
    path: tuple[slice, int],
    nuisances: Nuisances,
    noises: Sequence[Array],
) -> _Tried | None:
    """The best delay of one input to all outputs or one; several would be a search.

    It is looked for ever finer about the best so far.
    """
    longest = min(record.n_samples for record in view.records) // 4
    rows, j = path
    name = view.records[0].input_names[j]
    outputs = view.records[0].output_names[rows]
    where = name if len(outputs) == len(delay) else f"{name} to {outputs[0]}"
    known: dict[float, float] = {}

    def later(steps: float) -> Structure:
        late = delay.copy()
        late[rows, j] += steps * view.step
        return Structure(base.poles, base.zeros, delay=late.tolist())

    def promise(steps: float) -> float:
        if steps not in known:
            try:
                problem = _problem(view, later(steps), nuisances, noises)
                point = evaluate(problem, view.point.poles)
                fall = point.step(0.0).decrease
                known[steps] = (point.objective - fall) / float(point.counts.sum())
            except (TridentifyError, np.linalg.LinAlgError):
                known[steps] = np.inf
        return known[steps]

    grid = np.unique(np.round(np.geomspace(1, max(longest, 2), GRID)).astype(int)).tolist()
    best = float(min(grid, key=promise))
    near = [k for k in range(int(best / SPACING), int(best * SPACING) + 2) if 1 <= k <= longest]
    best = float(min([best, *near[:: max(len(near) // GRID, 1)]], key=promise))

    def finished(steps: float, poles: Complex) -> _Tried | None:
        total = float(delay[rows, j][0]) + steps * view.step
        remedy = Remedy(
            "delay",
            f"a delay of about {total:.3g} s of {where}",
            "estimate the delay (delay='free', --delay free) or state it",
            name,
        )
        return _try(view, later(steps), nuisances, noises, [poles], remedy)

    # one step ahead promises little more than where to begin
    here, tried = finished(best, view.point.poles), {0.0, best}
    for width in (1.0, 1.0, 1.0, 0.5, 0.25):
        for steps in (best - width, best + width):
            if here is None or steps in tried or steps < 0:
                continue
            one = finished(steps, here.point.poles)
            tried.add(steps)
            if one is not None and one.criterion < here.criterion:
                here, best = one, steps
    return here


def _orders(
    view: View, base: Structure, poles: Complex
) -> list[tuple[Structure, list[Complex], Remedy]]:
    """Structures with more poles or zeros, and where their new poles may begin."""
    if not isinstance(base.poles, int):
        return []
    n = base.poles
    shape = view.records[0].n_outputs, view.records[0].n_inputs
    zeros = np.array(base.zeros_matrix(*shape))
    slow = 2.0 / max(record.duration for record in view.records)
    rates = np.geomspace(slow, 1.0 / view.step, 6)
    real = [sort_poles(np.append(poles, -w)) for w in rates]
    pairs = [
        sort_poles(np.append(poles, [w * (-0.1 + 0.995j), w * (-0.1 - 0.995j)])) for w in rates
    ]
    wanted = [(n + 1, zeros, real), (n + 1, zeros + 1, real), (n + 2, zeros + 2, pairs)]
    if np.all(zeros < n):
        wanted.append((n, zeros + 1, [poles]))
    found = []
    for order, m, starts in wanted:
        if order > MOST_POLES:
            continue
        most = int(m.max())
        advice = f"use poles={order} and zeros={most}, or compare several orders"
        several = "" if len(np.unique(m)) == 1 else "up to "
        words = f"{order} poles and {several}{most} zero{'' if most == 1 else 's'}"
        structure = Structure(order, m.tolist(), delay=base.delay)
        found.append((structure, starts, Remedy("order", words, advice)))
    return found
