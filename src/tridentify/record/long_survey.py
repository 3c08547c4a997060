"""What a look at all samples of a long record says, part by part, in two readings.

Whether an input moves and where the outputs move most, which samples are missing, the scale of the
outputs, the record averaged over blocks, and the fingerprint of its samples.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tridentify.errors import EmptyChannelError, shown
from tridentify.numerics.arrays import Array
from tridentify.record.checks.samples import check_inputs, check_outputs
from tridentify.record.long_record import LongRecord, Told
from tridentify.record.record import Record

COARSE = 20_000
"""Samples of the whole record averaged over blocks, for dynamics slower than a stretch shows."""


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


def survey(record: LongRecord, told: Told | None = None) -> Survey:
    """A look at all samples, once for the inputs and once for the outputs.

    Parameters
    ----------
    record : LongRecord
    told : callable, optional
        Is told after each part how many samples have been read.

    Raises
    ------
    NotFiniteError, EmptyChannelError
        As `Record`, with the number of the sample.
    """
    digest = hashlib.sha256(np.array([record.t0, record.dt]).tobytes())
    seen_in, seen_out = _Inputs(record), _Outputs(record)
    start = 0
    for u in record.read(record.columns[0], told):
        check_inputs(u, record.input_names, first=start)
        digest.update(np.ascontiguousarray(u))  # type: ignore[arg-type]
        seen_in.take(start, u)
        start += len(u)
    start = 0
    for y in record.read(record.columns[1], told):
        check_outputs(y, record.output_names, first=start, whole=False)
        digest.update(np.ascontiguousarray(y))  # type: ignore[arg-type]
        seen_out.take(start, y)
        start += len(y)
    return _survey(record, seen_in, seen_out, digest.hexdigest())


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
