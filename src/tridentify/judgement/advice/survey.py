"""``advise``: what records can tell, and what stands in the way, before a model is chosen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tridentify.errors import TooFewSamplesError, TridentifyError
from tridentify.estimation.answer.finding import Finding, ranked
from tridentify.estimation.closed_loop.moving import still_names, with_still
from tridentify.judgement.advice.frequency import (
    FrequencyResponse,
    check_surveyed,
    frequency_response,
)
from tridentify.judgement.advice.outputs import NO_RESPONSE, Output, glance, looked_into
from tridentify.judgement.advice.result import Advice
from tridentify.judgement.advice.samples import bad_samples, gaps, hung, lost_rows, single_tone
from tridentify.judgement.advice.seen import DelaySeen, behaviours_seen, delay_seen, feedback_seen
from tridentify.judgement.advice.slow import DRIFTS, slow_seen
from tridentify.judgement.causes.attempts.first_samples import beginning
from tridentify.judgement.causes.attempts.intersample import AUTO, CLEARLY, IN_WORDS, needed_fall
from tridentify.judgement.causes.past_outputs import told_by_past, told_finding, unless_exchanged
from tridentify.judgement.causes.signals.wild_beginning import without_wild_beginning
from tridentify.judgement.cautions.sensors import seen_in
from tridentify.judgement.cautions.tones import tone_finding
from tridentify.judgement.selection import hankel_values
from tridentify.numerics.arrays import Array
from tridentify.record.checks.samples import Behaviour
from tridentify.record.checks.times import typical_step
from tridentify.record.listed import listed
from tridentify.record.record import Record
from tridentify.structure import Structure

LONGEST = 4_000
"""Samples of each record that the parallel model is fitted to: more would not change a clear
answer."""

LONGEST_SPECTRUM = 20_000
"""Samples of each record that the frequency response is measured from."""

FEWEST_SEEN = 40
"""Samples of an output that are needed to say anything."""

FEEDBACK = 1e-8
"""Chance for feedback: small, as no noise is quite Gaussian and no response quite linear."""

UNDERFLOW = 1e-12
"""Chance below which it is not told how small it is: no noise is Gaussian that far out."""

LATE = 12.0
"""Fall of ``-2 log L`` from which a delay is told (odds of 400 to 1)."""

SAME_TONE = 1.1
"""Highest over lowest tone of several records that count as one."""

SPOILT = ("bad-samples", "wraps-round", "stuck-sensor", "interpolated")
"""Findings whose samples are left out of what follows."""

UNUSUAL = ("wraps-round", "stuck-sensor", "quantisation")
"""Findings whose samples look bad for that reason."""

OPEN_LOOP = (
    "If a controller was running open the loop, or add a test signal that is large against the "
    "feedback, or identify with a noise model (noise='ar'); if none was, ask for as many zeros as "
    "poles."
)
BY_REFERENCE = (
    "Nothing: the reference is there, and identify takes what of input and output follows it."
)
"""What to do about a controller, by whether what it was told was recorded."""

WEAKEST = 0.1
"""Hankel singular values, in the largest, that count: what a real system has beside its linear
response rises above the noise too."""

COPIES = 8
"""Operators whose Hankel singular values are looked at."""


def advise(records: Record | Sequence[Record]) -> Advice:
    """Say what records can tell before anything is fitted, and what stands in the way.

    Parameters
    ----------
    records : Record or sequence of Record
        Experiments on one system.

    Returns
    -------
    Advice

    Raises
    ------
    DataError
        No record, records of different channels, or fewer than 40 samples of an output.
    ScaleError
        Signals or times whose squares have no room in a float.

    Notes
    -----
    No structure is assumed: a bank of fixed operators (`attempts.parallel`) stands for the system,
    and `frequency_response` looks at it without any. What needs a model to be seen (a plant that
    changes, an order too low) is for `validate`. The first 4,000 samples of each record are looked
    at, the first 20,000 for the frequency response.

    Examples
    --------
    >>> from tridentify import TransferFunction, simulate
    >>> rng = np.random.default_rng(0)
    >>> u = np.repeat(rng.choice([-1.0, 1.0], 120), 5)
    >>> y = simulate(TransferFunction([3.0], [1.0, 2.0, 9.0]), Record(u, u, dt=0.05))[:, 0]
    >>> y = y + 0.02 * rng.standard_normal(600)
    >>> y[300] += 1.0
    >>> found = advise(Record(u, y, dt=0.05))
    >>> [finding.code for finding in found.findings], found.findings[0].times
    (['bad-samples'], (15.0,))
    """
    given = listed(records)
    check_surveyed(given)
    first = given[0]
    for i, name in enumerate(first.output_names):
        count = sum(int(np.isfinite(record.y[:, i]).sum()) for record in given)
        if count < FEWEST_SEEN:
            raise TooFewSamplesError(
                f"found {count} samples of output {name}; expected at least {FEWEST_SEEN} to say "
                "anything of a record; record longer"
            )
    given, wild = without_wild_beginning(given)
    asked = given
    if still_names(asked):
        given = [one.select(references=[]) for one in asked]
    frequency, parts = _measured(given), [beginning(record, LONGEST) for record in given]
    still = not any(np.ptp(record.u, axis=0).any() for record in parts)
    outputs = [glance(parts, i, frequency) for i in range(first.n_outputs)]
    found = _of_samples(given, parts, outputs)
    if any(finding.code in SPOILT for finding in found):
        left = [_without(part, e, found) for e, part in enumerate(parts)]
        outputs = [glance(left, i, frequency) for i in range(first.n_outputs)]
        # a fit without them does not blame their neighbours
        found = _of_samples(given, parts, outputs)
        parts = [_without(part, e, found) for e, part in enumerate(parts)]
    outputs = [looked_into(parts, i, frequency) for i in range(first.n_outputs)]
    responding = [] if still else [output for output in outputs if output.any]
    delays = tuple(
        delay_seen(output.parallel, output.fit, j)
        for output in responding
        for j in range(first.n_inputs)
        if output.responds[j] < NO_RESPONSE
    )
    late = [_delayed(output, delays, first) for output in responding]
    behaviours, best = _between(parts, late)
    found += _of_input(given)
    found += [] if still else _of_response(first, outputs)
    found += [_of_delay(seen) for seen in delays if _is_late(seen)]
    found += [finding for output in late for finding in _of_noise(parts, output, best)]
    if not any(finding.code == "feedback" for finding in found):
        # an input that reacts to the output seems to act early
        found += _of_behaviour(given, behaviours, best)
    route = "direct" if any(one.code == "feedback" for one in found) else "open-loop"
    told = ranked([*wild, *unless_exchanged(found, given)])
    return Advice(
        with_still(told, asked, route),
        frequency,
        delays,
        _poles(parts, responding, delays),
        best,
        behaviours,
        first.input_names,
        first.output_names,
        sum(record.n_samples for record in given),
        float(sum(record.duration for record in given)),
        () if frequency is None else frequency.notes,
    )


def _measured(records: Sequence[Record]) -> FrequencyResponse | None:
    if not any(np.ptp(record.u, axis=0).any() for record in records):
        return None  # what never changes has no band, whatever its first sample was
    try:
        return frequency_response([beginning(record, LONGEST_SPECTRUM) for record in records])
    except TridentifyError:
        return None


def _between(
    records: Sequence[Record], outputs: Sequence[Output]
) -> tuple[dict[Behaviour, float], Behaviour]:
    """All behaviours of the inputs over all outputs, and the best."""
    present = records[0].behaviour
    if not outputs:
        return {present: 0.0}, present
    found = [behaviours_seen(output.parallel, output.fit) for output in outputs]
    known = [name for name in found[0] if all(name in one for one in found)]
    total = {name: sum(one[name] for one in found) for name in known}
    lowest = min(total.values())
    above = {name: value - lowest for name, value in total.items()}
    best = min(above, key=lambda name: above[name])
    # a staircase is held unless the record says clearly that it is not
    count = len(outputs) * sum(record.n_samples for record in records)
    if present in above and above[present] < needed_fall(records, count):
        best = present
    return {name: value - above[best] for name, value in above.items()}, best


def _of_samples(
    whole: Sequence[Record], parts: Sequence[Record], outputs: Sequence[Output]
) -> list[Finding]:
    found: list[Finding] = []
    names = parts[0].output_names
    for e, (record, part) in enumerate(zip(whole, parts, strict=True)):
        number = e if len(whole) > 1 else None
        fitted = [output.fit.fitted[e] for output in outputs]
        left = [part.y[:, i] - one for i, one in enumerate(fitted)]
        variance = np.array([_scale(one) ** 2 for one in left])
        found += gaps(record, number)
        still = [finding for i in range(len(names)) for finding in hung(part, i, number)]
        told = {finding.outputs for finding in still}
        seen = seen_in(part, np.column_stack(fitted), variance, number)
        found += still
        found += [f for f in seen if not (f.code == "stuck-sensor" and f.outputs in told)]
        repeats = {f.outputs for f in found if f.code in UNUSUAL}
        for i, one in enumerate(left):
            if (names[i],) not in repeats:
                found += bad_samples(part, i, one, number)
            found += tone_finding(one, part, i, False, number)
        found += lost_rows(part, fitted, number)
    return found


def _without(record: Record, number: int, found: Sequence[Finding]) -> Record:
    """The record with its bad samples missing."""
    where = np.zeros(record.y.shape, dtype=bool)
    for finding in found:
        if finding.code in SPOILT and finding.experiment in (None, number):
            column = record.output_names.index(finding.outputs[0])
            where[np.isin(record.t, finding.times), column] = True
    return record.mask(where) if where.any() else record


def _scale(left: Array) -> float:
    """Standard deviation of what is left, by its middle."""
    seen = np.abs(left[np.isfinite(left)])
    return float(np.median(seen)) / 0.6745 if seen.size else 0.0


def _of_input(records: Sequence[Record]) -> list[Finding]:
    found = []
    for j, name in enumerate(records[0].input_names):
        if not any(np.ptp(record.u[:, j]) for record in records):
            found.append(
                Finding(
                    "constant-input",
                    "error",
                    f"Input {name} never changes: only if it was switched on at the first sample, "
                    "with the system at rest before, does the record show its response.",
                    "Else leave it out, or record a manoeuvre in which it moves.",
                )
            )
        elif all(tones := [single_tone(record, j) for record in records]) and (
            max(tones) < SAME_TONE * min(tones)
        ):
            found.append(
                Finding(
                    "not-excited",
                    "warning",
                    f"Input {name} is a single tone of {tones[0]:.3g} rad/s, which tells two "
                    "coefficients and no more.",
                    "Record steps, pulses or several tones (tridentify excite).",
                )
            )
    return found


def _of_response(record: Record, outputs: Sequence[Output]) -> list[Finding]:
    found = []
    for output in outputs:
        name = record.output_names[output.index]
        if not output.any:
            found.append(
                Finding(
                    "no-response",
                    "error",
                    f"Output {name} shows no response to the input that is more than noise.",
                    "Check that the right columns were chosen and that the input reached the "
                    "system; a larger input or a longer record shows a weaker response.",
                    (name,),
                )
            )
            continue
        silent = [
            record.input_names[j] for j, p in enumerate(output.responds) if not p < NO_RESPONSE
        ]
        if silent:
            found.append(
                Finding(
                    "no-response",
                    "warning",
                    f"Output {name} shows no response to {', '.join(silent)} beside the other "
                    "inputs.",
                    "Leave the input out for this output, or move it by itself.",
                    (name,),
                )
            )
    return found


def _of_behaviour(
    records: Sequence[Record], above: dict[Behaviour, float], best: Behaviour
) -> list[Finding]:
    """A word where the stated behaviour is clearly not the one of the record."""
    stated = records[0].intersample
    if stated == "auto" or stated == best or above.get(stated, 0.0) < CLEARLY:
        return []
    return [
        Finding(
            "intersample",
            "warning",
            f"The input is stated as {IN_WORDS[stated]}; {IN_WORDS[best]} explains the record "
            f"clearly better (-2 log L lower by {above[stated]:.3g}).",
            f"State intersample={best!r} (--intersample {best}){AUTO}.",
        )
    ]


def _delayed(output: Output, delays: Sequence[DelaySeen], record: Record) -> Output:
    """With the delays that were seen, so that nothing else is taken for them."""
    own = {
        seen.input: seen.value
        for seen in delays
        if seen.output == record.output_names[output.index] and _is_late(seen)
    }
    step = typical_step(record.t)
    if not own or max(own.values()) < step:
        return output
    values = tuple(own.get(name, 0.0) for name in record.input_names)
    parallel = output.parallel.changed(delays=values, left=max(values))
    return replace(output, parallel=parallel, fit=parallel.best())


def _is_late(seen: DelaySeen) -> bool:
    """Whether the delay is more than noise would show."""
    return seen.fall > LATE and seen.low > 0


def _of_delay(seen: DelaySeen) -> Finding:
    return Finding(
        "delay",
        "note",
        f"{seen.output} answers {seen.input} after {seen.text}: a delay, or several fast lags in "
        "series.",
        "State a delay that is known; else compare orders, with delays among them "
        "(select_structure; tridentify select): lags in series are poles, and a delay that is "
        "estimated beside the right ones (delay='free'; --delay free) is the better number.",
        (seen.output,),
        effect=f"-2 log L is {seen.fall:.3g} lower than without.",
    )


def _driven_by_references(record: Record) -> Record:
    """A record of a loop with its references for inputs: a stable system, whatever the plant is."""
    clock = {"t": record.t} if record.dt is None else {"dt": record.dt}
    between = record.reference_behaviour or "zoh"
    return Record(
        np.asarray(record.reference),
        record.y,
        **clock,
        intersample=between,
        output_names=record.output_names,
    )


def _of_noise(records: Sequence[Record], output: Output, best: Behaviour) -> list[Finding]:
    """Feedback and drift.

    An input that moves between its samples acts before the sample that shows it, as one does that
    answers the output: feedback is what is left of the best of its behaviours.
    """
    record = records[0]
    name, found = record.output_names[output.index], []
    chance = feedback_seen(output.parallel, output.fit)
    if chance < FEEDBACK and best != record.behaviour:
        moved = output.parallel.changed(records=tuple(one.between(best) for one in records))
        chance = feedback_seen(moved, moved.best())
    if chance < FEEDBACK:
        found.append(
            Finding(
                "feedback",
                "warning" if record.reference is None else "note",
                f"Present and later inputs explain what past ones leave of {name} (by chance "
                f"{'below ' * (chance < UNDERFLOW)}{max(chance, UNDERFLOW):.1g}): the input reacts "
                "to the output, its clock is late, or the system has a direct part (as many zeros "
                "as poles).",
                OPEN_LOOP if record.reference is None else BY_REFERENCE,
                (name,),
            )
        )
        return found  # what comes back through a loop is slow as well
    told = told_by_past(records)[output.index] if record.reference is None else None
    if told is not None:
        return [told_finding(told, record.input_names, name)]
    fall, wandering = slow_seen(output)
    if (fall > DRIFTS or wandering) and record.reference is not None:
        # of a plant that the loop holds, the response to the input is none of a stable system
        driven = [_driven_by_references(one) for one in records]
        fall, wandering = slow_seen(glance(driven, output.index, None))
    # an autoregression stands on even time alone
    noise_model = "Use a noise model (noise='ar')" if record.dt else "Resample to even time"
    if fall <= DRIFTS and wandering:
        found.append(
            Finding(
                "drift",
                "warning",
                f"Most of what the inputs do not explain of {name} is slower than four periods in "
                "the record: a slow disturbance, which slow coefficients take for response.",
                f"{noise_model}, estimate a drift along (drift=True, --drift yes), or cut the "
                "record shorter.",
                (name,),
            )
        )
    if fall > DRIFTS:
        found.append(
            Finding(
                "drift",
                "warning",
                f"{name} drifts beside its response.",
                "Estimate a drift along (drift=True, --drift yes).",
                (name,),
                effect=f"The information criterion (AICc) falls by {fall:.3g} with a straight one.",
            )
        )
    return found


def _poles(
    records: Sequence[Record], outputs: Sequence[Output], delays: Sequence[DelaySeen]
) -> int | None:
    """How many Hankel singular values of the outputs that respond rise above the noise."""
    if not outputs:
        return None
    late = {(seen.output, seen.input): seen.value for seen in delays if _is_late(seen)}
    names = [records[0].output_names[output.index] for output in outputs]
    poles = dict.fromkeys(output.fit.pole for output in outputs)
    banks = [(f"on {p:.3g} rad/s", _bank(p)) for p in poles]
    noise = tuple(output.parallel.noise for output in outputs)
    delay = [[late.get((name, u), 0.0) for u in records[0].input_names] for name in names]
    template = Structure(1, 0, delay=delay, offset=True, initial_state="free")
    try:
        chosen = [record.settled(record.behaviour).select(outputs=names) for record in records]
        found = hankel_values(chosen, banks, template, noise)
    except (TridentifyError, np.linalg.LinAlgError, ValueError):
        return None
    seen = found.values > max(found.floor, WEAKEST * float(found.values[0]))
    return int(seen.sum()) or None


def _bank(pole: complex) -> NDArray[np.complex128]:
    pair = [pole, pole.conjugate()] if pole.imag else [pole, pole]
    return np.array(pair * (COPIES // 2), dtype=np.complex128)
