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

Where the noise of an output is coloured, all columns are turned into their innovations
(`numerics.autoregression`) before they enter that output's triangle: ordinary least squares on
them is generalised least squares on the samples, missing ones included. Combinations of columns
stay what they are, so nothing that works on the triangle has to know.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tridentify.numerics.autoregression import Whitener
from tridentify.numerics.discretize import discretize
from tridentify.numerics.least_squares import Accumulator
from tridentify.numerics.propagate import propagate
from tridentify.numerics.realization import Cascade

Array = NDArray[np.float64]

BLOCK = 1024
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
        Sampling interval [s].
    intersample : str
        ``"zoh"`` or ``"foh"``.
    free, offset, drift : bool
        Which nuisance terms are estimated along.
    noise : tuple of (p_i,) arrays
        Autoregressive coefficients of each output's noise; the empty tuple where all are white.
    """

    u: Array
    y: Array
    dt: float
    intersample: str
    free: bool
    offset: bool
    drift: bool
    noise: tuple[Array, ...] = ()

    @property
    def n_samples(self) -> int:
        """Number of samples."""
        return int(self.u.shape[0])

    @property
    def duration(self) -> float:
        """Length of the record [s]."""
        return (self.n_samples - 1) * self.dt


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
    """

    layout: Layout
    signals: tuple[Array, ...]
    targets: tuple[Array, ...]
    counts: tuple[int, ...]
    log_scale: tuple[float, ...] = ()

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
        Added to the inputs. The states' response to a constant from ``t0`` on is
        ``A^{-1} (x_impulse(t) - B)``, so this needs the impulse states and the constant among
        the columns.

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
    for s in regression.signals:
        if id(s) not in done:
            kept = s[:, index]
            if constants is not None and np.any(constants):
                one = s[:, old.nuisance.start]
                step = np.linalg.solve(bank.a, (s[:, :q] - np.outer(one, bank.b)).T).T
                for j, value in enumerate(constants):
                    kept[:, new.input_states(j)] += value * step
                    kept[:, new.direct(j)] += value * one
            done[id(s)] = kept
        signals.append(done[id(s)])
    return Regression(
        new, tuple(signals), regression.targets, regression.counts, regression.log_scale
    )


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
    Time ``O(n_samples)``; memory one block of ``BLOCK`` samples.
    """
    layout = _layout(experiment, bank)
    missing = np.isnan(experiment.y)
    n_outputs = experiment.y.shape[1]
    if any(a.size for a in experiment.noise):
        return _whitened(experiment, bank, layout, ~missing)
    if not missing.any():
        r = _triangle(experiment, bank, layout, experiment.y, None)
        s = r[:, : layout.n_signals]
        targets = tuple(r[:, layout.n_signals + i] for i in range(n_outputs))
        return Regression(layout, (s,) * n_outputs, targets, (experiment.n_samples,) * n_outputs)
    signals, targets_list, counts = [], [], []
    for i in range(n_outputs):
        keep = ~missing[:, i]
        y = np.where(keep, experiment.y[:, i], 0.0)[:, None]
        r = _triangle(experiment, bank, layout, y, keep.astype(np.float64))
        signals.append(r[:, : layout.n_signals])
        targets_list.append(r[:, layout.n_signals])
        counts.append(int(keep.sum()))
    return Regression(layout, tuple(signals), tuple(targets_list), tuple(counts))


def response_of(
    experiment: Experiment, bank: Cascade, rows: Array, most: int | None = None
) -> Array:
    """Combinations of the columns over time.

    Parameters
    ----------
    experiment : Experiment
    bank : Cascade
    rows : (k, n_signals) array
        Weights of the columns before the outputs.

    Returns
    -------
    (n_samples, k) array
    """
    layout = _layout(experiment, bank)
    buffer = np.zeros((layout.n_signals, min(experiment.n_samples, BLOCK)))
    count = experiment.n_samples if most is None else min(most, experiment.n_samples)
    found = np.empty((count, rows.shape[0]))
    for start, stop, _ in _signals(experiment, bank, layout, buffer):
        if start >= count:
            break
        stop = min(stop, count)
        found[start:stop] = (rows @ buffer[:, : stop - start]).T
    return found


def _layout(experiment: Experiment, bank: Cascade) -> Layout:
    return Layout(
        bank.order, experiment.u.shape[1], experiment.free, experiment.offset, experiment.drift
    )


def _triangle(
    experiment: Experiment, bank: Cascade, layout: Layout, y: Array, weight: Array | None
) -> Array:
    """R factor of [states | inputs | nuisance | y], rows multiplied by ``weight``."""
    accumulator = Accumulator(layout.n_signals + y.shape[1], min(experiment.n_samples, BLOCK))
    buffer = accumulator.buffer
    for start, stop, first in _signals(experiment, bank, layout, buffer):
        count = stop - start
        buffer[layout.n_signals :, :count] = y[start:stop].T
        if weight is not None:
            buffer[first:, :count] *= weight[start:stop]
        accumulator.absorb(count, first)
    return accumulator.r


def _whitened(
    experiment: Experiment, bank: Cascade, layout: Layout, seen: NDArray[np.bool_]
) -> Regression:
    """A triangle for each output, of the innovations of all columns."""
    block = min(experiment.n_samples, BLOCK)
    n_columns, n_outputs = layout.n_signals + 1, seen.shape[1]
    columns = np.zeros((n_columns, block))
    accumulators = [Accumulator(n_columns, block) for _ in range(n_outputs)]
    whiteners = [Whitener(a, n_columns) for a in experiment.noise]
    for start, stop, first in _signals(experiment, bank, layout, columns):
        count = stop - start
        for i, (accumulator, whitener) in enumerate(zip(accumulators, whiteners, strict=True)):
            y, there = experiment.y[start:stop, i], seen[start:stop, i]
            columns[-1, :count] = np.where(there, y, 0.0)
            whitener.apply(columns, there, accumulator.buffer)
            accumulator.absorb(count, first)
    triangles = [accumulator.r for accumulator in accumulators]
    return Regression(
        layout,
        tuple(r[:, : layout.n_signals] for r in triangles),
        tuple(r[:, layout.n_signals] for r in triangles),
        tuple(int(n) for n in seen.sum(axis=0)),
        tuple(whitener.log_scale for whitener in whiteners),
    )


def _signals(
    experiment: Experiment, bank: Cascade, layout: Layout, buffer: Array
) -> Iterator[tuple[int, int, int]]:
    """Fill ``buffer`` with block after block of the columns before the outputs.

    Gives the first sample of each block, the one after its last, and the first column that is
    not zero from here on (where the impulse states have died out).
    """
    q, n = bank.order, experiment.n_samples
    step = discretize(bank.a, bank.b[:, None], experiment.dt, experiment.intersample)
    upper = int(np.any(bank.poles.imag != 0))
    from_current, from_next = step.from_current[:, 0], step.from_next[:, 0]
    transition = np.ascontiguousarray(step.transition)
    block = min(n, BLOCK)
    nothing = np.zeros((n, 1)) if layout.free else experiment.u[:, :0]
    impulse = bank.b[None, :].copy()
    state = np.zeros((layout.n_inputs, q))
    after_impulse = q if layout.free else 0
    first = 0
    for start in range(0, n, block):
        stop = min(start + block, n)
        count = stop - start
        if layout.free and first == 0:
            propagate(
                transition, from_current, from_next, nothing, impulse, buffer,
                start=start, stop=stop, upper=upper, branches=bank.branches,
            )  # fmt: skip
        propagate(
            transition, from_current, from_next, experiment.u, state, buffer[after_impulse:],
            start=start, stop=stop, upper=upper, branches=bank.branches,
        )  # fmt: skip
        row = layout.states
        buffer[row : row + layout.n_inputs, :count] = experiment.u[start:stop].T
        row += layout.n_inputs
        if layout.offset:
            buffer[row, :count] = 1.0
            row += 1
        if layout.drift:
            buffer[row, :count] = np.arange(start, stop) / (n - 1)
            row += 1
        yield start, stop, first
        if layout.free and first == 0 and np.abs(impulse).max() < NEGLIGIBLE * np.abs(bank.b).max():
            first = q
            buffer[:q] = 0.0
