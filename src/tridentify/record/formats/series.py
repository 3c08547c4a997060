"""All channels of a file over time, before it is known what each of them is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tridentify.errors import OptionError, SamplingError
from tridentify.numerics.arrays import Array
from tridentify.record.checks.times import check_increasing, uniform_step
from tridentify.record.formats.channels import SECONDS, Channel, OpenFile
from tridentify.record.formats.contents import Contents
from tridentify.record.formats.read import opened
from tridentify.record.formats.summary import ChannelSummary, read_numbers, summed_up
from tridentify.record.formats.time.clock import time_channels
from tridentify.record.formats.time.serial_days import clock_seconds


class Thinned(NamedTuple):
    """A series as a picture of limited width shows it.

    Attributes
    ----------
    t : (n,) array
        Instants [s]: of the samples, or of the middle of each column of the picture.
    minimum, maximum : (n,) array
        Of the samples in each column, nan where there is none.
    thinned : bool
        Whether several samples share a column.
    """

    t: Array
    minimum: Array
    maximum: Array
    thinned: bool


CLOCK_NAMES = frozenset({"t", "time", "timestamp"})
"""What logs call their own clock where they list it as a channel."""
SAME_INSTANT = 1e-6
"""Part of the record by which a clock may differ from the instants that were read from it."""


@dataclass(frozen=True, eq=False)
class Series:
    """One channel over time.

    Attributes
    ----------
    channel : Channel
    t : (n,) array
        Sampling instants [s], increasing.
    values : (n,) array
        Samples [channel unit]; nan where one is missing.
    """

    channel: Channel
    t: Array
    values: Array

    @property
    def dt(self) -> float | None:
        """The step [s] where it is the same throughout."""
        return uniform_step(self.t)

    @property
    def missing(self) -> int:
        """Number of samples that are not there."""
        return int(np.sum(~np.isfinite(self.values)))

    def summary(self) -> ChannelSummary:
        """Number of samples, how many are missing, their range, mean and standard deviation.

        Returns
        -------
        ChannelSummary

        Examples
        --------
        >>> one = Series(Channel("q", "q"), np.arange(3.0), np.array([1.0, np.nan, 3.0])).summary()
        >>> one.missing, one.minimum, one.mean, one.std
        (1, 1.0, 2.0, 1.0)
        """
        return summed_up(self.channel, self.values)

    def beyond(self, low: float = -np.inf, high: float = np.inf) -> list[tuple[float, float]]:
        """First and last instants of the stretches at or beyond limits.

        Parameters
        ----------
        low, high : float
            Limits [channel unit].

        Returns
        -------
        list of (float, float)
            [s], in the order of time; the same instant twice for a single sample.

        Examples
        --------
        >>> one = Series(Channel("q", "q"), np.arange(5.0), np.array([0.0, 2.0, 2.0, 1.0, 2.0]))
        >>> one.beyond(high=2.0)
        [(1.0, 2.0), (4.0, 4.0)]
        """
        outside = np.concatenate([[False], (self.values <= low) | (self.values >= high), [False]])
        changes = np.flatnonzero(outside[1:] != outside[:-1])
        first, last = self.t[changes[::2]], self.t[changes[1::2] - 1]
        return list(zip(first.tolist(), last.tolist(), strict=True))

    def thinned(self, start: float, stop: float, columns: int) -> Thinned:
        """The stretch from one instant to another in so many columns, least and largest of each.

        What is seen of a line that is drawn through all samples is the range it covers in every
        column of the picture, so nothing that would be seen is lost. With fewer samples than
        columns they are given as they are.

        Parameters
        ----------
        start, stop : float
            [s].
        columns : int
            At least one.

        Returns
        -------
        Thinned

        Raises
        ------
        OptionError
            There is no column.

        Examples
        --------
        >>> import numpy as np
        >>> t = np.arange(1000) * 0.01
        >>> one = Series(Channel("q", "q"), t, np.sin(t)).thinned(0.0, 9.99, 4)
        >>> one.maximum.round(2).tolist()
        [1.0, 0.6, 0.93, 1.0]
        """
        if columns < 1:
            raise OptionError(f"found {columns} columns; expected at least 1; widen the picture")
        first, last = np.searchsorted(self.t, [start, stop], side="left")
        last = int(np.searchsorted(self.t, stop, side="right"))
        t, values = self.t[first:last], self.values[first:last]
        if t.size <= columns:
            return Thinned(t, values, values, False)
        edges = np.linspace(start, stop, columns + 1)
        at = np.searchsorted(t, edges[:-1])
        filled = np.diff(np.append(at, t.size)) > 0
        low, high = np.full(columns, np.nan), np.full(columns, np.nan)
        # fmin and fmax pass over missing samples
        low[filled] = np.fmin.reduceat(values, at[filled])
        high[filled] = np.fmax.reduceat(values, at[filled])
        return Thinned(0.5 * (edges[1:] + edges[:-1]), low, high, True)


def read_series(path: Contents, *, dt: float | None = None) -> tuple[Series, ...]:
    r"""Read all channels of a file that hold numbers, each on the time of its own clock.

    Parameters
    ----------
    path : path-like, bytes, or file open for reading
        As for `read_record`.
    dt : float, optional
        Sampling interval [s] of channels whose time the file does not tell.

    Returns
    -------
    tuple of Series
        In the order of the file, without the channels of time themselves.

    Raises
    ------
    SamplingError
        The file says nothing of time, and `dt` is not given.
    TimeNotIncreasingError
        Runs stand below each other, or rows are not sorted.
    UnreadableFileError, EmptyFileError, MissingHeaderError, MissingDependencyError
        As for `read_record`.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "doublet.csv")
    ...     _ = path.write_text("t,elevator [rad],q\n0,0,0\n0.1,1,0.2\n0.2,1,0.5\n")
    ...     [(one.channel.name, one.values.tolist()) for one in read_series(path)]
    [('elevator', [0.0, 1.0, 1.0]), ('q', [0.0, 0.2, 0.5])]
    """
    with opened(path) as source:
        clocks = time_channels(source)
        numbers = read_numbers(source)
        found = []
        for k, values in numbers.items():
            channel = source.channels[k]
            if channel in clocks or len(values) < 2:
                continue
            t = _instants(source, channel, clocks, numbers, dt)
            if t is not None and len(t) == len(values) and not _is_clock(channel, t, values):
                found.append(Series(channel, t, values))
    if not found:
        raise SamplingError(
            "found no channel of numbers whose sampling instants are known; expected a column t or "
            "time, a clock in the file, or dt; name the column of time t, or give dt [s]"
        )
    return tuple(found)


def _is_clock(channel: Channel, t: Array, values: Array) -> bool:
    """Whether a channel with a clock is that clock itself, in whatever unit it counts."""
    name = channel.name.rpartition(".")[2].casefold()
    if not channel.clock or name not in CLOCK_NAMES:
        return False
    since, own = t - t[0], values - values[0]
    return bool(own[-1] > 0.0 and np.allclose(own / own[-1], since / since[-1], atol=SAME_INSTANT))


def _instants(
    source: OpenFile,
    channel: Channel,
    clocks: list[Channel],
    numbers: dict[int, Array],
    dt: float | None,
) -> Array | None:
    """Increasing instants [s] of a channel; None where nothing tells them."""
    t: Array | None
    if channel.clock:
        t = source.instants(channel.clock)
    elif len(clocks) == 1 and clocks[0].unit in SECONDS:
        t = clock_seconds(clocks[0], numbers[source.channels.index(clocks[0])])
    elif dt is not None:
        t = np.asarray(dt * np.arange(len(numbers[source.channels.index(channel)])))
    else:
        return None
    if t is None or not np.isfinite(t).all():
        return None
    check_increasing(t)
    return np.asarray(t)
