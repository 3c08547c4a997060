"""Which columns of a stream of lines are wanted, and where they stand."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tridentify.errors import ChannelNameError, DuplicateColumnError, SamplingError, shown
from tridentify.numerics.arrays import Array
from tridentify.record.checks.names import file_units
from tridentify.record.formats.assemble import find_channel
from tridentify.record.formats.channels import (
    Channel,
    OpenFile,
    SampledFile,
    header_channel,
    seconds_of,
)
from tridentify.record.formats.text.text_table import repeated_name
from tridentify.record.formats.time_names import named_time, unit_in_name


@dataclass(frozen=True)
class Asked:
    """What is to be read from the lines.

    Attributes
    ----------
    inputs, outputs : tuple of str
        Names of columns.
    time : str or None
        Column of time; without it, and unless the step is known, the one called t or time.
    uniform : bool
        Whether the step is known and no column of time is to be read: a sample for each line.
    columns : tuple of str
        Names of the columns of lines without a header; else empty.
    form : str
        ``"csv"``, ``"json"``, or ``""`` to recognise it.
    decimal : str
        Decimal sign of CSV.
    units : dict of str to str
        Units of columns, before those of the header.
    name : str
        What to call the source in messages.
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    time: str | None = None
    uniform: bool = False
    columns: tuple[str, ...] = ()
    form: str = ""
    decimal: str = "."
    units: tuple[tuple[str, str], ...] = ()
    name: str = "the stream"


@dataclass(frozen=True)
class HeaderColumns:
    """Columns that were found.

    Attributes
    ----------
    headers : tuple of str
        Their full names, the time (if it is one of them) first, then inputs, then outputs.
    places : tuple of int
        Their numbers, from zero.
    width : int
        Number of all columns.
    scale : float
        Seconds in a unit of the column of time.
    units : tuple of (str, str)
        Channels as they are asked for, and their units.
    """

    headers: tuple[str, ...]
    places: tuple[int, ...]
    width: int
    scale: float
    units: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class _Header(SampledFile):
    """The names of columns as an `OpenFile`, so that they are found as in a file."""

    path: Path
    channels: tuple[Channel, ...]

    def read(self, indices: Sequence[int]) -> list[Array]:
        return []


def find_columns(names: Sequence[str], units: Sequence[str], asked: Asked) -> HeaderColumns:
    """Find the columns that are asked for.

    Parameters
    ----------
    names : sequence of str
        Cells of the header.
    units : sequence of str
        Cells of a line of units below it; empty without one.
    asked : Asked

    Returns
    -------
    HeaderColumns

    Raises
    ------
    MissingColumnError, DuplicateColumnError, ChannelNameError
        A name fits none or several of them, or is asked for twice.
    SamplingError
        There is no column of time.
    UnitError
        The unit of time is none; that of another column is not printable or too long.

    Examples
    --------
    >>> found = find_columns(["t [ms]", "u", "y"], [], Asked(("u",), ("y",)))
    >>> found.places, found.scale
    ((0, 1, 2), 0.001)
    """
    if repeated := repeated_name(names):
        raise DuplicateColumnError(
            f"found the column {shown(repeated[0])} {repeated[1]} times in {asked.name}; "
            "expected every name once; rename one"
        )
    table = _Header(Path(asked.name), tuple(_channels(names, units)))
    clock = None if asked.uniform else _clock(table, asked)
    channels = [find_channel(table, name) for name in (*asked.inputs, *asked.outputs)]
    for channel in channels:
        if channels.count(channel) > 1:
            raise ChannelNameError(
                f"found the column {shown(channel.header)} asked for more than once; expected "
                "different columns as inputs and outputs; drop one"
            )
    wanted = channels if clock is None else [clock, *channels]
    given = dict(asked.units)
    kept = {
        name: given.get(name, given.get(channel.header, channel.unit))
        for name, channel in zip((*asked.inputs, *asked.outputs), channels, strict=True)
    }
    return HeaderColumns(
        tuple(channel.header for channel in wanted),
        tuple(table.channels.index(channel) for channel in wanted),
        len(names),
        1.0 if clock is None else _scale(clock, given),
        tuple(file_units({name: unit for name, unit in kept.items() if unit}).items()),
    )


def _channels(names: Sequence[str], units: Sequence[str]) -> list[Channel]:
    found = []
    for name, unit in zip(names, units or [""] * len(names), strict=True):
        channel = header_channel(name)
        found.append(Channel(channel.header, channel.name, unit) if unit else channel)
    return found


def _clock(table: OpenFile, asked: Asked) -> Channel:
    if asked.time is not None:
        return find_channel(table, asked.time)
    found = [table.channels[k] for k in named_time([one.name for one in table.channels])]
    if len(found) != 1:
        what = " and ".join(c.header for c in found) if found else "no column called t or time"
        raise SamplingError(
            f"found {what} in {asked.name}, and no step stated; expected to know the sampling; "
            "name the column of time (--time) or state the step (--dt SECONDS)"
        )
    return found[0]


def _scale(clock: Channel, given: dict[str, str]) -> float:
    unit = given.get(clock.header, given.get(clock.name, clock.unit)) or unit_in_name(clock.name)
    return seconds_of(unit, clock.header)


def split_columns(text: str) -> tuple[str, ...]:
    """Take the names of columns apart.

    Examples
    --------
    >>> split_columns("t, u,y")
    ('t', 'u', 'y')
    """
    return tuple(cell.strip() for cell in re.split(r"[,;\t|]", text))
