"""What the numbers of a saved vector may be, place by place."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from tridentify.numerics.arrays import Array, Indices
from tridentify.online.kernels import gradient_slots as places
from tridentify.online.kernels import slots
from tridentify.online.layout import Stage

WHOLE = 2.0**53
"""Beyond this a float does not count any more."""


HUGE = 1e250
"""Larger than any sum of products of samples, which are below 1e40; its square overflows."""


ALARM_LASTS = 200.0
"""Samples for which a change is told, long enough to be seen on a slow display."""


EVERY_FLAG = 2 * slots.NOT_READY - 1


class NumberRule(NamedTuple):
    """What numbers of a vector may be: from ``least`` to ``most``, no nan; ``whole``: counts."""

    what: str
    at: int
    length: int
    least: float = -HUGE
    most: float = HUGE
    whole: bool = False


def check_rule(values: Array, rule: NumberRule) -> None:
    """Refuse numbers that are not what they may be.

    Raises
    ------
    ValueError
    """
    own = values[rule.at : rule.at + rule.length]
    good = (own >= rule.least) & (own <= rule.most)
    if rule.whole:
        good &= own == np.floor(own)
    if not good.all():
        kind = "a whole number" if rule.whole else "a number"
        raise ValueError(
            f"{rule.what} {own[~good][0]:g}; it is {kind} from {rule.least:g} to {rule.most:g}"
        )


def rules_of(stage: Stage, values: Array) -> Iterator[NumberRule]:
    """What the numbers of the vector may be; room for scratch numbers is left out."""
    ints, setting = stage.blueprint.ints, stage.setting
    m, p = setting.n_inputs, setting.n_outputs
    yield from _clock_rules(ints)
    line = int(ints[slots.AT_LARGEST] - ints[slots.AT_LINE])
    yield NumberRule(
        "an input", int(ints[slots.AT_LINE]), line, -2 * slots.LARGEST, 2 * slots.LARGEST
    )
    for k in range(m + p):
        at = int(ints[slots.AT_LARGEST]) + 2 * k
        yield NumberRule("a largest sample", at, 1, 0.0, slots.LARGEST)
        yield NumberRule("a count", at + 1, 1, 0.0, WHOLE, whole=True)
    for i in range(p):
        yield from _watch_rules(ints, int(ints[slots.AT_WATCH] + i * ints[slots.WATCH]), values)
        if ints[slots.SCATTER]:
            at = int(ints[slots.AT_SCATTER] + i * ints[slots.SCATTER])
            yield from _scatter_rules(int(ints[slots.DIRECTIONS]), at)
    yield NumberRule("a regressor", int(ints[slots.AT_ROW]), int(ints[slots.COLUMNS]))
    own = 1 if on_equation(ints) else p
    for i in range(own if ints[slots.FACTOR] else 0):
        yield from _triangle_rules(ints, int(ints[slots.AT_FACTOR] + i * ints[slots.FACTOR]))
    if on_equation(ints):
        begin, end = int(ints[slots.AT_IMPULSE]), int(ints[slots.AT_FACTOR])
        yield NumberRule("a filtered signal or coefficient", begin, end - begin)
        if ints[slots.FILTERING]:
            n, at = int(ints[slots.COLUMNS]), int(ints[slots.AT_COVARIANCE])
            yield NumberRule("a variance", at, n, 0.0)
            yield NumberRule("a covariance", at + n, n * (n - 1) // 2)
    if by_gradient(ints):
        begin, end = int(ints[places.X_FITS]), int(ints[places.X_ROOM])
        yield NumberRule("a weight of a model", begin, end - begin)


def _clock_rules(ints: Indices) -> Iterator[NumberRule]:
    for slot in (slots.COUNT, slots.SINCE, slots.ALARM):
        yield NumberRule("a count of samples", slot, 1, 0.0, WHOLE, whole=True)
    yield NumberRule("a time", slots.TIME, 1, 0.0)
    yield NumberRule("a flag", slots.FLAGS, 1, 0.0, EVERY_FLAG, whole=True)
    yield NumberRule("a flag", slots.SEEN, 1, 0.0, EVERY_FLAG, whole=True)
    yield NumberRule("an event", slots.EVENT, 1, 0.0, 0.0)
    yield NumberRule("a tick", slots.TICK, 1, 0.0, np.inf, whole=True)
    full = max(float(ints[slots.CHUNK]) - 1.0, 0.0)
    yield NumberRule("a number of samples kept", slots.FILLED, 1, 0.0, full, whole=True)
    yield NumberRule("a time", slots.BORN, 2)
    if by_gradient(ints):
        yield NumberRule("a count of samples", places.FROM, 1, 0.0, np.inf, whole=True)
        yield NumberRule("a count of samples", places.MOMENTS, 2, 0.0, WHOLE, whole=True)
    else:
        at = slots.OWN_TICK + 1
        yield NumberRule("a number in a place for none", at, slots.WORK_AT - at, 0.0, 0.0)
    yield NumberRule("a tick", slots.OWN_TICK, 1, 0.0, WHOLE, whole=True)
    yield NumberRule("a tick", slots.DUE, 1, 0.0, WHOLE, whole=True)
    yield NumberRule("a count of work", slots.WORK_AT, 3, 0.0, WHOLE, whole=True)


def _watch_rules(ints: Indices, w: int, values: Array) -> Iterator[NumberRule]:
    """Of one output (`online.kernels.intake`)."""
    for slot in (slots.LAST, slots.AT_FIRST, slots.MEAN, slots.FITTED):
        yield NumberRule("a value of an output", w + slot, 1)
    for slot in (
        slots.SCALE, slots.SQUARES, slots.WEIGHT, slots.WEIGHT2, slots.SPREAD, slots.FLOOR,
    ):  # fmt: skip
        yield NumberRule("a scale of an output", w + slot, 1, 0.0)
    for slot, most in (
        (slots.REPEATS, WHOLE), (slots.TAKEN, WHOLE), (slots.REFUSED, WHOLE), (slots.STANDS, 1.0),
        (slots.LIMITS, 3.0), (slots.INSIDE, float(ints[slots.BLOCK]) - 1.0), (slots.IDLE, WHOLE),
        (slots.MOVED, 1.0), (slots.BLOCKS, WHOLE), (slots.DOUBLES, WHOLE),
        (slots.SCALED, slots.FIRST_SCALED),
    ):  # fmt: skip
        yield NumberRule("a count of an output", w + slot, 1, 0.0, most, whole=True)
    if not np.isnan(values[w + slots.INNOVATION]):
        yield NumberRule("an innovation", w + slots.INNOVATION, 1)
    if values[w + slots.HIGHEST] != -np.inf or values[w + slots.LOWEST] != np.inf:
        yield NumberRule(
            "a limit of an output", w + slots.HIGHEST, 2, -slots.LARGEST, slots.LARGEST
        )
    k = int(ints[slots.DIRECTIONS])
    width = k + k * (k + 1) // 2
    yield NumberRule("a sensitivity", w + slots.SCORES, k)
    for scale in range(slots.SCALES):
        own = w + slots.SCORES + k + scale * (width + slots.SUMS)
        yield NumberRule("a score", own, width)
        yield NumberRule("a sum of scores", own + width, 2, 0.0)
        yield NumberRule(
            "a count of blocks", own + width + 2, 1, 0.0, slots.PER_SCALE - 1.0, whole=True
        )
        yield NumberRule("a count of blocks", own + width + 3, 1, 0.0, WHOLE, whole=True)
    usual = w + slots.SCORES + k + slots.SCALES * (width + slots.SUMS)
    yield NumberRule("a usual score", usual, k, 0.0)


def _scatter_rules(k: int, at: int) -> Iterator[NumberRule]:
    """Of one output (`online.scatter`)."""
    width = k * (k + 1) // 2
    yield NumberRule("a sum of squares", at, slots.HEADER, 0.0)
    yield NumberRule("a scatter", at + slots.HEADER, width)
    for level in range(slots.LEVELS):
        own = at + slots.HEADER + width + level * (k + 2 + width)
        yield NumberRule("a score", own, k)
        yield NumberRule("a count of blocks", own + k, 1, 0.0, float(slots.PER_LEVEL), whole=True)
        yield NumberRule("a number of blocks", own + k + 1, 1, 0.0, WHOLE)
        yield NumberRule("a scatter", own + k + 2, width)


def _triangle_rules(ints: Indices, at: int) -> Iterator[NumberRule]:
    """Of one output, or of all (`numerics.recursive`)."""
    n = int(ints[slots.COLUMNS])
    yield NumberRule("a diagonal", at, n, 0.0)
    yield NumberRule("a target", at + n, n)
    yield NumberRule("a largest regressor", at + 2 * n, 2 * n, 0.0)
    yield NumberRule("a triangle", at + 4 * n, int(ints[slots.FACTOR]) - 4 * n)


def on_equation(ints: Indices) -> bool:
    """Whether an estimator regresses on the differential equation."""
    return bool(ints[slots.COEFFICIENTS])


def by_gradient(ints: Indices) -> bool:
    """Whether an estimator follows the gradient rule."""
    return bool(ints[places.X_FITS])
