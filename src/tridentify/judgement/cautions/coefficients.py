"""What the coefficients themselves give away: vague, held, not stable, without a response."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import FEWER, Finding
from tridentify.judgement.causes.attempts.fewer import BEYOND_RECORD, foretold, unsure
from tridentify.numerics.delta_method import root_sensitivity, standard_deviation
from tridentify.numerics.quantiles import median
from tridentify.numerics.rational import scaled_roots
from tridentify.record.record import Record

SLOW = "the record shows the beginning of its response alone"
"""What is said of a pole that is slower than that."""
INTEGRATES = "or integrates: "
"""What is said of it in a loop, with the pole's error: its sign is chance."""

OVER_WITHIN = 3.0
"""Steps over a time constant from which a response is over within a sample: to a twentieth."""
SEEN = 0.3
"""Steps over which a fast pole is uncertain up to which the samples themselves tell it: what the
next one shows of its response is three standard errors from none."""
TURNS = 1.6
"""Angle of a mode between two samples [rad], four samples a period, from which it is suspicious."""

UNSURE = 2.0
"""Standard errors that a pole is from zero where its sign is not known."""

TOGETHER = 0.9
"""Correlation of two errors above which the coefficients cannot be told apart."""


def coefficient_findings(estimate: Estimate, records: Sequence[Record]) -> list[Finding]:
    """All that needs the estimate and the size of the records alone.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
        Those that were identified.
    """
    outside = _outside(estimate, records)
    longest = max(record.duration for record in records)
    not_stable, at_zero = _not_stable(estimate, longest)
    if any(INTEGRATES in one.message for one in not_stable):
        outside = [one for one in outside if SLOW not in one.message]
    elif any(SLOW in one.message for one in outside):
        at_zero = max(at_zero, 1)
    return [
        *_no_response(estimate, records),
        *_constant_input(estimate, records),
        *_vague(estimate, longest, at_zero),
        *_other_delays(estimate),
        *outside,
        *_at_bounds(estimate),
        *not_stable,
    ]


def _vague(estimate: Estimate, longest: float, at_zero: int) -> list[Finding]:
    """Coefficients whose standard error is above half of their size (`fewer.unsure`).

    ``at_zero``: so many poles are told that are about zero, or far slower than the record. Then as
    many of the last coefficients of the denominator are about zero as well, no excitation tells
    them better, and what to do is said with the poles.
    """
    found = []
    said = [f"a{k}" for k in range(at_zero)]
    wide = [name for name in unsure(estimate, longest) if name not in said]
    vague = [name for name in wide if not name.startswith("delay")]
    late = [name for name in wide if name.startswith("delay")]
    if vague and np.isnan(estimate.std).all():
        found.append(
            Finding(
                "not-determined",
                "warning",
                f"{estimate.method} gives no standard errors.",
                "ThreeModel() does.",
            )
        )
    elif vague:
        found.append(
            Finding(
                "not-determined",
                "warning",
                f"Standard error above half of the value: {', '.join(vague)}. Do not rely on these "
                "coefficients one by one.",
                f"Excite the system more{FEWER}.",
            )
        )
    if not np.isnan(estimate.std).all():
        found += _unsure_delays(estimate, late, vague)
    return found


def _other_delays(estimate: Estimate) -> list[Finding]:
    """Delays that explain the record as well, as the search told them."""
    found = [
        Finding(
            "not-determined",
            "warning",
            f"{told[0].upper()}{told[1:]}. The standard errors allow for them.",
            "Record longer, or excite the system faster, to tell them apart.",
        )
        for told in estimate.trace.about(DecisionKind.OTHER_DELAYS)
    ]
    found += [
        Finding(
            "not-determined",
            "warning",
            f"{told[0].upper()}{told[1:]}. The standard errors do not allow for the others.",
            "Check that so short a delay makes sense, or excite the system with an input that "
            "does not repeat.",
        )
        for told in estimate.trace.about(DecisionKind.REPEATED_INPUT)
    ]
    return found


def _not_stable(estimate: Estimate, longest: float) -> tuple[list[Finding], int]:
    """A pole at zero or to the right of it, where it is not given; how many cannot be told from it.

    Those are slower than the record, and their real parts less than `UNSURE` errors from zero: what
    is told of the rightmost pole holds of the pair that it belongs to. Two poles that lie together
    have no derivatives, and so no limits.
    """
    stable, shown = estimate.model.is_stable, estimate.loop is not None and estimate.loop.mirrored
    if stable and not shown:
        return [], 0
    parameters = estimate.parameters.values()
    if any(p.name.startswith("a0") and not (p.value or p.std) for p in parameters):
        return [], 0
    if estimate.route != "reference" and not shown:
        said = "The model is not stable."
        return [
            Finding("unstable", "warning", said, "Check whether the system is, or use fewer poles.")
        ], 0
    _, den, cov = estimate.channel(0, 0)
    n = den.size - 1
    poles, moved = root_sensitivity(den)
    errors = standard_deviation(moved.real, cov[:n, :n])
    errors[np.isnan(errors)] = np.inf
    right = int(np.argmax(poles.real))
    value, std, pair = poles[right].real, errors[right], bool(poles[right].imag)
    slow = (np.abs(poles) * longest < 1.0) & (np.abs(poles.real) < UNSURE * errors)
    if stable and not pair and not slow[right]:
        return [], 0
    if abs(value) < UNSURE * std:
        which = "or is hardly damped: " if pair and not slow[right] else INTEGRATES
        what = "pair of poles with a real part" if pair else "pole"
        said = (
            f"The plant is not stable, {which}its {what} of {value:.2g} +/- {std:.2g} "
            "rad/s cannot be told from one at zero."
        )
        remedy = "Fix it there if the plant integrates."
        return [Finding("unstable", "note", said, remedy)], int(slow.sum())
    if stable:
        return [], 0
    said = "The plant is not stable: the loop is, and its reference shows the pole."
    if estimate.route != "reference":
        said = "The plant is not stable: its response grows in the record."
    if estimate.route == "direct":
        said = "The plant is not stable: the loop is, and its input and output show the pole."
    return [Finding("unstable", "note", said, "")], 0


def _unsure_delays(estimate: Estimate, late: Sequence[str], vague: Sequence[str]) -> list[Finding]:
    """Delays that may be zero, and those that a numerator can stand for.

    For a slow input ``exp(-p L) = 1 - p L + ...``: the delay moves the output as the next higher
    coefficient of the numerator does, and the two errors go together.
    """
    found, zero = [], []
    for name in late:
        at = estimate.names.index(name)
        channel = name.removeprefix("delay").strip("[]").split(",")[-1]
        rivals = []
        for other in vague:
            k = estimate.names.index(other)
            size = float(estimate.std[at] * estimate.std[k])
            own = other.startswith("b") and (not channel or other.endswith((f"{channel}]",)))
            if own and size > 0 and abs(float(estimate.cov[at, k])) > TOGETHER * size:
                rivals.append(other)
        if not rivals:
            zero.append(name)
            continue
        found.append(
            Finding(
                "not-determined",
                "warning",
                f"{name} and {', '.join(rivals)} cannot be told apart: the response to a later "
                "input is that to another numerator, and their errors go together.",
                "Use fewer zeros for that input, give the delay (--delay, in Python delay=...), or "
                "excite the system faster.",
            )
        )
    if zero:
        found.append(
            Finding(
                "not-determined",
                "warning",
                f"Not distinguishable from zero: {', '.join(zero)}.",
                "Leave it out, or excite the system faster if the delay matters.",
            )
        )
    return found


def _no_response(estimate: Estimate, records: Sequence[Record]) -> list[Finding]:
    """Compare with a constant for each output: Akaike's criterion on what the fit gains."""
    samples = sum(np.isfinite(record.y).sum(axis=0) for record in records)
    left = np.maximum(1.0 - estimate.fit / 100.0, 1e-12)
    gained = float(np.sum(-2.0 * samples * np.log(left)))
    poles = estimate.model.den[0][0].size - 1
    # each pair of poles is the best of as many frequencies as there are samples
    price = 2.0 * len(estimate.names) + 2.0 * np.log(float(samples.sum())) * ((poles + 1) // 2)
    if not gained < price:
        return []
    # slow waves of the output that noise explains leave a poor fit beside a response that is seen
    if any(a.size for a in estimate.noise_model) and foretold(records, poles):
        return []
    return [
        Finding(
            "no-response",
            "error",
            "The output is explained no better than by a constant (AIC): the record shows no "
            "response to this input.",
            "Check the channels, excite the system more, or reduce the noise.",
        )
    ]


def _outside(estimate: Estimate, records: Sequence[Record]) -> list[Finding]:
    """Time constants far beyond the record, and oscillations that the samples cannot show."""
    longest = max(record.duration for record in records)
    step = _least_step(records)
    poles = np.unique(np.concatenate([np.ravel(row) for row in _denominators(estimate)]))
    found = []
    slow = [p for p in poles if 0.0 < abs(p.real) * longest < 1.0 / BEYOND_RECORD and not p.imag]
    if slow:
        constant = 1.0 / min(abs(p.real) for p in slow)
        found.append(
            Finding(
                "outside-the-record",
                "warning",
                f"A time constant of {constant:.3g} s is {constant / longest:.1f} times as long as "
                f"the record: {SLOW}, so that time constant and gain depend on what the model "
                "assumes.",
                "Fix the pole at zero if the system integrates (fixed={'a0': 0}; --fix a0=0), use "
                "one pole fewer with a drift, or record longer.",
            )
        )
    fast = [p for p in poles if abs(p.imag) * step > TURNS]
    if fast:
        turns = 2.0 * np.pi / (max(abs(p.imag) for p in fast) * step)
        found.append(
            Finding(
                "outside-the-record",
                "warning",
                f"A mode oscillates with {turns:.1f} samples a period: noise and what lies between "
                "the samples make such modes.",
                "Use two poles fewer, or sample faster if the mode is real.",
            )
        )
    beyond = over_within(estimate, records)
    if beyond is not None:
        found.append(
            Finding(
                "outside-the-record",
                "warning",
                f"The response of a pole at {beyond:.3g} 1/s is over within a sample "
                f"({step:.3g} s), and what the next one still shows of it is hardly told from "
                "nothing: what is said of the pole is little more than that it is fast, and "
                "coefficients that it multiplies are no better.",
                "Use one pole fewer, or sample faster if the pole is real.",
            )
        )
    return found


def over_within(estimate: Estimate, records: Sequence[Record]) -> float | None:
    """The fastest real pole, where the samples say little more of it than that it is fast.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
        Those that were identified.
    """
    step = _least_step(records)
    rates = [p for den in _denominators(estimate) for p in den if not p.imag]
    if not any(-p.real * step > OVER_WITHIN for p in rates):
        return None
    rows = [row for row in estimate.derived_rows() if row[0].startswith("real pole")]
    _, value, std, _ = min(rows, key=lambda row: row[1])
    return value if std * step > SEEN else None


def _least_step(records: Sequence[Record]) -> float:
    return min(median(np.diff(record.t)) if record.dt is None else record.dt for record in records)


def _denominators(estimate: Estimate) -> list[list[complex]]:
    dens = [den for row in estimate.model.den for den in row]
    return [list(scaled_roots(den)) for den in dens]


def _at_bounds(estimate: Estimate) -> list[Finding]:
    """Name the coefficients that a bound holds."""
    held = []
    for name, (low, high) in (estimate.structure.bounds or {}).items():
        parameter = estimate.parameters[name]
        if parameter.value in (low, high) and not parameter.std:
            held.append(f"{name} = {parameter.value:.6g}")
    if not held:
        return []
    return [
        Finding(
            "at-bound",
            "warning",
            f"Held by a bound: {', '.join(held)}. The record pulls beyond it; the standard errors "
            "are those of a model where it is fixed there.",
            "Check whether the bound is right.",
        )
    ]


def _constant_input(estimate: Estimate, records: Sequence[Record]) -> list[Finding]:
    assumed = [
        name
        for j, name in enumerate(estimate.input_names)
        if all(np.ptp(record.u[:, j]) == 0 for record in records)
    ]
    if not assumed:
        return []
    return [
        Finding(
            "constant-input",
            "warning",
            f"Input {', '.join(assumed)} never changes: the result holds only if it was switched "
            "on at the first sample, with the system at rest before.",
        )
    ]
