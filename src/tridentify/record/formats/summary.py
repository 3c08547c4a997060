"""What the channels of an open file hold, in a few numbers each: range, mean, missing samples."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tridentify.checks.samples import uniform_step
from tridentify.errors import DataError
from tridentify.numerics.arrays import Array
from tridentify.record.formats.assemble import time_channels
from tridentify.record.formats.channels import SECONDS, Channel, OpenFile

__all__ = ["ChannelSummary", "ClockSummary", "channel_summaries", "clock_summaries"]


@dataclass(frozen=True)
class ChannelSummary:
    """A channel in numbers; None where it holds no numbers or was not read.

    Attributes
    ----------
    channel : Channel
    samples, missing : int or None
    minimum, maximum, mean : float or None
        Of the samples that are finite.
    """

    channel: Channel
    samples: int | None = None
    missing: int | None = None
    minimum: float | None = None
    maximum: float | None = None
    mean: float | None = None


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
    read = _readable(source, range(len(source.channels)))
    return [_summed_up(channel, read.get(k)) for k, channel in enumerate(source.channels)]


def _readable(source: OpenFile, indices: Sequence[int]) -> dict[int, Array]:
    """Samples of the channels that hold numbers, found by halving where one of several does not."""
    try:
        return dict(zip(indices, source.read(list(indices)), strict=True)) if indices else {}
    except DataError:
        if len(indices) == 1:
            return {}
    middle = len(indices) // 2
    return _readable(source, indices[:middle]) | _readable(source, indices[middle:])


def _summed_up(channel: Channel, values: Array | None) -> ChannelSummary:
    if values is None:
        return ChannelSummary(channel, channel.samples)
    finite = values[np.isfinite(values)]
    missing = len(values) - len(finite)
    if not len(finite):
        return ChannelSummary(channel, len(values), missing)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a sum beyond any float is told as inf
        mean = float(finite.mean())
    return ChannelSummary(
        channel, len(values), missing, float(finite.min()), float(finite.max()), mean
    )


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
        time = _instants(source, clock)
        if time is None or len(time) < 2 or not np.isfinite(time).all():
            continue
        steps = np.diff(time)
        if steps.min() > 0.0:
            found[clock] = ClockSummary(
                clock,
                len(time),
                float(time[0]),
                float(time[-1]),
                float(steps.min()),
                float(steps.max()),
                uniform_step(time),
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
        return source.read([source.channels.index(named[0])])[0] * SECONDS[named[0].unit]
    except DataError:
        return None
