"""Where the delays lie: a profile of convex parallel models, then low-order models from there.

The output-error cost has many minima along a delay, about one to each period of what the output
does, and one for each way in which a fast pole can stand for a part of the delay. So its range is
looked at as a whole before anything is refined.

1. *Parallel models.* At every place of a grid the record is fitted by Laguerre functions of the
   delayed inputs, which is convex, and AICc says how many of them and how well. Too short a delay
   costs functions, too long a one misses the beginning of the response; the criterion is lowest
   near the delay, whatever the poles. With several inputs one delay is taken along the grid at a
   time, the others held, beginning from what is best for all in common.
2. *Low order.* At the lowest places the poles are searched (`search.search`), and poles and
   delays are refined together (`likelihood.minimum.levenberg_marquardt`).
3. *Away from there.* With the poles held the reduced cost is taken along each delay, and other
   minima that come near it are followed. Nearer by, where a delay can be traded for poles and
   zeros and the cost of a held input has a kink at every step, poles and delays are refined anew
   from half a step away, one, two, four, and so on up to the step of the grid, the delay held at
   first. Both are repeated as long as that helps.

A free initial state stands for the inputs before the record, so the samples before the longest
delay that is tried are explained by nothing. In a record with few edges they may hold all there is
to see, and a model that sees none of them always fits. So the range is searched in stretches, the
shortest delays first, none on fewer samples than its end allows, and a later delay has to explain
the samples that it allows better than the earlier one explains the same samples, both refined on
them. What it leaves out beyond a tenth of the record counts against it, one for each sample: as
much as an unknown of its own for each would bring and cost by AIC. A start at rest leaves nothing
out. Where all inputs repeat themselves the range ends before they do (`repeated_input`).

All this runs on a stand-in where the record is long, and with a start of every kind that the
structure allows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from tridentify.estimation.likelihood.cost import Point, evaluate
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import criterion, finish
from tridentify.estimation.likelihood.setup.held_past import held_before
from tridentify.estimation.likelihood.setup.nuisance import SLACK, Nuisances, build
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.estimation.likelihood.thresholds import EQUAL, HELPED, NEAR, PLAUSIBLE
from tridentify.estimation.search.band import rate_limits
from tridentify.estimation.search.following import Search
from tridentify.estimation.search.repeated_input import (
    LONGEST,
    LONGEST_STATED,
    longest_told,
)
from tridentify.estimation.search.stand_ins import SMALL, free_variant, is_large, is_usable, window
from tridentify.estimation.search.starts import parallel_criteria
from tridentify.models.regression import Experiment
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.slices import drain
from tridentify.record.record import Record
from tridentify.structure import InitialState, Structure

# shares of the shortest record: ends of the stretches of the range, the last one for a start that
# is known, which leaves no sample out
STRETCHES = (0.03, 0.1, LONGEST)
# steps; fewer than a stretch has places would be one place twice
SHORTEST_STRETCH = 6.0
# places of a stretch; a place for every width that a function of a parallel model can bridge
PLACES = 12
FINE = 36
"""Places of a delay at which the cost is taken with the poles held: three for every place of the
profile."""
RATES = 5
"""Rates of Laguerre functions that are tried, evenly over the band in the logarithm."""
FUNCTIONS = 10
"""Most Laguerre functions of a parallel model of the profile: of low order, so that it cannot stand
for a delay itself."""
MOST_PLACES = 3
"""Places that are followed, of a profile and of what lies elsewhere: they bound the time."""
MOST_RUNGS = 6
"""Places on either side on the ladder: from half a step to sixteen."""
STARTS = 2
"""Starts followed in the search for poles at one place."""
MOST_STEPS = 12
"""Steps on poles and delays from a place, to rank it: the best is finished later."""
HELD_STEPS = 6
"""Steps on the poles alone before the delay is let go, or it would slide back at once."""
MOST_ROUNDS = 4
"""Times that elsewhere and the ladder are tried again from a better end: it bounds the time."""
SWEEPS = 2
"""Times that the delays of several inputs are taken along the grid, one at a time."""
MOST_RIVALS = 6
"""Other ends that are kept for the uncertainty of the delay: they bound the time."""
FEW_STEPS = 5.0
"""Steps within which two delays are one place, so that the later one need not be better by
`EQUAL`."""
KEPT_RATES = 2
"""Rates with which all places are looked at, the best of `RATES`."""
# of how many places one is looked at with all rates
THINNED = 3
APART = 0.5
"""Steps within which two delays are the same end, and share of a place's width within which
elsewhere is here."""
AGREE = 0.25
"""Steps within which two kinds of start agree, so that little is looked for around the second."""
ROOM = 2.0
"""Steps beyond a delay, in which it may still move. Doubled, two of three short records end
worse."""
# share of the samples that a delay may leave out for nothing
FREE_SHARE = 0.1


class DelayEnds(NamedTuple):
    """The end of lowest cost, other ends of about that cost, and the rates that suit."""

    best: Point
    ends: list[Point]
    rates: Array


@dataclass(frozen=True, eq=False)
class DelayPlace:
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


def delay_places(records: Sequence[Record], structure: Structure) -> list[DelayPlace]:
    """Delays and poles to begin from, the best of every kind of start.

    Parameters
    ----------
    records : sequence of Record
    structure : Structure
        With free delays.

    Returns
    -------
    list of DelayPlace
        At least one.
    """
    step = min(float(np.median(np.diff(record.t))) for record in records)
    kept: list[DelayPlace] = []
    near: DelayEnds | None = None
    for whole in _problems(records, structure):
        near = _of_kind(whole, near)
        best = near.best
        delays = best.problem.delays
        if not any(np.all(np.abs(one.delays - delays) < APART * step) for one in kept):
            kept.append(DelayPlace(delays, best.poles, _rivals(best, near.ends, step)))
    return kept


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


def _problems(records: Sequence[Record], structure: Structure) -> list[Problem]:
    """Small problems without delay on all samples, their limits the longest that is looked for."""
    kinds: tuple[str, ...] = (structure.initial_state,)
    if structure.initial_state == "auto":
        moved = any(np.any(record.u[0]) for record in records)
        kinds = ("free", "rest", "equilibrium") if moved else ("free", "rest")
    shortest = min(record.duration for record in records)
    told = max(longest_told(records, j) for j in range(records[0].n_inputs))
    found = []
    for kind in kinds:
        offset = structure.offset is not False or kind == "equilibrium"
        chosen = Nuisances(kind, offset, structure.drift_degree)
        longest = (STRETCHES[-1] if kind == "free" else LONGEST_STATED) * shortest
        state = cast("InitialState", kind)
        known = replace(structure, delay=0.0, initial_state=state, offset=offset)
        problem = build(records, known, chosen)
        piece = problem
        if is_large(problem):
            step = min(e.dt for e in problem.experiments)
            piece = window(problem, SMALL + int(np.ceil(longest / step)))
            piece = piece if is_usable(piece) else problem
        limits = np.full(problem.n_inputs, min(longest, LONGEST_STATED * piece.shortest, told))
        found.append(piece.freed(limits))
    return found


def _until(whole: Problem, longest: float) -> Problem:
    """Delays up to the longest, on the samples that these allow."""

    def allowed(e: Experiment) -> Experiment:
        unknown = longest - held_before(e.u, e.instants) if e.free else 0.0
        start = int(np.searchsorted(e.instants, unknown - SLACK * e.dt)) if unknown > 0.0 else 0
        if not start:
            return e
        y = e.y.copy()
        y[:start] = np.nan
        return replace(e, y=y, start=start)

    assert whole.limits is not None
    some = whole.over([allowed(e) for e in whole.experiments])
    return some.freed(np.minimum(whole.limits, longest))


def _stretches(whole: Problem) -> Iterator[tuple[float, float]]:
    """Ends of the stretches of the range, the shortest delays first [s]."""
    assert whole.limits is not None
    last, step = float(whole.limits[0]), min(e.dt for e in whole.experiments)
    low = 0.0
    if len({e.dt for e in whole.experiments}) > 1:
        # the search for poles fails where free states begin at different times
        yield low, last
        return
    for share in (*STRETCHES, LONGEST_STATED):
        high = min(max(share * whole.shortest, low + SHORTEST_STRETCH * step), last)
        # the next would be next to nothing
        high = last if last - high < SHORTEST_STRETCH * step else high
        if high > low:
            yield low, high
        low = high


def left_out(problem: Problem) -> tuple[float, float]:
    """Output samples that no input explains, and all of them."""
    lost = sum(e.start for e in problem.experiments) * problem.n_outputs
    return float(lost), float(sum(e.n_samples for e in problem.experiments) * problem.n_outputs)


def price(lost: float, samples: float) -> float:
    """What samples that are left out count in ``-2 log L``.

    Examples
    --------
    >>> price(30.0, 400.0), price(100.0, 400.0)
    (0.0, 60.0)
    """
    return max(lost - FREE_SHARE * samples, 0.0)


def _of_kind(whole: Problem, near: DelayEnds | None) -> DelayEnds:
    """Poles and delays of the lowest cost with one kind of start, stretch by stretch.

    With another kind of start before, only the lowest place is searched anew, where the end of the
    first is not near it, and what lies around is looked at only where the two kinds do not agree.
    """
    best: Point | None = None
    ends: list[Point] = []
    rates = near.rates if near else None
    for low, high in _stretches(whole):
        problem = _until(whole, high)
        begun = [best] if best is not None else []
        if (
            near is not None
            and np.all(near.best.problem.delays <= high)
            and (np.any(near.best.problem.delays > low) or not low)
        ):
            begun.append(near.best)
        found = _best(problem, low, begun, rates, alone=near is None)
        rates = found.rates
        if best is None:
            best, ends = found.best, found.ends
            continue
        for end in _contenders(found.ends, best):
            best, ends = _better(whole, best, ends, end)
    assert best is not None
    assert rates is not None
    return DelayEnds(best, ends, rates)


def _contenders(ends: Sequence[Point], best: Point) -> list[Point]:
    """Ends elsewhere that may be better: the lowest, and the earliest that is about as low."""
    step = min(e.dt for e in best.problem.experiments)
    other = [
        end
        for end in ends
        if np.any(np.abs(end.problem.delays - best.problem.delays) > APART * step)
    ]
    if not other:
        return []
    lowest = min(other, key=lambda end: end.objective)
    equal = [end for end in other if end.objective < lowest.objective + EQUAL]
    earliest = min(equal, key=lambda end: float(end.problem.delays.sum()))
    return [earliest] if earliest is lowest else [earliest, lowest]


def _better(
    whole: Problem, best: Point, ends: list[Point], later: Point
) -> tuple[Point, list[Point]]:
    """The better one of two, on the samples that the later one allows; and all ends beside it."""
    step = min(e.dt for e in whole.experiments)
    both = [float(one.problem.delays.max()) for one in (best, later)]
    some = _until(whole, max(both) + ROOM * step)
    assert some.limits is not None
    # it may not slide to the other's place
    beside = some.freed(np.minimum(some.limits, best.problem.delays + ROOM * step))
    one = _from(beside, best.problem.delays, best.poles)
    other = _from(some, later.problem.delays, later.poles)
    asked = EQUAL if both[1] > both[0] + FEW_STEPS * step else 0.0
    asked += price(*left_out(some)) - price(*left_out(_until(whole, both[0])))
    if other.objective < one.objective - asked:
        return other, [one, other]
    return best, ends


def _best(
    problem: Problem, low: float, begun: Sequence[Point], rates: Array | None, *, alone: bool
) -> DelayEnds:
    """Poles and delays of the lowest cost that was found in a stretch, and all other ends.

    Parameters
    ----------
    problem : Problem
        Its limits are the end of the stretch.
    low : float
        Its beginning [s].
    begun : sequence of Point
        What was found before.
    rates : (k,) array, optional
        Those of the parallel models [rad/s].
    alone : bool
        Whether this is the first kind of start.
    """
    assert problem.limits is not None
    places, rates = _profile(problem, low, rates, begun)
    ends = [_from(problem, one.problem.delays, problem.admissible(one.poles)[0]) for one in begun]
    if not alone:
        around = (problem.limits - low) / PLACES
        known = [one.problem.delays for one in begun]
        places = [p for p in places[:1] if all(np.any(np.abs(p[1] - k) > around) for k in known)]
    for cost, delays in places:
        if ends and cost > min(criterion(end) for end in ends) + PLAUSIBLE:
            continue
        ends.append(_refined(problem, delays, thorough=not ends))
    best = min(ends, key=lambda point: point.objective)
    step = min(e.dt for e in problem.experiments)
    agree = any(
        np.all(np.abs(best.problem.delays - one.problem.delays) < AGREE * step) for one in begun
    )
    for _ in range(0 if agree and not alone else 1 if agree else MOST_ROUNDS):
        before = best
        ends += [_from(problem, delays, before.poles) for delays in _elsewhere(before, low)]
        best = min(ends, key=lambda point: point.objective)
        if not agree or best is not before:
            for delays in _ladder(before, low):
                ends.append(_held(problem, delays, best.poles))
                best = min((best, ends[-1]), key=lambda point: point.objective)
        if best.objective > before.objective - HELPED:
            break
    return DelayEnds(best, ends, rates)


def _profile(
    problem: Problem, low: float, rates: Array | None, begun: Sequence[Point]
) -> tuple[list[tuple[float, Array]], Array]:
    """Delays where the parallel models' criterion is low, the lowest first, and the best rates."""
    assert problem.limits is not None
    grid = np.linspace(low, float(problem.limits[0]), PLACES + 1)[1 if low else 0 :]
    count = problem.n_inputs
    tried = np.geomspace(*rate_limits(problem), RATES) if rates is None else rates

    def cost(delays: Array, rates: Array) -> Array:
        late = problem.delayed(delays).freed(None)
        return parallel_criteria(late, rates, FUNCTIONS)

    common_delays = [np.full(count, delay) for delay in grid]
    kept = tried
    if tried.size > KEPT_RATES:
        every = np.array([cost(one, tried) for one in common_delays[::THINNED]])
        kept = tried[np.argsort(every.min(axis=0))[:KEPT_RATES]]
    common = np.array([cost(one, kept).min() for one in common_delays])
    found = [(float(common[k]), np.full(count, grid[k])) for k in _low(common)]
    nothing = [(float(common[0]), np.zeros(count))] if not low else []
    if count > 1:
        at = begun[0].problem.delays.copy() if begun else found[0][1].copy()
        lowest = found[0][0]
        others: list[tuple[float, Array]] = []
        for sweep in range(SWEEPS):
            for j in range(count):
                moved = [np.where(np.arange(count) == j, d, at) for d in grid]
                costs = np.array([cost(one, kept).min() for one in moved])
                places = _low(costs)
                at[j], lowest = grid[places[0]], float(costs[places[0]])
                if sweep == SWEEPS - 1:
                    others += [(float(costs[k]), moved[k]) for k in places[1:3]]
        found = [(lowest, at.copy()), found[0], *others]
    return _distinct([*found[:MOST_PLACES], *nothing]), kept


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


def _refined(problem: Problem, delays: Array, *, thorough: bool) -> Point:
    """The search for poles at given delays, and both refined together.

    Most places need few starts. Where these end far above what the parallel model reaches, and no
    other end is there to begin from, more kinds of starts are followed: all places would else be
    judged by poor ends.
    """
    late = problem.delayed(delays).freed(None)
    worker, variants = Search(STARTS), [free_variant(late)]
    found = worker.begin(late, variants)
    if thorough and criterion(found.point) > found.reachable + PLAUSIBLE:
        found = drain(worker.following(late, variants))
    return _from(problem, delays, found.point.poles)


def _from(problem: Problem, delays: Array, poles: Complex) -> Point:
    assert problem.limits is not None
    late = problem.delayed(np.minimum(delays, problem.limits))
    at = partial(evaluate, late)
    return finish(at, at(poles), None, MOST_STEPS)[0]


def _held(problem: Problem, delays: Array, poles: Complex) -> Point:
    """The poles first, with the delays held, so that these do not slide back at once."""
    late = problem.delayed(delays).freed(None)
    at = partial(evaluate, late)
    return _from(problem, delays, finish(at, at(poles), None, HELD_STEPS)[0].poles)


def _elsewhere(point: Point, low: float) -> list[Array]:
    """Delays, one of them moved with the poles held, where the cost has another low minimum."""
    problem, found = point.problem, []
    assert problem.limits is not None
    for j, limit in enumerate(problem.limits):
        grid = np.linspace(low, float(limit), FINE + 1)
        tried = [np.where(np.arange(problem.n_inputs) == j, d, problem.delays) for d in grid]
        costs = np.array([evaluate(problem, point.poles, 1, delays=d).objective for d in tried])
        here = APART * (grid[1] - grid[0])
        found += [
            (float(costs[k]), tried[k])
            for k in _low(costs)
            if costs[k] < point.objective + NEAR and abs(grid[k] - problem.delays[j]) > here
        ]
    return [delays for _, delays in sorted(found, key=lambda one: one[0])[:MOST_PLACES]]


def _ladder(point: Point, low: float) -> list[Array]:
    """Delays, one of them half a step away, one step, two, up to the step of the grid."""
    problem, found = point.problem, []
    assert problem.limits is not None
    for j, limit in enumerate(problem.limits):
        away = 0.5 * min(e.dt for e in problem.experiments)
        widest = max((float(limit) - low) / PLACES, SHORTEST_STRETCH * away)
        rungs = max(int(np.ceil(np.log2(widest / away))), 0) + 1
        for rung in range(min(rungs, MOST_RUNGS)):
            for sign in (-1.0, 1.0):
                moved = problem.delays.copy()
                moved[j] += sign * away * 2.0**rung
                if 0.0 <= moved[j] <= limit:
                    found.append(moved)
    return found
