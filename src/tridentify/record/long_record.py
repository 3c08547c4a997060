"""One experiment that is longer than memory: where its samples are, not the samples themselves.

A `LongRecord` is what `Record` is, without the arrays. It gives its samples part by part, as often
as they are asked for, any stretch of them as a `Record`, and what a look at all of them says
(`LongRecord.survey`). Time is uniform.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tridentify.checks.samples import (
    TIME_TOLERANCE,
    Intersample,
    check_inputs,
    check_outputs,
)
from tridentify.errors import (
    EmptyChannelError,
    EmptyRangeError,
    NonUniformTimeError,
    OptionError,
    SamplingError,
    TimeNotIncreasingError,
    TooFewSamplesError,
    TridentifyError,
    shown,
)
from tridentify.numerics.arrays import Array
from tridentify.record.formats.assemble import Wanted, find_channel, record_from, time_channels
from tridentify.record.formats.channels import SECONDS
from tridentify.record.formats.parts import Part, PartedFile, damaged, open_parts
from tridentify.record.record import Record
from tridentify.writing.layout import printable

__all__ = ["LongRecord", "Survey", "open_record"]

CHUNK = 1 << 18
"""Samples of a part: 2 MB a channel, so that a dozen of parts and the columns of a block stay far
below 100 MB; and long enough that reading one costs no more than its bytes."""

STRETCH = 50_000
"""Samples of the stretch that the ordinary search sees: as many as it takes for a long record, and
some seconds of its time."""

COARSE = 20_000
"""Samples of the whole record averaged over blocks, for dynamics slower than a stretch shows."""

HEAD = 1_000
"""Samples from which names and units are read first."""

Told = Callable[[int], None]
"""Is told how many samples of a reading are done."""


@dataclass(frozen=True, eq=False)
class Survey:
    """What a look at all samples says.

    Attributes
    ----------
    first : (n_inputs,) array
        First sample of the inputs.
    still : tuple of bool
        For each input, whether it never changes.
    missing : (n_outputs,) int array
        Missing samples of each output.
    mean, power : (n_outputs,) array
        Means of the outputs, and their mean squares about them.
    size : (n_outputs,) array
        Mean squares of the outputs as recorded.
    liveliest : int
        First sample of the stretch where the outputs move most.
    begins_lively : bool
        Whether they move at the beginning at least half as much.
    coarse : Record or None
        The record averaged over blocks; None where a stretch is all of it.
    fingerprint : str
        As `Estimate.record_fingerprint`, of the same samples in memory.
    """

    first: Array
    still: tuple[bool, ...]
    missing: Array
    mean: Array
    power: Array
    size: Array
    liveliest: int
    begins_lively: bool
    coarse: Record | None
    fingerprint: str


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

    def part(self, start: int, stop: int) -> Record:
        """Samples ``start`` to ``stop - 1`` in memory, at their times.

        Raises
        ------
        EmptyRangeError
            There are fewer than two samples there.
        DataError
            As `Record`.
        """
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
        for both in self._read((*self._columns[0], *self._columns[1]), told):
            yield np.ascontiguousarray(both[:, :n]), np.ascontiguousarray(both[:, n:])

    def outputs(self, start: int, stop: int) -> Array:
        """(stop - start, n_outputs) outputs alone of some samples."""
        return read_part(self.source, self._columns[1], start, stop)

    def _read(self, columns: tuple[int, ...], told: Told | None) -> Iterator[Array]:
        for start in range(0, self.n_samples, self.chunk):
            stop = min(start + self.chunk, self.n_samples)
            yield read_part(self.source, columns, start, stop)
            if told is not None:
                told(stop)

    def survey(self, told: Told | None = None) -> Survey:
        """A look at all samples, once for the inputs and once for the outputs.

        Raises
        ------
        NotFiniteError, EmptyChannelError
            As `Record`, with the number of the sample.
        """
        digest = hashlib.sha256(np.array([self.t0, self.dt]).tobytes())
        seen_in, seen_out = _Inputs(self), _Outputs(self)
        start = 0
        for u in self._read(self._columns[0], told):
            check_inputs(u, self.input_names, first=start)
            digest.update(np.ascontiguousarray(u))  # type: ignore[arg-type]
            seen_in.take(start, u)
            start += len(u)
        start = 0
        for y in self._read(self._columns[1], told):
            check_outputs(y, self.output_names, first=start, whole=False)
            digest.update(np.ascontiguousarray(y))  # type: ignore[arg-type]
            seen_out.take(start, y)
            start += len(y)
        return _survey(self, seen_in, seen_out, digest.hexdigest())


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


class _Inputs:
    """Sums over the inputs: in blocks, and in stretches."""

    def __init__(self, record: LongRecord) -> None:
        self.block = -(-record.n_samples // COARSE)
        width = len(record.input_names)
        self.sums = np.zeros((record.n_samples // self.block, width))
        self.moves = _Movement(record, width)
        self.least, self.most = np.full(width, np.inf), np.full(width, -np.inf)
        self.first = np.zeros(width)

    def take(self, start: int, u: Array) -> None:
        if not start:
            self.first = u[0].copy()
        self.least = np.minimum(self.least, u.min(axis=0))
        self.most = np.maximum(self.most, u.max(axis=0))
        self.moves.take(start, u)
        place = np.arange(start, start + len(u)) // self.block
        kept = place < len(self.sums)
        for j in range(u.shape[1]):
            self.sums[:, j] += _binned(place[kept], u[kept, j], len(self.sums))


class _Outputs:
    """Sums over the outputs, and the samples at the edges of the blocks."""

    def __init__(self, record: LongRecord) -> None:
        self.block = -(-record.n_samples // COARSE)
        width = len(record.output_names)
        self.edges = np.zeros((record.n_samples // self.block, width))
        self.moves = _Movement(record, width)
        self.squares = np.zeros(width)

    def take(self, start: int, y: Array) -> None:
        self.moves.take(start, y)
        self.squares += np.nansum(y * y, axis=0)
        at = np.arange(-(-start // self.block), -(-(start + len(y)) // self.block))
        at = at[at < len(self.edges)]
        self.edges[at] = y[at * self.block - start]


class _Movement:
    """Sums and squares about the first value, stretch by stretch, of what is there."""

    def __init__(self, record: LongRecord, width: int) -> None:
        self._length = record.stretch
        count = -(-record.n_samples // record.stretch)
        self.first = np.full(width, np.nan)
        self.counts, self.sums, self.squares = np.zeros((3, count, width))

    def take(self, start: int, samples: Array) -> None:
        seen = np.isfinite(samples)
        for j in range(samples.shape[1]):
            own = samples[seen[:, j], j]
            if np.isnan(self.first[j]) and own.size:
                self.first[j] = own[0]
            moved = own - self.first[j]
            place = (start + np.flatnonzero(seen[:, j])) // self._length
            self.counts[:, j] += _binned(place, np.ones(own.size), len(self.counts))
            self.sums[:, j] += _binned(place, moved, len(self.sums))
            self.squares[:, j] += _binned(place, moved * moved, len(self.squares))

    @property
    def own(self) -> Array:
        """(n_stretches, n_channels) sums of squares about the mean of each stretch."""
        return np.asarray(
            np.maximum(self.squares - self.sums**2 / np.maximum(self.counts, 1.0), 0.0)
        )

    @property
    def mean(self) -> Array:
        """(n_channels,) of all that is there."""
        n = np.maximum(self.counts.sum(axis=0), 1.0)
        return np.asarray(self.first + self.sums.sum(axis=0) / n)

    @property
    def power(self) -> Array:
        """(n_channels,) mean square about the mean of all."""
        n = np.maximum(self.counts.sum(axis=0), 1.0)
        mean = self.sums.sum(axis=0) / n
        return np.asarray(np.maximum(self.squares.sum(axis=0) / n - mean**2, 0.0))


def _binned(place: NDArray[np.intp], values: Array, count: int) -> Array:
    """Sums of values by rising place."""
    if not place.size:
        return np.zeros(count)
    low = int(place[0])
    found = np.bincount(place - low, weights=values)
    return np.pad(found, (low, count - low - found.size))


AS_GOOD = 0.5
"""Movement of the beginning over that of the liveliest stretch from which the beginning is taken,
whose initial state may be known."""


def _survey(record: LongRecord, u: _Inputs, y: _Outputs, fingerprint: str) -> Survey:
    counts = y.moves.counts.sum(axis=0)
    empty = np.flatnonzero(counts == 0)
    if empty.size:
        raise EmptyChannelError(
            f"found nothing but nan in output {shown(record.output_names[int(empty[0])])}; "
            "expected at least one sample; leave the channel out"
        )
    power = y.moves.power
    full = record.n_samples // record.stretch
    moved = y.moves.own[: max(full, 1)] @ (1.0 / np.where(power > 0, power, 1.0))
    driven = np.all(u.moves.own[: max(full, 1)] > 0, axis=1)
    moved = np.where(driven, moved, 0.0)
    best = int(np.argmax(moved))
    return Survey(
        first=u.first,
        still=tuple((u.most == u.least).tolist()),
        missing=record.n_samples - counts.astype(np.int64),
        mean=y.moves.mean,
        power=power,
        size=y.squares / record.n_samples,
        liveliest=best * record.stretch,
        begins_lively=bool(moved[0] >= AS_GOOD * moved[best]),
        coarse=_coarse(record, u, y) if record.n_samples > record.stretch else None,
        fingerprint=fingerprint,
    )


def _coarse(record: LongRecord, u: _Inputs, y: _Outputs) -> Record | None:
    """Block means of the inputs and the outputs at the edges."""
    if len(u.sums) < 2 or np.isnan(y.edges).all(axis=0).any():
        return None
    coarse = Record(
        u.sums / u.block,
        y.edges,
        dt=record.dt * u.block,
        input_names=record.input_names,
        output_names=record.output_names,
        units=record.head.units,
        name=record.name,
    )
    return coarse._derive(t=record.t0 + coarse.t)


def open_record(
    path: str | os.PathLike[str],
    *,
    inputs: Sequence[str],
    outputs: Sequence[str],
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
    inputs, outputs : sequence of str
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
    source = open_parts(path)
    named = time
    if named is None and dt is None:
        named = _time_by_name(source)
    wanted = Wanted(
        tuple(inputs), tuple(outputs), None if dt is not None else named, dt, intersample, units
    )
    if source.n_samples < 2:
        raise TooFewSamplesError(
            f"found {source.n_samples} sample in {shown(source.path.name)}; expected at least two; "
            "record longer"
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


def _time_by_name(source: PartedFile) -> str:
    found = time_channels(source)
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
    scale = SECONDS.get(unit, 1.0)
    first, last = (float(read_part(source, [index], k, k + 1)[0, 0]) for k in (0, n - 1))
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
            row = int(np.argmin(off <= TIME_TOLERANCE * step))
            raise NonUniformTimeError(
                f"found time {t[row]:.9g} s at {source.place(start + row)}, where uniform steps of "
                f"{step:.6g} s lead to {scale * first + step * (start + row):.9g} s; expected "
                "uniform time in a record that is read in parts; give dt [s] if only the time "
                "stamps are inexact, or cut the file where rows are missing"
            )
    return float(step)
