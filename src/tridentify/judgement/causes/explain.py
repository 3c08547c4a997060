"""Which of the other explanations a record speaks for, each fitted before it is named.

The rivals are compared by AICc, each with a noise model of its own; which of them is named stands
in `explanation`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from tridentify.estimation.likelihood.minimum.levenberg_marquardt import coefficients
from tridentify.judgement.causes.attempts.attempt import Attempt, promise
from tridentify.judgement.causes.attempts.explanation import (
    AS_MUCH,
    CLEARLY,
    Explanation,
    Explanations,
    attempted,
    explanation_of,
    fitted,
    from_end,
)
from tridentify.judgement.causes.attempts.feedback import reacts
from tridentify.judgement.causes.attempts.intersample import (
    AUTO,
    BEHAVIOURS,
    IN_WORDS,
    is_staircase,
)
from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.attempts.rivals import (
    DISAGREEING,
    Rival,
    drift_rivals,
    lag_rivals,
    nonlinear_rivals,
    one,
    order_rivals,
    varying_rivals,
)
from tridentify.judgement.causes.sensors.both_ways_filtered import both_ways_rivals
from tridentify.judgement.causes.sensors.breaks import break_rivals
from tridentify.judgement.causes.sensors.input_floor import floor_rivals
from tridentify.judgement.causes.sensors.lost import Place, lost_rivals
from tridentify.judgement.causes.sensors.pulses import level_rivals, pulse_rivals
from tridentify.judgement.causes.sensors.saturation import saturation_rivals
from tridentify.judgement.causes.system.backlash import backlash_rivals
from tridentify.judgement.causes.system.gains import gain_rivals
from tridentify.judgement.causes.system.odd_experiment import MOST, apart_rivals, single_rivals
from tridentify.judgement.causes.system.periodic import periodic_rivals
from tridentify.judgement.causes.system.slow import slow_rivals
from tridentify.judgement.causes.timing.clocks import clock_rivals
from tridentify.judgement.causes.timing.delay import (
    both_rivals,
    delay_rivals,
    is_later,
    neighbours,
    shifted,
)
from tridentify.judgement.causes.timing.shifts import (
    LATE_LOG,
    early_rivals,
    late_log_rivals,
    wandering_rivals,
)
from tridentify.judgement.causes.timing.slow_input import slow_input_rivals
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import fit_autoregression
from tridentify.numerics.interpolation import FEWEST
from tridentify.record.record import Record

LOST = 3.0
"""Fit [percent points] that a noise model may cost before it is not used to compare."""

SHARPER = 3
"""Times that a non-linearity is fitted anew, at most: each begins with a better output."""

FINEST = 0.125
"""Samples to either side of a delay at which its likelihood is looked at, to find the top of it."""

FOLLOWED = 3
"""Rivals of one code that are fitted: those that promise most."""


def explain(
    present: Present,
    *,
    free: bool = False,
    torn: Sequence[Place] = (),
    only: str = "",
    known: Explanations | None = None,
) -> Explanations | None:
    """Fit all that may explain the records better.

    Parameters
    ----------
    present : Present
    free : bool
        Whether the delay is estimated: none is added to it then.
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
        return _ranked(found, from_end(present, known.present), known.present, present)
    base = settle(present)
    if base is None:
        return None
    settled = from_end(present, base)
    found = [] if only else fitted(lost_rivals(settled, torn), base)
    if torn and not any(one.is_clear for one in found):
        return Explanations(base, tuple(found), (None,) * base.point.problem.n_outputs)
    pairs = zip(base.point.problem.experiments, base.point.residuals(), strict=True)
    response = [experiment.y - residual for experiment, residual in pairs]
    for code, rivals in _rivals(settled, response, only, free).items():
        estimated = free and code == "delay"
        found += fitted((rival for rival in rivals if rival.exact or not estimated), base)
    if only in ("", "nonlinear"):
        found += fitted(backlash_rivals(settled, response), base)
    if only in ("", "intersample"):
        found += fitted(late_log_rivals(settled), base)
    if only == "" and free:
        found += fitted(_followed(list(lag_rivals(settled))), base)
    found += _sharper(found, settled, base)
    found += [] if only else _together(found, settled, base)
    found += _late_again(found, settled, base)
    found += _lines_again(found, settled, base)
    found += _odd_ones(found, settled, base)
    if only:
        return Explanations(base, tuple(sorted(found, key=lambda one: -one.gain)))
    late = _late_in_colour(found, present, base)
    if late is not None:
        base, found = late
        settled = from_end(present, base)
    return _ranked(found, settled, base, None if free else present)


def _ranked(
    found: Sequence[Explanation], settled: Present, base: Attempt, asked: Present | None
) -> Explanations:
    """All explanations, with the delays beside one that is named, and whether the input reacts."""
    result = Explanations(base, tuple(sorted(found, key=lambda one: -one.gain)), asked=asked)
    named = result.named
    if named is not None and named.rival.code == "delay" and not named.rival.exact:
        more = fitted(neighbours(settled, named.rival), base)
        every = sorted([*result.found, *more], key=lambda one: -one.gain)
        result = replace(result, found=tuple(every))
    others = replace(result, found=tuple(one for one in result.found if not one.rival.calms))
    most = max((one.gain for one in others.found), default=0.0)
    rival = () if others.best is None else _with_inputs(others.best, settled.records)
    return replace(result, reacts=tuple(reacts(base, settled.records, max(most, 0.0), rival)))


def sharpened(present: Present, explained: Explanations) -> Explanation:
    """The best explanation by a delay, or one with a delay beside it that gains more.

    Parameters
    ----------
    present : Present
    explained : Explanations
        Of it, by a delay alone.
    """
    first = explained.found[0]
    settled = from_end(present, explained.present)
    beside = fitted(neighbours(settled, first.rival), explained.present)
    return max([first, *beside], key=lambda one: one.gain)


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


def settle(present: Present) -> Attempt | None:
    """Where the present explanation ends on these records; None where it cannot be fitted."""
    plain = attempted(one("", replace(present, noise=()), "", ""))
    if plain is None:
        return None
    here = attempted(one("", present, "", "")) if present.has_noise else plain
    if here is None or np.any(here[0].fits < plain[0].fits - LOST):
        # a noise model that takes the system for noise compares nothing
        here = plain
    return here[0]


def _sharper(found: Sequence[Explanation], present: Present, base: Attempt) -> list[Explanation]:
    """The best non-linearity again, as a function of the outputs that it leads to itself.

    What acts against a motion is compared there with all that may: a linear model is too far off
    to tell friction, damping by the square of the speed and a stiffness apart.
    """
    n = present.records[0].n_inputs
    bends = [one for one in found if one.rival.parts[0].records[0].n_inputs > n]
    own = [one for one in bends if one.rival.code == "nonlinear" and one.gain > CLEARLY]
    better: list[Explanation] = []
    for k in range(SHARPER if own else 0):
        best = max([*own, *better], key=lambda one: one.gain)
        (end,) = best.attempts
        pairs = zip(end.point.problem.experiments, end.point.residuals(), strict=True)
        response = [experiment.y - residual for experiment, residual in pairs]
        rivals = list(nonlinear_rivals(present, response))
        again = [one for one in rivals if one.what == best.rival.what]
        if k == 0 and best.rival.of_motion:
            others = [one for one in rivals if one.of_motion and one.what != best.rival.what]
            from_there = ((present.poles, end.point.poles),)
            better += fitted((replace(one, starts=from_there) for one in others), base)
        ends = attempted(again[0]) if again else None
        if ends is None:
            break
        same = explanation_of(again[0], ends, base)
        better.append(same)
        if max(better, key=lambda one: one.gain) is same and same.gain < best.gain + CLEARLY:
            break
    return better


def _together(found: Sequence[Explanation], present: Present, base: Attempt) -> list[Explanation]:
    """Another behaviour between the samples and a delay at once, where either explains much."""
    n = present.records[0].n_inputs
    codes = ("intersample", "delay")
    found = [one for one in found if not one.rival.exact]
    single = [one for one in found if one.rival.code in codes and one.rival.refits and one.is_clear]
    lost = any(one.rival.code == "lost-rows" and one.is_clear for one in found)
    if lost or not single or not any(one.rival.code == "delay" for one in found):
        return []
    behaviours = tuple(
        one.rival
        for one in found
        if one.rival.code == "intersample" and one.rival.kind != LATE_LOG
        if one.rival.parts[0].records[0].n_inputs == n
    )
    both = fitted(both_rivals(present, behaviours), base)
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
    near = [fitted([shifted(present, one.rival, by)], base) for by in (-FINEST, FINEST)]
    if not all(near):
        return []
    (before,), (after,) = near
    found, bend = [before, after], before.gain - 2.0 * one.gain + after.gain
    if bend < 0.0:
        top = 0.5 * FINEST * (before.gain - after.gain) / bend
        top = float(np.clip(top, -2.0 * FINEST, 2.0 * FINEST))
        found += fitted([shifted(present, one.rival, top)], base)
    return [other for other in found if other.gain > one.gain + CLEARLY]


def _late_again(found: Sequence[Explanation], present: Present, base: Attempt) -> list[Explanation]:
    """One delay from the poles that one which varies led to: its own may be those of no delay."""
    wandering = [one for one in found if one.rival.exact and one.rival.code == "varying"]
    late = [one for one in found if one.rival.code == "delay" and not one.rival.exact]
    late = [one for one in late if is_later(present, one.rival)]
    if not (late and wandering and max(wandering, key=lambda one: one.gain).is_clear):
        return []
    first = max(late, key=lambda one: one.gain).rival
    (end,) = max(wandering, key=lambda one: one.gain).attempts
    every = (first, *neighbours(present, first))
    return fitted((replace(one, starts=((end.point.poles,),)) for one in every), base)


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
    return fitted(rivals, base)


def _late_in_colour(
    found: Sequence[Explanation], present: Present, base: Attempt
) -> tuple[Attempt, list[Explanation]] | None:
    """The present explanation and its rivals with noise models, where a delay explains most then.

    Where the noise has a memory and a delay is missing, a noise model fitted without the delay
    takes the response for noise, so that all are compared with white weights (`settle`). Whatever
    follows the noise gains as much as the delay does there. With a noise model of each one's own
    it does not; where the delay does not win by that, the comparison stays as it was.
    """
    if base.point.problem.noise or not present.has_noise:
        return None
    late = [one for one in found if one.rival.code == "delay" and one.rival.refits]
    late = [one for one in late if one.is_clear and not one.rival.exact]
    late = [one for one in late if is_later(present, one.rival)]
    here = attempted(one("", present, "", "")) if late else None
    if here is None:
        return None
    others: dict[str, Explanation] = {}
    for other in sorted(found, key=lambda one: -one.gain):
        if other.is_clear and other.rival.code != "delay":
            others.setdefault(f"{other.rival.code} {other.rival.exact}", other)
    first = max(late, key=lambda one: one.gain)
    own = _in_colour(first, present.orders, here[0])
    if own is None or not own.is_clear:
        return None
    settled = from_end(present, here[0])
    near = [replace(one, starts=own.rival.starts) for one in neighbours(settled, own.rival)]
    own = max([own, *fitted(near, here[0])], key=lambda one: one.gain)
    own = max([own, *_finer(own, settled, here[0])], key=lambda one: one.gain)
    rest = [_in_colour(one, present.orders, here[0]) for one in others.values()]
    kept = [one for one in rest if one is not None]
    if any(one.gain > own.gain + CLEARLY for one in kept):
        return None
    fewer = [one for one in kept if one.gain < own.gain or one.rival.code == "intersample"]
    return here[0], [own, *fewer]


def _in_colour(found: Explanation, orders: Sequence[int], base: Attempt) -> Explanation | None:
    """An explanation that was fitted with white weights again, with a model of its noise."""
    left = [one for end in found.attempts for one in end.point.standardised()]
    noise = tuple(
        fit_autoregression([np.ascontiguousarray(one[:, i]) for one in left], p, p)
        if p
        else np.zeros(0)
        for i, p in enumerate(orders)
    )
    rival = replace(
        found.rival,
        parts=tuple(replace(part, noise=noise) for part in found.rival.parts),
        starts=tuple((end.point.poles,) for end in found.attempts),
    )
    ends = attempted(rival)
    return None if ends is None else explanation_of(rival, ends, base)


def _odd_ones(found: Sequence[Explanation], present: Present, base: Attempt) -> list[Explanation]:
    """Which experiment differs from the others, and in what, where they do not agree.

    Of two the second is compared with the first. Less than all coefficients is what differs where
    these explain no more.
    """
    own = [one for one in found if one.rival.code == DISAGREEING and one.is_clear]
    several = len(present.records)
    if not own or several > MOST:
        return []
    (every,) = own
    whole, others, e = every, every.attempts[0], 1
    if several > 2:
        apart = fitted(apart_rivals(present, every.attempts), base)
        apart.sort(key=lambda one: -one.gain)
        # two that differ alike, or all of them
        next_best = max((one.gain for one in apart[1:]), default=-np.inf)
        if not apart or apart[0].gain < max(next_best + CLEARLY, every.gain - CLEARLY):
            return []
        whole = apart[0]
        others, number = whole.attempts[0], whole.rival.experiment
        assert number is not None
        e = number
    single = fitted(single_rivals(present, e, others), base)
    least = min(AS_MUCH * whole.gain, whole.gain - CLEARLY)
    kept = [one for one in single if one.is_clear and one.gain > least]
    return [*([whole] if several > 2 else []), *kept]


def _rivals(
    present: Present, fitted: Sequence[Array], only: str, free: bool
) -> dict[str, list[Rival]]:
    """Of every code but lost rows, or of one, those that promise most.

    Where the delay is free there is none to be added to it.
    """
    asked = only in ("", "delay", "varying") and not free
    late = list(delay_rivals(present)) if asked else []
    makers: tuple[tuple[tuple[str, ...], Callable[[], Iterable[Rival]]], ...] = (
        (("intersample",), lambda: _intersample_rivals(present)),
        (("intersample",), lambda: slow_input_rivals(present)),
        (("input-noise", "intersample"), lambda: pulse_rivals(present)),
        (("input-noise",), lambda: level_rivals(present)),
        (("input-noise",), lambda: floor_rivals(present)),
        (("channel-changes",), lambda: break_rivals(present, fitted)),
        (("delay",), lambda: late),
        (("delay", "intersample"), lambda: early_rivals(present)),
        (("filtered",), lambda: both_ways_rivals(present)),
        (("saturation",), lambda: saturation_rivals(present, fitted)),
        (("nonlinear",), lambda: nonlinear_rivals(present, fitted)),
        (("varying", "disagreeing-experiments"), lambda: varying_rivals(present)),
        (("varying",), lambda: gain_rivals(present)),
        (("varying",), lambda: wandering_rivals(present, late)),
        (("varying",), lambda: clock_rivals(present)),
        (("drift",), lambda: drift_rivals(present)),
        (("drift",), lambda: slow_rivals(present)),
        (("drift",), lambda: periodic_rivals(present, fitted)),
        (("order-low",), lambda: order_rivals(present)),
    )
    sorted_: dict[str, list[Rival]] = {}
    for codes, make in makers:
        for rival in make() if not only or only in codes else ():
            if rival.code == (only or rival.code):
                sorted_.setdefault(rival.code, []).append(rival)
    return {code: own if len(own) <= FOLLOWED else _followed(own) for code, own in sorted_.items()}


def _followed(own: Sequence[Rival]) -> list[Rival]:
    """Those that promise most, and what is exact."""
    plain = sorted((rival for rival in own if not rival.exact), key=_promised)[:FOLLOWED]
    return [*plain, *(rival for rival in own if rival.exact)]


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
                f"State intersample={behaviour!r} (--intersample {behaviour}){AUTO}.",
            )
        )
    return found


def moved(
    explanation: Explanation, base: Attempt, std: Array, theta: Array | None = None
) -> tuple[int, float, float, float]:
    """The coefficient that moves most with an explanation of the same structure.

    Parameters
    ----------
    explanation : Explanation
    base : Attempt
    std : (n_coefficients,) array
        Standard errors.
    theta : (n_coefficients,) array, optional
        From where they move; from where the present explanation ended if left out.

    Returns
    -------
    position, before, after, size
        The last in standard errors; position -1 where the coefficients are other ones.
    """
    (end, *others) = explanation.attempts
    if others or end.point.problem.n_coefficients != base.point.problem.n_coefficients:
        return -1, np.nan, np.nan, np.nan
    b = coefficients(end.point)
    a = coefficients(base.point) if theta is None or theta.size != b.size else theta
    size = np.abs(b - a) / np.where(std > 0, std, np.inf)[: a.size]
    k = int(np.argmax(size))
    return k, float(a[k]), float(b[k]), float(size[k])
