"""From test results to words: what was found, in seconds and names of channels, and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding, ranked
from tridentify.judgement.causes.attempts.feedback import Coming
from tridentify.judgement.causes.attempts.told_apart import answers_at_once
from tridentify.judgement.validation.explained import (
    drift_tried,
    finding_of,
    is_little_beside_colour,
    of_sampling,
)
from tridentify.judgement.validation.interpolated import beside_lines, interpolated_findings
from tridentify.judgement.validation.known_causes import KnownCauses
from tridentify.judgement.validation.noise_findings import about_noise, carried_findings, not_white
from tridentify.judgement.validation.other_record import about_other_record
from tridentify.judgement.validation.phrases import (
    around_top,
    decapitalised,
    one_finding,
    seconds,
    sentence,
    span,
)
from tridentify.judgement.validation.residuals import View
from tridentify.judgement.validation.result import Check, CrossCorrelation, Transfer
from tridentify.judgement.validation.statistics.evidence import Evidence
from tridentify.judgement.validation.statistics.likelihood_ratio import CALLED
from tridentify.judgement.validation.statistics.rounding import beyond_steps
from tridentify.models.simulate import simulate


def family(
    evidence: Sequence[Evidence], names: Sequence[str], transfer: Transfer | None
) -> list[Check]:
    """Every test, not yet judged; ``nan`` where it could not be made."""
    found = []
    for one, name in zip(evidence, names, strict=True):
        explained = one.past < CALLED or one.level < CALLED
        white = one.coloured if explained else one.whiteness.p_value
        rows = (
            ("white", white),
            ("past inputs", one.past),
            ("feedback", one.feedback),
            ("level", one.level),
            ("scale", one.scale),
            ("coefficients constant", one.later),
            ("linear", one.linear),
            ("Gaussian", one.normality.p_value),
        )
        found += [Check(what, name, p, False) for what, p in rows]
    if transfer is not None:
        found.append(Check("same coefficients", "all", transfer.coefficients_p_value, False))
        pairs = zip(names, transfer.size_p_values.tolist(), strict=True)
        found += [Check("size of the noise", name, p, False) for name, p in pairs]
    return found


NO_CONTROLLER = "if no controller was running, ask for as many zeros as poles. If one was,"
"""What to do where the output follows the input at once, before what to do about feedback."""


DRAWN = 0.3
"""Of the residual, what two ways to draw an input between its samples make differently: from here
on it explains what is left. Inputs that were sampled fast enough make less than a tenth."""


CALLING = ("past inputs", "level", "coefficients constant", "linear")
"""Tests that a cause may explain."""


SAID_BY = {
    "level": ("drift",),
    "coefficients constant": ("varying", "disagreeing-experiments"),
    "linear": ("nonlinear", "saturation"),
}
"""Test -> causes that say what it says: the model that is fitted beside a cause is a rough one, and
may leave some of it."""


def findings(
    beside: KnownCauses,
    pictures: Sequence[CrossCorrelation],
    tests: Sequence[Check],
    transfer: Transfer | None,
) -> tuple[Finding, ...]:
    """All findings, the most important first.

    Parameters
    ----------
    beside : KnownCauses
        What was seen, and what would explain the residual.
    pictures : sequence of CrossCorrelation
        Output by output.
    tests : sequence of Check
        Judged.
    transfer : Transfer or None
    """
    view, evidence = beside.view, beside.evidence
    rejected = {(test.name, test.output): test.p_value for test in tests if test.rejected}
    found: list[Finding] = []
    n_inputs = view.records[0].n_inputs
    concerned = []
    for i, (one, output) in enumerate(zip(evidence, view.outputs, strict=True)):
        own = pictures[n_inputs * i : n_inputs * (i + 1)]
        name = output.name
        calling = [test for test in CALLING if (test, name) in rejected]
        left = dict(rejected)
        if (calling or beside.torn) and beside.named is not None:
            concerned.append((name, beside.torn or _where(one, own, calling)))
            again = None if of_sampling(beside.named) else beside.again[i]
            left = _left(rejected, name, again, beside.named.rival.code)
            one = one if again is None else _with_shocks_that_stay(one, again)
            if beside.no_better or beside.keeps_colour(i, one):
                # this model stays, and its standard errors do not allow for what is left
                left |= {key: p for key, p in rejected.items() if key == ("white", name)}
        elif ("past inputs", name) in rejected:
            found.append(_unexplained(i, own, beside))
        reacts = None if beside.explained is None else beside.explained.reacts[i]
        found += _about_one(one, name, left, own, beside, reacts)
    if concerned and beside.named is not None and beside.explained is not None:
        names = [name for name, _ in concerned]
        where = sentence(concerned[0][1])[:-1]
        told = finding_of(beside.named, beside.explained, beside.estimate, names, where)
        if is_little_beside_colour(beside.named) and any(f.code == "noise-model" for f in found):
            told = replace(told, severity="note")
        found.append(told)
    elif beside.alone is not None and beside.explained is not None:
        where = f"AICc falls by {beside.alone.gain:.3g} where one more cause is fitted"
        found.append(finding_of(beside.alone, beside.explained, beside.estimate, (), where))
    if transfer is not None:
        found += carried_findings(view, transfer, rejected)
        found = about_other_record(found, transfer, beside)
    if beside.estimate.route == "direct":
        found = [_as_noise(one) if one.code == "drift" else one for one in found]
    made = interpolated_findings(view.records, beside.estimate if view.own else None)
    return ranked([*made, *beside_lines(beyond_steps(found, view), made)])


def _as_noise(drift: Finding) -> Finding:
    """What is slow beside an estimate by the direct route, whose noise model stands for it.

    A drift that is fitted with white weights, as all causes are, would be biased by the feedback.
    """
    seen = drift.message.split(": ")[0].rstrip(".")
    said = f"{seen}: something pushes the plant slowly, and the model of the noise stands for it."
    return replace(drift, severity="note", message=said, remedy="", effect="")


def _with_shocks_that_stay(one: Evidence, again: Evidence) -> Evidence:
    """With the disturbances that are seen beside a cause too: others are what it makes."""
    shocks = one.normality.shocks
    stay = np.isin(shocks[:, 1], again.normality.shocks[:, 1])
    return one.having(normality=replace(one.normality, shocks=shocks[stay]))


def _left(
    rejected: dict[tuple[str, str], float], name: str, again: Evidence | None, named: str
) -> dict[tuple[str, str], float]:
    """What is still rejected beside a cause that was fitted along, and is not that cause."""
    quiet = set(CALLING) | {"white"}
    if again is not None and again.past >= CALLED:
        still = {
            "level": again.level,
            "coefficients constant": again.later,
            "linear": again.linear,
            "white": again.coloured,
            "feedback": again.feedback,
            "scale": again.scale,
        }
        quiet = {"past inputs"} | {test for test, p in still.items() if not p < CALLED}
        quiet |= {test for test, codes in SAID_BY.items() if named in codes}
    return {key: p for key, p in rejected.items() if key[1] != name or key[0] not in quiet}


def _where(one: Evidence, pictures: Sequence[CrossCorrelation], calling: Sequence[str]) -> str:
    """What the residual shows."""
    name = pictures[0].output
    if calling[0] == "past inputs":
        j = int(np.argmin(one.by_input))
        low, high = _around(pictures[j], True)
        return (
            f"the residual of {name} is correlated with {pictures[j].input} at {seconds(low, high)}"
        )
    said = {
        "level": f"the level of the residual of {name} moves slowly over the record",
        "coefficients constant": f"the coefficients behind {name} do not hold over the record",
        "linear": f"the residual of {name} follows powers or a limit of the input or of the output",
    }
    return said[calling[0]]


def _around(picture: CrossCorrelation, past: bool) -> tuple[float, float]:
    """The lags beside the farthest out that are outside the bounds too."""
    side = picture.lags >= 0 if past else picture.lags < 0
    lags = picture.lags[side]
    bound = np.where(picture.bound[side] > 0, picture.bound[side], np.inf)
    low, high = around_top(np.abs(picture.correlation[side]) / bound, 1.0)
    first, last = float(lags[low]), float(lags[high])
    return (first, last) if past else (-last, -first)


def _unexplained(i: int, pictures: Sequence[CrossCorrelation], beside: KnownCauses) -> Finding:
    """A response of an output that is missing, by no cause that was tried."""
    one = beside.evidence[i]
    name = pictures[0].output
    j = int(np.argmin(one.by_input))
    low, high = _around(pictures[j], True)
    where = _where(one, pictures, ("past inputs",))
    drawn = _drawn_between(beside.view, beside.estimate, i)
    if drawn > DRAWN:
        return one_finding(
            "intersample",
            name,
            f"{where}: the input moves faster than it was sampled, so that nothing tells what it "
            "does between its samples",
            "record the input faster, or through a filter that lets nothing pass above half the "
            "sampling rate; the standard errors do not allow for it",
            effect=f"joined by lines and band-limited inputs, which no sample tells apart, make "
            f"responses that differ by {100.0 * drawn:.0f} % of what is left",
        )
    if low == high == 0.0:
        # a strictly proper response begins later: neither poles nor a delay make this
        return one_finding(
            "unmodelled-response",
            name,
            f"{where}: the input reacts to the output within the sample (feedback), or the output "
            "has a share of the input itself",
            "open the loop, or add a test signal that is large against the feedback; without one, "
            "try as many zeros as poles",
        )
    tried = "" if beside.explained is None else ", and none of the causes that were tried is it"
    return one_finding(
        "unmodelled-response",
        name,
        f"{where}: part of the response is missing{tried}",
        "check that the input is what acted on the system, and look for inputs that were not "
        "recorded; the standard errors do not allow for what is missing",
    )


def _drawn_between(view: View, estimate: Estimate, output: int) -> float:
    """How an input is drawn between its samples, in the response, over what is left of an output.

    A band-limited input is known from its samples, and lines come close to it; of one that was
    sampled too slowly neither is right, and both are wrong by about as much as they differ.
    """
    if any(record.dt is None or record.behaviour == "zoh" for record in view.records):
        return 0.0
    try:
        lines, smooth = (
            [
                simulate(estimate.model, record._derive(u=record.u - record.u[0], intersample=way))
                for record in view.records
            ]
            for way in ("foh", "band-limited")
        )
    except TridentifyError:  # too few samples, or a model that grows out of a float
        return 0.0
    apart = np.concatenate(
        [a[:, output] - b[:, output] for a, b in zip(lines, smooth, strict=True)]
    )
    return float(np.std(apart) / np.nanstd(np.concatenate(view.outputs[output].residual)))


def _about_one(
    one: Evidence,
    name: str,
    rejected: dict[tuple[str, str], float],
    pictures: Sequence[CrossCorrelation],
    beside: KnownCauses,
    reacts: Coming | None,
) -> list[Finding]:
    found = []

    def add(code: str, test: str, text: str, advice: str, effect: str = "") -> None:
        if (test, name) in rejected:
            found.append(
                one_finding(code, name, text, advice.rstrip("."), effect=effect.rstrip("."))
            )

    if ("feedback", name) in rejected:
        found.append(
            _feedback(beside.view, name, pictures, reacts, not answers_at_once(beside.estimate))
        )
    add(
        "drift",
        "level",
        f"the level of the residual of {name} moves slowly over the record: the sensor drifts, or "
        "an offset or a slow disturbance is missing",
        *drift_tried(beside.explained, beside.estimate),
    )
    if ("white", name) in rejected:
        found.append(not_white(one, name, beside))
    add(
        "nonlinear",
        "linear",
        f"the residual of {name} follows powers or a limit of the input or of the output: the "
        "system is not linear over this range",
        "use smaller amplitudes, or identify each operating point on its own",
    )
    add(
        "varying",
        "coefficients constant",
        f"the coefficients behind {name} differ between the first and the second half of the "
        "samples",
        "identify the parts on their own, or use online.ThreeModel(forgetting=...)",
    )
    found += about_noise(one, name, rejected, beside)
    return found


def _feedback(
    view: View,
    name: str,
    pictures: Sequence[CrossCorrelation],
    reacts: Coming | None,
    strictly_proper: bool,
) -> Finding:
    """The input reacts to the output, or acts in the same sample where the model cannot."""
    direct = reacts is not None and not reacts.lag and strictly_proper
    if reacts is None:
        picture = pictures[int(np.argmax([_outside(picture) for picture in pictures]))]
        which, when = picture.input, f"{span(*_around(picture, False))} s later"
        effect = ""
    else:
        which = pictures[reacts.input].input
        when = f"{reacts.lag * view.step:.3g} s later" if reacts.lag else "of the same sample"
        share = f"{100.0 * reacts.share:.0f} %"
        effect = (
            f"inputs that come too late to act explain {share} of its sum of squares beside all "
            "past ones, and no other cause that was tried takes that away"
        )
    return one_finding(
        "feedback",
        name,
        f"the residual of {name} is correlated with {which} {when}: the input reacts to the output "
        f"(feedback), {'' if direct else 'or '}its clock is late"
        f"{', or the output follows it at once' if direct else ''}",
        f"{f'{NO_CONTROLLER} ' if direct else ''}"
        "open the loop, or add a test signal that is large against the feedback; check that the "
        "channels share one clock",
        effect=effect,
    )


def _outside(picture: CrossCorrelation) -> float:
    side = picture.lags < 0
    bound = np.where(picture.bound[side] > 0, picture.bound[side], np.inf)
    return float(np.max(np.abs(picture.correlation[side]) / bound, initial=0.0))


def in_words(
    found: Sequence[Finding], names: Sequence[str], transfer: Transfer | None, fit: Sequence[float]
) -> str:
    """The verdict: one or two sentences.

    Parameters
    ----------
    found : sequence of Finding
    names : sequence of str
        Of the outputs.
    transfer : Transfer or None
    fit : sequence of float
        Of every output [percent].
    """
    serious = [f for f in found if f.matters]
    fits = ", ".join(f"{n} {f:.1f} %" for n, f in zip(names, fit, strict=True))
    where = f"fit {fits}"
    if transfer is not None:
        best = ", ".join(f"{f:.1f} %" for f in transfer.expected_fit)
        where += f" on a record that was not identified, where {best} was to be expected"
    if serious:
        text = f"{serious[0].message[:-1]} ({where})."
        others = list(dict.fromkeys(brief(f.message) for f in serious[1:]))
        return text + (f" Besides, {'; '.join(others[:3])}." if others else "")
    what = "noise alone" if transfer is None else "noise and the standard errors alone"
    text = f"Nothing speaks against the model: the residual is explained by {what} ({where})."
    if any(f.code == "order-low" for f in found):
        text = f"Nothing speaks against the response of the model ({where})."
    if found:
        text += f" To be known: {decapitalised(found[0].message)}"
    return text


def brief(message: str) -> str:
    """What was found, without what it means.

    Parameters
    ----------
    message : str
    """
    return decapitalised(message.split(":")[0].split(" (")[0].rstrip("."))
