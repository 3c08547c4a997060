"""What a column of time is called, and the unit that its name ends on."""

from __future__ import annotations

import re
from collections.abc import Sequence

from tridentify.numerics.arrays import Array

ENGLISH_NAMES = ("t", "time")
TIME_NAMES = (*ENGLISH_NAMES, "zeit", "temps", "tiempo", "tempo", "tijd")
"""What a channel of time is called, in any case: the first two come before what other languages
call it."""

COUNTED = ("seconds", "milliseconds", "microseconds", "nanoseconds")
LONGER_NAMES = ("elapsed", "elapsed time", "x value", *COUNTED)
"""What else it is called: words apart by a blank, an underscore or a hyphen; X_Value by LabVIEW."""

WITH_UNIT = (*TIME_NAMES, *LONGER_NAMES[:2], "timestamp", "time stamp", "stamp")
"""What stands before a unit at the end of a name: ``t_ms``, ``timestamp_us``."""

ENDINGS = ("ms", "us", "µs", "μs", "ns", "s", "sec", "min", "h")
ENDING = re.compile(rf"(?P<name>.*[^ _-])[ _-]+(?P<unit>{'|'.join(ENDINGS)})")

SPELT = {
    "s": ("s", "sec", "secs", "second", "seconds", "sekunden"),
    "ms": ("ms", "msec", "milli", "millis", "millisecond", "milliseconds", "millisekunden"),
    "us": ("us", "µs", "μs", "usec", "micro", "micros", "microsecond", "microseconds"),
    "ns": ("ns", "nsec", "nano", "nanos", "nanosecond", "nanoseconds"),
    "min": ("min", "mins", "minute", "minutes", "minuten"),
    "h": ("h", "hr", "hrs", "hour", "hours", "stunden"),
    "d": ("d", "day", "days", "tage"),
}
"""How people and loggers write units where a name is one, or ends on one."""

RUN_ON = re.compile(r"(?i:time|timestamp|stamp|elapsed|clock)(?P<unit>Ms|MS|Us|US|Ns|NS|Sec|Min)")
"""A unit without anything between: ``timeMs``, and the ``TimeUS`` of ArduPilot."""

STAMPS = ("timestamp", "time stamp", "epoch", "unix time")
"""What may be time where its numbers tell since when and in what they count."""

NOWADAYS = (1.2e9, 2.5e9)
"""Seconds since 1970 of 2008 and 2049."""

LONGEST_STEP = 60.0
"""Mean step [s] of such a column: what counts microseconds since it was switched on, the usual
other kind, passes the numbers of `NOWADAYS` after twenty minutes, in larger steps."""

# larger numbers of seconds since 1970 lie thousands of years ahead
EPOCHS = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))


def unit_in_name(name: str) -> str:
    """The unit of time that a name is or ends on; empty where there is none.

    It is asked of columns that were taken as time: ``min`` of another may be the smallest.

    Examples
    --------
    >>> unit_in_name("stamp_ms"), unit_in_name("logged"), unit_in_name("Time s")
    ('ms', '', 's')
    >>> unit_in_name("Minutes"), unit_in_name("TimeUS"), unit_in_name("Zeit in Minuten")
    ('min', 'us', 'min')
    """
    match = ENDING.fullmatch(name.strip()) or RUN_ON.fullmatch(name.strip())
    last = match["unit"] if match else re.split(r"[ _.-]+", name.strip(" ()[]."))[-1]
    if match and last in ENDINGS:
        return last
    return next((unit for unit, words in SPELT.items() if last.casefold() in words), "")


def unit_of_clock(name: str) -> str:
    """The unit that a name says where it is that of a column of time, as its first words say.

    A capital T before a unit is a temperature: hot, or that of a surface.

    Examples
    --------
    >>> unit_of_clock("t_ms"), unit_of_clock("T_h"), unit_of_clock("milliseconds")
    ('ms', '', 'milliseconds')
    """
    if _words(name) in COUNTED:
        return _words(name)
    match = ENDING.fullmatch(name.strip())
    if match is None or match["name"] == "T" or (match["name"] == "t" and match["unit"] == "h"):
        return ""
    return match["unit"] if _words(match["name"]) in WITH_UNIT else ""


def is_called_time(name: str) -> bool:
    """Whether a name is that of a column of time.

    Examples
    --------
    >>> [is_called_time(name) for name in ("T", "Elapsed Time", "time_ms", "timestamp", "T_h")]
    [True, True, True, False, False]
    """
    return _words(name) in (*TIME_NAMES, *LONGER_NAMES) or bool(unit_of_clock(name))


def named_time(names: Sequence[str]) -> list[int]:
    """Positions of names of time: t or time, else another language's, else a longer one.

    Examples
    --------
    >>> named_time(["u", "time_ms", "t"]), named_time(["t_ms", "u"]), named_time(["u"])
    ([2], [0], [])
    """
    for known in (ENGLISH_NAMES, TIME_NAMES):
        found = [k for k, name in enumerate(names) if name.casefold() in known]
        if found:
            return found
    return [k for k, name in enumerate(names) if is_called_time(name)]


def _words(name: str) -> str:
    return " ".join(re.split(r"[ _-]+", name.strip().casefold()))


def epoch_unit(time: Array) -> str:
    """The unit of numbers that are too large to be seconds since 1970; empty where they are not.

    Parameters
    ----------
    time : (n_samples,) array

    Examples
    --------
    >>> import numpy as np
    >>> epoch_unit(np.array([1.76e12, 1.76e12 + 20.0])), epoch_unit(np.array([0.0, 0.1]))
    ('ms', '')
    """
    largest = float(abs(time).max()) if time.size else 0.0
    return next((unit for least, unit in EPOCHS if largest > least), "")


def is_stamp(name: str) -> bool:
    """Whether a name is that of a column that may count from 1970.

    Examples
    --------
    >>> is_stamp("Timestamp"), is_stamp("unix_time"), is_stamp("u")
    (True, True, False)
    """
    return _words(name) in STAMPS


def is_epoch(time: Array) -> bool:
    """Whether numbers count from 1970.

    Parameters
    ----------
    time : (n_samples,) array

    Examples
    --------
    >>> import numpy as np
    >>> is_epoch(1.76e9 + np.arange(5.0)), is_epoch(np.arange(5.0))
    (True, False)
    """
    if len(time) < 2:
        return False
    seconds = time * {"": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[epoch_unit(time)]
    within = NOWADAYS[0] < seconds[0] <= seconds[-1] < NOWADAYS[1]
    return bool(within and seconds[-1] - seconds[0] <= LONGEST_STEP * (len(time) - 1))
