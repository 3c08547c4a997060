"""Dates and times of day as text: ISO 8601, counted in nanoseconds so that no digit is lost.

What is understood: ``2026-11-22T10:30:00.25``, with a blank for the T, with ``Z`` or ``+01:00``, a
date alone, and ``10:30:00.25`` alone, whose hours may go on beyond 24 as those of a stopwatch do.
``2026/11/22`` and ``22.11.2026`` have one reading as well. Years are those from 1900 to 2189.
Other orders of day and month are refused: 1/2/2026 is January to one reader and February to
another.
"""

from __future__ import annotations

import re
from array import array
from datetime import UTC, datetime

import numpy as np

from tridentify.numerics.arrays import Array

_DATE = re.compile(
    r"(\d{4}-\d\d-\d\d|\d{4}/\d\d/\d\d|\d\d\.\d\d\.\d{4})"
    r"(?:[Tt ]+(\d\d:\d\d(?::\d\d)?)(?:[.,](\d{1,9})\d*)?\s*([Zz]|[-+]\d\d(?::?\d\d)?)?)?",
    re.ASCII,
)
_CLOCK = re.compile(r"(\d{1,4}):([0-5]\d):([0-5]\d)(?:[.,](\d{1,9})\d*)?", re.ASCII)
YEARS = range(1900, 2190)
"""Of dates that are read: the nanoseconds between any two of them fit into 64 bits."""

_SECOND = 1_000_000_000
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)

Moment = tuple[str, int]
"""What kind of time a cell holds ("date", "date with zone", "time of day"), and how many ns."""


def read_moment(cell: str) -> Moment | None:
    """Give the time that a cell holds, None when it is none.

    Parameters
    ----------
    cell : str

    Returns
    -------
    tuple of (str, int) or None
        Its kind, and nanoseconds since 1970 or since midnight.

    Examples
    --------
    >>> read_moment("1970-01-01 00:01:00.5"), read_moment("00:00:02"), read_moment("1/2/2026")
    (('date', 60500000000), ('time of day', 2000000000), None)
    >>> read_moment("1970-01-01T01:00:00+01:00")
    ('date with zone', 0)
    """
    text = cell.strip()
    if clock := _CLOCK.fullmatch(text):
        hours, minutes, seconds = (int(part) for part in clock.groups()[:3])
        whole = 3600 * hours + 60 * minutes + seconds
        return "time of day", whole * _SECOND + _nanoseconds(clock[4])
    if (date := _DATE.fullmatch(text)) is None:
        return None
    day, time, fraction, zone = date.groups()
    day = "-".join(reversed(day.split("."))).replace("/", "-")
    try:
        stated = datetime.fromisoformat(f"{day}T{time or '00:00'}{(zone or 'Z').upper()}")
    except ValueError:
        return None
    if stated.year not in YEARS:
        return None
    since = stated - _EPOCH
    whole = 86400 * since.days + since.seconds
    return "date with zone" if zone else "date", whole * _SECOND + _nanoseconds(fraction)


def _nanoseconds(digits: str | None) -> int:
    return int((digits or "0").ljust(9, "0"))


class Instants:
    """A column of times that is read cell by cell; all have to be of one kind.

    Examples
    --------
    >>> column = Instants()
    >>> [column.take(cell, 1) for cell in ("10:00:00", "", "10:00:01.5", "2026-01-01", "1.5")]
    [True, True, True, False, False]
    >>> column.values()
    array([0. , nan, 1.5])
    """

    def __init__(self) -> None:
        self._kind = ""
        self._counts = array("q")
        self._known = array("b")

    def take(self, cell: str, _line: int) -> bool:
        """Take a cell, blank where time is missing; False if it is no time, or of another kind."""
        moment = ("", 0) if not cell.strip() else read_moment(cell)
        if moment is None or (self._kind and moment[0] not in ("", self._kind)):
            return False
        self._kind = moment[0] or self._kind
        self._counts.append(moment[1])
        self._known.append(bool(moment[0]))
        return True

    def values(self) -> Array:
        """Seconds since the first time that is known; nan for a blank."""
        counts = np.array(self._counts, dtype=np.int64)
        known = np.array(self._known, dtype=np.bool_)
        if known.any():
            counts = counts - counts[int(np.argmax(known))]
        return np.where(known, counts * 1e-9, np.nan)
