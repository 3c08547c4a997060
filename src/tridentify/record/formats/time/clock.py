"""The column of time of an open file: which it is, and its instants in seconds."""

from __future__ import annotations

import warnings
from collections.abc import Mapping

import numpy as np

from tridentify.errors import DataError, DataWarning, NotFiniteError, UnitError, shown
from tridentify.numerics.arrays import Array
from tridentify.record.formats.channels import CALLER, SECONDS, Channel, OpenFile, seconds_of
from tridentify.record.formats.time.rounded_time import raster_behind
from tridentify.record.formats.time.serial_days import DAY, about_days, serial_unit
from tridentify.record.formats.time_names import (
    LONGER_NAMES,
    TIME_NAMES,
    epoch_unit,
    is_epoch,
    is_stamp,
    named_time,
    unit_in_name,
)

DATE_NAMES = ("timestamp", "datetime", "date")
"""What a channel of time may be called besides if it holds dates: numbers under such a name count
from who knows when in who knows what."""

JITTER = 0.05
"""Largest departure of a step of recorded time from a stated `dt`, as a fraction of it."""


def time_channels(source: OpenFile) -> list[Channel]:
    """Give the channels that are time by their name, in any case, without a time of their own.

    Those called t or time; where there are none, those that another language calls so, then those
    called at greater length or with a unit, then those called `DATE_NAMES` that hold dates, then
    stamps with a unit or that count from 1970, then the one column that holds dates. A ``T`` in a
    unit that is none of time is another quantity.
    """
    free = [c for c in source.channels if not c.clock and not is_other_quantity(c)]
    named = [free[k] for k in named_time([channel.name for channel in free])]
    named = named or [c for c in free if c.dated and c.name.casefold() in DATE_NAMES]
    named = named or [c for c in free if _tells_time(source, c)]
    dated = [c for c in free if c.dated]
    return named or (dated if len(dated) == 1 else [])


def is_other_quantity(channel: Channel) -> bool:
    """Whether a name of one letter or word is that of time, and its unit is none.

    Examples
    --------
    >>> [is_other_quantity(Channel(f"T [{u}]", "T", u)) for u in ("°C", "ms", "")]
    [True, False, False]
    """
    short = channel.name.casefold() in ("t", *LONGER_NAMES, *TIME_NAMES[2:])
    return short and not channel.dated and channel.unit not in SECONDS


def _tells_time(source: OpenFile, channel: Channel) -> bool:
    """Whether stamps say in what they count, or do so by how large they are."""
    if channel.dated or not is_stamp(channel.name):
        return False
    if channel.unit:
        return channel.unit in SECONDS
    (values,) = source.read([source.channels.index(channel)])
    return is_epoch(values)


def seconds_in(source: OpenFile, clock: Channel, time: Array, units: Mapping[str, str]) -> Array:
    """The instants [s] of a column of time, by its unit, or by how large its numbers are.

    Raises
    ------
    NotFiniteError, UnitError
    """
    check_finite(source, clock, time, 0, len(time))
    unit = units.get(clock.header) or unit_in_name(clock.name) or epoch_unit(time)
    if not unit and not clock.dated:
        unit = serial_unit(time)
        if said := about_days(time, unit, clock.header, source.path.name):
            warnings.warn(said, DataWarning, stacklevel=CALLER)
    if SECONDS.get(unit) == DAY:
        time = time - time[:1]  # as seconds they would lose digits
    if unit in ("s", "sec") and epoch_unit(time):
        raise UnitError(
            f"found {time[0]:.6g} s in the time column {shown(clock.header)}; expected less than "
            "1e11, as seconds since 1970 are; correct its unit (ms, us or ns)"
        )
    scale = seconds_of(unit, clock.header)
    even = raster_behind(time)
    seconds: Array = (time if even is None else even) * scale
    return seconds


def check_finite(source: OpenFile, channel: Channel, values: Array, first: int, last: int) -> None:
    """Refuse a sample between two rows that is no number.

    Raises
    ------
    NotFiniteError
    """
    finite = np.isfinite(values[first:last])
    if not finite.all():
        row = first + int(np.argmin(finite))
        raise NotFiniteError(
            f"found {values[row]} (or a blank) in column {shown(channel.header)}, "
            f"{source.place(row)} of {shown(source.path.name)}; expected a finite number; repair "
            "it or cut the record"
        )


def compare_with_own_time(source: OpenFile, dt: float) -> None:
    """Say that a stated step is not that of the file's time, which is not used where `dt` is."""
    found = time_channels(source)
    if len(found) != 1:
        return
    clock = found[0]
    if source.instants(clock.clock) is not None:
        return  # it is used, and refused where it does not agree
    try:
        (values,) = source.read([source.channels.index(clock)])
    except DataError:
        return
    scale = SECONDS.get(clock.unit or unit_in_name(clock.name) or serial_unit(values))
    mean = np.nan if scale is None else scale * float(values[-1] - values[0])
    mean /= max(len(values) - 1, 1)
    if clock.dated and not mean:
        return  # the day alone
    if abs(mean - dt) > JITTER * dt:
        warnings.warn(
            f"column {shown(clock.header)} is not used; its mean step is {mean:.6g} s, not "
            f"{dt:.6g} s",
            DataWarning,
            stacklevel=CALLER,
        )
