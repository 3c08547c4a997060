"""Explanations that were fitted, and the rule that names one of them.

A cause that is tested early (`finding.CODES` has the order) may pass for a later one: a late input,
a held one that was not held, or a cubic spring are all explained in part by more poles. More poles
explain a little of everything, so that the best criterion is not enough: the first cause in that
order is named whose rival gains the greater part of what the best one gains.

A rival fitted: its ends, and what it gains on the samples that it explains.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.finding import CODES
from tridentify.judgement.causes.attempts.attempt import ROUNDING, ROUNDS, Attempt, attempt
from tridentify.judgement.causes.attempts.feedback import Coming
from tridentify.judgement.causes.attempts.intersample import clear_fall, seems_held
from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.attempts.rivals import Rival
from tridentify.numerics.arrays import Array
from tridentify.numerics.information import aicc_price
from tridentify.record.checks.samples import is_switched

CLEARLY = 10.0
"""Fall of AICc from which another explanation is worth a word: odds of 150 to 1."""

MOST_OF_IT = 0.7
"""Share of the best rival's gain from which an earlier cause is named in its place."""

NEARLY = 0.8
"""The same among rivals of one cause, of which the simplest is named."""

AS_MUCH = 0.9
"""Share of the best rival's gain from which an offset or a line is named before a bend or a change
of the coefficients, which follow what is slow as well where the input is as slow or moves in a few
places only."""

FOLLOW = ("nonlinear", "order-low")
"""Causes that follow whatever has an instant or a delay of its own, with more freedom."""

ALONE = 0.5
"""Share of the gain of lost rows that no other cause may reach: cuts in a record explain a little
of everything that is not noise."""

LEAST_SHARE = 0.005
"""Share of the sum of squares below which a cause changes nothing that anyone could see."""

WORSE = 0.2
"""Fall of the simulated fit [percent points] from which an explanation is none that anyone would
use, whatever its likelihood on whitened samples."""

WORSE_BETWEEN = 0.02
"""The same of times at which an input moved between the samples, as a share of what is not
followed: they explain what is sharp, and what is slow then ends up a little elsewhere by chance."""

OF_ONE_STEP = ("nonlinear", "drift")
"""Causes that one step of the input says little of."""

BENT = ("nonlinear", "varying")
"""Causes that follow what is slow as well."""


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
    unknowns : int
    """

    rival: Rival
    attempts: tuple[Attempt, ...]
    gain: float
    share: float
    unknowns: int

    @property
    def is_clear(self) -> bool:
        """Whether it gains enough to be worth a word."""
        return self.gain > CLEARLY and self.share > LEAST_SHARE

    def fits(self, base: Attempt) -> Array:
        """(n_outputs,) NRMSE [percent] of one part, about the means of the records as they are."""
        (end,) = self.attempts
        if len(end.point.problem.experiments) == len(base.point.problem.experiments):
            return end.fits
        return np.asarray(100.0 * (1.0 - np.sqrt(end.raw_energy / base.spread)))


@dataclass(frozen=True, eq=False)
class Explanations:
    """The present explanation, and the rivals that were fitted, the best first.

    Attributes
    ----------
    present : Attempt
    found : tuple of Explanation
    reacts : tuple of Coming or None
        Per output, what inputs to come explain where that is the cause: the input reacts.
    asked : Present, optional
        What all causes were tried on; None where only some were.
    printed : (n_outputs,) array, optional
        Fit [percent] of the estimate as it stands on the samples of the present explanation, which
        is fitted anew and may end elsewhere; None where that is not of these records.
    """

    present: Attempt
    found: tuple[Explanation, ...]
    reacts: tuple[Coming | None, ...] = ()
    asked: Present | None = None
    printed: Array | None = None

    @property
    def named(self) -> Explanation | None:
        """The first cause that makes the greater part of what can be gained.

        Of several rivals of that cause, the one with fewest unknowns that gains nearly as much as
        the best of them. None where the input reacts to the output.
        """
        return None if any(self.reacts) else self.best

    @cached_property
    def best(self) -> Explanation | None:
        """The same, whatever the input does."""
        clear = [
            one
            for one in self.found
            if one.is_clear
            and not self._is_worse(one)
            and not self._is_shared(one)
            and not self._is_a_bend(one)
            and not self._is_needless(one)
            and not self._is_no_late_log(one)
        ]
        clear = self._without_exact(clear)
        if not clear or clear[0].rival.exact:
            return next(iter(clear), None)
        enough = MOST_OF_IT * clear[0].gain
        rank = list(CODES)
        code = min((one.rival.code for one in clear if one.gain >= enough), key=rank.index)
        if code in BENT and self._is_slow(code, clear):
            code = "drift"
        if code == "nonlinear" and _is_clearly_more(clear, "disagreeing-experiments", "nonlinear"):
            code = "disagreeing-experiments"
        if code in OF_ONE_STEP and self._is_of_one_step(code, clear):
            code = "order-low"
        if code == "intersample" and _is_clearly_more(clear, "delay", "intersample"):
            code = "delay"
        if code == "delay" and _is_clearly_more(clear, "order-low", "delay"):
            code = "order-low"
        own = [one for one in clear if one.rival.code == code]
        # a line is as plain as an offset: which of the two it is, the criterion says by itself
        lines = [one.gain for one in own if one.rival.refits] if code == "drift" else []
        least = max(lines, default=0.0) - CLEARLY
        near = [one for one in own if one.gain >= max(NEARLY * own[0].gain, least)]
        if code == "nonlinear":
            # what bends in another way is another cause, and not a simpler one
            near = [one for one in near if one.rival.what == own[0].rival.what]
        return min(near, key=lambda one: (one.unknowns, -one.gain))

    @staticmethod
    def _without_exact(clear: Sequence[Explanation]) -> list[Explanation]:
        """The exact cause alone where it explains clearly more than the others, or these."""
        others = [one for one in clear if not one.rival.exact]
        exact = next((one for one in clear if one.rival.exact), None)
        loose = max((one.gain for one in others if one.rival.code in FOLLOW), default=0.0)
        # a system that changes slowly is followed by a change at one instant almost as well
        halves = max((one.gain for one in others if one.rival.code == "varying"), default=0.0)
        known = (*FOLLOW, "varying")
        strict = max((one.gain for one in others if one.rival.code not in known), default=0.0)
        if exact is not None and exact.rival.as_lags:
            own = (one.gain for one in others if one.rival.code == "order-low")
            strict = max(strict, max(own, default=0.0))
        least = max(AS_MUCH * loose, halves, strict / NEARLY, strict + CLEARLY)
        return [exact] if exact is not None and exact.gain > least else others

    def _is_slow(self, code: str, clear: Sequence[Explanation]) -> bool:
        """Whether what is slow explains as much as a bend or a change of the coefficients.

        An offset or a drift, to be estimated along; slow waves where a bend does not explain
        clearly more.
        """
        bent = max(one.gain for one in clear if one.rival.code == code)
        drifts = [one for one in clear if one.rival.code == "drift"]
        lines = max((one.gain for one in drifts if one.rival.refits), default=-np.inf)
        waves = max((one.gain for one in drifts if not one.rival.refits), default=-np.inf)
        # a change that goes on is not one between two halves, and waves follow it
        waves = waves if code == "nonlinear" else -np.inf
        return bool(lines >= min(bent, AS_MUCH * clear[0].gain) or waves > bent - CLEARLY)

    def _is_of_one_step(self, code: str, clear: Sequence[Explanation]) -> bool:
        """Whether more poles explain more than a bend, or waves, of what one step shows.

        One amplitude says nothing of another, and what wanders may be a part of one response: both
        are a guess there, and their shape is what makes up for poles that are missing. Where the
        system does bend, or its output wanders, that explains more than any poles.
        """
        inputs = (e.u for e in self.present.point.problem.experiments)
        if not all(np.all(np.count_nonzero(np.diff(u, axis=0), axis=0) < 2) for u in inputs):
            return False
        bend, poles = (
            max((one.gain for one in clear if one.rival.code == each), default=-np.inf)
            for each in (code, "order-low")
        )
        return bool(poles > bend)

    def _is_worse(self, one: Explanation) -> bool:
        """Whether the simulated output of some channel is farther from the recorded one."""
        if len(one.attempts) > 1:
            return False
        now = self.present.fits
        share = WORSE_BETWEEN if one.rival.kind == "between" else 0.0
        return bool(np.any(one.fits(self.present) < now - np.maximum(WORSE, share * (100.0 - now))))

    def _is_a_bend(self, one: Explanation) -> bool:
        """Whether pulses have sizes of their own where a function of the input explains as much."""
        if one.rival.code != "intersample" or one.rival.refits:
            return False
        bends = [other.gain for other in self.found if other.rival.code in ("nonlinear", "delay")]
        return max(bends, default=0.0) > AS_MUCH * one.gain

    def _is_needless(self, one: Explanation) -> bool:
        """Whether another behaviour, or two remedies together, bring hardly more than nothing else.

        Two remedies together have as many unknowns as one of them alone: the smallest change that
        explains the record is the one to make. An input that seems to be held is held, whatever a
        likelihood leans to, as where its behaviour is left open. One that is switched jumps: where
        one remedy explains most of it, the other takes up a share of what else is missing.
        """
        rival = one.rival
        alone = rival.changes < 2
        if alone and (rival.code != "intersample" or not rival.refits):
            return False
        held = seems_held(rival.parts[0].records)
        if alone:
            return held and one.gain < clear_fall(int(self.present.count), held)
        codes = ("intersample", "delay")
        singles = [e.gain for e in self.found if e.rival.code in codes and e.rival.changes < 2]
        single = max(singles, default=0.0)
        switched = any(is_switched(record.u) for record in rival.parts[0].records)
        mostly = switched and AS_MUCH * one.gain < single
        return mostly or one.gain < single + clear_fall(int(self.present.count), held)

    def _is_no_late_log(self, one: Explanation) -> bool:
        """Whether inputs seem logged late where another behaviour, or more freedom, does as well.

        A direct part, which follows the input at once, explains most of it too, with an unknown
        more: it is the cause where it explains clearly more.
        """
        if one.rival.kind != "late-log":
            return False
        others = [other for other in self.found if other is not one]
        loose = max((e.gain for e in others if e.rival.code in FOLLOW), default=0.0)
        plain = [e for e in others if e.rival.code == "intersample" and e.rival.changes < 2]
        plainer = max((e.gain for e in plain), default=0.0)
        return one.gain < max(min(AS_MUCH * loose, loose - CLEARLY), plainer + CLEARLY)

    def _is_shared(self, one: Explanation) -> bool:
        """Whether rows seem lost where something else explains much of the same."""
        # where the time stamps tell of gaps no instants were looked for, and that is its headline
        if one.rival.code != "lost-rows" or one.rival.headline:
            return False
        return any(
            other.gain > ALONE * one.gain for other in self.found if other.rival.code != "lost-rows"
        )


def _is_clearly_more(clear: Sequence[Explanation], code: str, other: str) -> bool:
    """Whether one cause explains clearly more than another, which is asked about earlier.

    What is the cause explains all there is, and its neighbour a part. A system that bends is
    explained by its bend at all amplitudes, two systems in part only. A delay of half a sample
    makes up for most of what lines have over steps, and lines for half a sample of a longer delay.
    A late input is explained by its delay, a missing fast pole in part only.
    """
    own, less = (
        max((one.gain for one in clear if one.rival.code == each), default=-np.inf)
        for each in (code, other)
    )
    return bool(AS_MUCH * own > less and own > less + CLEARLY)


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
