"""The search of a record, or of stand-ins for a long one (`search.stand_ins`).

A long record is searched in a window, and averaged. Where the window's poles leave nothing but
white noise on the whole record there is nothing left for the averages to find; otherwise both are
judged on a longer window.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from tridentify.estimation.answer.estimate import Pass, Start
from tridentify.estimation.likelihood.cost import Point, evaluate_variant
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import Recorder, criterion, finish
from tridentify.estimation.likelihood.question import Question
from tridentify.estimation.likelihood.setup.nuisance import Nuisances
from tridentify.estimation.likelihood.setup.problem import Problem, Variant
from tridentify.estimation.likelihood.thresholds import CLEARLY, PLAUSIBLE, WORTHWHILE
from tridentify.estimation.search.band import SLOW_EDGE
from tridentify.estimation.search.following import CERTAIN, Search, explained
from tridentify.estimation.search.found import ALIKE, Far, KnownTriangles, SearchEnd, Starts
from tridentify.estimation.search.stand_ins import (
    SMALL,
    averaged,
    free_variant,
    is_large,
    is_usable,
    window,
)
from tridentify.estimation.search.starts import best_laguerre
from tridentify.estimation.search.whole_record import (
    HOPELESS_RATIO,
    LONGER,
    MOST_SHARPENING,
    end_of,
    leaves_white_noise,
    nearer,
)
from tridentify.numerics.arrays import Complex
from tridentify.numerics.slices import drain

FEW_ADAPTED = 3
"""Adapted passes from the window's best start, before anything else is tried."""
OF_WINDOW = "window of the record: "
OF_AVERAGES = "record averaged: "


def search(
    question: Question,
    n_starts: int,
    far: Far | None = None,
    *,
    whitened_later: bool = False,
    near: Complex | None = None,
) -> Starts:
    """Steps 1 and 2 from several operators, repeated until a richer model has nothing to add.

    Parameters
    ----------
    question : Question
    n_starts : int
        Most starts of a kind that are followed.
    far : Far, optional
        What the averaged record gave to the search of the same records before they were whitened.
    whitened_later : bool
        Whether noise that is not white will get a model, and whitened samples a search of their
        own: then this one need not follow what only coloured noise asks for.
    near : (n,) complex array, optional
        Poles that the record may well have: the search begins there and not with Laguerre models,
        and ends there where they are then known to `CERTAIN`.
    """
    worker = RecordSearch(n_starts, far=far, whitened_later=whitened_later, near=near)
    worker.run(question.base, question.variants)
    seeds, trails, tried = tuple(worker.seeds), tuple(worker.trails), tuple(worker.starts)
    return Starts(seeds, trails, tried, n_starts, worker.known, worker.scan, worker.far, near)


def search_again(question: Question, nuisances: Nuisances, poles: Complex) -> tuple[Complex, Start]:
    """Another way in, after the end turned out to lie at a limit: runaway poles put back.

    Parameters
    ----------
    question : Question
    nuisances : Nuisances
        Of the end.
    poles : (n,) complex array
        Where it lies.

    Returns
    -------
    (n,) complex array
        The best poles reached from the relocated ones.
    Start
        How they were come by.
    """
    worker = Search(1)
    found = drain(worker.trying_again(question.base, question.variant_of(nuisances), poles))
    return found, worker.starts[-1]


@dataclass(eq=False)
class RecordSearch(Search):
    """`Search` of a record of any length."""

    hastens: ClassVar[bool] = True

    def run(self, base: Problem, variants: Sequence[Variant]) -> None:
        """Find poles from the record, or from stand-ins for a long one."""
        if not is_large(base):
            drain(self.running(base, variants))
            return
        self.near = None  # what a window or averages show of these poles is another matter
        piece = window(base)
        passes: list[Pass] = []
        first: SearchEnd | None = None
        near: Point | None = None
        if is_usable(piece):
            if self._at_once(base, variants, piece):
                return
            first = drain(self.following(piece, [free_variant(piece)], OF_WINDOW))
            near = self.move(first, OF_WINDOW)
            passes = list(self.recorder.passes)
            if first.settled and self._suffices(base, variants, near, passes):
                return
        little = averaged(base)
        if first is None or near is None or not is_usable(little):
            drain(self.running(base, variants))
            return
        far = self._averaged(little, variants, first.settled)
        blind = explained(far) < WORTHWHILE <= explained(near)
        self._choose(base, near.poles, far.poles, passes, blind)

    def _averaged(self, little: Problem, variants: Sequence[Variant], settled: bool) -> Point:
        """Where the search of the averaged record leads."""
        known = self.far
        if known is not None and known.settled == settled:
            self.recorder.passes[:], self.scan = known.passes, known.scan
            return known.point
        if settled:
            second = self.begin(little, variants, OF_AVERAGES, most=1)
        else:
            second = drain(self.following(little, variants, OF_AVERAGES))
        point = self.move(second, OF_AVERAGES)
        self.far = Far(settled, point, tuple(self.recorder.passes), self.scan)
        return point

    def _at_once(self, base: Problem, variants: Sequence[Variant], piece: Problem) -> bool:
        """Whether the window's best Laguerre model leads to an end that leaves no doubt."""
        variant = free_variant(piece)
        start = best_laguerre(piece, variant)
        reachable = start.criterion + PLAUSIBLE
        poles = start.reduced_poles()
        if poles is None:
            return False
        name = OF_WINDOW + start.name
        point = drain(self._adapted(piece, variant, poles, reachable, None, name, FEW_ADAPTED))
        if criterion(point) >= reachable:
            return False
        return self._suffices(base, variants, point, self.recorder.passes, CERTAIN)

    def _suffices(
        self,
        base: Problem,
        variants: Sequence[Variant],
        near: Point,
        passes: Sequence[Pass],
        loosest: float = np.inf,
    ) -> bool:
        """Whether the window's poles leave nothing but white noise on the whole record.

        Then there is nothing for the averaged record to find. Slow dynamics that the window cannot
        show are looked for in block means of the residual.

        A pole or pair at the wrong place has next to nothing to explain, and is loose. Where all
        poles are much less loose than ``loosest`` none of them needs to be looked for elsewhere.
        """
        if explained(near) < WORTHWHILE or base.noise:
            return False
        shown = np.sqrt(near.counts.sum() / sum(e.n_samples for e in base.experiments))
        if near.looseness * shown > HOPELESS_RATIO * loosest:
            return False
        end = self.end
        if end is None or not np.allclose(end.near, near.poles, rtol=ALIKE, atol=0.0):
            end = self.end = end_of(base, variants, near, loosest)
        if end is None or end.point.looseness > loosest or not leaves_white_noise(end.point):
            return False
        self._keep(end.poles, [*passes, *end.passes])
        self.known = KnownTriangles(end.poles, end.whole, end.alone)
        return True

    def _choose(
        self, base: Problem, near: Complex, far: Complex, passes: list[Pass], blind: bool
    ) -> None:
        """Poles of the window, of the averaged record, or both, judged on a longer window.

        Averaging spoils what is faster than a block, so its poles are dropped where the
        window's explain the longer window clearly better and that is long enough to show the
        slowest of them.
        """
        piece = window(base, LONGER * SMALL)
        if sum(e.n_samples for e in base.experiments) < 4 * LONGER * SMALL or not is_usable(piece):
            self._keep(near, passes)
            if not blind:
                self._keep(far)
            return
        at = partial(evaluate_variant, piece, free_variant(piece))
        point, other = at(near), at(far)
        shown = float(np.min(-far.real)) * piece.experiments[0].duration > SLOW_EDGE
        clear = other.objective - point.objective > CLEARLY
        if clear and (shown or blind):
            sharp = finish(at, point, Recorder(), MOST_SHARPENING)[0].poles
            self._keep(nearer(base, sharp), passes)
        else:
            self._keep(near, passes)
            self._keep(far)
