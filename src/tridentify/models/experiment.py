"""One record as the estimators see it, and what of it the filters are given."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from tridentify.models.columns import Regression, drift_columns
from tridentify.numerics.arrays import Array, Flags, Indices
from tridentify.numerics.autoregression import gains
from tridentify.numerics.interpolation import DEGREE
from tridentify.numerics.kept import cached_property, varied
from tridentify.numerics.realization import Cascade
from tridentify.numerics.sampled import Sampled

MIDDLING = 8_192
"""Samples up to which an experiment is filtered along time, column by column: the columns of a few
dozen states stay in the processor's near memory."""
OF_SAMPLES = frozenset({"moments", "instants", "ramp", "sampled", "runs", "is_coloured", "leads"})
"""What is the same whatever nuisance terms are estimated along (`Experiment.beside`)."""


@dataclass(frozen=True, eq=False)
class Experiment:
    """One record as the estimators see it.

    Attributes
    ----------
    u : (n_samples, n_inputs) array
        Input minus its reference, C-contiguous.
    y : (n_samples, n_outputs) array
        Output; ``nan`` marks a missing sample.
    dt : float
        Sampling interval [s]; where ``t`` is given, one of the shorter intervals.
    intersample : str
        ``"zoh"`` or ``"foh"``.
    free, offset : bool
        Whether a free initial state and a constant are estimated along.
    drift : int
        Degree of the polynomial in time that is: 0 for none, 1 for a slope.
    noise : tuple of (p_i,) arrays
        Autoregressive coefficients of each output's noise; the empty tuple where all are white.
    t : (n_samples,) array, optional
        Instants from zero [s], where they are not uniform.
    delays : (n_outputs, n_inputs) array, optional
        How late every input reaches every output [s].
    start : int
        The sample at which a free initial state begins to act; outputs before it are ``nan``.
    scale : (n_outputs,) array, optional
        Noise of each output over that of all experiments together: what the rows are divided by.
    """

    u: Array
    y: Array
    dt: float
    intersample: str
    free: bool
    offset: bool
    drift: int
    noise: tuple[Array, ...] = ()
    t: Array | None = None
    delays: Array | None = None
    start: int = 0
    scale: Array | None = None

    @property
    def n_samples(self) -> int:
        """Number of samples."""
        return int(self.u.shape[0])

    @property
    def at_hand(self) -> bool:
        """Whether its samples are there."""
        return True

    def beside(self, free: bool, offset: bool, drift: int) -> Experiment:
        """The same samples with other nuisance terms."""
        return varied(self, OF_SAMPLES, free=free, offset=offset, drift=drift)

    def reduced(self, bank: Cascade) -> Regression | None:
        """The triangle on a bank, where it is known without the samples."""
        return None

    @property
    def duration(self) -> float:
        """Length of the record [s]."""
        return (self.n_samples - 1) * self.dt if self.t is None else float(self.t[-1])

    @cached_property
    def moments(self) -> tuple[Array, Array, Array]:
        """(n_outputs,) samples, mean squares, and sums of squares about the mean."""
        y = self.y
        n = np.full(y.shape[1], float(self.n_samples))
        if np.isnan(y.sum()):
            n = np.maximum(np.isfinite(y).sum(axis=0), 1.0)
            y = np.where(np.isfinite(y), y, np.nansum(y, axis=0) / n)
        # centred on the first value, so that a large trim does not drown the movement
        moved = y - y[0]
        about = np.einsum("ij,ij->j", moved, moved) - moved.sum(axis=0) ** 2 / y.shape[0]
        return n, np.einsum("ij,ij->j", y, y) / y.shape[0], np.maximum(about, 0.0)

    @cached_property
    def instants(self) -> Array:
        """(n_samples,) from zero [s]."""
        if self.t is not None:
            return self.t
        return np.asarray(np.arange(self.n_samples) * self.dt, dtype=np.float64)

    def instant(self, sample: int) -> float:
        """When one sample was taken, from zero [s]."""
        return sample * self.dt if self.t is None else float(self.t[sample])

    @cached_property
    def drifts(self) -> Array:
        """(drift, n_samples) what the drift is made of."""
        return drift_columns(self.ramp, self.drift)

    @cached_property
    def ramp(self) -> Array:
        """(n_samples,) from 0 at the first sample to 1 at the last."""
        if self.t is None:
            return np.asarray(np.arange(self.n_samples) / (self.n_samples - 1))
        return np.asarray(self.t / self.t[-1])

    @cached_property
    def sampled(self) -> tuple[Sampled, ...]:
        """The inputs as each output sees them; the same object where the delays are the same."""
        n_outputs = int(self.y.shape[1])
        if self.delays is None or not np.any(self.delays):
            return (Sampled(self.u, self.dt, self.intersample, self.t),) * n_outputs
        known: dict[tuple[float, ...], Sampled] = {}
        found: list[Sampled] = []
        for row in self.delays:
            key = tuple(float(delay) for delay in row)
            if key not in known:
                known[key] = Sampled(self.u, self.dt, self.intersample, self.t, key)
            found.append(known[key])
        return tuple(found)

    @cached_property
    def runs(self) -> tuple[OutputRun, ...]:
        """Outputs in groups that one run over the samples serves."""
        seen = ~np.isnan(self.y)
        complete = bool(seen.all())
        groups: dict[object, list[int]] = {}
        for i, signal in enumerate(self.sampled):
            key: object = id(signal)
            if not self.is_coloured and not complete:
                key = (id(signal), seen[:, i].tobytes())
            if self.scale is not None:
                key = (key, float(self.scale[i]))
            groups.setdefault(key, []).append(i)
        found = []
        for outputs in groups.values():
            own = tuple(int(n) for n in seen[:, outputs].sum(axis=0))
            y = self.y if len(outputs) == self.y.shape[1] else self.y[:, outputs]
            y = y if complete else np.where(seen[:, outputs], y, 0.0)
            weight = None if min(own) == self.n_samples else seen[:, outputs[0]].astype(np.float64)
            if self.scale is not None:
                weight = seen[:, outputs[0]] / self.scale[outputs[0]]
            found.append(OutputRun(tuple(outputs), seen[:, outputs], own, y, weight))
        return tuple(found)

    @cached_property
    def charts(self) -> tuple[Chart, ...] | None:
        """What the filters in machine code are given; None where they do not serve.

        They do on uniform time, up to ``MIDDLING`` samples.
        """
        if not (self.t is None and self.at_hand and 2 <= self.n_samples <= MIDDLING):
            return None
        found = []
        for run in self.runs:
            if not self.is_coloured:
                found.append(self._chart(run, run.outputs, run.y, run.weight))
                continue
            for k, i in enumerate(run.outputs):
                found.append(self._chart(run, (i,), run.y[:, k : k + 1], None))
        return tuple(found)

    def _chart(
        self, run: OutputRun, outputs: tuple[int, ...], y: Array, weight: Array | None
    ) -> Chart:
        signal, n = self.sampled[outputs[0]], self.n_samples
        degree, acting = _acting(signal)
        known = [*signal.direct.T]
        known += [np.ones(n)] * self.offset + [*self.drifts]
        noise = self.noise[outputs[0]] if self.is_coloured else np.zeros(0)
        seen, log_scale = run.seen[:, run.outputs.index(outputs[0])], 0.0
        gain, scale = np.zeros((0, 1)), np.zeros(0)
        if noise.size:
            gain, scale, log_scale = gains(noise, seen)
        elif self.is_coloured and (self.scale is not None or not seen.all()):
            weight = seen / self.scale_of(outputs[0])
        given = (
            self.dt,
            degree,
            *acting,
            np.array(known).reshape(len(known), n),
            np.array(y.T, order="C"),
            np.zeros(0) if weight is None else weight,
            self.free,
            self.start,
        )
        colour = (np.array(noise, dtype=np.float64), np.array(seen), gain, scale)
        counts = tuple(run.counts[run.outputs.index(i)] for i in outputs)
        return Chart(outputs, counts, log_scale, given, colour if noise.size else None)

    def scale_of(self, output: int) -> float:
        """What the rows of an output are divided by."""
        return 1.0 if self.scale is None else float(self.scale[output])

    def standardised(self, series: Array) -> Array:
        """(n_samples, n_outputs) of the outputs, over the noise as the rows are."""
        return series if self.scale is None else series / self.scale

    @cached_property
    def is_coloured(self) -> bool:
        """Whether the noise of any output has a model."""
        return any(a.size for a in self.noise)

    @cached_property
    def leads(self) -> Array | None:
        """(n_outputs, n_inputs) how long before ``start`` each input begins to act [s]."""
        if self.delays is None and not self.start:
            return None
        delays = 0.0 if self.delays is None else self.delays
        begin = self.instant(self.start)
        return np.asarray(np.broadcast_to(begin - delays, (self.y.shape[1], self.u.shape[1])))


def _acting(signal: Sampled) -> tuple[int, tuple[Array, Indices, Array, Array]]:
    """What acts from sample to sample, as `compiled_regression.triangles_of` is given it."""
    n, inputs = signal.u.shape
    firsts, parts = np.zeros(inputs, dtype=np.int64), np.zeros(inputs)
    if signal.intersample == "band-limited":
        w, begun = np.zeros((inputs, DEGREE + 1, n)), np.zeros((inputs, DEGREE + 1))
        for j, (first, part, head, body) in enumerate(signal.pieces):
            firsts[j], parts[j], begun[j] = min(first, n), part, head
            own = body[:, : n - firsts[j]]
            w[j, :, first : first + own.shape[1]] = own
        return DEGREE, (w, firsts, parts, begun)
    w = np.zeros((inputs, 2, n))
    w[:, 0], w[:, 1, : n - 1] = signal.u.T, signal.u[1:].T
    groups = zip(signal.shifted, signal.groups, strict=True) if any(signal.delays) else ()
    for (first, part, own), (delay, channels) in groups:
        if delay:
            for column, j in enumerate(channels):
                w[j] = own[:-1, column], own[1:, column]
                firsts[j], parts[j] = min(first, n), part
    begun = np.array(signal.u[:2].T, order="C")
    return int(signal.intersample == "foh"), (w, firsts, parts, begun)


@dataclass(frozen=True, eq=False)
class OutputRun:
    """Outputs with the same delays and, where their noise is white, the same samples.

    Attributes
    ----------
    outputs : tuple of int
    seen : (n_samples, n) bool array
        Where each has a sample.
    counts : tuple of int
        How many samples each has.
    y : (n_samples, n) array
        The outputs, zero where missing.
    weight : (n_samples,) array, optional
        One where the first has a sample, else zero; None where all have all.
    """

    outputs: tuple[int, ...]
    seen: Flags
    counts: tuple[int, ...]
    y: Array
    weight: Array | None


class Chart(NamedTuple):
    """Outputs of an experiment, and what `compiled_regression.triangles_of` is given of it.

    ``log_scale`` as of `Regression`; ``given``: all arguments behind the banks; ``colour``: what
    `compiled_whitening.whitened_triangles` is given of a noise that is not white.
    """

    outputs: tuple[int, ...]
    counts: tuple[int, ...]
    log_scale: float
    given: tuple[Any, ...]
    colour: tuple[Any, ...] | None

    @property
    def without_outputs(self) -> tuple[Any, ...]:
        """The same for the columns themselves."""
        nothing = np.zeros((0, self.given[7].shape[1]))
        return (*self.given[:7], nothing, np.zeros(0), *self.given[9:])
