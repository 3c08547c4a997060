"""Logs that were interpolated: outputs on straight lines between every k-th sample.

What lies between two recorded samples was made from both, the later one among them: it is no
response, and its noise follows from that of its neighbours. A model takes the corners for modes,
for delays or for bad samples. The recorded samples alone tell the truth; the model is fitted to
them before that is advised.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.likelihood.question import Question
from tridentify.estimation.search.search import search
from tridentify.judgement.causes.attempts.attempt import Attempt, attempt
from tridentify.judgement.causes.attempts.intersample import IN_WORDS, is_staircase
from tridentify.judgement.causes.attempts.revisit import poles_of_estimate, problem_of, stated
from tridentify.judgement.causes.signals.interpolated import in_rows, interpolated, without_lines
from tridentify.judgement.validation.explained import NOTHING_MOVES, most_moved
from tridentify.numerics.joined_by_lines import Joined
from tridentify.record.record import Record

FOLLOW = (
    "bad-samples",
    "lost-rows",
    "channel-changes",
    "input-noise",
    "intersample",
    "delay",
    "feedback",
    "nonlinear",
    "varying",
    "disagreeing-experiments",
    "drift",
    "order-low",
    "order-high",
    "unmodelled-response",
    "quantisation",
    "noise-model",
    "tone",
    "noise-changes",
    "noise-size",
    "distribution",
)
"""What the lines make as well, so that nothing is known of it before they are gone."""


def interpolated_findings(
    records: Sequence[Record], estimate: Estimate | None = None
) -> list[Finding]:
    """What is to be said of logs that were interpolated.

    Parameters
    ----------
    records : sequence of Record
    estimate : Estimate, optional
        Of these records: fitted to the recorded samples, it says what the others have done.
    """
    several = len(records) > 1
    each = [interpolated_in(one, e if several else None) for e, one in enumerate(records)]
    found = [one for own in each for one in own]
    effect = _without_lines(estimate, records) if found and estimate is not None else ""
    return [replace(one, effect=effect) for one in found]


def interpolated_in(record: Record, experiment: int | None) -> list[Finding]:
    """The same of one record, and its position; None for the only one."""
    found = interpolated(record)
    rows = in_rows(record, found)
    return [_finding(record, i, joined, rows, experiment) for i, joined in found]


def beside_lines(found: Iterable[Finding], made: Sequence[Finding]) -> list[Finding]:
    """Without what lines between recorded samples make as well, where there are any."""
    return [one for one in found if not made or one.code not in FOLLOW]


def _finding(
    record: Record, output: int, joined: Joined, rows: bool, experiment: int | None
) -> Finding:
    between = joined.between(record.n_samples) & np.isfinite(record.y[:, output])
    every, first = joined
    name = record.output_names[output]
    where = "" if experiment is None else f" in experiment {experiment + 1}"
    start = f"{first}::{every}" if first else f"::{every}"
    step = f"{every * record.dt:.6g}" if record.dt else ""
    if rows:
        keep = f"Keep the recorded rows alone: Record(u[{start}], y[{start}], dt={step})"
    else:
        keep = (
            f"Keep y[{start}] of {name} and mark its other samples as missing (nan, record.mask): "
            "the rows in between have inputs or outputs of their own"
        )
    return Finding(
        "interpolated",
        "error",
        f"{int(between.sum())} of {record.n_samples} samples of {name}{where} lie on straight "
        f"lines between others, every {ordinal(every)} sample: the log was interpolated, and what "
        "lies between two recorded samples was made from both.",
        f"{keep}, or take the log as it was recorded.",
        (name,),
        experiment,
        tuple(record.t[between].tolist()),
    )


def ordinal(number: int) -> str:
    """Which one in a row, in digits.

    Examples
    --------
    >>> ordinal(2), ordinal(3), ordinal(12), ordinal(21)
    ('2nd', '3rd', '12th', '21st')
    """
    ends = {1: "st", 2: "nd", 3: "rd"}
    own = number % 10 if number % 100 not in (11, 12, 13) else 0
    return f"{number}{ends.get(own, 'th')}"


def _without_lines(estimate: Estimate, records: Sequence[Record]) -> str:
    """What an estimate becomes with the recorded samples alone; empty where that cannot be had."""
    if estimate.structure.constrained or not estimate.status.ok:
        return ""
    kept = [without_lines(record) for record in records]
    now = kept[0].behaviour
    fewer = any(a.n_samples < b.n_samples for a, b in zip(kept, records, strict=True))
    others = [now]
    if fewer and not all(record.behaviour == "band-limited" for record in kept):
        others = ["zoh"] if is_staircase(kept) else ["zoh", "foh"]
    ends = {name: _fitted(estimate, [one.between(name) for one in kept]) for name in others}
    there = {name: end for name, end in ends.items() if end is not None}
    if not there:
        return ""
    name, end = min(there.items(), key=lambda pair: pair[1].deviance)
    taken = "" if name == now else f" and an input that is {IN_WORDS[name]}"
    moves = most_moved(estimate, end) or NOTHING_MOVES
    return f"With the recorded samples alone{taken}: {moves}."


def _fitted(estimate: Estimate, records: Sequence[Record]) -> Attempt | None:
    """The model on other samples, from where it ended and from a search of its own."""
    try:
        problem = problem_of(estimate, records, stated(estimate))
        orders = [a.size for a in problem.noise] or [0] * problem.n_outputs
        starts = [poles_of_estimate(estimate, problem)]
        if estimate.structure.delay != "free":
            starts += search(Question.of(records, estimate.structure), 1).seeds
        ends = [attempt(problem, [one], orders) for one in starts]
        return min(filter(None, ends), key=lambda one: one.deviance, default=None)
    except (TridentifyError, np.linalg.LinAlgError):
        return None
