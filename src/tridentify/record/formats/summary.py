"""What the channels of an open file hold, in a few numbers each: range, mean, missing samples."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tridentify.errors import DataError, DataWarning
from tridentify.numerics.arrays import Array
from tridentify.record.checks.times import uniform_step
from tridentify.record.formats.channels import CALLER, SECONDS, Channel, OpenFile
from tridentify.record.formats.roles import guess_roles
from tridentify.record.formats.text.csv import TextFile
from tridentify.record.formats.time.clock import time_channels
from tridentify.record.formats.time.serial_days import about_days, clock_seconds, serial_unit

PATIENCE = 20.0
"""Time for the channels of a file [s]: a table of many columns of text would take hours."""


@dataclass(frozen=True)
class ChannelSummary:
    """A channel in numbers; None where it holds no numbers or was not read.

    Attributes
    ----------
    channel : Channel
    tried : bool
        Whether it was read, or would have been but for what it holds.
    samples, missing : int or None
    minimum, maximum, mean, std : float or None
        Of the samples that are finite.
    role : {"input", "output", "reference", "unused", "time", ""}
        What it is taken for at first (`guess_roles`); empty where it was not read.
    problem : str
        Why a column that begins with numbers holds none throughout.
    """

    channel: Channel
    tried: bool = False
    samples: int | None = None
    missing: int | None = None
    minimum: float | None = None
    maximum: float | None = None
    mean: float | None = None
    std: float | None = None
    role: str = ""
    problem: str = ""


@dataclass(frozen=True)
class ClockSummary:
    """Time of the channels that were sampled together.

    Attributes
    ----------
    clock : str
        As in `Channel.clock`.
    samples : int
    start, stop : float
        First and last instant [s].
    shortest, longest : float
        Steps [s].
    step : float or None
        The step [s] if it is the same throughout, to a thousandth of it.
    """

    clock: str
    samples: int
    start: float
    stop: float
    shortest: float
    longest: float
    step: float | None

    @property
    def rate(self) -> float:
        """Mean sampling rate [1/s]."""
        return (self.samples - 1) / (self.stop - self.start)


def channel_summaries(source: OpenFile) -> list[ChannelSummary]:
    """Read all channels of an open file and sum them up.

    Parameters
    ----------
    source : OpenFile

    Returns
    -------
    list of ChannelSummary
        In the order of the file; what cannot be read as numbers has none.
    """
    end = time.monotonic() + PATIENCE
    problems: dict[int, str] = {}
    read = _readable(source, range(len(source.channels)), end, problems)
    roles = _roles(source, read)
    return [
        replace(summed_up(channel, read[k]), role=roles.get(k, ""), problem=problems.get(k, ""))
        if k in read
        else ChannelSummary(channel, False, channel.samples)
        for k, channel in enumerate(source.channels)
    ]


def _roles(source: OpenFile, read: Mapping[int, Array | None]) -> dict[int, str]:
    clocks = time_channels(source)
    free = {
        k: values
        for k, values in sorted(read.items())
        if values is not None and source.channels[k] not in clocks and source.channels[k].header
    }
    unnamed = {k: "unused" for k in read if not source.channels[k].header}
    guessed = guess_roles([source.channels[k].name for k in free], list(free.values()))
    times = {k: "time" for k in read if source.channels[k] in clocks}
    return unnamed | times | dict(zip(free, map(str, guessed), strict=True))


def read_numbers(source: OpenFile) -> dict[int, Array]:
    """Samples of all channels that hold numbers.

    Parameters
    ----------
    source : OpenFile

    Returns
    -------
    dict of int to (n,) array
        By position in `OpenFile.channels`.
    """
    read = _readable(source, range(len(source.channels)), time.monotonic() + PATIENCE)
    return {k: values for k in sorted(read) if (values := read[k]) is not None}


def _readable(
    source: OpenFile, indices: Sequence[int], end: float, problems: dict[int, str] | None = None
) -> dict[int, Array | None]:
    """Samples of channels, None for what is no number; found by halving where one of several is.

    Every half costs a reading, in a table of text one of the whole file, so nothing is begun when
    the time is over. With `problems`, which takes what is wrong with which channel, a table of text
    is read on behind lines that are no rows.
    """
    if not indices or time.monotonic() > end:
        return {}
    try:
        if problems is None:
            return dict(zip(indices, source.read(list(indices)), strict=True))
        return dict(zip(indices, _read_on(source, indices), strict=True))
    except DataError as error:
        if len(indices) == 1:
            if problems is not None and _began_as_numbers(source, indices[0]):
                problems[indices[0]] = str(error)
            return {indices[0]: None}
    middle = len(indices) // 2
    first = _readable(source, indices[:middle], end, problems)
    return first | _readable(source, indices[middle:], end, problems)


def _read_on(source: OpenFile, indices: Sequence[int]) -> list[Array]:
    return source.read_on(indices) if isinstance(source, TextFile) else source.read(indices)


def _began_as_numbers(source: OpenFile, index: int) -> bool:
    return isinstance(source, TextFile) and not source.begins_with_text(index)


def broken_lines(source: OpenFile) -> tuple[str, ...]:
    """What is wrong with lines among the rows, in the order of the file; empty where none is.

    Parameters
    ----------
    source : OpenFile
    """
    return source.broken if isinstance(source, TextFile) else ()


def summed_up(channel: Channel, values: Array | None) -> ChannelSummary:
    """A channel that was read in numbers; `values` is None where it holds none."""
    if values is None:
        return ChannelSummary(channel, True, channel.samples)
    finite = values[np.isfinite(values)]
    missing = len(values) - len(finite)
    if not len(finite):
        return ChannelSummary(channel, True, len(values), missing)
    # a sum beyond any float is told as inf
    with warnings.catch_warnings(), np.errstate(over="ignore", invalid="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)
        mean, std = float(finite.mean()), float(finite.std())
    low, high = float(finite.min()), float(finite.max())
    return ChannelSummary(channel, True, len(values), missing, low, high, mean, std)


def clock_summaries(source: OpenFile) -> dict[str, ClockSummary]:
    """Sum up the time of every clock that the file knows or names.

    Parameters
    ----------
    source : OpenFile

    Returns
    -------
    dict of str to ClockSummary
        Without clocks whose time is unknown, not finite or not increasing.
    """
    found = {}
    for clock in dict.fromkeys(channel.clock for channel in source.channels):
        t = _instants(source, clock)
        if t is None or len(t) < 2 or not np.isfinite(t).all():
            continue
        steps = np.diff(t)
        if steps.min() > 0.0:
            found[clock] = ClockSummary(
                clock,
                len(t),
                float(t[0]),
                float(t[-1]),
                float(steps.min()),
                float(steps.max()),
                uniform_step(t),
            )
    return found


def _instants(source: OpenFile, clock: str) -> Array | None:
    """Give the time of a clock, or the one column of its channels that is called t or time [s]."""
    try:
        if clock:
            return source.instants(clock)
        named = time_channels(source)
        if len(named) != 1 or named[0].unit not in SECONDS:
            return None
        (values,) = _read_on(source, [source.channels.index(named[0])])
        if not named[0].unit and not named[0].dated:
            unit = serial_unit(values)
            if said := about_days(values, unit, named[0].header, source.path.name):
                warnings.warn(said, DataWarning, stacklevel=CALLER)
        return clock_seconds(named[0], values)
    except DataError:
        return None
