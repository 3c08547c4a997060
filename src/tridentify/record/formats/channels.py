"""What a file of measurements holds: channels, and the clocks that they were sampled by.

A reader of `tridentify.record.formats` turns a file into an `OpenFile`: a list of `Channel`, and a
way to read some of them as numbers. Channels with the same `Channel.clock` were sampled together.
Where the format itself knows when (ULog, MDF4, MATLAB timeseries), `OpenFile.instants` says so;
else a channel of the same clock has to be named as time, or the step stated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from tridentify.errors import ForeignObjectError, TextInColumnError, UnitError, shown
from tridentify.numerics.arrays import Array
from tridentify.record.checks.names import split_unit
from tridentify.record.formats.time_names import unit_of_clock

SECONDS = {
    "": 1.0,
    "s": 1.0,
    "sec": 1.0,
    "second": 1.0,
    "seconds": 1.0,
    "ms": 1e-3,
    "msec": 1e-3,
    "millisecond": 1e-3,
    "milliseconds": 1e-3,
    "us": 1e-6,
    "µs": 1e-6,
    "μs": 1e-6,
    "microsecond": 1e-6,
    "microseconds": 1e-6,
    "ns": 1e-9,
    "nanosecond": 1e-9,
    "nanoseconds": 1e-9,
    "min": 60.0,
    "minute": 60.0,
    "minutes": 60.0,
    "h": 3600.0,
    "hr": 3600.0,
    "hour": 3600.0,
    "hours": 3600.0,
    "d": 86400.0,
    "day": 86400.0,
    "days": 86400.0,
}
"""Units of time, as the formats write them [s]."""


def seconds_of(unit: str, header: str) -> float:
    """How long the unit of a column of time is [s].

    Raises
    ------
    UnitError
        It is none of time.
    """
    if unit not in SECONDS:
        raise UnitError(
            f"found the unit {shown(unit)} of the time column {shown(header)}; expected s, ms, "
            "us, ns, min, h or d; convert the column to seconds or correct the unit"
        )
    return SECONDS[unit]


CALLER = 6
"""Frames from where an open file warns to the line that called `read_record`."""


@dataclass(frozen=True)
class Channel:
    """A channel of a file.

    Attributes
    ----------
    header : str
        The full name, as the file has it: ``alpha [deg]``, ``vehicle_attitude.q[0]``.
    name : str
        The name without unit, and without a prefix that says nothing.
    unit : str
        As the file has it; empty where it does not say.
    clock : str
        Channels of the same clock were sampled together.
    samples : int or None
        Number of samples; None where the file has to be read to know.
    dated : bool
        Whether it holds dates, times of day or durations, which are read as seconds.
    """

    header: str
    name: str
    unit: str = ""
    clock: str = ""
    samples: int | None = None
    dated: bool = False


class OpenFile(Protocol):
    """A file, or a frame, whose channels are known."""

    @property
    def path(self) -> Path:
        """Where it is, for messages and the name of the record."""

    @property
    def channels(self) -> tuple[Channel, ...]:
        """All channels, in the order of the file."""

    def read(self, indices: Sequence[int]) -> list[Array]:
        """Give channels as numbers, nan for a missing sample; positions in `channels`."""

    def instants(self, clock: str) -> Array | None:
        """Give the sampling instants of a clock [s], if the file knows them."""

    def place(self, row: int) -> str:
        """Say in words where in the file a sample of what was read stands."""


class SampledFile:
    """What the readers of files share where a file says nothing else.

    Attributes
    ----------
    path : Path
    channels : tuple of Channel
    """

    path: Path
    channels: tuple[Channel, ...]

    def instants(self, clock: str) -> Array | None:
        """Give nothing: the time is a column."""

    def place(self, row: int) -> str:
        """Name a sample by its number, from 1."""
        return f"sample {row + 1}"


def real_numbers(rows: Any, what: str, path: Path) -> Array:
    """The numbers of an array that a file holds, named by ``what``.

    Raises
    ------
    TextInColumnError
        They are text, dates or complex.
    """
    if rows.dtype.kind not in "fiub":
        raise TextInColumnError.found(
            f"{rows.dtype} in {what} of ", path.name, "real numbers", "save the array as float"
        )
    return np.asarray(rows, dtype=np.float64)


def refuse_objects(kind: np.dtype[Any], where: str) -> None:
    """Refuse an array of Python objects, which would have to be unpickled.

    Raises
    ------
    ForeignObjectError
    """
    if kind.hasobject:
        raise ForeignObjectError(
            f"found Python objects in {where}; expected numbers, since objects would have to be "
            "unpickled, which can run any program; save the array as float"
        )


def header_channel(header: str, samples: int | None = None) -> Channel:
    """Take the unit out of the header of a column.

    Parameters
    ----------
    header : str
        Such as ``alpha [deg]``, ``alpha (deg)`` or ``alpha``. An index, ``x[0]``, is no unit. That
        of a column of time may end its name, as in ``t_ms``.
    samples : int, optional

    Returns
    -------
    Channel

    Examples
    --------
    >>> header_channel("alpha [deg]").unit, header_channel("x[0]").name
    ('deg', 'x[0]')
    """
    name, unit = split_unit(header)
    return Channel(header, name, unit or unit_of_clock(name), samples=samples)
