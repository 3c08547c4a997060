"""Which of the other explanations a record speaks for, each fitted before it is named.

The rivals are compared by AICc, each with a noise model of its own. A cause that is tested early
(`finding.CODES` has the order) may pass for a later one: a late input, a held one that was not
held, or a cubic spring are all explained in part by more poles. More poles explain a little of
everything, so that the best criterion is not enough: the first cause in that order is named whose
rival gains the greater part of what the best one gains.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tridentify.causes.attempt import Attempt, attempt, promise
from tridentify.causes.delay import delay_rivals
from tridentify.causes.intersample import BEHAVIOURS, IN_WORDS, is_staircase
from tridentify.causes.present import Present
from tridentify.causes.rivals import (
    Rival,
    drift_rivals,
    nonlinear_rivals,
    one,
    order_rivals,
    varying_rivals,
)
from tridentify.errors import TridentifyError
from tridentify.finding import CODES
from tridentify.numerics.interpolation import FEWEST
from tridentify.output_error.finish import coefficients

Array = NDArray[np.float64]

CLEARLY = 10.0
"""Fall of AICc from which another explanation is worth a word: odds of 150 to 1."""

MOST_OF_IT = 0.7
"""Share of the best rival's gain from which an earlier cause is named in its place."""

FOLLOWED = 3
"""Rivals of one code that are fitted: those that promise most."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """A rival that was fitted.

    Attributes
    ----------
    rival : Rival
    attempts : tuple of Attempt
        Where its parts ended.
    gain : float
        Fall of AICc against the present explanation.
    share : float
        By how much the sum of squares of the residual falls with it (0 to 1).
    """

    rival: Rival
    attempts: tuple[Attempt, ...]
    gain: float
    share: float


@dataclass(frozen=True, eq=False)
class Explanations:
    """The present explanation, and the rivals that were fitted, the best first.

    Attributes
    ----------
    present : Attempt
    found : tuple of Explanation
    """

    present: Attempt
    found: tuple[Explanation, ...]

    @property
    def named(self) -> Explanation | None:
        """The first cause that makes the greater part of what can be gained."""
        clear = [one for one in self.found if one.gain > CLEARLY]
        if not clear:
            return None
        enough = MOST_OF_IT * clear[0].gain
        rank = list(CODES)
        return min(
            (one for one in clear if one.gain >= enough),
            key=lambda one: (rank.index(one.rival.code), -one.gain),
        )


def explain(present: Present, *, skip: Iterable[str] = ()) -> Explanations | None:
    """Fit all that may explain the records better.

    Parameters
    ----------
    present : Present
    skip : iterable of str
        Codes that are not tried.

    Returns
    -------
    Explanations or None
        None where the present explanation itself cannot be fitted.
    """
    here = _attempted(one("", present, "", ""))
    if here is None:
        return None
    (base,) = here
    settled = _from(present, base)
    pairs = zip(base.point.problem.experiments, base.point.residuals(), strict=True)
    fitted = [experiment.y - residual for experiment, residual in pairs]
    left_out = set(skip)
    found = []
    for code, rivals in _rivals(settled, fitted).items():
        if code in left_out:
            continue
        for rival in rivals:
            ends = _attempted(rival)
            if ends is not None:
                found.append(_explanation(rival, ends, base))
    return Explanations(base, tuple(sorted(found, key=lambda one: -one.gain)))


def _from(present: Present, base: Attempt) -> Present:
    """From where the present explanation ended."""
    return replace(present, poles=base.point.poles, noise=base.point.problem.noise)


def _rivals(present: Present, fitted: Sequence[Array]) -> dict[str, list[Rival]]:
    """Of every code those that promise most."""
    every = [
        *_intersample_rivals(present),
        *delay_rivals(present),
        *nonlinear_rivals(present, fitted),
        *varying_rivals(present),
        *drift_rivals(present),
        *order_rivals(present),
    ]
    sorted_: dict[str, list[Rival]] = {}
    for rival in every:
        sorted_.setdefault(rival.code, []).append(rival)
    return {
        code: own if len(own) <= FOLLOWED else sorted(own, key=_promised)[:FOLLOWED]
        for code, own in sorted_.items()
    }


def _promised(rival: Rival) -> float:
    parts = zip(rival.parts, rival.starts, strict=True)
    return sum(min(promise(part, poles) for poles in starts) for part, starts in parts)


def _intersample_rivals(present: Present) -> list[Rival]:
    records = present.records
    now = records[0].behaviour
    limited = not is_staircase(records) and all(
        r.dt is not None and r.n_samples >= FEWEST for r in records
    )
    found = []
    for behaviour in BEHAVIOURS:
        if behaviour == now or (behaviour == "band-limited" and not limited):
            continue
        other = replace(present, records=tuple(r.between(behaviour) for r in records))
        found.append(
            one(
                "intersample",
                other,
                f"an input that is {IN_WORDS[behaviour]}, where it is taken as {IN_WORDS[now]}",
                f"State intersample={behaviour!r} (--intersample {behaviour}), or 'auto'.",
            )
        )
    return found


def _attempted(rival: Rival) -> tuple[Attempt, ...] | None:
    found = []
    for part, starts in zip(rival.parts, rival.starts, strict=True):
        try:
            end = attempt(part.problem(), starts, part.orders)
        except TridentifyError:
            return None
        if end is None:
            return None
        found.append(end)
    return tuple(found)


def _explanation(rival: Rival, ends: tuple[Attempt, ...], base: Attempt) -> Explanation:
    """A rival on fewer samples (those after a longer delay) counts as if it had all of them."""
    count = sum(end.count for end in ends)
    unknowns = float(sum(end.unknowns for end in ends))
    deviance = sum(end.deviance for end in ends)
    if len(ends) > 1 and not any(end.point.problem.noise for end in ends):
        deviance = _joint(ends)
    deviance *= base.count / count
    room = max(base.count - unknowns - 1.0, 0.5)
    criterion = deviance + 2.0 * unknowns + 2.0 * unknowns * (unknowns + 1.0) / room
    before = float(np.sum(base.point.rss / base.point.problem.power))
    after = sum(float(np.sum(end.point.rss / base.point.problem.power)) for end in ends)
    share = 1.0 - after * base.count / count / before if before > 0 else 0.0
    return Explanation(rival, ends, base.criterion - criterion, share)


def _joint(ends: Sequence[Attempt]) -> float:
    """``-2 log L`` of several parts whose noise has one variance an output."""
    counts = np.sum([end.point.counts for end in ends], axis=0)
    rss = np.sum([end.point.rss for end in ends], axis=0)
    size = ends[0].point.problem.size
    return float(counts @ np.log(rss / counts + 1e-20 * size))


def moved(explanation: Explanation, base: Attempt, std: Array) -> tuple[int, float, float, float]:
    """The coefficient that moves most with an explanation of the same structure.

    Returns
    -------
    position, before, after, size
        The last in standard errors; position -1 where the coefficients are other ones.
    """
    (end, *others) = explanation.attempts
    if others or end.point.problem.n_coefficients != base.point.problem.n_coefficients:
        return -1, np.nan, np.nan, np.nan
    a, b = coefficients(base.point), coefficients(end.point)
    size = np.abs(b - a) / np.where(std > 0, std, np.inf)[: a.size]
    k = int(np.argmax(size))
    return k, float(a[k]), float(b[k]), float(size[k])
