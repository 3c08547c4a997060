"""Local times without a zone over the night in which clocks go forward or back by an hour.

A logger that writes the time of the wall leaves an hour of no samples in spring, and writes one
hour twice in autumn. Read as they stand, the one is a hole in a record that has none, and the other
runs backwards. Both nights are those to a Sunday, between midnight and four, wherever clocks are
changed; in spring and autumn of either half of the earth that is March, April, or September to
November (IANA time zone database, rules in force since 2007).
"""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from tridentify.numerics.arrays import Flags

Counts = NDArray[np.int64]

SECOND = 1_000_000_000
HOUR = 3600 * SECOND
MONTHS = frozenset((3, 4, 9, 10, 11))
SUNDAY = 6
LATEST = 4
"""Hour of the night by which clocks have been changed."""
SLACK = 0.25
"""Departure from an hour and the usual step, in usual steps: less than a row that is lost."""


def without_clock_change(counts: Counts, known: Flags) -> tuple[Counts, str]:
    """Instants as if the clock had not been changed, and a word on it.

    Parameters
    ----------
    counts : ndarray of int64, shape (n_samples,)
        Nanoseconds since 1970 of the wall's time.
    known : ndarray of bool, shape (n_samples,)
        Where there is one.

    Returns
    -------
    counts : ndarray
        As they were where no step is an hour too long or too short in such a night.
    told : str
        What was found, for a sentence; blank where nothing was.

    Examples
    --------
    >>> begin = int(datetime(2026, 3, 29, 1, 50, tzinfo=UTC).timestamp()) * SECOND
    >>> wall = begin + np.array([0, 5, 70, 75, 80]) * 60 * SECOND
    >>> even, told = without_clock_change(wall, np.ones(5, dtype=bool))
    >>> np.diff(even) // (60 * SECOND)
    array([5, 5, 5, 5])
    >>> told
    'a clock that goes forward by an hour in the night to 2026-03-29, taken as no time that passes'
    """
    at = np.flatnonzero(known)
    steps = np.diff(counts[at])
    if steps.size < 2:
        return counts, ""
    usual = float(np.median(steps))
    if not 0.0 < usual <= HOUR:
        return counts, ""
    moved, told = np.array(counts), []
    for sign, words in ((1, "forward"), (-1, "back")):
        changed = np.abs(steps - usual - sign * HOUR) <= SLACK * usual
        for k in np.flatnonzero(changed):
            if _in_such_a_night(counts[at[k]]):
                moved[at[k + 1] :] -= sign * HOUR
                told.append(f"{words} by an hour in the night to {_wall(counts[at[k]]):%Y-%m-%d}")
    if not told:
        return counts, ""
    how = "taken as no time that passes" if len(told) == 1 else "each taken as no time that passes"
    return moved, f"a clock that goes {' and '.join(told)}, {how}"


def _wall(count: int) -> datetime:
    return datetime.fromtimestamp(int(count) // SECOND, UTC)


def _in_such_a_night(count: int) -> bool:
    wall = _wall(count)
    return wall.weekday() == SUNDAY and wall.month in MONTHS and wall.hour < LATEST
