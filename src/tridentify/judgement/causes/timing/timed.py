"""An estimate beside the times at which its inputs moved, where nobody stated what they do.

The record decides (`moves`): held from the samples on, or moved at times of their own in between.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.likelihood.answer import widened_by
from tridentify.estimation.likelihood.cost import Point
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import coefficients
from tridentify.estimation.methods.base import Method, Progress
from tridentify.judgement.causes.attempts.attempt import Attempt, attempt
from tridentify.judgement.causes.attempts.intersample import (
    HANGS_ON_IT,
    IN_WORDS,
    MATERIAL_STAIRCASE,
    NOTABLY,
    UNDECIDED,
)
from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.attempts.revisit import point_of, stated
from tridentify.judgement.causes.timing.moves import (
    EARLIER,
    Times,
    less_what_is_missed,
    moved_earlier,
    moves_of,
    repeats,
    times_told,
)
from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.autoregression import whiten
from tridentify.numerics.whiteness import is_white
from tridentify.record.record import Record
from tridentify.structure import Structure

ROUNDS = 15
"""Fits and times in turn, at most; a step that leads upwards is halved."""

STILL = 1e-3
"""Change of a time from which the next round tells no other [samples]: a hundredth of what short
records tell of it."""


class Timed(NamedTuple):
    """A record whose inputs move at times of their own, and what is known of these.

    Attributes
    ----------
    record : Record
    early : (m,) array
        How much earlier than recorded [samples].
    told : Times
    end : Attempt
        Where the structure ends on that record.
    fall : float
        By how much ``-2 log`` of the evidence is lower than with what the input was taken for.
    """

    record: Record
    early: Array
    told: Times
    end: Attempt
    fall: float

    @property
    def is_clear(self) -> bool:
        """Whether the record says so, and no shift of all of them explains as much."""
        least = max(UNDECIDED, MATERIAL_STAIRCASE * self.end.count)
        return self.told.alike > UNDECIDED and self.fall > least

    @property
    def leaves_noise(self) -> bool:
        """Whether white noise is left: of a misfit, times of their own take up a share alone."""
        noise = self.end.point.problem.noise
        for i, own in enumerate(self.end.residuals()[0].T):
            a = noise[i] if noise else np.zeros(0)
            if not is_white([whiten(own, a)[0] if a.size else own]):
                return False
        return True


def times_beside(estimate: Estimate, records: Sequence[Record]) -> Timed | None:
    """The times of the moves, where the record may speak for such.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
        Those that were identified, with the behaviour that was used.

    Returns
    -------
    Timed or None
        None where the inputs are none of levels, and where the first step already tells that they
        moved at the samples.
    """
    if not (len(records) == 1 and estimate.status.ok and estimate.route == "open-loop"):
        return None
    (record,), asked = records, estimate.structure
    if record.dt is None or record.behaviour == "band-limited":
        return None
    if asked.constrained or asked.delay == "free" or not isinstance(asked.poles, int):
        return None
    jumps = moves_of(record)
    # one that moves at every k-th sample alone was recorded so (`slow_input`)
    if not jumps.size or repeats(jumps) > 1:
        return None
    try:
        return _timed(estimate, record, jumps, -UNDECIDED)
    except (TridentifyError, np.linalg.LinAlgError):
        return None


def with_times(
    method: Method,
    estimate: Estimate,
    records: Sequence[Record],
    structure: Structure,
    progress: Progress | None,
) -> tuple[Estimate, list[Record]]:
    """The estimate beside the times of the moves, and the record with these, where it says so.

    Else both as they are, with a word where the record does not tell and much hangs on it.

    Parameters
    ----------
    method : Method
    estimate : Estimate
        With the behaviour that explains the record best.
    records : sequence of Record
        Those that were identified.
    structure : Structure
        As it was asked for.
    progress : callable, optional
    """
    own = list(records)
    found = times_beside(estimate, own)
    if found is None:
        return estimate, own
    if not found.is_clear:
        return _said(estimate, _open_question(estimate, own[0], found)), own
    if progress is not None:
        progress("inputs that move between the samples")
    again = method.estimate([found.record], structure, progress)
    if again.status.ok and _orders(again) != _orders(estimate):
        # what the moves left had passed for noise with memory
        found = _timed(again, own[0], moves_of(own[0]), -np.inf) or found
        again = method.estimate([found.record], structure, progress)
    if not again.status.ok or again.errors == "scores":
        # times of their own take up a share of any misfit: what is left then is no noise
        return _said(estimate, _open_question(estimate, own[0], found)), own
    cov, draws = widened_by(again.cov, again.draws, list(found.told.tied.T))
    step = float(own[0].dt or 0.0)
    decision = DecisionKind.MOVES_TIMED.told(
        f" ({found.early.size} moves, {found.early.mean() * step:.2g} s earlier than recorded on "
        f"the mean, each known to {float(np.median(found.told.std)) * step:.1g} s; the standard "
        "errors allow for it)"
    )
    trace = replace(again.trace, decisions=(*again.trace.decisions, decision))
    return replace(again, cov=cov, draws=draws, trace=trace), [found.record]


def is_timed(estimate: Estimate) -> bool:
    """Whether the times at which the inputs moved were estimated along."""
    return bool(estimate.trace.about(DecisionKind.MOVES_TIMED))


def as_timed(estimate: Estimate, record: Record) -> Record:
    """A record with the times that its outputs tell, for an estimate that was found beside them.

    They belong to a record, as its offset and initial state do.

    Parameters
    ----------
    estimate : Estimate
    record : Record
    """
    jumps = moves_of(record) if record.dt is not None else np.arange(0)
    if not jumps.size:
        return record
    try:
        found = _timed(estimate, record, jumps, -np.inf)
    except (TridentifyError, np.linalg.LinAlgError):
        return record
    return record if found is None else found.record


def beside_stated_moves(estimate: Estimate, records: Sequence[Record]) -> Estimate:
    """The estimate with a word where an input was stated as held, and it moved in between.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
        Those that were identified.
    """
    found = times_beside(estimate, records)
    if found is None or not (found.is_clear and found.leaves_noise):
        return estimate
    return _said(estimate, _moved_between(estimate, records[0], found))


def _moved_between(estimate: Estimate, record: Record, found: Timed) -> tuple[Finding, ...]:
    k, before, after, size = _hanging(estimate, found)
    fit = f"fit of {estimate.output_names[0]} from {estimate.fit[0]:.2f} to {found.end.fits[0]:.2f}"
    return (
        Finding(
            "intersample",
            "warning",
            f"The input moves between its samples: {_early(found, record)}, of which "
            f"-2 log L is lower by {found.fall:.3g}, the price of the times counted.",
            "State intersample='auto' (--intersample auto), which estimates these times along, or "
            "record the input faster.",
            effect=f"With it: {estimate.names[k]} from {before:.4g} to {after:.4g} ({size:.1f} "
            f"standard errors), {fit} %.",
            kind="alone",
        ),
    )


def _open_question(estimate: Estimate, record: Record, found: Timed) -> tuple[Finding, ...]:
    k, before, after, size = _hanging(estimate, found)
    if size < HANGS_ON_IT or abs(after - before) < NOTABLY * abs(before):
        return ()
    return (
        Finding(
            "intersample",
            "warning",
            f"The record does not tell whether the input moves at its samples, "
            f"{IN_WORDS[record.behaviour]} as it is taken here, or in between "
            f"(-2 log of the evidence: {abs(found.fall):.2g} "
            f"{'lower' if found.fall > 0 else 'higher'}); {estimate.names[k]} hangs on it.",
            "State intersample='zoh' (--intersample zoh) if inputs and outputs share a clock; else "
            "record faster, or when the input moved.",
            effect=f"With moves in between: {estimate.names[k]} from {before:.4g} to {after:.4g} "
            f"({size:.1f} standard errors).",
            kind="between",
        ),
    )


def _early(found: Timed, record: Record) -> str:
    step = float(record.dt or 0.0)
    return (
        f"{found.early.size} moves come {found.early.mean() * step:.2g} s earlier than recorded on "
        f"the mean, each at a time of its own, up to {found.early.max() * step:.2g} s"
    )


def _hanging(estimate: Estimate, found: Timed) -> tuple[int, float, float, float]:
    """The coefficient that moves most, from where to where, and by how many standard errors."""
    after = coefficients(found.end.point)
    std = np.where(estimate.std > 0, estimate.std, np.inf)
    sizes = np.abs(after - estimate.theta) / std
    k = int(np.argmax(sizes))
    return k, float(estimate.theta[k]), float(after[k]), float(sizes[k])


def _orders(estimate: Estimate) -> list[int]:
    return [a.size for a in estimate.noise_model]


def _said(estimate: Estimate, found: Sequence[Finding]) -> Estimate:
    return estimate.saying(findings=(*estimate.findings, *found)) if found else estimate


def _timed(estimate: Estimate, record: Record, jumps: Indices, least: float) -> Timed | None:
    """The times, if the first step promises a fall of the evidence above a least one."""
    delay = estimate.model.delay
    here = point_of(estimate, [record], stated(estimate))
    part, early, end = record, np.zeros(jumps.size), None
    if record.behaviour != "zoh":
        # lines have the area of moves half a sample earlier
        early = np.full(jumps.size, EARLIER)
        part = moved_earlier(record, jumps, early)
        end = _ended(estimate, part, here)
        if end is None:
            return None
    told = times_told(here if end is None else end.point, record, delay, jumps, early)
    more = 0.0 if end is None else end.point.objective - here.objective
    if told is None or told.gain - told.price - more < least:
        return None
    base, length = _ended(estimate, record, here), 1.0
    last = here if end is None else end.point
    height = last.objective + told.price
    for _ in range(ROUNDS):
        new = np.clip(early + length * told.sooner, 0.0, 2.0 * EARLIER)
        change = float(np.abs(new - early).max())
        other = less_what_is_missed(last, record, delay, jumps, new)
        tried = _ended(estimate, other, last)
        if base is None or tried is None:
            return None
        again = times_told(tried.point, record, delay, jumps, new)
        if again is None:
            return None
        if tried.deviance + again.price > height and change > STILL:
            length *= 0.5
            continue
        early, part, end, told, last = new, other, tried, again, tried.point
        height, length = end.deviance + told.price, min(2.0 * length, 1.0)
        if change < STILL:
            break
    if end is None or base is None:
        return None
    return Timed(part, early, told, end, base.deviance - height)


def _ended(estimate: Estimate, record: Record, begin: Point) -> Attempt | None:
    """Where the structure ends on a record, under the noise model of the estimate."""
    part = Present.of(
        [record],
        estimate.structure,
        estimate.model.delay,
        stated(estimate),
        estimate.noise_model,
        begin.poles,
    )
    return attempt(part.problem(), [part.poles], part.orders, rounds=0)
