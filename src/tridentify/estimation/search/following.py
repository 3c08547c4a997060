"""The search for starting poles: several convex starts, and a test that tells when to stop.

A start is a parallel model turned into poles (`search.starts`) and taken through the adapted
passes (`search.passes`). Whether it is good enough is not a matter of taste: the parallel
model on the poles found, twice each, and on a spread over the whole band contains the model,
everything near it, and much that is far from it. If it explains the record better than the
model does, by AICc, then the order allows more, or the poles are wrong, and that same parallel
model is the next start. Otherwise the search ends. What is tried in turn:

1. Laguerre models, the best of the grid by AICc;
2. the best poles so far enriched by the spread, as long as that lowers the cost;
3. discrete-time least squares on the raw record;
4. models on the spread alone;
5. the same with numerators of full degree, which are easier to fit, before the wanted degree is
imposed.

When the finish on the output error nevertheless ends at a limit (a pole faster than the
sampling, or hardly decaying), runaway poles are put back into the band at several rates, and
the better end counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import ClassVar

import numpy as np

from tridentify.estimation.answer.estimate import Pass, Start
from tridentify.estimation.likelihood.cost import Point, evaluate_variant
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import (
    Recorder,
    at_rounding,
    coefficients,
    criterion,
    finishing,
    mean_square,
)
from tridentify.estimation.likelihood.noise.noise_model import leaves_coloured_noise
from tridentify.estimation.likelihood.setup.problem import Problem, Variant
from tridentify.estimation.likelihood.thresholds import ALLOWANCE, EQUAL, HELPED, NEAR, WORTHWHILE
from tridentify.estimation.search.band import rate_limits, relocated_poles
from tridentify.estimation.search.beginning import begun
from tridentify.estimation.search.found import (
    End,
    Far,
    Followed,
    KnownTriangles,
    Met,
    Scan,
    SearchEnd,
)
from tridentify.estimation.search.one_mode_moved import moving_poles
from tridentify.estimation.search.passes import MOST_ADAPTED, adapting
from tridentify.estimation.search.stand_ins import SMALL, free_variant, is_large, is_usable, window
from tridentify.estimation.search.starts import (
    ParallelStart,
    discrete_poles,
    enriched_starts,
    laguerre_slices,
    spread_slices,
)
from tridentify.estimation.search.whole_record import LONGER
from tridentify.numerics.arrays import Complex
from tridentify.numerics.least_squares import solve
from tridentify.numerics.slices import Slices, drain

MOST_ENRICHED = 8
"""Times that a richer parallel model is asked what is left: it bounds the time."""
MOST_TRIED = 12
"""Steps on the cost from a start, to rank it: the best is finished later."""
MOST_MOVES = 4
"""Times that one pole or pair is taken to another place, each after a lower one was found."""
MOST_FOLLOWED = 3
"""Places followed of one scan, the lowest."""
CERTAIN = 0.1
"""Largest standard error of a pole over its decay rate (`Point.looseness`) for which nothing needs
to be looked for elsewhere: a pole at a wrong place explains little and is loose."""
AT_ONCE = "poles that the record may have"
FURTHER = ("discrete", "spread", "relaxed")


@dataclass(eq=False)
class Search:
    """Collects passes, starts and seeds while it looks for poles.

    Attributes
    ----------
    n_starts : int
        Most starts of a kind that are followed.
    recorder : Recorder
        Passes of the best start.
    starts : list of Start
        All starts with the cost they led to.
    seeds : list of (n,) complex arrays
        Poles to finish from.
    trails : list of Recorder
        The passes that led to each seed.
    variant : Variant, optional
        The nuisance terms of the best start.
    scan : Scan, optional
        The last places looked at.
    known : KnownTriangles, optional
        Triangles of the whole record, where they were made.
    end : End, optional
        Where the window's poles led on the whole record.
    further : tuple of {"discrete", "spread", "relaxed"}
        Other kinds of starts, for where a richer model explains more.
    followed : list of Followed
        Starts that were followed to an end that is not good enough, and where they led.
    ends : list of Met
        Where steps on the cost ended.
    far : Far, optional
        What the averaged record gave.
    whitened_later : bool
        Whether coloured noise is left to a search of whitened samples.
    near : (n,) complex array, optional
        Poles that the record may well have.
    hastens : bool
        Whether an end that is known well is not looked for elsewhere. On-line, a search that takes
        fewer slices is taken up earlier.
    """

    n_starts: int
    recorder: Recorder = field(default_factory=Recorder)
    starts: list[Start] = field(default_factory=list)
    seeds: list[Complex] = field(default_factory=list)
    trails: list[Recorder] = field(default_factory=list)
    variant: Variant | None = None
    scan: Scan | None = None
    known: KnownTriangles | None = None
    end: End | None = None
    further: tuple[str, ...] = FURTHER
    followed: list[Followed] = field(default_factory=list)
    ends: list[Met] = field(default_factory=list)
    far: Far | None = None
    whitened_later: bool = False
    near: Complex | None = None
    hastens: ClassVar[bool] = False

    def running(self, base: Problem, variants: Sequence[Variant]) -> Slices[None]:
        """Find poles from all samples of the record, in slices."""
        found = yield from self.following(base, variants)
        point = yield from self.moving(found)
        self._keep(point.poles)
        triangles = point.triangles
        if found.base is base and triangles.of_base and triangles.bank.repeats == 2:
            self.known = KnownTriangles(point.poles, point=point)

    def trying_again(self, base: Problem, variant: Variant, poles: Complex) -> Slices[Complex]:
        """`search_again` in slices."""
        if is_large(base):
            piece = window(base, LONGER * SMALL)
            if is_usable(piece):
                base, variant = piece, free_variant(piece)
        at = partial(evaluate_variant, base, variant)
        ends = []
        for start in relocated_poles(base, poles):
            yield
            ends.append((yield from finishing(at, at(start), Recorder(), MOST_TRIED))[0])
        best = min(ends, key=lambda point: point.objective)
        self.starts.append(Start("runaway poles put back", coefficients(best), mean_square(best)))
        return best.poles

    def _keep(self, poles: Complex, passes: Sequence[Pass] | None = None) -> None:
        trail = Recorder(passes or ())
        if passes is None:
            trail.extend(self.recorder)
        self.seeds.append(poles)
        self.trails.append(trail)

    def begin(
        self,
        base: Problem,
        variants: Sequence[Variant],
        where: str = "",
        most: int | None = None,
    ) -> SearchEnd:
        """Laguerre starts only."""
        return drain(self._beginning(base, variants, where, most))

    def _beginning(
        self, base: Problem, variants: Sequence[Variant], where: str = "", most: int | None = None
    ) -> Slices[SearchEnd]:
        if self.near is not None:
            return (yield from self._nearby(base, _extremes(variants)[-1], self.near))
        known = begun(base, _extremes(variants)) if self.hastens and most is None else None
        if known is not None:
            reachable = known.criterion + ALLOWANCE
            if criterion(known.point) < reachable:
                self._keep_start(where + known.name, known.point)
                self.recorder, self.variant = known.recorder, known.variant
                return SearchEnd(base, known.point, known.variant, reachable, False)
            laguerre = known.starts
        else:
            laguerre = yield from laguerre_slices(base, _extremes(variants))
        reachable = laguerre[0].criterion + ALLOWANCE
        starts = _distinct(laguerre, most or self.n_starts)
        best = yield from self._best_of(starts, reachable, None, where)
        assert self.variant is not None
        return SearchEnd(base, best, self.variant, reachable, False)

    def _keep_start(self, name: str, point: Point) -> None:
        self.starts.append(Start(name, coefficients(point), mean_square(point)))

    def _nearby(self, base: Problem, variant: Variant, near: Complex) -> Slices[SearchEnd]:
        """Where poles lead that the record may well have, in place of Laguerre starts."""
        own, at = Recorder(), partial(evaluate_variant, base, variant)
        point = (yield from finishing(at, at(base.admissible(near)[0]), own, MOST_TRIED))[0]
        self._keep_start(AT_ONCE, point)
        self.recorder, self.variant = own, variant
        return SearchEnd(base, point, variant, np.inf, False)

    def _is_certain(self, point: Point) -> bool:
        """Whether poles that the record may well have are known too well to lie elsewhere."""
        return self.near is not None and point.looseness <= CERTAIN

    def following(
        self, base: Problem, variants: Sequence[Variant], where: str = ""
    ) -> Slices[SearchEnd]:
        """Follow starts until the model explains the record as well as the parallel model does."""
        found = yield from self._beginning(base, variants, where)
        best, variant, reachable = found.point, found.variant, found.reachable
        if self._is_certain(best):
            return SearchEnd(base, best, variant, reachable, True)
        extremes = _extremes(variants)
        further = list(self.further)
        if len(base.groups) > 1 and "discrete" in further:
            further.remove("discrete")
        asked: Point | None = None
        for _ in range(MOST_ENRICHED):
            if at_rounding(best):
                return SearchEnd(base, best, variant, reachable, True)
            if best is not asked:  # the same place has nothing new to tell
                variant = self.variant or variant
                enriched = yield from enriched_starts(base, variant, best.poles)
                reachable = enriched[0].criterion + ALLOWANCE
                if criterion(best) < reachable:
                    return SearchEnd(base, best, variant, reachable, True)
                # one pole is looked for along the whole band by `moving`
                if base.n_poles == 1 and explained(best) >= WORTHWHILE:
                    break
                if self.near is not None and self.whitened_later and leaves_coloured_noise(best):
                    break
                asked, before = best, criterion(best)
                best = yield from self._best_of(enriched[:2], reachable, best, where)
                if self.whitened_later and leaves_coloured_noise(best):
                    break
                if criterion(best) < before - EQUAL:
                    continue
            if not further:
                break
            kind = further.pop(0)
            if kind == "discrete":
                poles = discrete_poles(base)
                name = where + "discrete-time least squares"
                best = yield from self._adapted(base, variant, poles, reachable, best, name)
            elif kind == "spread":
                starts = yield from spread_slices(base, extremes)
                best = yield from self._best_of(starts[: self.n_starts], reachable, best, where)
            else:
                best = yield from self._relaxed(base, extremes, reachable, best, where)
        return SearchEnd(base, best, self.variant or variant, reachable, False)

    def move(self, found: SearchEnd, where: str = "") -> Point:
        """Steps on the cost, then one pole or pair taken to another place as long as that helps."""
        return drain(self.moving(found, where))

    def moving(self, found: SearchEnd, where: str = "") -> Slices[Point]:
        """`move` in slices."""
        if at_rounding(found.point) or explained(found.point) < WORTHWHILE:
            return found.point
        if self._is_certain(found.point):
            self.scan = Scan(found.base, found.variant, found.point.poles, [])
            return found.point
        at = partial(evaluate_variant, found.base, found.variant)
        start = _with_slopes(found.base, found.variant, found.point)
        best = (yield from finishing(at, start, self.recorder, MOST_TRIED))[0]
        if found.settled and self.hastens and is_known(best):
            # a richer model misses nothing, and no pole can be spared for another place
            self.scan = Scan(found.base, found.variant, best.poles, [])
            return best
        for _ in range(MOST_MOVES):
            before = best
            places = yield from moving_poles(found.base, found.variant, before.poles)
            self.scan = Scan(found.base, found.variant, before.poles, places)
            for place in places[:MOST_FOLLOWED]:
                if place.objective > best.objective + NEAR:
                    break
                own = Recorder()
                point = (yield from finishing(at, at(place.poles), own, MOST_TRIED))[0]
                self.starts.append(
                    Start(where + "one pole or pair moved", coefficients(point), mean_square(point))
                )
                if point.objective < best.objective - HELPED:
                    best = point
                    self.recorder.extend(own)
            if best is before:
                break
        return best

    def _best_of(
        self, parallel: Sequence[ParallelStart], reachable: float, best: Point | None, where: str
    ) -> Slices[Point]:
        """Follow starts until one reaches the criterion; the best point."""
        for start in parallel:
            yield
            firsts = []
            for poles in start.candidates():
                yield
                firsts.append(evaluate_variant(start.base, start.variant, poles))
            first = min(firsts, key=lambda point: point.objective)
            best = yield from self._adapted(
                start.base, start.variant, first.poles, reachable, best, where + start.name
            )
            if criterion(best) < reachable:
                break
        assert best is not None
        return best

    def _adapted(
        self,
        base: Problem,
        variant: Variant,
        poles: Complex,
        reachable: float,
        best: Point | None,
        name: str,
        most: int = MOST_ADAPTED,
    ) -> Slices[Point]:
        """Adapted passes and, where they do not reach the criterion, steps on the cost."""
        known = (one for one in self.followed if one.is_of(base, variant, poles))
        found = next(known, None)
        if found is None:
            point, own = yield from self._followed(base, variant, poles, reachable, most)
            found = Followed(base, variant, poles, point, own)
            if criterion(point) >= reachable:
                self.followed.append(found)
        point = found.point
        self._keep_start(name, point)
        if best is not None and criterion(best) <= criterion(point):
            return best
        self.recorder, self.variant = Recorder(), variant
        self.recorder.extend(found.recorder)
        return point

    def _followed(
        self, base: Problem, variant: Variant, poles: Complex, reachable: float, most: int
    ) -> Slices[tuple[Point, Recorder]]:
        """Where one start leads; what comes to an end that was met before ends there."""
        own = Recorder()
        point = yield from adapting(base, variant, poles, own, most)
        if criterion(point) >= reachable:
            for end in self.ends:
                if end.variant is variant and end.base is base and end.is_near(point):
                    return end.point, own
            at = partial(evaluate_variant, base, variant)
            yield
            start = _with_slopes(base, variant, point)
            point = (yield from finishing(at, start, own, MOST_TRIED))[0]
            self.ends.append(Met(base, variant, point))
        return point, own

    def _relaxed(
        self,
        base: Problem,
        variants: Sequence[Variant],
        reachable: float,
        best: Point,
        where: str,
    ) -> Slices[Point]:
        """Poles from numerators of full degree, then the wanted degree."""
        zeros = tuple(
            tuple(max(m, base.order(i, j) - 1) for j, m in enumerate(row))
            for i, row in enumerate(base.n_zeros)
        )
        if zeros == base.n_zeros:
            return best
        relaxed = replace(base, n_zeros=zeros)
        inner = Search(self.n_starts, further=self.further)
        point = (yield from inner.following(relaxed, variants)).point
        for variant in variants:
            name = where + "numerators of full degree first"
            best = yield from self._adapted(base, variant, point.poles, reachable, best, name)
        return best


def is_known(point: Point) -> bool:
    """Whether every pole is one that the record shows, and known to `CERTAIN`."""
    low, high = rate_limits(point.problem)
    shown = all(-z.real >= low and abs(z) <= high for z in point.poles.tolist())
    return shown and point.looseness <= CERTAIN


def _with_slopes(base: Problem, variant: Variant, point: Point) -> Point:
    """The same place, on a bank that steps on the cost begin from."""
    known = point.problem is variant.problem(base) and point.triangles.bank.repeats == 2
    return point if known else evaluate_variant(base, variant, point.poles)


def explained(point: Point) -> float:
    """Fall of -2 log L from offset and drift alone to the model: little where all is noise."""
    total, triangles = 0.0, point.triangles
    for i, cost in enumerate(point.rss.tolist()):
        rest = 0.0
        for t, target in zip(triangles.which[:, i], triangles.targets[:, i], strict=True):
            rest += solve(triangles.stack[t][:, triangles.nuisance], target).cost
        total += float(point.counts[i] * np.log(max(rest / cost, 1.0)))
    return total


def _extremes(variants: Sequence[Variant]) -> Sequence[Variant]:
    """The leanest choice, the fullest, and a start in equilibrium where that is one."""
    shifted = [v for v in variants[1:-1] if any(c is not None for c in v.constants)][:1]
    return variants if len(variants) == 1 else (variants[0], *shifted, variants[-1])


def _distinct(parallel: Sequence[ParallelStart], count: int) -> list[ParallelStart]:
    """The best starts with operators' poles at least a factor of two apart."""
    kept: list[ParallelStart] = []
    for start in parallel:
        if all(not 0.5 < start.rate / other.rate < 2.0 for other in kept):
            kept.append(start)
    return kept[:count]
