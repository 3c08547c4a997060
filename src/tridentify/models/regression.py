"""A record seen through a bank of operators: all that the three models need, in one triangle.

For one experiment and one orthonormal cascade (`numerics.realization`) the columns are

    [ impulse states | input states, channel by channel | inputs | 1 | (t - t0) / T | outputs ]

where the impulse states are the cascade's response to ``delta(t - t0)``: a record that does not
start at rest has the free response ``c(p) / a(p) delta``, so an unknown initial state is one
more input channel whose signal is known, and needs no treatment of its own. All columns are
exact for the stated intersample behaviour. The samples are read once, block by block, into the
triangle of a QR factorisation; each model then solves its least-squares problem with
combinations of the triangle's columns.

A missing output sample is a row of zeros for that output.

Time need not be uniform, and every input may reach every output late (`numerics.sampled`): the
columns of an output are those of its own delays. What the input did before its first sample is
unknown. Where the start is one of rest or equilibrium it was at its reference, that is at zero. A
free initial state stands for any past, but only from the moment on when the last of the delayed
inputs has arrived: the impulse states begin at that sample (`Experiment.start`), and output samples
before it are not used (`likelihood.nuisance`), since no known input explains them.

Where the noise of an output is coloured, all columns are turned into their innovations
(`numerics.autoregression`) before they enter that output's triangle: ordinary least squares on
them is generalised least squares on the samples, missing ones included. Combinations of columns
stay what they are, so nothing that works on the triangle has to know.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import Whitener
from tridentify.numerics.least_squares import Accumulator
from tridentify.numerics.realization import Cascade
from tridentify.numerics.sampled import Sampled, States

BLOCK = 1024
LONG_BLOCK = 4096
LONG = 5_000
NEGLIGIBLE = 1e-30


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
    free, offset, drift : bool
        Which nuisance terms are estimated along.
    noise : tuple of (p_i,) arrays
        Autoregressive coefficients of each output's noise; the empty tuple where all are white.
    t : (n_samples,) array, optional
        Instants from zero [s], where they are not uniform.
    delays : (n_outputs, n_inputs) array, optional
        How late every input reaches every output [s].
    start : int
        The sample at which a free initial state begins to act; outputs before it are ``nan``.
    """

    u: Array
    y: Array
    dt: float
    intersample: str
    free: bool
    offset: bool
    drift: bool
    noise: tuple[Array, ...] = ()
    t: Array | None = None
    delays: Array | None = None
    start: int = 0

    @property
    def n_samples(self) -> int:
        """Number of samples."""
        return int(self.u.shape[0])

    def reduced(self, bank: Cascade) -> Regression | None:
        """The triangle on a bank, where it is known without the samples."""
        return None

    @property
    def duration(self) -> float:
        """Length of the record [s]."""
        return (self.n_samples - 1) * self.dt if self.t is None else float(self.t[-1])

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
            groups.setdefault(key, []).append(i)
        found = []
        for outputs in groups.values():
            own = tuple(int(n) for n in seen[:, outputs].sum(axis=0))
            y = self.y if len(outputs) == self.y.shape[1] else self.y[:, outputs]
            y = y if complete else np.where(seen[:, outputs], y, 0.0)
            weight = None if min(own) == self.n_samples else seen[:, outputs[0]].astype(np.float64)
            found.append(OutputRun(tuple(outputs), seen[:, outputs], own, y, weight))
        return tuple(found)

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
    seen: NDArray[np.bool_]
    counts: tuple[int, ...]
    y: Array
    weight: Array | None


@dataclass(frozen=True)
class Layout:
    """Where things stand among the columns of a triangle."""

    order: int
    n_inputs: int
    free: bool
    offset: bool
    drift: bool

    @property
    def states(self) -> int:
        """Number of impulse and input states."""
        return self.order * (self.n_inputs + self.free)

    @property
    def n_signals(self) -> int:
        """Columns before the outputs."""
        return self.states + self.n_inputs + self.offset + self.drift

    def input_states(self, j: int) -> slice:
        """Columns of the states driven by input ``j``."""
        first = self.order * (j + self.free)
        return slice(first, first + self.order)

    def direct(self, j: int) -> int:
        """Column of input ``j`` itself."""
        return self.states + j

    @property
    def nuisance(self) -> slice:
        """Columns of the constant and the ramp."""
        return slice(self.states + self.n_inputs, self.n_signals)


@dataclass(frozen=True, eq=False)
class Regression:
    """The triangle of one experiment on one bank.

    Attributes
    ----------
    layout : Layout
    signals : tuple of (r, n_signals) arrays
        One per output (the same array when all outputs have the same samples).
    targets : tuple of (r,) arrays
        The outputs in the same coordinates.
    counts : tuple of int
        Output samples used.
    log_scale : tuple of float
        Per output the log determinant of the noise's covariance, for innovations of variance
        one; empty where all are white.
    leads : (n_outputs, n_inputs) array, optional
        How long before the impulse each input begins to act [s]; None where it never does.
    """

    layout: Layout
    signals: tuple[Array, ...]
    targets: tuple[Array, ...]
    counts: tuple[int, ...]
    log_scale: tuple[float, ...] = ()
    leads: Array | None = None

    def input_signal(self, output: int, channel: int, row: Array, direct: float = 0.0) -> Array:
        """``(row X + direct) u_channel`` of ``output``; ``row`` (q,) or (q, k)."""
        s = self.signals[output]
        value = s[:, self.layout.input_states(channel)] @ row
        if direct:
            value = value + direct * s[:, self.layout.direct(channel)]
        return np.asarray(value)

    def impulse_signal(self, output: int, row: Array) -> Array:
        """``row X delta`` in the coordinates of ``output``; ``row`` (q,) or (q, k)."""
        return np.asarray(self.signals[output][:, : self.layout.order] @ row)

    def nuisance_signals(self, output: int) -> Array:
        """The constant and the ramp (r, 0 to 2)."""
        return self.signals[output][:, self.layout.nuisance]


def restricted(
    regression: Regression,
    bank: Cascade,
    *,
    free: bool,
    offset: bool,
    drift: bool,
    constants: Array | None = None,
) -> Regression:
    """The triangle with fewer nuisance columns, and constants put back on the inputs.

    Parameters
    ----------
    regression : Regression
        With at least the nuisance columns that are kept.
    bank : Cascade
        The bank it was made on.
    free, offset, drift : bool
        Which to keep.
    constants : (n_inputs,) array, optional
        Added to the inputs. The states' response to a constant that began to act a time ``s``
        before the impulse is ``A^{-1} (e^{A s} x_impulse(t) - B)``, so this needs the impulse
        states and the constant among the columns.

    Returns
    -------
    Regression
    """
    old = regression.layout
    if constants is not None and np.any(constants) and not (old.free and old.offset):
        raise ValueError("constants need the impulse states and the constant among the columns")
    new = Layout(old.order, old.n_inputs, free, offset, drift)
    q = old.order
    index = list(range(0 if free else q * old.free, old.states + old.n_inputs))
    at = old.nuisance.start
    if old.offset:
        index += [at] if offset else []
        at += 1
    if old.drift and drift:
        index.append(at)
    done: dict[int, Array] = {}
    signals = []
    for i, s in enumerate(regression.signals):
        if id(s) not in done:
            kept = s[:, index]
            if constants is not None and np.any(constants):
                one = s[:, old.nuisance.start]
                for j, value in enumerate(constants):
                    lead = 0.0 if regression.leads is None else float(regression.leads[i, j])
                    kept[:, new.input_states(j)] += value * _held(bank, s[:, :q], one, lead)
                    kept[:, new.direct(j)] += value * one
            done[id(s)] = kept
        signals.append(done[id(s)])
    return replace(regression, layout=new, signals=tuple(signals))


def _held(bank: Cascade, impulse: Array, one: Array, lead: float) -> Array:
    """States' response to a constant that began to act ``lead`` seconds before the impulse."""
    if lead:
        impulse = impulse @ scipy.linalg.expm(bank.a * lead).T
    return np.asarray(np.linalg.solve(bank.a, (impulse - np.outer(one, bank.b)).T).T)


def regress(experiment: Experiment, bank: Cascade) -> Regression:
    """Filter one experiment through a bank and reduce it to a triangle.

    Parameters
    ----------
    experiment : Experiment
    bank : Cascade
        Orthonormal cascade with q states.

    Returns
    -------
    Regression

    Notes
    -----
    Time ``O(n_samples)``; memory one block of at most ``LONG_BLOCK`` samples.
    """
    known = experiment.reduced(bank)
    if known is not None:
        return known
    layout = _layout(experiment, bank)
    found: dict[int, tuple[Array, Array, int, float]] = {}
    for run in experiment.runs:
        if experiment.is_coloured:
            found.update(_whitened(experiment, bank, layout, run))
            continue
        r = _triangle(experiment, bank, layout, run)
        s = r[:, : layout.n_signals]
        for k, i in enumerate(run.outputs):
            found[i] = (s, r[:, layout.n_signals + k], run.counts[k], 0.0)
    signals, targets, counts, scales = zip(*(found[i] for i in sorted(found)), strict=True)
    return Regression(
        layout,
        signals,
        targets,
        counts,
        scales if experiment.is_coloured else (),
        experiment.leads,
    )


def response_of(
    experiment: Experiment,
    bank: Cascade,
    rows: Array,
    most: int | None = None,
    outputs: Sequence[int] | None = None,
) -> Array:
    """Combinations of the columns over time.

    Parameters
    ----------
    experiment : Experiment
    bank : Cascade
    rows : (k, n_signals) array
        Weights of the columns before the outputs.
    most : int, optional
        Only so many samples.
    outputs : sequence of int, optional
        Whose columns each row combines, which matters where the outputs have delays of their own
        (default: row ``k`` those of output ``k``).

    Returns
    -------
    (n_samples, k) array
    """
    layout = _layout(experiment, bank)
    buffer = np.zeros((layout.n_signals, _block(experiment)))
    count = experiment.n_samples if most is None else min(most, experiment.n_samples)
    found = np.empty((count, rows.shape[0]))
    sampled = experiment.sampled
    last = len(sampled) - 1
    owners = [min(k, last) for k in range(rows.shape[0])] if outputs is None else list(outputs)
    for signal in dict.fromkeys(sampled[i] for i in owners):
        mine = [k for k, i in enumerate(owners) if sampled[i] is signal]
        for start, stop, _ in _signals(experiment, bank, layout, buffer, sampled.index(signal)):
            if start >= count:
                break
            stop = min(stop, count)
            found[start:stop, mine] = (rows[mine] @ buffer[:, : stop - start]).T
    return found


def _layout(experiment: Experiment, bank: Cascade) -> Layout:
    return Layout(
        bank.order, experiment.u.shape[1], experiment.free, experiment.offset, experiment.drift
    )


def _block(experiment: Experiment) -> int:
    """Samples taken at a time."""
    n = experiment.n_samples
    return min(n, BLOCK if n <= LONG else LONG_BLOCK)


def _triangle(experiment: Experiment, bank: Cascade, layout: Layout, run: OutputRun) -> Array:
    """R factor of [states | inputs | nuisance | y], rows multiplied by the weight of the run."""
    n = layout.n_signals
    accumulator = Accumulator(n + len(run.outputs), _block(experiment))
    buffer = accumulator.buffer
    for start, stop, first in _signals(experiment, bank, layout, buffer, run.outputs[0]):
        count = stop - start
        buffer[n:, :count] = run.y[start:stop].T
        if run.weight is not None:
            buffer[first:, :count] *= run.weight[start:stop]
        accumulator.absorb(count, first)
    return accumulator.r


def _whitened(
    experiment: Experiment, bank: Cascade, layout: Layout, run: OutputRun
) -> dict[int, tuple[Array, Array, int, float]]:
    """A triangle for each output, of the innovations of all columns."""
    block = _block(experiment)
    n_columns = layout.n_signals + 1
    columns = np.zeros((n_columns, block))
    accumulators = [Accumulator(n_columns, block) for _ in run.outputs]
    whiteners = [Whitener(experiment.noise[i], n_columns) for i in run.outputs]
    for start, stop, first in _signals(experiment, bank, layout, columns, run.outputs[0]):
        count = stop - start
        for k, (accumulator, whitener) in enumerate(zip(accumulators, whiteners, strict=True)):
            columns[-1, :count] = run.y[start:stop, k]
            whitener.apply(columns, run.seen[start:stop, k], accumulator.buffer)
            accumulator.absorb(count, first)
    found = {}
    for k, i in enumerate(run.outputs):
        r = accumulators[k].r
        scale = whiteners[k].log_scale
        found[i] = (r[:, : layout.n_signals], r[:, layout.n_signals], run.counts[k], scale)
    return found


def _signals(
    experiment: Experiment, bank: Cascade, layout: Layout, buffer: Array, output: int
) -> Iterator[tuple[int, int, int]]:
    """Fill ``buffer`` with block after block of one output's columns before the outputs.

    Gives the first sample of each block, the one after its last, and the first column that is
    not zero from here on (where the impulse states have died out).
    """
    q, n = bank.order, experiment.n_samples
    signal = experiment.sampled[output]
    upper, branches = int(np.any(bank.poles.imag != 0)), bank.branches
    states = States(signal, bank.a, bank.b, upper=upper, branches=branches)
    impulse = states.impulse(experiment.start)  # nothing is computed before it advances
    block = _block(experiment)
    after_impulse = q if layout.free else 0
    first, least = 0, NEGLIGIBLE * np.abs(bank.b).max()
    for start in range(0, n, block):
        stop = min(start + block, n)
        count = stop - start
        if layout.free and first == 0:
            impulse.advance(start, stop, buffer[:q])
        states.advance(start, stop, buffer[after_impulse:])
        row = layout.states
        buffer[row : row + layout.n_inputs, :count] = signal.direct[start:stop].T
        row += layout.n_inputs
        if layout.offset:
            buffer[row, :count] = 1.0
            row += 1
        if layout.drift:
            buffer[row, :count] = experiment.ramp[start:stop]
            row += 1
        yield start, stop, first
        if layout.free and first == 0 and np.abs(impulse.state).max() < least:
            first = q
            buffer[:q] = 0.0
