"""One experiment that is longer than memory: where its samples are, not the samples themselves.

A `LongRecord` is what `Record` is, without the arrays. It gives its samples part by part, as often
as they are asked for, and any stretch of them as a `Record`. Time is uniform.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NoReturn

import numpy as np

from tridentify.errors import (
    EmptyChannelError,
    EmptyRangeError,
    NonUniformTimeError,
    OptionError,
    SamplingError,
    TimeNotIncreasingError,
    TooFewSamplesError,
    TridentifyError,
    UnsupportedError,
    shown,
)
from tridentify.numerics.arrays import Array
from tridentify.record.checks.samples import Intersample
from tridentify.record.checks.times import TIME_TOLERANCE
from tridentify.record.formats.assemble import Wanted, find_channel, record_from
from tridentify.record.formats.channels import SECONDS
from tridentify.record.formats.parts import Part, PartedFile, damaged, open_parts
from tridentify.record.formats.time.clock import time_channels
from tridentify.record.formats.time_names import epoch_unit, unit_in_name
from tridentify.record.record import Record
from tridentify.writing.layout import printable

CHUNK = 1 << 18
"""Samples of a part: 2 MB a channel, so that a dozen of parts and the columns of a block stay far
below 100 MB; and long enough that reading one costs no more than its bytes."""

STRETCH = 50_000
"""Samples of the stretch that the ordinary search sees: as many as it takes for a long record, and
some seconds of its time."""

UNEVEN = 0.25
"""Departure of one step of time from the usual one, as a share of it, that is told as a gap:
between the scatter of time stamps and a row that is missing."""

HEAD = 1_000
"""Samples from which names and units are read first."""

Told = Callable[[int], None]
"""Is told how many samples of a reading are done."""


@dataclass(frozen=True, eq=False)
class LongRecord:
    """One experiment whose samples stay in their file; made by `open_record`.

    Attributes
    ----------
    source : PartedFile
        The file.
    wanted : Wanted
        Which of its channels.
    head : Record
        The first samples: names, units and where time begins.
    dt : float
        Uniform sampling interval [s].
    chunk : int
        Samples that are read at once.
    stretch : int
        Samples of the stretch that is searched and judged as a whole.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = Path(folder.name) / "run.npy"
    >>> np.save(path, np.column_stack([np.arange(600.0), np.arange(600.0) ** 2]))
    >>> record = open_record(path, inputs=["x[0]"], outputs=["x[1]"], dt=0.5)
    >>> record.n_samples, record.part(2, 4).y.ravel().tolist()
    (600, [4.0, 9.0])
    >>> folder.cleanup()
    """

    source: PartedFile
    wanted: Wanted
    head: Record
    dt: float
    chunk: int = CHUNK
    stretch: int = STRETCH
    _columns: tuple[tuple[int, ...], tuple[int, ...]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        places = [
            tuple(self.source.channels.index(find_channel(self.source, name)) for name in names)
            for names in (self.wanted.inputs, self.wanted.outputs)
        ]
        object.__setattr__(self, "_columns", (places[0], places[1]))

    @property
    def n_samples(self) -> int:
        """Number of samples."""
        return self.source.n_samples

    @property
    def duration(self) -> float:
        """Length [s]."""
        return (self.n_samples - 1) * self.dt

    @property
    def t0(self) -> float:
        """Time of the first sample [s]."""
        return float(self.head.t[0])

    @property
    def input_names(self) -> tuple[str, ...]:
        """One a channel."""
        return self.head.input_names

    @property
    def output_names(self) -> tuple[str, ...]:
        """One a channel."""
        return self.head.output_names

    @property
    def name(self) -> str:
        """Of the file."""
        return self.head.name

    @property
    def intersample(self) -> Intersample:
        """What the input does between samples, as stated."""
        return self.head.intersample

    def __repr__(self) -> str:
        ins, outs = ", ".join(self.input_names), ", ".join(self.output_names)
        return (
            f"LongRecord({self.name!r}, {self.n_samples} samples, {self.duration:g} s, "
            f"dt={self.dt:g} s, {self.intersample}, inputs: {ins}, outputs: {outs})"
        )

    def __iter__(self) -> NoReturn:
        """Nobody takes it for a list of records.

        Raises
        ------
        UnsupportedError
            Always.
        """
        raise UnsupportedError(
            f"found a LongRecord of {self.n_samples} samples; expected samples in memory for "
            "anything but identify; give a stretch: record.part(0, 100000)"
        )

    def part(self, start: int, stop: int) -> Record:
        """Samples ``start`` to ``stop - 1`` in memory, at their times.

        Raises
        ------
        EmptyRangeError
            There are fewer than two samples there.
        OptionError
            A limit is no whole number.
        DataError
            As `Record`.
        """
        for limit in (start, stop):
            if not isinstance(limit, (int, np.integer)):
                raise OptionError(
                    f"found {shown(limit)} as the number of a sample; expected a whole number; "
                    "time t [s] is at sample round((t - record.t0) / record.dt)"
                )
        start, stop = max(start, 0), min(stop, self.n_samples)
        if stop - start < 2:
            raise EmptyRangeError(
                f"found samples {start} to {stop - 1} of {self.n_samples} asked for; expected at "
                "least two; name a stretch of the record"
            )
        made = record_from(Part(self.source, start, stop), self.wanted, self.name)
        t = self.t0 + self.dt * np.arange(start, stop)
        return made._derive(dt=self.dt, t=t)

    def parts(self, told: Told | None = None) -> Iterator[tuple[Array, Array]]:
        """Inputs and outputs of one part after another.

        Parameters
        ----------
        told : callable, optional
            Is told after each part how many samples have been read.

        Raises
        ------
        UnreadableFileError
            The file is damaged.
        """
        n = len(self._columns[0])
        for both in self.read((*self._columns[0], *self._columns[1]), told):
            yield np.ascontiguousarray(both[:, :n]), np.ascontiguousarray(both[:, n:])

    def outputs(self, start: int, stop: int) -> Array:
        """(stop - start, n_outputs) outputs alone of some samples."""
        return read_part(self.source, self._columns[1], start, stop)

    @property
    def columns(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Places of the inputs and of the outputs among the channels of the file."""
        return self._columns

    def read(self, columns: tuple[int, ...], told: Told | None = None) -> Iterator[Array]:
        """Some channels of one part after another, (n, n_channels) each."""
        for start in range(0, self.n_samples, self.chunk):
            stop = min(start + self.chunk, self.n_samples)
            yield read_part(self.source, columns, start, stop)
            if told is not None:
                told(stop)


def read_part(source: PartedFile, columns: Sequence[int], start: int, stop: int) -> Array:
    """Some columns of some rows.

    Raises
    ------
    UnreadableFileError
        The file is damaged there, or shorter than it says.
    """
    try:
        found = source.part(columns, start, stop)
    except TridentifyError:
        raise
    except MemoryError:
        raise
    except Exception as error:  # of the library that reads it, of whatever kind
        raise damaged(source.path, error) from error
    if found.shape[0] != stop - start:
        short = f"{found.shape[0]} of {stop - start} rows from row {start + 1} on"
        raise damaged(source.path, ValueError(short))
    return found


def open_record(
    path: str | os.PathLike[str],
    *,
    inputs: str | Sequence[str],
    outputs: str | Sequence[str],
    time: str | None = None,
    dt: float | None = None,
    intersample: Intersample = "auto",
    units: Mapping[str, str] | None = None,
    chunk: int = CHUNK,
    stretch: int = STRETCH,
) -> LongRecord:
    r"""Open one experiment that is too long to be read whole.

    Parameters
    ----------
    path : path-like
        Parquet, Feather, a NumPy array (``.npy``, whose columns are ``x[0]``, ``x[1]``, ...; of one
        dimension ``x``) or, where that library is installed, a Zarr store. One that is written in
        row groups of about a million rows is read fastest.
    inputs, outputs : str or sequence of str
        Names of the channels, as in `read_record`.
    time : str, optional
        Channel of time, in seconds unless its unit says otherwise, uniform to a thousandth of a
        step. Without it and without `dt` the one that is called ``t`` or ``time``.
    dt : float, optional
        Uniform sampling interval [s]; time then begins at zero and no channel of time is read.
    intersample : {"auto", "zoh", "foh"}
        What the input does between samples; with "auto" a stretch of the record decides.
    units : mapping of str to str, optional
        By channel name, before those of the file.
    chunk : int
        Samples that are read at once.
    stretch : int
        Samples of the stretch that is searched and judged as a whole.

    Returns
    -------
    LongRecord
        `identify` takes it in place of a `Record`.

    Raises
    ------
    UnreadableFileError, MissingDependencyError
        The file cannot be read in parts, is damaged, or its library is not installed.
    MissingColumnError, DuplicateColumnError, TextInColumnError
        A channel does not exist, occurs twice, or holds text.
    SamplingError, NonUniformTimeError, TimeNotIncreasingError
        Time is not stated, or not uniform.
    OptionError
        An option is none of those above.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> import numpy as np
    >>> from tridentify import open_record
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "run.npy")
    ...     np.save(path, np.column_stack([np.sin(np.arange(5000.0) ** 1.5), np.arange(5000.0)]))
    ...     open_record(path, inputs=["x[0]"], outputs=["x[1]"], dt=0.01)
    LongRecord('run', 5000 samples, 49.99 s, dt=0.01 s, auto, inputs: x[0], outputs: x[1])
    """
    _check_options(intersample, chunk, stretch)
    inputs, outputs = ((side,) if isinstance(side, str) else side for side in (inputs, outputs))
    source = open_parts(path)
    named = time
    if named is None and dt is None:
        named = _time_by_name(source, (*inputs, *outputs))
    wanted = Wanted(
        tuple(inputs), tuple(outputs), None if dt is not None else named, dt, intersample, units
    )
    if source.n_samples < 2:
        raise TooFewSamplesError.found(
            f"{source.n_samples} sample in ", source.path.name, "at least two", "record longer"
        )
    head = _head(source, wanted)
    step = float(dt) if dt is not None else _uniform_step(source, str(named), wanted, chunk)
    return LongRecord(source, replace(wanted, dt=dt), head, step, chunk, stretch)


def _check_options(intersample: object, chunk: object, stretch: object) -> None:
    if intersample == "band-limited":
        raise OptionError(
            "found intersample='band-limited'; expected 'auto', 'zoh' or 'foh' for a record that "
            "is read in parts, since a band-limited input asks for its future; state 'foh', or "
            "read a stretch with read_record"
        )
    for name, value in (("chunk", chunk), ("stretch", stretch)):
        if not isinstance(value, int) or isinstance(value, bool) or value < 2:
            raise OptionError(
                f"found {name}={shown(value)}; expected a whole number of samples, at least 2; "
                "leave it out or correct it"
            )


def _time_by_name(source: PartedFile, asked: Sequence[str]) -> str:
    found = time_channels(source)
    if len(found) > 1:
        found = [one for one in found if one.header not in asked and one.name not in asked]
    if len(found) != 1:
        listed = " and ".join(shown(one.header) for one in found) or "no column called t or time"
        raise SamplingError(
            f"found {listed} in {shown(source.path.name)}, and neither time nor dt; expected to "
            "know the sampling; name the column of time or give dt [s]"
        )
    return found[0].header


def _head(source: PartedFile, wanted: Wanted) -> Record:
    """The first samples; more of them where an output begins late."""
    count = HEAD
    while True:
        stop = min(count, source.n_samples)
        name = printable(Path(source.path).stem)
        try:
            return record_from(Part(source, 0, stop), wanted, name)
        except EmptyChannelError:
            if stop == source.n_samples or count > CHUNK:
                raise
        except TridentifyError:
            raise
        except Exception as error:  # of the library that reads the file
            raise damaged(source.path, error) from error
        count *= 16


def _uniform_step(source: PartedFile, time: str, wanted: Wanted, chunk: int) -> float:
    """The step of a recorded time, which must be uniform."""
    channel = find_channel(source, time)
    if channel.dated:
        raise SamplingError(
            f"found dates in column {shown(time)}; expected seconds in a record that is read in "
            "parts; give dt [s], or convert the column"
        )
    index, n = source.channels.index(channel), source.n_samples
    unit = {**{channel.header: channel.unit}, **(wanted.units or {})}.get(time, channel.unit)
    first, last = (float(read_part(source, [index], k, k + 1)[0, 0]) for k in (0, n - 1))
    unit = unit or unit_in_name(channel.name) or epoch_unit(np.array([first, last]))
    scale = SECONDS.get(unit, 1.0)
    step = (scale * last - scale * first) / (n - 1)
    if not step > 0:
        raise TimeNotIncreasingError(
            f"found time from {first:.9g} to {last:.9g} in column {shown(time)}; expected time "
            "that increases; sort the samples, or give dt [s]"
        )
    for start in range(0, n, chunk):
        stop = min(start + chunk, n)
        t = scale * read_part(source, [index], start, stop)[:, 0]
        off = np.abs(t - scale * first - step * np.arange(start, stop))
        if not np.all(off <= TIME_TOLERANCE * step):
            raise _uneven(source, index, scale, chunk)
    return float(step)


def _uneven(source: PartedFile, index: int, scale: float, chunk: int) -> NonUniformTimeError:
    """Where time first leaves the steps that it begins with.

    The mean step is no measure: one gap in the middle would have every row before it blamed.
    """
    n = source.n_samples
    begin = scale * read_part(source, [index], 0, min(n, HEAD))[:, 0]
    usual = float(np.median(np.diff(begin)))
    last = float(begin[0]) - usual
    for start in range(0, n, chunk):
        t = scale * read_part(source, [index], start, min(start + chunk, n))[:, 0]
        steps = np.diff(t, prepend=last)
        wrong = ~(np.abs(steps - usual) <= UNEVEN * abs(usual))
        if np.any(wrong):
            at = int(np.argmax(wrong))
            here = float(t[at])
            return NonUniformTimeError(
                f"found a step of time of {steps[at]:.6g} s at {source.place(start + at)} (to "
                f"{here:.9g} s), where the others are {usual:.6g} s; expected uniform time in a "
                "record that is read in parts; give dt [s] if only the time stamps are inexact, "
                "or cut the file where rows are missing"
            )
        last = float(t[-1])
    return NonUniformTimeError(
        f"found time that drifts or scatters about steps of {usual:.9g} s, with which it begins; "
        "expected uniform time in a record that is read in parts; give dt [s] if only "
        "its stamps are inexact"
    )
