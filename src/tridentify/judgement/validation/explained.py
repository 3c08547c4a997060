"""Causes that were tried on the records at hand, put into findings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding, Severity
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import coefficients
from tridentify.estimation.likelihood.setup.nuisance import Nuisances
from tridentify.judgement.causes.attempts.attempt import Attempt
from tridentify.judgement.causes.attempts.explanation import (
    CLEARLY,
    NEARLY,
    Explanation,
    Explanations,
)
from tridentify.judgement.causes.attempts.fewer import unsure
from tridentify.judgement.causes.attempts.intersample import for_left_open
from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.attempts.rivals import Rival
from tridentify.judgement.causes.explain import explain, moved, settle
from tridentify.judgement.causes.sensors.lost import Place
from tridentify.judgement.causes.timing.shifts import LATE_LOG
from tridentify.judgement.validation.residuals import View
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record

TRIED = "Of all causes tried"
"""Where in a message what was seen ends and what was tried begins."""

HEADLINES = {
    "lost-rows": "rows were lost there, or something struck the system from outside",
    "channel-changes": "a channel changes",
    "input-noise": "a recorded input carries noise that did not act",
    "intersample": "between its samples the input is not what it is taken for",
    "delay": "a delay is missing",
    "saturation": "a sensor or an actuator is at its limit",
    "nonlinear": "the system is not linear over this range",
    "varying": "the system changes during the record",
    "disagreeing-experiments": "the experiments are not of one system",
    "drift": "an offset or a drift is missing",
    "order-low": "the order is too low",
}
"""Code of a cause that can be fitted -> what it is called."""

SEVERAL = ("coefficients", "outputs", "inputs", "clocks")
"""First words of causes that are more than one thing."""

SPOILS = ("lost-rows", "channel-changes", "intersample", "delay")
"""Causes with which the numbers are wrong, not only less sure."""

ALONE = 12.0
"""Fall of AICc from which a cause that was fitted is told although no test rejects: each test is
one of many, and shares their level. Causes fitted to 180 right records lowered it by at most 11;
more poles, which choose their frequency, by 19, so that these need a test. So do slow waves: noise
that forgets within a tenth of the record is as slow, and they lower AICc by 17 to 27 there, with
white weights by hundreds."""

BENT_ALONE = 17.0
"""The same of a bend, which is the best of a dozen shapes (``2 log 12`` more). Bends fitted to 256
right records in noise with memory lowered AICc by 19 once and by 15 three times at most, to 60 in
white noise by 9; cubic springs that no test rejects by 24."""

OF_COLOUR = 0.05
"""Share of what a noise model brings (-2 log L) below which a drift beside it is hardly more than
that noise: what forgets slowly is slow itself. A line brought 0.01 of it in 1,000 samples of
stationary noise that forgets within 20, slow waves 0.04 in 400; a ramp of half the output's spread
0.08 to 0.2 in noise that forgets within three."""

MOSTLY = 0.5
"""Share of a bad sample's residual that a cause leaves, below which it explains that sample."""

RISES = 0.02
"""Fall of the misfit (100 % minus the fit, relative) from which a larger model follows an output
better: a mode more took up to 1 % of it from the noise of 800 samples, and 5 % or more where it
was there and could be seen."""

HALVED = 0.5
"""The same from which the model misses most of what can be followed."""

LITTLE = 10.0
"""Fit [percent] below which such a model shows nothing of the response."""

NOISE_MODEL = (
    "Use a noise model (noise='ar', --noise ar), which takes what wanders for noise; a straight "
    "drift (drift=True) does not stand for it."
)
"""What to do about a slow disturbance where the noise has no model."""

RECORD_IT = (
    "Record what acts slowly on the output (a load, the supply, the weather) as a further input; "
    "more poles do not stand for it."
)
"""What to do about a slow disturbance that nothing at hand stands for."""

NOTHING_MOVES = "no coefficient moves by more than its standard error"
HARDLY = 1.0
"""Movement of a coefficient [standard errors] below which it may stay as it is."""


def explanations(
    view: View,
    estimate: Estimate,
    noises: Sequence[Array],
    torn: Sequence[Place] = (),
    only: str = "",
    known: Explanations | None = None,
) -> Explanations | None:
    """Fit what may explain the records of a view better than the estimate.

    Parameters
    ----------
    view : View
    estimate : Estimate
    noises : sequence of (p,) arrays
        Model of each output's noise.
    torn : sequence of Place
        Where the state of the model seems to jump.
    only : str
        The one code that is tried; all where it is left out.
    known : Explanations, optional
        Of an earlier look, which is not repeated where the question is the same.

    Returns
    -------
    Explanations or None
        None for a structure with constraints: what is known is not to be given up for a fit.
    """
    if estimate.structure.constrained and not _integrates(estimate):
        return None
    present = present_of(view, estimate, noises)
    free = estimate.structure.delay == "free"
    found = explain(present, free=free, torn=torn, only=only, known=known)
    if found is not None and view.driven:
        found = replace(found, reacts=(None,) * len(view.outputs))
    if found is None or not view.own:
        return found
    return replace(found, printed=_printed(view, estimate, found.present))


def of_input_noise(view: View, estimate: Estimate, noises: Sequence[Array]) -> Explanations | None:
    """All causes, where an input without the noise that it may carry explains more; else None.

    Noise that a smooth input carries makes a residual that looks like noise of the output.

    Parameters
    ----------
    view : View
    estimate : Estimate
    noises : sequence of (p,) arrays
        Model of each output's noise.
    """
    found = explanations(view, estimate, noises, only="input-noise")
    if found is None or found.best is None or not told_alone(found.best):
        return None
    return explanations(view, estimate, noises)


def _printed(view: View, estimate: Estimate, base: Attempt) -> Array:
    """(n_outputs,) fit [percent] of an estimate where the present explanation has a residual.

    What a finding says of a fit "from" is what stands in the estimate's own table, but for samples
    that are left out: one model has one fit.
    """
    energy = np.zeros(len(view.outputs))
    for e, (record, seen) in enumerate(zip(view.records, base.residuals(), strict=True)):
        left = np.where(np.isfinite(seen), estimate.residual(record, experiment=e), np.nan)
        energy = energy + np.nansum(left**2, axis=0)
    return np.asarray(100.0 * (1.0 - np.sqrt(energy / base.spread)))


def _integrates(estimate: Estimate) -> bool:
    """Whether all that is known is an integrator, which a pole that is slow enough stands for."""
    given = estimate.structure
    alone = given.static_gain is None and not given.bounds and not given.priors
    return alone and isinstance(given.poles, int) and dict(given.fixed or {}) == {"a0": 0.0}


def settled(view: View, estimate: Estimate, noises: Sequence[Array]) -> Attempt | None:
    """The model of an estimate fitted to the samples of a view; None where it cannot be."""
    if estimate.structure.constrained:
        return None
    return settle(present_of(view, estimate, noises))


def present_of(view: View, estimate: Estimate, noises: Sequence[Array]) -> Present:
    """The model of an estimate on the samples of a view, to be fitted anew."""
    records = [_without(record, view, e) for e, record in enumerate(view.records)]
    delay = np.array(estimate.model.delay)
    return Present.of(
        records, estimate.structure, delay, _nuisances(view), noises, view.point.poles
    )


def change(end: Attempt, estimate: Estimate) -> str:
    """How far the coefficients move to where another fit ended; empty where they hardly do."""
    moves = most_moved(estimate, end)
    if moves is None:
        return ""
    moves = moves.replace(" from ", " goes from ", 1) if moves else NOTHING_MOVES
    return f"Without them {moves}."


def most_moved(estimate: Estimate, end: Attempt) -> str | None:
    """The coefficient that moves most, from ... to ...

    Parameters
    ----------
    estimate : Estimate
    end : Attempt
        Where another fit of the same structure ended.

    Returns
    -------
    str or None
        Empty where none moves by more than its standard error; None where the coefficients are
        other ones.
    """
    found = coefficients(end.point)
    if found.size != estimate.theta.size:
        return None
    std = np.where(estimate.std > 0, estimate.std, np.inf)
    size = np.abs(found - estimate.theta) / std
    k = int(np.argmax(size))
    if not size[k] > HARDLY:
        return ""
    name, before = estimate.names[k], estimate.theta[k]
    return f"{name} from {before:.4g} to {found[k]:.4g} ({size[k]:.1f} standard errors)"


def _without(record: Record, view: View, experiment: int) -> Record:
    """The record without the samples that the view leaves out."""
    y = np.array(record.y)
    for i, output in enumerate(view.outputs):
        y[np.isnan(output.residual[experiment]), i] = np.nan
    return record._derive(y=y)


def _nuisances(view: View) -> Nuisances:
    one = view.point.problem.experiments[0]
    if one.free:
        return Nuisances("free", one.offset, one.drift)
    # an input that counts from another value than recorded started in equilibrium
    moved_by = not np.array_equal(one.u, view.records[0].u)
    return Nuisances("equilibrium" if moved_by else "rest", one.offset, one.drift)


def finding_of(
    found: Explanation,
    explained: Explanations,
    estimate: Estimate,
    outputs: Sequence[str],
    where: str,
) -> Finding:
    """A cause that was fitted, in words, with what it brings.

    Parameters
    ----------
    found : Explanation
    explained : Explanations
        Among which it is.
    estimate : Estimate
    outputs : sequence of str
        Names of those whose residual is concerned.
    where : str
        What the residual shows, a sentence.
    """
    rival = found.rival
    if rival.code == "order-low":
        return _order_low(found, explained, estimate, outputs, where)
    several = rival.code == "lost-rows" or rival.what.startswith(SEVERAL)
    verb = "explain" if several else "explains"
    message = (
        f"{where}: {rival.headline or HEADLINES[rival.code]}. {TRIED}, {rival.what} {verb} it best."
    )
    message += _not_told_from(found, explained)
    severity: Severity = "error" if _spoils(rival) else "warning"
    if rival.kind in ("floor", "between") and not _moves(found, explained, estimate):
        # a coefficient seldom feels what a smooth input carries, or half a sample to either side
        severity = "note"
    advice = for_left_open(rival.advice, estimate)
    remedy, effect = advice, _effect(found, explained, estimate)
    if rival.code == "drift" and not (rival.refits or rival.headline):
        remedy, brings = _about_slow(explained, estimate)
        effect = f"{effect} {brings}".rstrip()
    return Finding(
        rival.code,
        severity,
        message,
        remedy or advice,
        tuple(outputs),
        times=rival.times,
        effect=effect,
        kind=rival.kind,
        experiment=rival.experiment,
    )


def _moves(found: Explanation, explained: Explanations, estimate: Estimate) -> bool:
    """Whether a coefficient moves by more than its standard error."""
    theta = None if explained.printed is None else np.asarray(estimate.theta)
    return moved(found, explained.present, np.asarray(estimate.std), theta)[3] > HARDLY


def _spoils(rival: Rival) -> bool:
    """Whether the numbers are wrong with a cause, and are put right by its remedy."""
    return rival.spoils or (rival.refits and (rival.code in SPOILS or rival.kind == "clocks"))


def _about_slow(explained: Explanations, estimate: Estimate) -> tuple[str, str]:
    """What to do about a slow disturbance, of what was tried, and what that brings.

    A model of the noise takes for noise what wanders: the present explanation has one where the
    noise is not white, whether the estimate has one or not. It is no advice where the method had
    one at hand, and its end was not kept.
    """
    base = explained.present
    if estimate.trace.about(DecisionKind.FAR_LIKELIER):
        return drift_tried(explained, estimate)
    white = estimate.loss == "squared" and not any(a.size for a in estimate.noise_model)
    if white and any(a.size for a in base.point.problem.noise):
        moves = most_moved(estimate, base) or NOTHING_MOVES
        return NOISE_MODEL, f"With a noise model: {moves}."
    return drift_tried(explained, estimate)


def drift_tried(explained: Explanations | None, estimate: Estimate) -> tuple[str, str]:
    """What to do about a drift, of what was tried, and what that brings.

    Parameters
    ----------
    explained : Explanations or None
    estimate : Estimate
    """
    own = () if explained is None else explained.found
    lines = [one for one in own if one.rival.code == "drift" and one.rival.refits]
    best = max(lines, key=lambda one: one.gain, default=None)
    if best is None or explained is None:
        return RECORD_IT, ""
    if not best.is_clear:
        return (
            RECORD_IT,
            f"{best.rival.what[0].upper()}{best.rival.what[1:]} does not stand for it.",
        )
    brings = _effect(best, explained, estimate)
    what = best.rival.what
    return best.rival.advice, f"With {what}{brings.removeprefix('With it')}"


def raised(found: Explanation, base: Attempt) -> float:
    """By which share of itself the misfit of an output falls, at most."""
    before, after = 100.0 - base.fits, 100.0 - found.fits(base)
    return float(np.max(1.0 - after / np.maximum(before, np.finfo(float).tiny)))


def follows_no_better(found: Explanation, base: Attempt) -> bool:
    """Whether a larger model explains the correlation of a residual alone, not the response."""
    return found.rival.code == "order-low" and raised(found, base) < RISES


def is_little_beside_colour(found: Explanation) -> bool:
    """Whether a drift brings little beside what a noise model brings once it is fitted along."""
    if found.rival.code != "drift":
        return False
    (end,) = found.attempts
    plain = [np.vstack(end.standardised())[:, i] for i in range(end.point.problem.n_outputs)]
    seen = [one[np.isfinite(one)] for one in plain]
    white = sum(one.size * float(np.log(np.mean(one**2))) for one in seen)
    return found.gain < OF_COLOUR * (white - end.deviance)


def of_sampling(found: Explanation) -> bool:
    """Whether a cause is that the samples of pulses say little of what acted.

    What its rough model leaves of the response to these looks like bends and changes, and is none.
    """
    code, refits = found.rival.code, found.rival.refits
    return code == "input-noise" or (code == "intersample" and not refits)


def _not_told_from(found: Explanation, explained: Explanations) -> str:
    """Another bend, a delay with another behaviour, or a direct part, that explains as much."""
    bends, early = found.rival.code == "nonlinear", found.rival.kind == LATE_LOG
    if not (bends or early or found.rival.code == "delay"):
        return ""
    others = ("nonlinear", "saturation") if bends else ("order-low" if early else "intersample",)
    least = found.gain - CLEARLY if not bends else min(found.gain - CLEARLY, NEARLY * found.gain)
    near = [
        one
        for one in explained.found
        if one.rival.code in others and one.rival.what != found.rival.what and one.gain > least
    ]
    best = max(near, key=lambda one: one.gain, default=None)
    if best is None:
        return ""
    more = f"AICc {'higher' if best.gain < found.gain else 'lower'} by "
    more += f"{abs(found.gain - best.gain):.2g}"
    return f" The record hardly tells it from {best.rival.what} ({more})."


def _order_low(
    found: Explanation,
    explained: Explanations,
    estimate: Estimate,
    outputs: Sequence[str],
    where: str,
) -> Finding:
    """A larger model: advice only where the response is followed better, and is determined."""
    base = explained.present
    rival, rise = found.rival, raised(found, base)
    longest = max(one.duration for one in base.point.problem.experiments)
    tried = f"{TRIED}, {rival.what} explain it best"
    severity: Severity = "warning"
    remedy = rival.advice
    if follows_no_better(found, base):
        severity, remedy = "note", ""
        said = f"{where}. A larger model ({rival.what}) explains this correlation, not the response"
    elif rise < HALVED and unsure(estimate, longest):
        remedy = ""
        said = f"{where}. {tried}, but the record does not even tell all coefficients of this order"
    else:
        said = f"{where}: {HEADLINES[rival.code]}. {tried}"
        if rise >= HALVED and np.max(estimate.fit) < LITTLE:
            severity = "error"
    effect = _effect(found, explained, estimate)
    return Finding("order-low", severity, f"{said}.", remedy, tuple(outputs), effect=effect)


def _effect(found: Explanation, explained: Explanations, estimate: Estimate) -> str:
    """Fit from ... to ..., coefficient from ... to ..., as the estimate itself states them."""
    said, base, printed = [], explained.present, explained.printed
    if len(found.attempts) == 1:
        before = base.fits if printed is None else printed
        pairs = zip(estimate.output_names, before, found.fits(base), strict=True)
        said += [f"fit of {name} from {a:.2f} to {b:.2f} %" for name, a, b in pairs]
    theta = None if printed is None else np.asarray(estimate.theta)
    k, old, new, size = moved(found, base, np.asarray(estimate.std), theta)
    if k >= 0 and size > 0.1:
        name = estimate.names[k]
        said.append(f"{name} from {old:.4g} to {new:.4g} ({size:.1f} standard errors)")
    if found.rival.experiment is not None and len(found.attempts) > 1:
        moves = most_moved(estimate, found.attempts[0])
        said += [f"{moves} for the others"] if moves else []
    said.append(f"the sum of squares of the whitened residual falls by {_percent(found.share)}")
    return f"With it: {', '.join(said)}."


def _percent(share: float) -> str:
    percent = 100.0 * max(share, 0.0)
    return f"{percent:.1f} %" if 0.05 < percent < 10 or percent > 99 else f"{percent:.0f} %"


def told_alone(found: Explanation) -> bool:
    """Whether a cause explains so much that no test of the residual has to reject."""
    code = found.rival.code
    if code == "order-low" or (code == "drift" and not found.rival.refits):
        return False
    least = BENT_ALONE if code == "nonlinear" else ALONE
    return found.gain > least and not is_little_beside_colour(found)


def still_far(found: Explanation, view: View, output: int, rows: Array) -> Array:
    """Bad samples that stay bad beside a cause.

    Parameters
    ----------
    found : Explanation
    view : View
        With the samples.
    output : int
    rows : (k, 3) array
        Experiment, time and size of each.
    """
    if not same_records(found):
        return rows
    (end,) = found.attempts
    if len(end.point.problem.experiments) != len(view.records):
        return rows
    kept = []
    for e, t, _ in rows:
        k = int(np.argmin(np.abs(view.records[int(e)].t - t)))
        there = float(end.outputs()[int(e)][k, output])
        seen = view.outputs[output]
        left = abs(float(seen.y[int(e)][k]) - there)
        kept.append(not left < MOSTLY * abs(float(seen.residual[int(e)][k])))
    return np.asarray(rows[kept])


def same_records(found: Explanation) -> bool:
    """Whether a cause leaves one model on the records as they are, which can be looked at again."""
    return len(found.attempts) == 1
