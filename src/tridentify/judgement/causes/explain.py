"""Which of the other explanations a record speaks for, each fitted before it is named.

The rivals are compared by AICc, each with a noise model of its own. A cause that is tested early
(`finding.CODES` has the order) may pass for a later one: a late input, a held one that was not
held, or a cubic spring are all explained in part by more poles. More poles explain a little of
everything, so that the best criterion is not enough: the first cause in that order is named whose
rival gains the greater part of what the best one gains.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.finding import CODES
from tridentify.estimation.likelihood.levenberg_marquardt import coefficients
from tridentify.judgement.causes.attempt import ROUNDING, ROUNDS, Attempt, attempt, promise
from tridentify.judgement.causes.backlash import backlash_rivals, with_gap
from tridentify.judgement.causes.both import both_rivals
from tridentify.judgement.causes.delay import delay_rivals, neighbours, shifted
from tridentify.judgement.causes.feedback import Coming, reacts
from tridentify.judgement.causes.intersample import (
    BEHAVIOURS,
    IN_WORDS,
    MATERIAL,
    MATERIAL_STAIRCASE,
    is_staircase,
)
from tridentify.judgement.causes.lost import Place, lost_rival
from tridentify.judgement.causes.present import Present
from tridentify.judgement.causes.pulses import pulse_rivals
from tridentify.judgement.causes.rivals import (
    Rival,
    drift_rivals,
    nonlinear_rivals,
    one,
    order_rivals,
    varying_rivals,
)
from tridentify.judgement.causes.saturation import saturation_rivals, with_limits
from tridentify.judgement.causes.slow import slow_rivals
from tridentify.numerics.arrays import Array
from tridentify.numerics.information import aicc_price
from tridentify.numerics.interpolation import FEWEST
from tridentify.record.record import Record

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

ALONE = 0.5
"""Share of the gain of lost rows that no other cause may reach: cuts in a record explain a little
of everything that is not noise."""

LEAST_SHARE = 0.005
"""Share of the sum of squares below which a cause changes nothing that anyone could see."""

LOST = 3.0
"""Fit [percent points] that a noise model may cost before it is not used to compare."""

WORSE = 0.2
"""Fall of the simulated fit [percent points] from which an explanation is none that anyone would
use, whatever its likelihood on whitened samples."""

SHARPER = 3
"""Times that a non-linearity is fitted anew, at most: each begins with a better output."""

BENT = ("nonlinear", "varying")
"""Causes that follow what is slow as well."""

FINEST = 0.125
"""Samples to either side of a delay at which its likelihood is looked at, to find the top of it."""

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
    """

    present: Attempt
    found: tuple[Explanation, ...]
    reacts: tuple[Coming | None, ...] = ()
    asked: Present | None = None

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
        ]
        if not clear:
            return None
        enough = MOST_OF_IT * clear[0].gain
        rank = list(CODES)
        code = min((one.rival.code for one in clear if one.gain >= enough), key=rank.index)
        if code in BENT and self._is_slow(code, clear):
            code = "drift"
        if code == "intersample" and self._is_late(clear):
            code = "delay"
        own = [one for one in clear if one.rival.code == code]
        # a line is as plain as an offset: which of the two it is, the criterion says by itself
        lines = [one.gain for one in own if one.rival.refits] if code == "drift" else []
        least = max(lines, default=0.0) - CLEARLY
        near = [one for one in own if one.gain >= max(NEARLY * own[0].gain, least)]
        if code == "nonlinear":
            # what bends in another way is another cause, and not a simpler one
            near = [one for one in near if one.rival.what == own[0].rival.what]
        return min(near, key=lambda one: (one.unknowns, -one.gain))

    def _is_slow(self, code: str, clear: Sequence[Explanation]) -> bool:
        """Whether what is slow explains as much as a bend or a change of the coefficients.

        An offset or a drift, to be estimated along, or slow waves where these explain clearly more.
        """
        bent = max(one.gain for one in clear if one.rival.code == code)
        drifts = [one for one in clear if one.rival.code == "drift"]
        lines = max((one.gain for one in drifts if one.rival.refits), default=-np.inf)
        waves = max((one.gain for one in drifts if not one.rival.refits), default=-np.inf)
        return lines >= min(bent, AS_MUCH * clear[0].gain) or AS_MUCH * waves > bent

    def _is_late(self, clear: Sequence[Explanation]) -> bool:
        """Whether a delay explains clearly more than any behaviour between the samples.

        A delay of half a sample makes up for most of what lines have over steps, and lines for half
        a sample of a longer delay: the better of the two is the cause.
        """
        between, late = (
            max((one.gain for one in clear if one.rival.code == code), default=-np.inf)
            for code in ("intersample", "delay")
        )
        return bool(AS_MUCH * late > between and late > between + CLEARLY)

    def _is_worse(self, one: Explanation) -> bool:
        """Whether the simulated output of some channel is farther from the recorded one."""
        if len(one.attempts) > 1:
            return False
        return bool(np.any(one.fits(self.present) < self.present.fits - WORSE))

    def _is_a_bend(self, one: Explanation) -> bool:
        """Whether pulses have sizes of their own where a function of the input explains as much."""
        if one.rival.code != "intersample" or one.rival.refits:
            return False
        bends = [other.gain for other in self.found if other.rival.code in ("nonlinear", "delay")]
        return max(bends, default=0.0) > AS_MUCH * one.gain

    def _is_needless(self, one: Explanation) -> bool:
        """Whether two remedies together explain hardly more than one of them alone.

        They have as many unknowns: the smallest change that explains the record is the one to make.
        An input that repeats its values is held, whatever a likelihood leans to.
        """
        if one.rival.changes < 2:
            return False
        codes = ("intersample", "delay")
        alone = [e.gain for e in self.found if e.rival.code in codes and e.rival.changes < 2]
        most = max(alone, default=0.0)
        material = MATERIAL_STAIRCASE if is_staircase(one.rival.parts[0].records) else MATERIAL
        return one.gain < most + max(CLEARLY, material * self.present.count)

    def _is_shared(self, one: Explanation) -> bool:
        """Whether rows seem lost where something else explains much of the same."""
        if one.rival.code != "lost-rows":
            return False
        return any(
            other.gain > ALONE * one.gain for other in self.found if other.rival.code != "lost-rows"
        )


def explain(
    present: Present,
    *,
    skip: Collection[str] = (),
    torn: Sequence[Place] = (),
    only: str = "",
    known: Explanations | None = None,
) -> Explanations | None:
    """Fit all that may explain the records better.

    Parameters
    ----------
    present : Present
    skip : collection of str
        Codes that are not tried.
    torn : sequence of Place
        Where the state of the model seems to jump (`lost.jumps`).
    only : str
        The one code that is tried, where it is not lost rows; whether the input reacts is left
        open then.
    known : Explanations, optional
        Of an earlier question: where it was the same but for lost rows, nothing is fitted again.

    Returns
    -------
    Explanations or None
        None where the present explanation itself cannot be fitted; lost rows alone where the state
        jumps and they do not explain it.
    """
    if known is not None and known.asked is not None and known.asked.is_same(present) and not torn:
        found = [one for one in known.found if one.rival.code != "lost-rows"]
        return _ranked(found, _from(present, known.present), known.present, present)
    base = settle(present)
    if base is None:
        return None
    settled = _from(present, base)
    found = [] if only or "lost-rows" in skip else _fitted(lost_rival(settled, torn), base)
    if torn and not any(one.is_clear for one in found):
        return Explanations(base, tuple(found), (None,) * base.point.problem.n_outputs)
    pairs = zip(base.point.problem.experiments, base.point.residuals(), strict=True)
    fitted = [experiment.y - residual for experiment, residual in pairs]
    for code, rivals in _rivals(settled, fitted, only).items():
        if code not in skip:
            found += _fitted(rivals, base)
    if only in ("", "nonlinear"):
        found += _fitted(backlash_rivals(settled, fitted), base)
    found += _sharper(found, settled, base)
    found += [] if only else _together(found, settled, base)
    found += _lines_again(found, settled, base)
    if only:
        return Explanations(base, tuple(sorted(found, key=lambda one: -one.gain)))
    return _ranked(found, settled, base, None if skip else present)


def _ranked(
    found: Sequence[Explanation], settled: Present, base: Attempt, asked: Present | None
) -> Explanations:
    """All explanations, with the delays beside one that is named, and whether the input reacts."""
    result = Explanations(base, tuple(sorted(found, key=lambda one: -one.gain)), asked=asked)
    named = result.named
    if named is not None and named.rival.code == "delay":
        more = _fitted(neighbours(settled, named.rival), base)
        every = sorted([*result.found, *more], key=lambda one: -one.gain)
        result = replace(result, found=tuple(every))
    most = max((one.gain for one in result.found), default=0.0)
    rival = () if result.best is None else _with_inputs(result.best, settled.records)
    return replace(result, reacts=tuple(reacts(base, settled.records, max(most, 0.0), rival)))


def _with_inputs(
    named: Explanation, records: Sequence[Record]
) -> tuple[tuple[Attempt, Sequence[Record]], ...]:
    """Where the parts of a cause ended, and the recorded inputs there, without those it adds."""
    n_inputs = records[0].n_inputs
    found = []
    for end, part in zip(named.attempts, named.rival.parts, strict=True):
        own = [one.select(inputs=one.input_names[:n_inputs]) for one in part.records]
        found.append((end, own))
    return tuple(found)


def _fitted(rivals: Iterable[Rival], base: Attempt) -> list[Explanation]:
    """Those that can be fitted."""
    pairs = ((rival, _attempted(rival)) for rival in rivals)
    return [_explanation(rival, ends, base) for rival, ends in pairs if ends is not None]


def settle(present: Present) -> Attempt | None:
    """Where the present explanation ends on these records; None where it cannot be fitted."""
    plain = _attempted(one("", replace(present, noise=()), "", ""))
    if plain is None:
        return None
    here = _attempted(one("", present, "", "")) if present.has_noise else plain
    if here is None or np.any(here[0].fits < plain[0].fits - LOST):
        # a noise model that takes the system for noise compares nothing
        here = plain
    return here[0]


def _sharper(found: Sequence[Explanation], present: Present, base: Attempt) -> list[Explanation]:
    """The best non-linearity again, as a function of the outputs that it leads to itself."""
    n = present.records[0].n_inputs
    bends = [one for one in found if one.rival.parts[0].records[0].n_inputs > n]
    own = [one for one in bends if one.rival.code == "nonlinear" and one.gain > CLEARLY]
    better: list[Explanation] = []
    for _ in range(SHARPER if own else 0):
        best = max([*own, *better], key=lambda one: one.gain)
        (end,) = best.attempts
        pairs = zip(end.point.problem.experiments, end.point.residuals(), strict=True)
        fitted = [experiment.y - residual for experiment, residual in pairs]
        again = [r for r in nonlinear_rivals(present, fitted) if r.what == best.rival.what]
        ends = _attempted(again[0]) if again else None
        if ends is None:
            break
        better.append(_explanation(again[0], ends, base))
        if better[-1].gain < best.gain + CLEARLY:
            break
    return better


def _together(found: Sequence[Explanation], present: Present, base: Attempt) -> list[Explanation]:
    """Another behaviour between the samples and a delay at once, where either explains much."""
    n = present.records[0].n_inputs
    codes = ("intersample", "delay")
    single = [one for one in found if one.rival.code in codes and one.rival.refits and one.is_clear]
    lost = any(one.rival.code == "lost-rows" and one.is_clear for one in found)
    if lost or not single or not any(one.rival.code == "delay" for one in found):
        return []
    behaviours = tuple(
        one.rival
        for one in found
        if one.rival.code == "intersample" and one.rival.parts[0].records[0].n_inputs == n
    )
    both = _fitted(both_rivals(present, behaviours), base)
    best = [
        max(
            (one for one in several if one.rival.code == code),
            key=lambda one: one.gain,
            default=None,
        )
        for several, code in ((found, "delay"), (both, "intersample"))
    ]
    clear = [one for one in best if one is not None and one.is_clear]
    more = [new for one in clear for new in _finer(one, present, base)]
    return [*both, *more]


def _finer(one: Explanation, present: Present, base: Attempt) -> list[Explanation]:
    """Delays beside one, to the top of the parabola through their gains.

    Where there is little noise, a tenth of a sample outweighs what the input does in between.
    """
    sides = [_fitted([shifted(present, one.rival, by)], base) for by in (-FINEST, FINEST)]
    if not all(sides):
        return []
    (before,), (after,) = sides
    bend = before.gain - 2.0 * one.gain + after.gain
    if not bend < 0.0:
        return [before, after]
    top = 0.5 * FINEST * (before.gain - after.gain) / bend
    top = float(np.clip(top, -2.0 * FINEST, 2.0 * FINEST))
    return [before, after, *_fitted([shifted(present, one.rival, top)], base)]


def _lines_again(
    found: Sequence[Explanation], present: Present, base: Attempt
) -> list[Explanation]:
    """An offset and a line from where slow waves led, which may take both for a response no more.

    A model that was fitted to a drift has poles that make one, and a line beside these gains
    nothing.
    """
    own = [one for one in found if one.rival.code == "drift" and one.is_clear]
    best = max(own, key=lambda one: one.gain, default=None)
    if best is None or best.rival.refits:
        return []
    (end,) = best.attempts
    rivals = (replace(one, starts=((end.point.poles,),)) for one in drift_rivals(present))
    return _fitted(rivals, base)


def _from(present: Present, base: Attempt) -> Present:
    """From where the present explanation ended."""
    return replace(present, poles=base.point.poles, noise=base.point.problem.noise)


def _rivals(present: Present, fitted: Sequence[Array], only: str) -> dict[str, list[Rival]]:
    """Of every code but lost rows, or of one, those that promise most."""
    makers: tuple[tuple[tuple[str, ...], Callable[[], Iterable[Rival]]], ...] = (
        (("intersample",), lambda: _intersample_rivals(present)),
        (("input-noise", "intersample"), lambda: pulse_rivals(present)),
        (("delay",), lambda: delay_rivals(present)),
        (("saturation",), lambda: saturation_rivals(present, fitted)),
        (("nonlinear",), lambda: nonlinear_rivals(present, fitted)),
        (("varying", "disagreeing-experiments"), lambda: varying_rivals(present)),
        (("drift",), lambda: drift_rivals(present)),
        (("drift",), lambda: slow_rivals(present)),
        (("order-low",), lambda: order_rivals(present)),
    )
    sorted_: dict[str, list[Rival]] = {}
    for codes, make in makers:
        for rival in make() if not only or only in codes else ():
            if rival.code == (only or rival.code):
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
    # parts are compared under the noise model that they share
    rounds = ROUNDS if len(rival.parts) == 1 else 0
    for part, starts in zip(rival.parts, rival.starts, strict=True):
        try:
            end = attempt(part.problem(), starts, part.orders, rounds=rounds)
        except TridentifyError:
            return None
        if end is None:
            return None
        if rival.gap is not None:
            end = with_gap(end, rival.gap)
        found.append(end if rival.limits is None else with_limits(end, rival.limits))
    return tuple(found)


def _explanation(rival: Rival, ends: tuple[Attempt, ...], base: Attempt) -> Explanation:
    """Compare on the samples that the rival explains: a longer delay leaves some out."""
    masks = [np.isfinite(one) for end in ends for one in end.residuals()]
    whole = [np.isfinite(one) for one in base.point.residuals()]
    if len(ends) == 1 and len(masks) > len(whole):
        # pieces of records
        lengths = np.cumsum([one.shape[0] for one in whole])[:-1]
        masks = np.split(np.concatenate(masks), lengths)
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
