"""What to be careful about: findings that go with an estimate wherever it is shown.

They need the record, so they are drawn up once, when the estimate is made, and kept with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import SEVERITIES, Finding, joined, same_thing
from tridentify.judgement.causes.attempts.at_once import gain_findings
from tridentify.judgement.causes.attempts.fewer import order_findings
from tridentify.judgement.causes.attempts.first_samples import Predictions
from tridentify.judgement.causes.attempts.intersample import (
    Behaviours,
    intersample_findings,
    is_clearly_better,
)
from tridentify.judgement.causes.attempts.rivals import ALONG
from tridentify.judgement.causes.attempts.told_apart import about_loop
from tridentify.judgement.cautions.coefficients import coefficient_findings
from tridentify.judgement.cautions.levels import level_findings
from tridentify.judgement.cautions.opposite import opposite_findings
from tridentify.judgement.cautions.outliers import outlier_findings
from tridentify.judgement.cautions.remedies import with_drift_tried, with_stuck_tried
from tridentify.judgement.cautions.residual import (
    far_likelier,
    residual_findings,
    response_as_noise,
    slow_findings,
)
from tridentify.judgement.cautions.sensors import sensor_findings
from tridentify.judgement.cautions.stuck import SLOW
from tridentify.judgement.cautions.tones import tone_findings
from tridentify.judgement.validation.assess import looked_at
from tridentify.judgement.validation.explained import HEADLINES, TRIED
from tridentify.judgement.validation.interpolated import beside_lines, interpolated_findings
from tridentify.record.record import Record


def judged(
    estimate: Estimate,
    records: Sequence[Record],
    between: Behaviours | None = None,
    recorded: Sequence[Record] | None = None,
) -> tuple[Finding, ...]:
    """What a reader should know before using the numbers.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
        Those that were identified.
    between : Behaviours, optional
        What other behaviours of the input between its samples would make of the records.
    recorded : sequence of Record, optional
        What sensors gave, where the estimate is a fit to what a reference drives of it.

    Returns
    -------
    tuple of Finding
        What matters most first; empty when nothing stands out.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Record, Structure, identify
    >>> noise = np.random.default_rng(0).standard_normal(100)
    >>> record = Record(np.sign(noise[::-1]), noise, dt=0.1)
    >>> identify(record, Structure(1, 0), throw=False).findings[0].code
    'no-response'
    """
    known = Predictions(estimate)
    recorded = records if recorded is None else recorded
    # those of the method come first: what it alone could see
    found = [*estimate.findings, *coefficient_findings(estimate, records)]
    if not _unanswered(found):
        found += [*order_findings(estimate, records), *level_findings(estimate, records)]
        found += gain_findings(estimate, records, known)
    if _unanswered(found) and estimate.route != "reference":
        # what no output answers may move as it likes; of a loop the kind of its controller is told
        between, found = None, [one for one in found if one.code != "intersample"]
    seen = [*outlier_findings(estimate, records, known)]
    found += response_as_noise(estimate)
    tested = list(looked_at(estimate, records, known)) if estimate.status.ok else []
    if between is not None and not any(_moves_between(one) for one in tested):
        found += intersample_findings(estimate, between)
    tested += opposite_findings(estimate, records, [*found, *tested])
    found = _beside_better(found, tested)
    loop = about_loop(estimate, records, tested)
    if loop:
        # nothing else of such a response is the plant's; feedback is, where the plant can be told
        told = () if any(one.severity == "error" for one in loop) else ("feedback",)
        tested, found = (
            [one for one in part if one.code not in IN_LOOP or one.code in told]
            for part in (tested, found)
        )
    found += loop
    hung: list[Finding] = []
    for number, record in enumerate(records):
        found += _missing(record, number if len(records) > 1 else None)
        hung += sensor_findings(estimate, record, number, known, recorded[number])
        if not tested:
            found += residual_findings(estimate, record, number, known)
    if not any(one.matters and one.code != "noise-model" for one in tested):
        # a cause that was fitted says what is slow there
        found += with_drift_tried(slow_findings(estimate, records, known), estimate, records)
    step = records[0].duration / max(records[0].n_samples - 1, 1)
    if any(one.kind == "friction" for one in tested):
        hung = [one for one in hung if not _may_be_held(one, records, step)]
    tested, seen = (_beside_hanging(one, hung, step) for one in (tested, seen))
    if any(one.code == "wraps-round" for one in hung):
        tested = []  # whatever else it looks like is looked at when it is undone
    slow = {name for one in hung if one.kind == SLOW for name in one.outputs}
    tested, seen = (_beside_slow(one, slow) for one in (tested, seen))
    undone = any(one.kind == "missing-code" or one.code == "wraps-round" for one in hung)
    if undone or any(one.kind == "scale" and one.matters for one in tested):
        found = [one for one in found if one.code != "no-response"]  # it was not looked at yet
    seen = _beside_causes(
        [*seen, *with_stuck_tried(hung, estimate, records, known, recorded)], tested
    )
    if all(not np.any(np.ptp(record.u, axis=0)) for record in records):
        tested, found = _of_constant_inputs(tested, found)
    explained = any(one.code in EXPLAIN and one.matters and one.remedy for one in tested)
    if not explained:  # what rings on because a response is missing is no tone from outside
        found += tone_findings(estimate, records, known)
    first = [] if explained else far_likelier(estimate)
    if first and any(one.remedy == ALONG for one in tested):
        # the line that was fitted along is what was not recorded
        tested = [replace(one, severity="error") if one.remedy == ALONG else one for one in tested]
        first = []
    made = [one for one in tested if one.code == "interpolated"]
    made = made or interpolated_findings(records, estimate)
    parts = ([*first, *_with_trial(seen, tested)], tested, [*found, *seen])
    return joined(made, *(beside_lines(part, made) for part in parts))


def _unanswered(found: Sequence[Finding]) -> bool:
    """Whether nothing answers the inputs, as far as that was looked at."""
    return any(one.code == "no-response" for one in found)


def _moves_between(one: Finding) -> bool:
    """Whether a cause was compared with other behaviours of the input between its samples.

    They let an output follow the sample to come, and an input move within a gap. What the reference
    route says of the controller there is no such behaviour, and stays.
    """
    early = one.code in ("feedback", "lost-rows", "filtered") or one.kind == "clocks"
    return (early and one.matters) or one.kind == "between"


def _beside_better(found: Sequence[Finding], tested: Sequence[Finding]) -> list[Finding]:
    """With another behaviour of the input as a note where the tests name a cause before it.

    They fitted it beside all others, and it explains a part of what that cause explains.
    """
    others = [one for one in tested if one.code in HEADLINES and one.code != "intersample"]
    if not any(one.matters and one.effect for one in others):
        return list(found)
    return [
        replace(one, severity="note", remedy="") if is_clearly_better(one) else one for one in found
    ]


EXPLAIN = ("intersample", "delay", "feedback", "saturation", "order-low")
"""Causes which say why another model of the noise is likelier: it makes up for them. Not where
nothing is to be done about them: an order of which the record does not tell the coefficients."""


BENDS = ("saturation", "nonlinear", "varying", "disagreeing-experiments")
"""Causes that leave single samples far from a model that was fitted across them."""


LATE = ("repeated", "between")
"""The same of an input whose moves were recorded late."""


def _beside_causes(seen: Sequence[Finding], tested: Sequence[Finding]) -> list[Finding]:
    """Without far samples that a cause makes.

    What a limit cuts off lies far from a model that was fitted to it. The tests look for far
    samples beside the causes that they fit, so where they find such a cause and no bad samples, a
    robust loss would only keep what the cause bends.
    """
    every = {name for one in seen for name in one.outputs}
    makes = [one for one in tested if one.code in BENDS or one.kind in LATE]
    bent = {name for one in makes if one.effect for name in one.outputs or every}
    bad = [one for one in tested if one.code == "bad-samples" and one.matters]
    bent -= {name for one in bad for name in one.outputs}
    return [one for one in seen if one.code != "bad-samples" or not set(one.outputs) <= bent]


def _may_be_held(one: Finding, records: Sequence[Record], step: float) -> bool:
    """Whether friction explains that an output stands: it goes on by steps, or is not seen to."""
    if one.code != "stuck-sensor" or not one.times:
        return False
    last = float(records[one.experiment or 0].t[-1])
    in_one = one.times[-1] - one.times[0] < (len(one.times) - 0.5) * step
    return one.kind == "held" or (in_one and last - one.times[-1] < 0.5 * step)


def _beside_hanging(
    tested: Sequence[Finding], hung: Sequence[Finding], step: float
) -> list[Finding]:
    """Leave out what a sensor that hangs, or rows that are stored twice, make seen there.

    Bad samples, lost rows, disturbances that set in; nor another channel from there on.
    """
    still = np.array([t for one in hung if one.code == "stuck-sensor" for t in one.times])

    def there(one: Finding) -> bool:
        return all(bool(np.any(np.abs(still - t) < 1.5 * step)) for t in one.times)

    at_all = ("bad-samples", "lost-rows", "drift")
    kept = [one for one in tested if one.code not in at_all or not one.times or not there(one)]
    return [one for one in kept if not still.size or one.code != "channel-changes"]


def _beside_slow(found: Sequence[Finding], slow: set[str]) -> list[Finding]:
    """Leave out what held values of an output look like; a controller is there all the same."""
    return [
        one
        for one in found
        if one.code == "feedback" or not (one.outputs and slow >= {*one.outputs})
    ]


MOVING = ("feedback", "nonlinear", "saturation", "delay", "intersample")
"""Causes that only an input that moves tells from others."""


IN_LOOP = (*MOVING, "order-low", "order-high", "drift", "varying", "unmodelled-response")
"""Causes that a controller which alone moves the input makes, or hides."""


def _with_trial(seen: Sequence[Finding], tested: Sequence[Finding]) -> list[Finding]:
    """What was both seen at a limit and tried: what was seen, then what the trial brought.

    Bad samples that the tests found stand as they are: what the trial brought is of these, which
    `validate` tells as well, and not of all that lie far from a model that misses something.
    """
    found: list[Finding] = []
    for one in seen:
        same = (t for t in tested if one.code == "saturation" and same_thing(one, t))
        trial = next(same, None)
        if trial is None:
            continue
        first = not any(same_thing(one, other) for other in found)
        _, begins, rest = trial.message.partition(TRIED)
        message = f"{one.message} {begins}{rest}" if first and begins else one.message
        found.append(
            replace(
                trial,
                message=message,
                remedy=one.remedy,  # it states the limit
                severity=min(one.severity, trial.severity, key=SEVERITIES.index),
                times=one.times,
                experiment=one.experiment,
            )
        )
    return found


def _of_constant_inputs(
    tested: Sequence[Finding], found: Sequence[Finding]
) -> tuple[list[Finding], list[Finding]]:
    """Without what only an input that moves can show; where nothing answered, that says why."""
    kept = [one for one in tested if one.code not in MOVING]
    if not _unanswered(found):
        return kept, list(found)
    still = [replace(one, severity="error") for one in found if one.code == "constant-input"]
    return [], still


def _missing(record: Record, experiment: int | None) -> list[Finding]:
    """Samples that are not there."""
    lost = np.isnan(record.y)
    missing = int(lost.sum())
    if not missing:
        return []
    where = "" if experiment is None else f" in experiment {experiment + 1}"
    at = record.t[lost.any(axis=1)]
    return [
        Finding(
            "missing-samples",
            "note",
            f"{missing} output samples are missing{where}; they do not count.",
            experiment=experiment,
            times=(at[0], at[-1]),
        )
    ]
