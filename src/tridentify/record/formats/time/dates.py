"""Dates and times of day as text: ISO 8601, counted in nanoseconds so that no digit is lost.

What is understood: ``2026-11-22T10:30:00.25``, with a blank for the T, with ``Z`` or ``+01:00``, a
date alone, and ``10:30:00.25`` alone, whose hours may go on beyond 24 as those of a stopwatch do.
``2026/11/22`` and ``22.11.2026`` have one reading as well. Years are those from 1900 to 2189. All
times of a column are written alike. Times of day go on over midnight where their steps do, and
dates without a zone over an hour that the clock is put forward or back (below).

``11/20/2026 11:59:40 AM`` has two readings, as 1/2/2026 is January to one reader and February to
another: a column of those is read in the order of day and month that all its dates allow, and where
both do in the one whose instants lie closer together, which is told. A day alone is refused.

*Summer time*: local times without a zone over the night in which clocks go forward or back by an
hour. A logger that writes the time of the wall leaves an hour of no samples in spring, and writes
one hour twice in autumn. Read as they stand, the one is a hole in a record that has none, and the
other runs backwards. Both nights are those to a Sunday, between midnight and four, wherever clocks
are changed; in spring and autumn of either half of the earth that is March, April, or September to
November (IANA time zone database, rules in force since 2007).
"""

from __future__ import annotations

import re
from array import array
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from tridentify.numerics.arrays import Array, Flags

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


_DATE = re.compile(
    r"(\d{4}-\d\d-\d\d|\d{4}/\d\d/\d\d|\d\d\.\d\d\.\d{4})"
    r"(?:[Tt ]+(\d\d:\d\d(?::\d\d)?)(?:[.,](\d{1,9})\d*)?\s*([Zz]|[-+]\d\d(?::?\d\d)?)?)?",
    re.ASCII,
)
_CLOCK = re.compile(
    r"(\d{1,4}):([0-5]\d):([0-5]\d)(?:[.,](\d{1,9})\d*)?(?:\s*([AaPp])\.?[Mm]\.?)?", re.ASCII
)
_SLASHES = re.compile(
    r"(\d{1,2})/(\d{1,2})/(\d{4})[ ,T]+"
    r"(\d{1,2}:[0-5]\d)(:[0-5]\d(?:[.,]\d+)?)?(\s*[AaPp]\.?[Mm]\.?)?",
    re.ASCII,
)
YEARS = range(1900, 2190)
"""Of dates that are read: the nanoseconds between any two of them fit into 64 bits."""

_SECOND = 1_000_000_000
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)

Moment = tuple[str, int]
"""What kind of time a cell holds ("date", "date with zone", "time of day" and others), and ns."""

SLASHES = "day and month in either order"
DOTS = "date with points"
WITHOUT_ZONE = ("date", "date with slashes", DOTS, SLASHES)
"""Kinds of time as the clock on the wall tells it."""

LONGEST_LEAP = 2.0
"""Step over midnight, in largest other steps, up to which a time of day goes on the next day."""


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
    if (clock := _clock(text)) is not None:
        return "time of day", clock
    if (date := _DATE.fullmatch(text)) is None:
        both = slashed(text)
        return next(((SLASHES, count) for count in both if count is not None), None)
    day, time, fraction, zone = date.groups()
    kind = DOTS if "." in day else "date with slashes" if "/" in day else "date"
    day = "-".join(reversed(day.split("."))).replace("/", "-")
    try:
        stated = datetime.fromisoformat(f"{day}T{time or '00:00'}{(zone or 'Z').upper()}")
    except ValueError:
        return None
    if stated.year not in YEARS:
        return None
    since = stated - _EPOCH
    whole = 86400 * since.days + since.seconds
    return f"{kind} with zone" if zone else kind, whole * _SECOND + _nanoseconds(fraction)


def slashed(cell: str) -> tuple[int | None, int | None]:
    """Nanoseconds since 1970 with the month first and with the day first; None where it is none.

    Examples
    --------
    >>> slashed("01/02/1970 00:00:01"), slashed("01/13/1970 12:00:00 AM"), slashed("1/2/1970")
    ((86401000000000, 2678401000000000), (1036800000000000, None), (None, None))
    """
    match = _SLASHES.fullmatch(cell.strip())
    clock = None if match is None else _clock(f"{match[4]}{match[5] or ':00'}{match[6] or ''}")
    if match is None or clock is None or clock >= 86400 * _SECOND:
        return None, None
    first, second, year = (int(part) for part in match.groups()[:3])
    return _day(year, first, second, clock), _day(year, second, first, clock)


def _day(year: int, month: int, day: int, clock: int) -> int | None:
    if year not in YEARS:
        return None
    try:
        return (datetime(year, month, day, tzinfo=UTC) - _EPOCH).days * 86400 * _SECOND + clock
    except ValueError:
        return None


def _clock(text: str) -> int | None:
    """Nanoseconds of a time of day, of 12 or of 24 hours."""
    if (clock := _CLOCK.fullmatch(text)) is None:
        return None
    hours, minutes, seconds = (int(part) for part in clock.groups()[:3])
    if clock[5]:
        if not 0 < hours < 13:
            return None
        hours = hours % 12 + (12 if clock[5] in "Pp" else 0)
    return (3600 * hours + 60 * minutes + seconds) * _SECOND + _nanoseconds(clock[4])


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
        self._orders = (array("q"), array("q"))
        self._possible = [True, True]
        self.choice = ""

    def take(self, cell: str, _line: int) -> bool:
        """Take a cell, blank where time is missing; False if it is no time, or of another kind."""
        moment = ("", 0) if not cell.strip() else read_moment(cell)
        if moment is None or (self._kind and moment[0] not in ("", self._kind)):
            return False
        if SLASHES in (self._kind, moment[0]) and not self._take_slashed(cell, moment[1]):
            return False
        self._kind = moment[0] or self._kind
        self._counts.append(moment[1])
        self._known.append(bool(moment[0]))
        return True

    def _take_slashed(self, cell: str, count: int) -> bool:
        """Take a date in both orders, unless it needs the one that those above it rule out."""
        both = slashed(cell) if cell.strip() else (count, count)
        possible = [a and b is not None for a, b in zip(self._possible, both, strict=True)]
        if not any(possible):
            return False
        self._possible = possible
        for order, own in zip(self._orders, both, strict=True):
            order.extend([0] * (len(self._counts) - len(order)))  # blank ones above the first date
            order.append(0 if own is None else own)
        return True

    def drop(self) -> None:
        """Drop the last one, which is blank."""
        self._counts.pop()
        self._known.pop()
        for order in self._orders:
            del order[len(self._counts) :]

    def values(self) -> Array:
        """Seconds since the first time that is known; nan for a blank."""
        known = np.array(self._known, dtype=np.bool_)
        counts = self._read() if self._kind == SLASHES else np.array(self._counts, dtype=np.int64)
        if self._kind in WITHOUT_ZONE:
            counts, changed = without_clock_change(counts, known)
            self.choice = " and ".join(filter(None, (self.choice, changed)))
        if known.any():
            counts = counts - counts[int(np.argmax(known))]
        if self._kind == "time of day":
            counts[known] = _over_midnight(counts[known])
        return np.where(known, counts * 1e-9, np.nan)

    def _read(self) -> np.ndarray:
        """Dates with slashes in the order that they allow, or that puts them closer together."""
        month, day = (np.array(order, dtype=np.int64) for order in self._orders)
        known = np.array(self._known, dtype=np.bool_)
        spans = [float(np.abs(np.diff(one[known])).sum()) for one in (month, day)]
        if not all(self._possible):
            return month if self._possible[0] else day
        if spans[0] != spans[1]:
            first, other = ("month", "day") if spans[0] < spans[1] else ("day", "month")
            self.choice = f"dates that may begin with month or day, read with the {first} first"
            self.choice += f" (the {other} first would put them farther apart)"
        return day if spans[1] < spans[0] else month


def _over_midnight(counts: np.ndarray) -> np.ndarray:
    """Times of day that go on the next day, where the steps are no longer there than elsewhere.

    Examples
    --------
    >>> clock = [read_moment(text)[1] for text in ("23:59:58", "23:59:59", "00:00:00", "00:00:01")]
    >>> (_over_midnight(np.array(clock)) - clock[0]) // _SECOND
    array([0, 1, 2, 3])
    """
    steps, day = np.diff(counts), 86400 * _SECOND
    back = steps < -day // 2
    if not back.any() or back.all():
        return counts
    over = steps[back] + day
    if np.any(over < 0) or over.max() > LONGEST_LEAP * steps[~back].max():
        return counts
    return np.asarray(counts + np.r_[0, day * np.cumsum(back)])
