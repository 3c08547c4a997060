"""Where the delays lie: a profile of convex parallel models, then low-order models from there.

The output-error cost has many minima along a delay, about one to each period of what the output
does, and one for each way in which a fast pole can stand for a part of the delay. So its range is
looked at as a whole before anything is refined.

1. *Parallel models.* At every place of a grid the record is fitted by Laguerre functions of the
   delayed inputs, which is convex, and AICc says how many of them and how well. Too short a delay
   costs functions, too long a one misses the beginning of the response; the criterion is lowest
   near the delay, whatever the poles. With several inputs one delay is taken along the grid at a
   time, the others held, beginning from what is best for all in common.
2. *Low order.* At the lowest places the poles are searched (`strategy.search`), and poles and
   delays are refined together (`output_error.finish`).
3. *Away from there.* With the poles held the reduced cost is taken along each delay, and other
   minima that come near it are followed. Nearer by, where a delay can be traded for poles and
   zeros and the cost of a held input has a kink at every step, poles and delays are refined anew
   from half a step away, one, two, four, and so on up to the step of the grid, the delay held at
   first. Both are repeated as long as that helps.

All this runs on a stand-in where the record is long, and with a start of every kind that the
structure allows. A free initial state stands for the inputs before the record, so output samples
that the longest delay leaves unexplained are not looked at; a start at rest uses all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from tridentify.errors import IdentifiabilityError, UnsupportedError
from tridentify.estimate import Estimate
from tridentify.numerics.realization import Complex, sort_poles
from tridentify.output_error.finish import criterion, finish
from tridentify.output_error.mixture import mixture
from tridentify.output_error.nuisance import Nuisances, build
from tridentify.output_error.point import Point, evaluate
from tridentify.output_error.problem import Problem, Variant
from tridentify.record import Record
from tridentify.strategy.search import Search
from tridentify.strategy.starts import parallel_criterion, rate_limits
from tridentify.strategy.thin import is_large, is_usable, window
from tridentify.structure import InitialState, Structure
from tridentify.trace import OTHER_DELAYS

Array = NDArray[np.float64]

LONGEST = 0.3
LONGEST_STATED = 0.6
PLACES = 32
FINE = 96
RATES = 5
FUNCTIONS = 10
MOST_PLACES = 4
MOST_RUNGS = 6
STARTS = 2
MOST_STEPS = 12
HELD_STEPS = 6
MOST_ROUNDS = 4
SWEEPS = 2
NEAR = 20.0
NAMED = 0.05
MOST_RIVALS = 6
HELPED = 0.005
EQUAL = 1.0
FEW_STEPS = 5.0
HOPELESS = 30.0
KEPT_RATES = 2
APART = 0.5
AGREE = 0.25
MOVED = 0.1
MARGIN_STEPS = 2.0
MARGIN_SHARE = 0.1


class Found(NamedTuple):
    """The end of lowest cost, all ends, and the rates that suit the parallel models."""

    best: Point
    ends: list[Point]
    rates: Array


@dataclass(frozen=True, eq=False)
class Place:
    """Delays and poles worth beginning from.

    Attributes
    ----------
    delays : (n_inputs,) array [s]
    poles : (n,) complex array
    rivals : tuple of (delays, poles)
        Other ends of the search whose cost is not much higher.
    """

    delays: Array
    poles: Complex
    rivals: tuple[tuple[Array, Complex], ...] = ()


def delay_places(records: Sequence[Record], structure: Structure) -> list[Place]:
    """Delays and poles to begin from, the best of every kind of start.

    Parameters
    ----------
    records : sequence of Record
    structure : Structure
        With free delays.

    Returns
    -------
    list of Place
        At least one.
    """
    step = min(float(np.median(np.diff(record.t))) for record in records)
    kept: list[Place] = []
    near: Found | None = None
    for problem in _problems(records, structure):
        near = _best(problem, near)
        best, ends = _earliest(near.best, near.ends, step), near.ends
        delays = best.problem.delays
        if not any(np.all(np.abs(one.delays - delays) < APART * step) for one in kept):
            kept.append(Place(delays, best.poles, _rivals(best, ends, step)))
    return kept


def _earliest(best: Point, ends: Sequence[Point], step: float) -> Point:
    """Of ends that explain the record as well, the one with the shortest delays.

    With an input that repeats itself a delay of a period more is as good. Places a few steps apart
    are left to the cost.
    """

    def sooner(end: Point) -> bool:
        less = best.problem.delays - end.problem.delays
        return bool(np.all(less > -APART * step) and less.max() > FEW_STEPS * step)

    equal = [end for end in ends if end.objective < best.objective + EQUAL and sooner(end)]
    return min(equal, key=lambda end: float(end.problem.delays.sum()), default=best)


def _rivals(best: Point, ends: Sequence[Point], step: float) -> tuple[tuple[Array, Complex], ...]:
    """Where the search ended otherwise and not much higher, the lowest first."""
    kept: list[tuple[Array, Complex]] = []
    for end in sorted(ends, key=lambda point: point.objective):
        delays = end.problem.delays
        if end.objective > best.objective + NEAR or len(kept) == MOST_RIVALS:
            break
        if all(
            np.any(np.abs(delays - other) > APART * step)
            for other in [best.problem.delays, *[one for one, _ in kept]]
        ):
            kept.append((delays, end.poles))
    return tuple(kept)


def best_of_places(
    records: Sequence[Record],
    structure: Structure,
    located: Callable[[Structure, Place, Array], Estimate],
    given: Array | None = None,
) -> Estimate:
    """The best of the estimates from every place; again where a delay ended at its limit.

    Parameters
    ----------
    records : sequence of Record
    structure : Structure
        With free delays.
    located : callable
        The estimate for a structure of known delays, from a place, with limits of the delays.
    given : (n_inputs,) array, optional
        Delays to begin with [s], in place of a search.
    """
    _refuse_direct(records[0], structure)
    none = np.zeros(0, dtype=np.complex128)
    places = delay_places(records, structure) if given is None else [Place(given, none)]
    known, limits = with_delays(records, structure, [place.delays for place in places])
    found, refusals = [], []
    for place in places:
        try:
            found.append((located(known, place, limits), place))
        except IdentifiabilityError as refusal:
            refusals.append(refusal)
    if not found:
        raise refusals[0]
    best, place = min(found, key=lambda one: one[0].aicc)
    for _ in range(MOST_ROUNDS):
        delays = best.theta[-best.model.n_inputs :]
        if np.all(delays < 0.999 * limits):
            break
        known, limits = with_delays(records, structure, [delays])
        best = located(known, Place(delays, none), limits)
    rivals = [*place.rivals, (place.delays, place.poles)] if place.poles.size else []
    return _spread(best, records, known, limits, rivals)


def _spread(
    estimate: Estimate,
    records: Sequence[Record],
    known: Structure,
    limits: Array,
    rivals: Sequence[tuple[Array, Complex]],
) -> Estimate:
    """The estimate with the covariance of all minima and cells, and a word on other delays."""
    chosen = estimate.structure
    nuisances = Nuisances(chosen.initial_state, bool(chosen.offset), bool(chosen.drift))
    built = build(records, replace(known, initial_state=chosen.initial_state), nuisances)
    delays = estimate.theta[-built.n_inputs :]
    problem = built.whitened(estimate.noise_model).delayed(delays).freed(limits)
    best = evaluate(problem, _poles(estimate, problem))
    step = max(e.dt for e in problem.experiments)
    others = [one for one in rivals if np.any(np.abs(one[0] - delays) > MOVED * step)]
    found = mixture(best, others)
    if found is None:
        return estimate
    told = _in_words(found.shares, found.means[:, -built.n_inputs :], delays, step)
    trace = estimate.trace
    if told:
        trace = replace(trace, decisions=(*trace.decisions, told))
    return replace(estimate, cov=found.cov, trace=trace)


def _poles(estimate: Estimate, problem: Problem) -> Complex:
    """Of every denominator."""
    dens = [estimate.model.den[i][j] for i, j in (g.channels[0] for g in problem.groups)]
    return np.concatenate([sort_poles(np.roots(den).astype(np.complex128)) for den in dens])


def _in_words(shares: Array, means: Array, delays: Array, step: float) -> str:
    """Delays farther off than a step, where they hold a share of the probability."""
    groups: list[tuple[float, Array]] = []
    for k in np.argsort(-shares):
        near = [i for i, (_, one) in enumerate(groups) if np.all(np.abs(one - means[k]) < step)]
        if np.all(np.abs(means[k] - delays) < step):
            continue
        if near:
            groups[near[0]] = (groups[near[0]][0] + float(shares[k]), groups[near[0]][1])
        else:
            groups.append((float(shares[k]), means[k]))
    named = [
        f"{', '.join(f'{max(d, 0.0):.4g}' for d in one)} s ({100.0 * share:.0f} %)"
        for share, one in groups
        if share > NAMED
    ]
    if not named:
        return ""
    return f"{OTHER_DELAYS}: {'; '.join(named)}"


def _refuse_direct(record: Record, structure: Structure) -> None:
    """Refuse channels that follow their input at once: the delay of a jump has no derivative.

    Raises
    ------
    UnsupportedError
    """
    poles = structure.poles_matrix(record.n_outputs, record.n_inputs)
    zeros = structure.zeros_matrix(record.n_outputs, record.n_inputs)
    if any(
        m == n
        for row, line in zip(poles, zeros, strict=True)
        for n, m in zip(row, line, strict=True)
    ):
        raise UnsupportedError(
            "found as many zeros as poles together with delay='free'; expected fewer zeros, as the "
            "output must depend smoothly on the delay; lower zeros, or give the delay in seconds"
        )


def with_delays(
    records: Sequence[Record], structure: Structure, delays: Sequence[Array]
) -> tuple[Structure, Array]:
    """A structure with known delays that leaves room around some, and how far they may go.

    Parameters
    ----------
    records : sequence of Record
    structure : Structure
        With free delays.
    delays : sequence of (n_inputs,) arrays [s]

    Returns
    -------
    known : Structure
        Output samples that no input explains, up to its delays, are not to be used.
    limits : (n_inputs,) array [s]
    """
    first = records[0]
    longest = max(float(one.max()) for one in delays)
    step = max(float(np.median(np.diff(record.t))) for record in records)
    shortest = min(record.duration for record in records)
    room = longest + max(MARGIN_STEPS * step, MARGIN_SHARE * longest)
    room = min(room, 0.9 * shortest)
    known = replace(structure, delay=((room,) * first.n_inputs,) * first.n_outputs)
    stated = structure.initial_state in ("rest", "equilibrium")
    limit = 0.9 * shortest if stated else room
    return known, np.full(first.n_inputs, limit)


def _problems(records: Sequence[Record], structure: Structure) -> list[Problem]:
    """Small problems without delay, their limits the longest that is looked for."""
    kinds: tuple[str, ...] = (structure.initial_state,)
    if structure.initial_state == "auto":
        moved = any(np.any(record.u[0]) for record in records)
        kinds = ("free", "rest", "equilibrium") if moved else ("free", "rest")
    first = records[0]
    shortest = min(record.duration for record in records)
    found = []
    for kind in kinds:
        offset = structure.offset is not False or kind == "equilibrium"
        chosen = Nuisances(kind, offset, structure.drift is not False)
        longest = (LONGEST if kind == "free" else LONGEST_STATED) * shortest
        late = ((longest,) * first.n_inputs,) * first.n_outputs
        state = cast("InitialState", kind)
        known = replace(structure, delay=late, initial_state=state, offset=offset)
        problem = build(records, known, chosen)
        piece = window(problem) if is_large(problem) else problem
        if is_large(problem) and not is_usable(piece):
            piece = problem
        nothing = np.zeros(first.n_inputs)
        limits = np.full(first.n_inputs, min(longest, LONGEST_STATED * piece.shortest))
        found.append(piece.delayed(nothing).freed(limits))
    return found


def _best(problem: Problem, near: Found | None) -> Found:
    """Poles and delays of the lowest cost that was found, and all other ends.

    With another kind of start only the lowest place is searched anew, where the end of the first is
    not near it, and what lies around is looked at only where the two kinds do not agree.
    """
    places, rates = _profile(problem, near.rates if near else None)
    ends = []
    if near:
        assert problem.limits is not None
        delays = np.minimum(near.best.problem.delays, problem.limits)
        ends = [_from(problem, delays, problem.admissible(near.best.poles)[0])]
        apart = np.abs(places[0][1] - delays) > problem.limits / PLACES
        places = places[:1] if apart.any() else []
    for cost, delays in places:
        if ends and cost > min(criterion(end) for end in ends) + HOPELESS:
            continue
        ends.append(_refined(problem, delays))
    best = min(ends, key=lambda point: point.objective)
    step = min(e.dt for e in problem.experiments)
    agree = near and np.all(np.abs(best.problem.delays - near.best.problem.delays) < AGREE * step)
    for _ in range(0 if agree else MOST_ROUNDS):
        before = best
        ends += [_from(problem, delays, before.poles) for delays in _elsewhere(before)]
        best = min(ends, key=lambda point: point.objective)
        for delays in _ladder(before):
            ends.append(_held(problem, delays, best.poles))
            best = min((best, ends[-1]), key=lambda point: point.objective)
        if best.objective > before.objective - HELPED:
            break
    return Found(best, ends, rates)


def _profile(problem: Problem, rates: Array | None) -> tuple[list[tuple[float, Array]], Array]:
    """Delays where the parallel models' criterion is low, the lowest first, and the best rates."""
    assert problem.limits is not None
    grid = np.linspace(0.0, float(problem.limits[0]), PLACES + 1)
    count = problem.n_inputs
    tried = np.geomspace(*rate_limits(problem), RATES) if rates is None else rates

    def cost(delays: Array, rates: Array) -> Array:
        late = problem.delayed(delays).freed(None)
        return np.array([parallel_criterion(late, rate, FUNCTIONS) for rate in rates])

    every = np.array([cost(np.full(count, delay), tried) for delay in grid])
    kept = tried[np.argsort(every.min(axis=0))[:KEPT_RATES]]
    common = every.min(axis=1)
    found = [(float(common[k]), np.full(count, grid[k])) for k in _low(common)]
    nothing = (float(common[0]), np.zeros(count))
    if count > 1:
        at = found[0][1].copy()
        low = found[0][0]
        others: list[tuple[float, Array]] = []
        for sweep in range(SWEEPS):
            for j in range(count):
                moved = [np.where(np.arange(count) == j, d, at) for d in grid]
                costs = np.array([cost(one, kept).min() for one in moved])
                places = _low(costs)
                at[j], low = grid[places[0]], float(costs[places[0]])
                if sweep == SWEEPS - 1:
                    others += [(float(costs[k]), moved[k]) for k in places[1:3]]
        found = [(low, at.copy()), found[0], *others]
    return _distinct([*found[:MOST_PLACES], nothing]), kept


def _low(costs: Array) -> NDArray[np.intp]:
    """Positions of the local minima, the lowest first."""
    around = np.concatenate([[np.inf], costs, [np.inf]])
    low = np.flatnonzero((costs <= around[:-2]) & (costs <= around[2:]))
    return low[np.argsort(costs[low], kind="stable")]


def _distinct(places: Sequence[tuple[float, Array]]) -> list[tuple[float, Array]]:
    kept: list[tuple[float, Array]] = []
    for cost, one in places:
        if not any(np.array_equal(one, other) for _, other in kept):
            kept.append((cost, one))
    return kept


def _refined(problem: Problem, delays: Array) -> Point:
    """The search for poles at given delays, and both refined together."""
    late = problem.delayed(delays).freed(None)
    return _from(problem, delays, Search(STARTS).begin(late, [_kept(problem)]).point.poles)


def _from(problem: Problem, delays: Array, poles: Complex) -> Point:
    late = problem.delayed(delays)
    at = partial(evaluate, late)
    return finish(at, at(poles), None, MOST_STEPS)[0]


def _held(problem: Problem, delays: Array, poles: Complex) -> Point:
    """The poles first, with the delays held, so that these do not slide back at once."""
    late = problem.delayed(delays).freed(None)
    at = partial(evaluate, late)
    return _from(problem, delays, finish(at, at(poles), None, HELD_STEPS)[0].poles)


def _elsewhere(point: Point) -> list[Array]:
    """Delays, one of them moved with the poles held, where the cost has another low minimum."""
    problem, found = point.problem, []
    assert problem.limits is not None
    for j, limit in enumerate(problem.limits):
        grid = np.linspace(0.0, float(limit), FINE + 1)
        tried = [np.where(np.arange(problem.n_inputs) == j, d, problem.delays) for d in grid]
        costs = np.array([evaluate(problem, point.poles, 1, delays=d).objective for d in tried])
        here = APART * (grid[1] - grid[0])
        found += [
            (float(costs[k]), tried[k])
            for k in _low(costs)
            if costs[k] < point.objective + NEAR and abs(grid[k] - problem.delays[j]) > here
        ]
    return [delays for _, delays in sorted(found, key=lambda one: one[0])[:MOST_PLACES]]


def _ladder(point: Point) -> list[Array]:
    """Delays, one of them half a step away, one step, two, up to the step of the grid."""
    problem, found = point.problem, []
    assert problem.limits is not None
    for j, limit in enumerate(problem.limits):
        away = 0.5 * min(e.dt for e in problem.experiments)
        rungs = max(int(np.ceil(np.log2(float(limit) / PLACES / away))), 0) + 1
        for rung in range(min(rungs, MOST_RUNGS)):
            for sign in (-1.0, 1.0):
                moved = problem.delays.copy()
                moved[j] += sign * away * 2.0**rung
                if 0.0 <= moved[j] <= limit:
                    found.append(moved)
    return found


def _kept(problem: Problem) -> Variant:
    """The problem as it is: no nuisance term dropped."""
    e = problem.experiments[0]
    return Variant(e.free, e.offset, e.drift, (None,) * len(problem.experiments))
