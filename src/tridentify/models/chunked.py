"""A record seen through a bank of operators, part by part: for records longer than memory.

The columns are those of `models.regression`, sample for sample, and so are the triangles: the
states of the filters are carried from one part of the record to the next, the rows of every part
are folded into the triangle of all before them, and nothing else is kept. What a part needs of its
neighbours are the inputs that reach it late, and the one sample after it, to which a first-order
hold leads. So neither the length of the record nor that of the parts shows in the result, but for
rounding.

Only uniform time, and inputs that are held or joined by straight lines: a band-limited input asks
for its future.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from tridentify.models.columns import drift_columns
from tridentify.models.regression import LONG_BLOCK, NEGLIGIBLE, Experiment, Layout, Regression
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import Whitener
from tridentify.numerics.least_squares import Accumulator
from tridentify.numerics.realization import Cascade
from tridentify.numerics.sampled import Sampled, States, split_delay

Parts = Iterator[tuple[Array, Array]]
"""Inputs ``(n, n_inputs)`` and outputs ``(n, n_outputs)`` of one part after another."""

REMEMBERED = 4
"""Banks whose triangles are kept: that of a point, of the one before it, and of two seeds."""


class Supply(Protocol):
    """Where the parts of a record come from, as often as they are asked for."""

    def parts(self) -> Parts:
        """All parts, from the first sample to the last."""


@dataclass(frozen=True, eq=False)
class ChunkedExperiment(Experiment):
    """A record that is read part by part whenever a triangle of it is wanted.

    ``u`` and ``y`` are its first samples alone; there are two at least.

    Attributes
    ----------
    samples : int
        How many the record has.
    supply : Supply
    shift : (n_inputs,) array
        Subtracted from the inputs as they are supplied.
    gappy : tuple of bool
        For each output, whether samples of it are missing.
    known : dict
        Triangles that were made, by the bank; shared by what `dataclasses.replace` makes of it.
    """

    samples: int = 0
    supply: Supply | None = None
    shift: Array = field(default_factory=lambda: np.zeros(0))
    gappy: tuple[bool, ...] = ()
    known: dict[bytes, Regression] = field(default_factory=dict)

    @property
    def n_samples(self) -> int:
        """Number of samples."""
        return self.samples

    @property
    def at_hand(self) -> bool:
        """Whether its samples are there: they are read when they are wanted."""
        return False

    def reduced(self, bank: Cascade) -> Regression | None:
        """The triangle on a bank, from one reading of the record; the last few are remembered."""
        key = b"".join([bank.poles.tobytes(), *(a.tobytes() + b"|" for a in self.noise)])
        if key not in self.known:
            while len(self.known) >= REMEMBERED:
                self.known.pop(next(iter(self.known)))
            self.known[key] = _reduced(self, bank)
        return self.known[key]


def _reduced(experiment: ChunkedExperiment, bank: Cascade) -> Regression:
    layout = Layout(
        bank.order, experiment.u.shape[1], experiment.free, experiment.offset, experiment.drift
    )
    sweeps = [_Sweep(experiment, bank, layout, outputs) for outputs in _alike(experiment)]
    before = max(one.before for one in sweeps)
    for start, u, y in extended(experiment, before):
        for one in sweeps:
            one.take(start, u, before, y)
    found = {i: part for one in sweeps for i, part in one.triangles().items()}
    signals, targets, counts, scales = zip(*(found[i] for i in sorted(found)), strict=True)
    own = scales if experiment.is_coloured else ()
    return Regression(layout, signals, targets, counts, own, experiment.leads)


def _alike(experiment: ChunkedExperiment) -> list[list[int]]:
    """Outputs in groups with the same delays, whose columns are the same."""
    groups: dict[tuple[float, ...], list[int]] = {}
    for i in range(experiment.y.shape[1]):
        own = () if experiment.delays is None else tuple(experiment.delays[i].tolist())
        groups.setdefault(own, []).append(i)
    return list(groups.values())


def extended(experiment: ChunkedExperiment, before: int) -> Iterator[tuple[int, Array, Array]]:
    """Each part with the inputs that lie before it (zeros before the record) and one after it.

    Gives its first sample, the inputs less the shift, and the outputs, ``nan`` where they do not
    count.
    """
    assert experiment.supply is not None
    shift = experiment.shift if experiment.shift.size else 0.0
    past = np.zeros((before, experiment.u.shape[1]))
    held: tuple[Array, Array] | None = None
    start = 0
    for u, y in experiment.supply.parts():
        moved = np.asarray(u - shift)
        if held is not None:
            yield start, np.vstack([past, held[0], moved[:1]]), held[1]
            past = np.vstack([past, held[0]])[held[0].shape[0] :]
            start += held[0].shape[0]
        held = moved, _from(y, experiment.start - start)
    if held is not None:
        yield start, np.vstack([past, held[0]]), held[1]


def _from(y: Array, begin: int) -> Array:
    """Outputs without those before a sample."""
    if begin <= 0:
        return y
    kept = np.array(y)
    kept[:begin] = np.nan
    return kept


class _Sweep:
    """Columns of outputs with the same delays, and their triangles."""

    def __init__(
        self, experiment: ChunkedExperiment, bank: Cascade, layout: Layout, outputs: Sequence[int]
    ) -> None:
        self._experiment, self._layout, self._outputs = experiment, layout, list(outputs)
        delays = () if experiment.delays is None else tuple(experiment.delays[outputs[0]].tolist())
        delays = delays if any(delays) else ()
        self._signal = Sampled(experiment.u, experiment.dt, experiment.intersample, None, delays)
        upper = int(np.any(bank.poles.imag != 0))
        self._states = States(self._signal, bank.a, bank.b, upper=upper)
        self._impulse = self._states.impulse(experiment.start)
        self._least, self._first = NEGLIGIBLE * np.abs(bank.b).max(), 0
        self.before = 1 + max(split_delay(delay, experiment.dt)[0] for delay in (*delays, 0.0))
        self._columns = np.zeros((layout.n_signals, LONG_BLOCK))
        self._folds = [_Fold(experiment, layout, own) for own in self._together()]

    def _together(self) -> list[list[int]]:
        """Outputs that one triangle serves: those without gaps, while the noise is white."""
        gappy = self._experiment.gappy
        if self._experiment.is_coloured:
            return [[i] for i in self._outputs]
        whole = [i for i in self._outputs if not gappy[i]]
        return [*([whole] if whole else []), *([i] for i in self._outputs if gappy[i])]

    def take(self, start: int, u: Array, before: int, y: Array) -> None:
        """Fold a part in: its inputs with what lies before and after it, and its outputs."""
        count = y.shape[0]
        self._states.go_on(u, start, before, count)
        direct = late_inputs(self._signal, u, start, before, count)
        for begin in range(0, count, LONG_BLOCK):
            stop = min(begin + LONG_BLOCK, count)
            first = self._fill(start + begin, start + stop, direct[begin:stop])
            for fold in self._folds:
                fold.take(self._columns, y[begin:stop], first)

    def _fill(self, start: int, stop: int, direct: Array) -> int:
        """Columns of a block; gives the first that is not zero from here on."""
        layout, buffer, count = self._layout, self._columns, stop - start
        q, first = layout.order, self._first
        if layout.free and first == 0:
            self._impulse.advance(start, stop, buffer[:q])
            if np.abs(self._impulse.state).max() < self._least:
                self._first = q
        elif layout.free:
            buffer[:q] = 0.0
        self._states.advance(start, stop, buffer[q if layout.free else 0 :])
        row = layout.states
        buffer[row : row + layout.n_inputs, :count] = direct.T
        row += layout.n_inputs
        if layout.offset:
            buffer[row, :count] = 1.0
            row += 1
        place = np.arange(start, stop) / (self._experiment.n_samples - 1)
        buffer[row : row + layout.drift, :count] = drift_columns(place, layout.drift)
        return first

    def triangles(self) -> dict[int, tuple[Array, Array, int, float]]:
        """For each output: signals, target, samples, log of the scale."""
        return {i: part for fold in self._folds for i, part in fold.triangles().items()}


class _Fold:
    """The triangle of outputs that have the same samples, or of one."""

    def __init__(
        self, experiment: ChunkedExperiment, layout: Layout, outputs: Sequence[int]
    ) -> None:
        self._n, self._outputs = layout.n_signals, list(outputs)
        self._accumulator = Accumulator(self._n + len(outputs), LONG_BLOCK)
        self._whitener: Whitener | None = None
        if experiment.is_coloured:
            self._whitener = Whitener(experiment.noise[outputs[0]], self._n + 1)
            self._rows = np.zeros((self._n + 1, LONG_BLOCK))
        self._count = 0

    def take(self, columns: Array, y: Array, first: int) -> None:
        """Fold one block in."""
        count, n, buffer = y.shape[0], self._n, self._accumulator.buffer
        own = y[:, self._outputs]
        seen = ~np.isnan(own[:, 0])
        samples = int(seen.sum())
        self._count += samples
        values = own if samples == count else np.where(seen[:, None], own, 0.0)
        if self._whitener is not None:
            self._rows[:n, :count] = columns[:, :count]
            self._rows[n, :count] = values[:, 0]
            self._whitener.apply(self._rows, seen, buffer)
        else:
            buffer[first:n, :count] = columns[first:, :count]
            buffer[n:, :count] = values.T
            if samples < count:
                buffer[first:, :count] *= seen
        self._accumulator.absorb(count, first)

    def triangles(self) -> dict[int, tuple[Array, Array, int, float]]:
        """For each output: signals, target, samples, log of the scale."""
        r, n = self._accumulator.r, self._n
        scale = 0.0 if self._whitener is None else self._whitener.log_scale
        s = r[:, :n]
        return {i: (s, r[:, n + k], self._count, scale) for k, i in enumerate(self._outputs)}


def late_inputs(signal: Sampled, u: Array, origin: int, before: int, count: int) -> Array:
    """(count, n_channels) the delayed inputs themselves at the samples of a part.

    Parameters
    ----------
    signal : Sampled
        On uniform time, held or joined by straight lines.
    u : (n, n_channels) array
        As `extended` gives them.
    origin, before, count : int
        First sample of the part, samples of ``u`` before it, and its length.
    """
    found = np.empty((count, u.shape[1]))
    for delay, channels in signal.groups:
        own = u[:, list(channels)]
        whole, part = split_delay(delay, signal.dt)
        now = own[before - whole : before - whole + count]
        if part:
            earlier = own[before - whole - 1 : before - whole - 1 + count]
            if signal.intersample == "zoh":
                now = earlier
            else:
                now = (1.0 - part) * now + part * earlier
                now[: max(whole + 1 - origin, 0)] = 0.0  # nothing has arrived yet
        found[:, list(channels)] = now
    return found
