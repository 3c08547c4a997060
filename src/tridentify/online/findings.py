"""What stands between an estimate made on-line and trust, in the words of findings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding, ranked
from tridentify.numerics.arrays import Array
from tridentify.online.kernels import slots
from tridentify.online.saved.state import Flag, State
from tridentify.online.search import TRIED, first_try
from tridentify.online.unexplained import doubt_finding

WORTH_TELLING = 1.05  # standard errors that differ by less tell nobody anything
BIASED = 1.5  # times wider: an equation error that follows its own past
LOOSE = 0.5  # of a coefficient, its standard error
LOOKED = 2 * TRIED  # times a first search's samples: a look that found no change is over


def with_findings(state: State, estimate: Estimate) -> Estimate:
    """The estimate with what its samples, and the changes seen in them, say of it.

    Parameters
    ----------
    state : State
    estimate : Estimate
    """
    found = (
        *estimate.findings, *_remembered(state, estimate.findings), *_changes(state),
        *_excitation(estimate), *_samples(state),
    )  # fmt: skip
    return replace(estimate, findings=ranked(found))


def _remembered(state: State, told: Sequence[Finding]) -> tuple[Finding, ...]:
    """What spoke against the model in samples that are gone, unless those at hand say the same."""
    doubt = state.stage.doubt
    if doubt is None or any(one.code == doubt.code for one in told):
        return ()
    return (doubt_finding(doubt),)


def noise_finding(white: Array, cov: Array) -> tuple[Finding, ...]:
    """That the noise is coloured, where the standard errors had to be made for it.

    Parameters
    ----------
    white, cov : (n, n) arrays
        Covariance for white noise, and as the scatter of the scores shows it.
    """
    ratio = _widest(white, cov)
    if not ratio > WORTH_TELLING:
        return ()
    return (
        Finding(
            "noise-model",
            "note",
            "The noise is not white, and has no model on-line: the standard errors are those of "
            f"the scatter of the scores, up to {ratio:.1f} times those of white noise.",
            "Nothing needs doing; for smaller errors identify the stored record with noise='ar'.",
        ),
    )


def bias_finding(white: Array, cov: Array) -> tuple[Finding, ...]:
    """`noise_finding` for an equation error: where it follows its own past it biases what it gives.

    Parameters
    ----------
    white, cov : (n, n) arrays
        Covariance for white noise, and as the scatter of the scores shows it.
    """
    told = noise_finding(white, cov)
    if not told or not _widest(white, cov) > BIASED:
        return told
    return (
        Finding(
            "noise-model",
            "warning",
            "The equation error is not white: noise biases the coefficients, which the standard "
            f"errors do not contain, though they are {_widest(white, cov):.1f} times those of "
            "white noise.",
            "Use online.ThreeModel(), which noise does not bias.",
        ),
    )


def _widest(white: Array, cov: Array) -> float:
    with np.errstate(invalid="ignore", divide="ignore"):
        ratios = np.sqrt(np.diagonal(cov) / np.diagonal(white))
    return float(np.nanmax(ratios, initial=1.0))


def _changes(state: State) -> tuple[Finding, ...]:
    x, stage = state
    found = []
    if stage.changes:
        at = stage.changes[-1] * stage.setting.dt
        several = len(stage.changes) > 1
        restarts = getattr(stage.method, "on_change", "flag") == "restart"
        what = f"{len(stage.changes)} times, the last time at" if several else "at"
        found.append(
            Finding(
                "varying",
                "note" if restarts else "warning",
                f"The coefficients changed {what} {at:.6g} s"
                + ("; the estimate is of the samples since." if restarts else "."),
                "" if restarts else "Use on_change='restart', or a forgetting factor below 1.",
                times=tuple(k * stage.setting.dt for k in stage.changes),
            )
        )
    if x[slots.SUSPECT] > 0.0 and x[slots.SUSPECT] != x[slots.LOOK]:
        since = (x[slots.SUSPECT] - 1.0) * stage.setting.dt
        looked = x[slots.COUNT] - x[slots.SUSPECT] > LOOKED * first_try(stage.setting)
        found.append(
            Finding(
                "varying",
                "note" if looked else "warning",
                f"The coefficients may have changed at {since:.6g} s; "
                + (
                    "no other ones explain the samples since clearly better."
                    if looked
                    else "the samples since are too few to tell."
                ),
                "Wait for more samples.",
                times=(float(since),),
            )
        )
    return tuple(found)


def _excitation(estimate: Estimate) -> tuple[Finding, ...]:
    n = estimate.model.den[0][0].size - 1
    loose = [
        name
        for name, value, std in zip(
            estimate.names[:n], estimate.theta[:n], estimate.std[:n], strict=True
        )
        if not std < LOOSE * abs(value)
    ]
    if not loose:
        return ()
    return (
        Finding(
            "not-excited",
            "warning",
            f"The input has not moved the system enough so far to tell {', '.join(loose)}.",
            "Move the input more richly, or wait until it has moved.",
        ),
    )


_SAMPLES = (
    (Flag.STUCK, "stuck-sensor", "warning", "An output stands still while the model moves; its "
     "samples are left out.", "Look at the sensor and its recording."),
    (Flag.SATURATED, "saturation", "warning", "An output is at its limit while the model is "
     "beyond; its samples are left out.", "Reduce the input, or widen the range of the sensor."),
    (Flag.OUTLIER, "bad-samples", "note", "Samples far from what was expected of them were left "
     "out.", ""),
    (Flag.MISSING_OUTPUT, "missing-samples", "note", "Output samples are missing.", ""),
    (Flag.MISSING_INPUT, "missing-samples", "note", "Input samples are missing; the one before "
     "each was held.", ""),
)  # fmt: skip


def _samples(state: State) -> tuple[Finding, ...]:
    now, seen = state.flags, state.seen
    found = []
    for flag, code, severity, message, remedy in _SAMPLES:
        if flag in seen:
            # what is over has been left out and does no harm any more
            told = "warning" if severity == "warning" and flag in now else "note"
            remedied = remedy if flag in now else ""
            found.append(Finding(code, told, message, remedied))  # type: ignore[arg-type]
    return tuple(found)
