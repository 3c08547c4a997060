"""Step 4: from the starts of the search to the stationary point of the output error.

Every choice of nuisance terms that is worth it is finished there, and AICc decides
(`likelihood.choose_nuisance`). An end at a limit is no end: the poles that ran away are put back,
and the better of the two counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from tridentify.estimation.answer.trace import Awaited, Start, Status, Trace
from tridentify.estimation.likelihood.answer import Ending
from tridentify.estimation.likelihood.choose_nuisance import Finished, decide
from tridentify.estimation.likelihood.cost import Point, evaluate
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import (
    Recorder,
    coefficients,
    criterion,
    finish,
    mean_square,
)
from tridentify.estimation.likelihood.question import Question
from tridentify.estimation.methods.base import Progress
from tridentify.estimation.search.delays import Located
from tridentify.estimation.search.following import AT_ONCE, CERTAIN
from tridentify.estimation.search.found import Scan, Starts
from tridentify.estimation.search.search import search_again
from tridentify.estimation.search.stand_ins import is_large
from tridentify.numerics.arrays import Array, Complex
from tridentify.record.record import Record
from tridentify.structure import Structure

SOUND = (Status.CONVERGED, Status.WEAKLY_IDENTIFIABLE)


@dataclass(frozen=True, eq=False)
class Maximum:
    """The likelihood's maximum, and the way there.

    Attributes
    ----------
    end : Finished
    decisions : tuple of str
        About nuisance terms and noise.
    trail : Recorder
        The passes that led to where the end was begun from.
    tried : tuple of Start
        All starts with the cost they led to.
    moved : (n_coefficients,) array, optional
        Half of how far white weights lead from the end, where that is more than chance.
    """

    end: Finished
    decisions: tuple[str, ...]
    trail: Recorder
    tried: tuple[Start, ...]
    moved: Array | None = None

    def told(self, *words: str) -> Maximum:
        """The same with further decisions."""
        return replace(self, decisions=(*self.decisions, *words))


def maximum(question: Question, starts: Starts) -> Maximum:
    """The lowest output error that the starts lead to.

    Parameters
    ----------
    question : Question
    starts : Starts
        From `search.search`.
    """
    reached = _only_end(question, starts)
    known = starts.triangles if reached is None else {}
    found = decide(question, starts.seeds, known, reached)
    best = Maximum(found.best, found.decisions, starts.trails[found.seed], starts.tried)
    if best.end.status in SOUND:
        return best
    question.say("another search, as the end lies at a limit")
    poles, start = search_again(question.held, best.end.nuisances, best.end.point.poles)
    best = replace(best, tried=(*best.tried, start))
    other = decide(question, [poles])
    if other.best.criterion < best.end.criterion:
        best = replace(best, end=other.best, decisions=other.decisions)
    return best


def _only_end(question: Question, starts: Starts) -> Point | None:
    """Where the search ended, if there is nothing to choose from there."""
    end = starts.reached
    if end is None or len(starts.seeds) > 1 or len(question.choices) > 1:
        return None
    is_own = end.problem is question.variants[0].problem(question.base)
    return end if is_own and np.array_equal(end.poles, starts.seeds[0]) else None


@dataclass(frozen=True, eq=False)
class Reached(Ending):
    """The ending of a method that goes to the likelihood's maximum.

    Attributes
    ----------
    scan : Scan, optional
        The search's last look at other places.
    open_drift : int
        Highest degree of a drift that the residual of white weights asked to try; 0 for none.
    """

    scan: Scan | None = None
    open_drift: int = 0

    @classmethod
    def of(
        cls, end: Finished, trace: Trace, scan: Scan | None = None, moved: Array | None = None
    ) -> Reached:
        """Where the steps ended."""
        return cls(
            end.point, end.nuisances, end.status, end.criterion, trace, moved=moved, scan=scan
        )


def nearby(question: Question, near: Complex) -> Reached | None:
    """The maximum next to poles that the record may well have, if they are known there.

    Parameters
    ----------
    question : Question
    near : (n,) complex array

    Returns
    -------
    Reached or None
        None where nuisance terms are open, for a long record, and where the poles are not known to
        `CERTAIN`: then a search may find others.
    """
    if len(question.choices) > 1 or is_large(question.base):
        return None
    (chosen,), (variant,), recorder = question.choices, question.variants, Recorder()
    problem = question.chosen(chosen)
    at = partial(evaluate, problem)
    start = at(problem.admissible(near)[0])
    settled = question.patience.settled(start.counts.sum())
    point, status, why = finish(at, start, recorder, question.patience.most, settled)
    if status is not Status.CONVERGED or point.looseness > CERTAIN:
        return None
    end = Finished(chosen, point, status, why, criterion(point), recorder)
    tried = (Start(AT_ONCE, coefficients(point), mean_square(point)),)
    trace = Trace(Awaited(lambda: tuple(recorder.passes)), tried, (), why)
    return Reached.of(end, trace, Scan(question.base, variant, point.poles, []))


class Maximiser(Protocol):
    """A method that goes to the likelihood's maximum: what the loops around it are given."""

    @property
    def name(self) -> str:
        """What tables and files call it."""

    def maximise(
        self,
        records: Sequence[Record],
        structure: Structure,
        say: Progress,
        located: Located | None = None,
    ) -> Reached:
        """The maximum for known delays, or for delays near some that are known."""

    def weighed(self, reached: Reached, say: Progress) -> Ending:
        """Where to end: there or, where that is not to be trusted, beyond it."""
