"""A rival fitted: its ends, and what it gains on the samples that it explains."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.judgement.causes.attempts.attempt import ROUNDING, ROUNDS, Attempt, attempt
from tridentify.judgement.causes.attempts.explanation import Explanation
from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.attempts.rivals import Rival
from tridentify.numerics.information import aicc_price


def fitted(rivals: Iterable[Rival], base: Attempt) -> list[Explanation]:
    """Those of the rivals that can be fitted.

    Parameters
    ----------
    rivals : iterable of Rival
    base : Attempt
        The present explanation, fitted.
    """
    pairs = ((rival, attempted(rival)) for rival in rivals)
    return [explanation_of(rival, ends, base) for rival, ends in pairs if ends is not None]


def from_end(present: Present, base: Attempt) -> Present:
    """The present explanation from where it ended.

    Parameters
    ----------
    present : Present
    base : Attempt
        It, fitted.
    """
    return replace(present, poles=base.point.poles, noise=base.point.problem.noise)


def attempted(rival: Rival) -> tuple[Attempt, ...] | None:
    """The ends of the parts of a rival; None where one has none.

    Parameters
    ----------
    rival : Rival
    """
    found = []
    # parts are compared under the noise model that they share
    rounds = ROUNDS if len(rival.parts) == 1 else 0
    for part, starts in zip(rival.parts, rival.starts, strict=True):
        try:
            end = attempt(part.problem(), starts, part.orders, rounds=rounds)
        except TridentifyError:
            return None
        if end is None:
            return None
        found.append(end if rival.behind is None else rival.behind(end))
    return tuple(found)


def explanation_of(rival: Rival, ends: tuple[Attempt, ...], base: Attempt) -> Explanation:
    """Compare on the samples that the rival explains: a longer delay leaves some out.

    Parameters
    ----------
    rival : Rival
    ends : tuple of Attempt
        Of its parts.
    base : Attempt
        The present explanation, fitted.
    """
    masks = [np.isfinite(one) for end in ends for one in end.residuals()]
    whole = [np.isfinite(one) for one in base.point.residuals()]
    if len(ends) == 1 and len(masks) > len(whole):
        # pieces of records
        lengths = np.cumsum([one.shape[0] for one in whole])[:-1]
        masks = np.split(np.concatenate(masks), lengths)
    if rival.experiment is not None and len(ends) > 1:
        masks.insert(rival.experiment, masks.pop())
    split = len(masks) != len(whole)
    same = split or all(np.array_equal(a, b) for a, b in zip(masks, whole, strict=True))
    before = base.deviance if same else base.on(masks).deviance
    if len(ends) > 1:
        # one variance for all parts: noise that changes its size is no change of the system
        deviance, before = _joint(ends), _joint((base,))
    else:
        deviance = ends[0].deviance
    count = sum(end.count for end in ends)
    unknowns = sum(end.unknowns for end in ends)
    if len(ends) > 1:
        unknowns -= (len(ends) - 1) * sum(a.size for a in base.point.problem.noise)
    gain = before - deviance + aicc_price(float(base.unknowns), count)
    gain -= aicc_price(float(unknowns), count)
    gain -= rival.price
    energy = base.energy if same else base.on(masks).energy
    left = sum(end.energy for end in ends)
    share = 1.0 - left / energy if energy > 0 else 0.0
    return Explanation(rival, ends, gain, share, unknowns)


def _joint(ends: Sequence[Attempt]) -> float:
    """``-2 log L`` of several parts whose noise has one variance an output."""
    counts = np.sum([end.point.counts for end in ends], axis=0)
    rss = np.sum([end.point.rss for end in ends], axis=0)
    size = ends[0].point.problem.size
    return float(counts @ np.log(rss / counts + ROUNDING * size))
