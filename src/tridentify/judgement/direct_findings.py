"""What is said of an estimate by the direct route, and of feedback that past outputs alone show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tridentify.estimation.answer.decision import DecisionKind, KnownDecision
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding, ranked
from tridentify.estimation.closed_loop.moving import MOVE, still_names
from tridentify.estimation.methods.in_loop import NOT_HELD
from tridentify.judgement.causes.attempts.fewer import NO_RESPONSE, foretold
from tridentify.judgement.causes.past_outputs import (
    told_finding,
    unless_exchanged,
)
from tridentify.judgement.direct import (
    CODE,
    hold_past_samples,
    moved_by_weights,
    told_by_outputs,
    with_white_weights,
)
from tridentify.judgement.validation.assess import (
    own_look,
)
from tridentify.judgement.validation.verdict import NO_CONTROLLER
from tridentify.record.record import Record

HELD = 95
"""Percent of 95 % intervals that held the truth where no error was said: 496 coefficients of 156
random loops (`benchmarks/trust.py`, feedback); of plants that are stable, integrate or are not
stable alike."""

KNOWN = (
    "record what the controller was told to follow and give it as reference, open the loop, or "
    "add a test signal that is large against the feedback."
)

BACKWARDS = (
    "Without a model of the noise these may be the numbers of the controller, backwards, or of a "
    "stand-in."
)

LOW = 50.0
"""Fit [percent] up to which it is said what it is the fit of."""


def about_direct(
    findings: Sequence[Finding], estimate: Estimate, records: Sequence[Record]
) -> tuple[Finding, ...]:
    """Findings of an estimate, with feedback that past outputs alone show.

    By the direct route, with what hangs on the model of the noise.

    Parameters
    ----------
    findings : sequence of Finding
    estimate : Estimate
    records : sequence of Record
        Those that were identified.
    """
    told = [] if any(one.code == CODE for one in findings) else _of_past(estimate, records)
    findings = ranked([*findings, *told]) if told else findings
    findings = unless_exchanged(findings, records)
    if estimate.route != "direct":
        return tuple(findings)
    doubted = estimate.trace.about(DecisionKind.NOT_INDEPENDENT)
    weak, undecided = bool(doubted) or hold_past_samples(estimate, records), _undecided(estimate)
    hangs = doubted[0].rest if doubted else ""
    if not (hangs or undecided):
        white = with_white_weights(estimate, records)
        hangs = "" if white is None else moved_by_weights(estimate, white)
    found = [
        replace(
            one,
            severity="error" if weak or undecided else one.severity,
            effect=_sentences(
                _said(weak, bool(doubted)),
                undecided,
                "" if undecided else hangs,
                _rests(estimate),
                _ahead(estimate, records),
                one.effect,
            ),
            remedy=_with_statement(_remedy(one, records), estimate),
        )
        if one.code == CODE
        else one
        for one in findings
    ]
    if undecided and not any(one.code == CODE for one in found):
        found.append(_alone(estimate, records))
    order = sorted(found, key=lambda one: one.severity != "error")
    return tuple(order)


def _of_past(estimate: Estimate, records: Sequence[Record]) -> list[Finding]:
    """Feedback that past outputs show: an error of what is taken for an open loop."""
    if estimate.route == "reference":
        return []
    found = [
        told_finding(one, estimate.input_names, name)
        for one, name in zip(
            told_by_outputs(estimate, records), estimate.output_names, strict=False
        )
        if one is not None
    ]
    if estimate.route == "direct":
        return found
    return [replace(one, severity="error", effect=BACKWARDS) for one in found]


def predictor_findings(estimate: Estimate, records: Sequence[Record]) -> tuple[Finding, ...]:
    """What is to be said of a plant that is not stable, by the direct route.

    Parameters
    ----------
    estimate : Estimate
        That of the mirrored predictor, of which no residual can be shown.
    records : sequence of Record
        Those that were identified.
    """
    if estimate.route != "direct":
        return ()
    poles = max(den.size - 1 for row in estimate.model.den for den in row)
    # of short loops that are moved one in ten tells no more, and may be right all the same
    weak = foretold(records, poles) is False
    unseen = (replace(NO_RESPONSE, severity="warning"),) if weak else ()
    return (_alone(estimate, records), *unseen)


def _alone(estimate: Estimate, records: Sequence[Record]) -> Finding:
    undecided, known = _undecided(estimate), _known(records)
    return Finding(
        CODE,
        "error" if undecided else "warning",
        "The input reacts to the output (feedback), and no reference says what else moved it.",
        _with_statement(f"{known[0].upper()}{known[1:]}", estimate),
        estimate.output_names,
        effect=_sentences(_said(), undecided, _rests(estimate)),
    )


def _with_statement(remedy: str, estimate: Estimate) -> str:
    """With the statement that settles what the input does between its samples."""
    told = _open(estimate)
    if _rests(estimate) or (told is not None and NOT_HELD in told):
        kind, between = "may work in continuous time", "auto"
    elif told is not None and told.kind is DecisionKind.BETWEEN_DECIDES:
        kind, between = "works on the recorded samples", "zoh"
    else:
        return remedy
    return (
        f"{remedy} If the controller {kind}, it may be enough to state intersample='{between}' "
        f"(--intersample {between})."
    )


def _undecided(estimate: Estimate) -> str:
    """That the record cannot tell the plant; empty where it can."""
    told = _open(estimate)
    return "" if told is None else f"The record cannot tell the plant: {told}"


def _open(estimate: Estimate) -> KnownDecision | None:
    kinds = (
        DecisionKind.BETWEEN_DECIDES,
        DecisionKind.NO_END_TOGETHER,
        DecisionKind.ANOTHER_PLANT,
    )
    return next(iter(estimate.trace.about(*kinds)), None)


def _rests(estimate: Estimate) -> str:
    """What hangs on an input that is said to be held; empty where little does."""
    told = next(iter(estimate.trace.about(DecisionKind.RESTS_ON_HELD)), "")
    return f"{told[0].upper()}{told[1:]}" if told else ""


def _ahead(estimate: Estimate, records: Sequence[Record]) -> str:
    """What a low fit says, which is that of a simulation; empty where it is none, or not short."""
    view, fit = own_look(estimate, records), float(estimate.fit[0])
    if view is None or view.uneven or len(view.outputs) > 1 or fit > LOW:
        return ""
    one = view.outputs[0]
    y = [record.y[:, 0] - np.nanmean(record.y[:, 0]) for record in view.records]
    spread, last = (np.sqrt(sum(np.nansum(f(own) ** 2) for own in y)) for f in (np.array, np.diff))
    left = np.linalg.norm(one.white(one.residual, one.noise))
    known, plain = (100.0 * (1.0 - size / spread) for size in (left, last))
    return (
        f"The fit of {fit:.3g} % is that of a simulation, from which slow noise leads away; one "
        f"sample ahead plant and noise tell {known:.5g} %, the last sample alone {plain:.4g} %"
    )


def _remedy(feedback: Finding, records: Sequence[Record]) -> str:
    known = _known(records)
    told = f"{NO_CONTROLLER} {known}" if NO_CONTROLLER in feedback.remedy.lower() else known
    return f"{told[0].upper()}{told[1:]}"


def _known(records: Sequence[Record]) -> str:
    """What to do about feedback: a reference is missing, or stands still."""
    if not still_names(records):
        return KNOWN
    return f"{MOVE[0].lower()}{MOVE[1:]}."


def _said(weak: bool = False, wide: bool = False) -> str:
    if weak:
        return (
            "Not even with a model of the noise (direct route) are the innovations independent of "
            "past samples: the numbers are biased"
            + (", and their errors reach as far as those with white noise do" if wide else "")
        )
    return (
        "Estimated by the direct route: the numbers are as good as the model of the noise; "
        f"in random loops its 95 % intervals held {HELD} % of the coefficients"
    )


def _sentences(*parts: str) -> str:
    return " ".join(f"{part.rstrip('.')}." for part in parts if part)
