"""Whether a channel wraps round: a counter that overflowed, a heading beyond north.

At the end of its range such a channel jumps to the other end and goes on from there. With the range
``P`` taken off the jump the samples go on as they came. An output that is thrown from one end to
the other by its input looks alike, but that it stays within what was recorded: ``P`` has to be that
of an angle, a clock or a counter of some bits, or the samples go beyond their range without jumps.
"""

from __future__ import annotations

import math

import numpy as np

from tridentify.judgement.cautions.stuck import Seen
from tridentify.numerics.arrays import Array
from tridentify.numerics.converter import quantum

FEWEST = 2
"""Jumps below which it went out of its range once and did not come back."""
ACROSS = 0.6
"""Share of the range that a jump spans."""
USUAL = 0.35
"""Share of the range that the largest other step may be."""
BEYOND = 0.01
"""Share of the range by which the samples go beyond it once the jumps are taken off."""
TURNS = (360.0, 2.0 * math.pi, 24.0)
"""Ranges of angles and clocks."""
NEAR = 0.01
"""Relative distance within which a range is one of these, or of a counter."""


def period_of(y: Array) -> float:
    """By how much the samples jump at the ends of their range; zero where they do not.

    Parameters
    ----------
    y : (n,) array
        nan where one is missing.

    Examples
    --------
    >>> heading = 90.0 * np.sin(0.05 * np.arange(300.0)) + 120.0
    >>> period_of((heading + 180.0) % 360.0 - 180.0), period_of(heading)
    (360.0, 0.0)
    """
    seen = y[np.isfinite(y)]
    if seen.size < 10 * FEWEST:
        return 0.0
    steps, size = np.diff(seen), float(np.ptp(seen))
    far = np.abs(steps) > ACROSS * size
    if far.sum() < FEWEST or float(np.abs(steps[~far]).max(initial=0.0)) > USUAL * size:
        return 0.0
    at = np.flatnonzero(far)
    # the step that the range hides is like those beside it
    beside = np.clip(np.array([at - 1, at + 1]), 0, steps.size - 1)
    near = np.where(far[beside], 0.0, steps[beside]).mean(axis=0)
    period = float(np.median(np.abs(steps[at] - near)))
    known = (one for one in (*TURNS, *_counters(seen)) if abs(period / one - 1.0) < NEAR)
    range_ = next((one for one in known if one >= size), 0.0)
    undone = undo(seen, range_ or period)
    if np.abs(np.diff(undone)).max() > USUAL * size:
        return 0.0
    return range_ or (period if np.ptp(undone) > (1.0 + BEYOND) * size else 0.0)


def undo(y: Array, period: float) -> Array:
    """The samples without the jumps, most of them where they were; nan stay."""
    found = np.array(y, dtype=np.float64)
    seen = np.isfinite(found)
    plain = np.unwrap(found[seen], period=period)
    turns = np.round((plain - found[seen]) / period)
    found[seen] = plain - period * np.median(turns)
    return found


def _counters(seen: Array) -> list[float]:
    """Ranges of a counter of some bits, of a converter's step."""
    step = quantum(seen, 0.0)
    return [step * 2.0**bits for bits in (8, 10, 12, 14, 16)] if step > 0.0 else []


def wrapped(y: Array, name: str) -> Seen | None:
    """Whether an output wraps round, and where.

    Parameters
    ----------
    y : (n,) array
    name : str
    """
    period = period_of(y)
    if not period:
        return None
    away = np.flatnonzero(np.isfinite(y) & (np.abs(undo(y, period) - y) > 0.5 * period))
    starts = np.flatnonzero(np.diff(away, prepend=-2) > 1)
    lengths = np.diff(starts, append=away.size)
    lost = tuple((int(away[k]), int(n)) for k, n in zip(starts, lengths, strict=True))
    return Seen(
        "wraps-round",
        "error",
        f"Output {name} jumps by {period:.6g} from one end of its range to the other and back, "
        f"{len(lost)} times (the first at sample {lost[0][0]}): it wraps round, as an angle does, "
        "or a counter that overflows.",
        f"Undo it: numpy.unwrap(y, period={period:.6g}) on the column, before anything is made "
        "of it; or mark these samples as missing.",
        tuple(first for first, _ in lost),
        lost,
    )
