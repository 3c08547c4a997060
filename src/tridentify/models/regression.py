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
before it are not used (`likelihood.setup.nuisance`), since no known input explains them.

Where the noise of an output is coloured, all columns are turned into their innovations
(`numerics.autoregression`) before they enter that output's triangle: ordinary least squares on
them is generalised least squares on the samples, missing ones included. Combinations of columns
stay what they are, so nothing that works on the triangle has to know.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy.linalg

from tridentify.models.columns import Layout, Regression
from tridentify.models.experiment import Chart, Experiment, OutputRun
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.autoregression import Whitener
from tridentify.numerics.least_squares import Accumulator
from tridentify.numerics.realization import Cascade
from tridentify.numerics.sampled import States

__all__ = [
    "BLOCK",
    "LONG",
    "LONG_BLOCK",
    "NEGLIGIBLE",
    "Experiment",
    "Layout",
    "Regression",
    "Stack",
    "held_states",
    "regress",
    "regression_at",
    "response_of",
    "restricted",
    "regressions_in",
    "stacks_on",
]

BLOCK = 1024
LONG_BLOCK = 4096
LONG = 5_000
NEGLIGIBLE = 1e-30


def restricted(
    regression: Regression,
    bank: Cascade,
    *,
    free: bool,
    offset: bool,
    drift: int,
    constants: Array | None = None,
) -> Regression:
    """The triangle with fewer nuisance columns, and constants put back on the inputs.

    Parameters
    ----------
    regression : Regression
        With at least the nuisance columns that are kept.
    bank : Cascade
        The bank it was made on.
    free, offset : bool
        Which to keep.
    drift : int
        The degree to keep.
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
    index += range(at, at + min(old.drift, drift))
    done: dict[int, Array] = {}
    signals = []
    for i, s in enumerate(regression.signals):
        if id(s) not in done:
            kept = s[:, index]
            if constants is not None and np.any(constants):
                one = s[:, old.nuisance.start]
                for j, value in enumerate(constants):
                    lead = 0.0 if regression.leads is None else float(regression.leads[i, j])
                    kept[:, new.input_states(j)] += value * held_states(
                        bank.a, bank.b, s[:, :q], one, lead
                    )
                    kept[:, new.direct(j)] += value * one
            done[id(s)] = kept
        signals.append(done[id(s)])
    return replace(regression, layout=new, signals=tuple(signals))


def held_states(a: Array, b: Array, impulse: Array, one: Array, lead: float) -> Array:
    """States' response to a constant that began to act some time before the impulse.

    Parameters
    ----------
    a, b : (..., q, q), (..., q) arrays
        Of one bank, or of a stack of them.
    impulse, one : (..., r, q), (..., r) arrays
        Columns of the impulse states and of the constant.
    lead : float
        How long before [s].

    Returns
    -------
    (..., r, q) array
    """
    if lead:
        impulse = impulse @ scipy.linalg.expm(a * lead).swapaxes(-1, -2)
    sides = impulse - one[..., :, None] * b[..., None, :]
    return np.asarray(np.linalg.solve(a, sides.swapaxes(-1, -2)).swapaxes(-1, -2))


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
    if experiment.charts is not None:
        stacks = stacks_on(experiment, bank.a[None], bank.b[None], bank.poles[None])
        return regression_at(experiment, bank.order, stacks, 0)
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
    return _joined(experiment, layout, found)


class Stack(NamedTuple):
    """Triangles of some outputs of one experiment on several banks of the same order.

    Attributes
    ----------
    outputs, counts : tuples of int
        Which they are, and how many samples each has.
    log_scale : float
        As of `Regression`.
    rows : (n_banks, r, n_signals + n_outputs) array
        The targets behind the signals.
    """

    outputs: tuple[int, ...]
    counts: tuple[int, ...]
    log_scale: float
    rows: Array


def stacks_on(experiment: Experiment, a: Array, b: Array, poles: Complex) -> list[Stack]:
    """`regress` on several banks of the same order at once.

    Parameters
    ----------
    experiment : Experiment
    a : (n_banks, q, q) array
        Each lower triangular but for pairs on the diagonal.
    b : (n_banks, q) array
    poles : (n_banks, q) complex array
    """
    if experiment.charts is not None:
        return [
            Stack(*chart[:3], _over_noise(_triangles(a, b, chart), chart, experiment))
            for chart in experiment.charts
        ]
    found = [regress(experiment, Cascade(*one)) for one in zip(a, b, poles, strict=True)]
    first, groups = found[0], dict[int, list[int]]()
    for i, signals in enumerate(first.signals):
        groups.setdefault(id(signals), []).append(i)
    stacks = []
    for own in groups.values():
        rows = [np.column_stack([r.signals[own[0]], *(r.targets[i] for i in own)]) for r in found]
        scale = first.log_scale[own[0]] if first.log_scale else 0.0
        counts = tuple(first.counts[i] for i in own)
        stacks.append(Stack(tuple(own), counts, scale, np.stack(rows)))
    return stacks


def _over_noise(rows: Array, chart: Chart, experiment: Experiment) -> Array:
    """Innovations over the noise of the experiment; white samples are weighted already."""
    if chart.colour is None or experiment.scale is None:
        return rows
    return rows / experiment.scale_of(chart.outputs[0])


def _triangles(a: Array, b: Array, chart: Chart) -> Array:
    """Of the columns of a chart, or of their innovations."""
    from tridentify.models.compiled_regression import triangles_of

    if chart.colour is None:
        return triangles_of(a, b, *chart.given)
    from tridentify.models.compiled_whitening import whitened_triangles

    columns = triangles_of(a, b, *chart.without_outputs)
    return whitened_triangles(columns, chart.given[7], *chart.colour)


def regression_at(
    experiment: Experiment, order: int, stacks: Sequence[Stack], k: int
) -> Regression:
    """What is stacked, of bank ``k``."""
    layout = Layout(
        order, experiment.u.shape[1], experiment.free, experiment.offset, experiment.drift
    )
    n = layout.n_signals
    found: dict[int, tuple[Array, Array, int, float]] = {}
    for stack in stacks:
        r = stack.rows[k]
        signals = r[:, :n]
        for at, i in enumerate(stack.outputs):
            found[i] = (signals, r[:, n + at], stack.counts[at], stack.log_scale)
    return _joined(experiment, layout, found)


def regressions_in(
    experiments: Sequence[Experiment], layout: Layout, stack: Array, targets: Array
) -> tuple[Regression, ...]:
    """The regressions of experiments whose charts were all filtered at once.

    Parameters
    ----------
    experiments : sequence of Experiment
        With charts.
    layout : Layout
        Of the columns.
    stack : (n_charts, r, n_columns) array
        The triangle of every chart in turn, with rows of zeros where one is shorter.
    targets : (n_experiments, n_outputs, r) array
    """
    regressions, triangles = [], iter(stack)
    for e, experiment in enumerate(experiments):
        found: dict[int, tuple[Array, Array, int, float]] = {}
        for chart in experiment.charts or ():
            rows = layout.n_signals + len(chart.outputs)
            signals = next(triangles)[:rows]
            for i, count in zip(chart.outputs, chart.counts, strict=True):
                found[i] = (signals, targets[e, i, :rows], count, chart.log_scale)
        regressions.append(_joined(experiment, layout, found))
    return tuple(regressions)


def _joined(
    experiment: Experiment, layout: Layout, found: dict[int, tuple[Array, Array, int, float]]
) -> Regression:
    """Output by output: signals, target, count, log scale."""
    signals, targets, counts, scales = zip(*(found[i] for i in sorted(found)), strict=True)
    own = scales if experiment.is_coloured else ()
    return Regression(layout, signals, targets, counts, own, experiment.leads)


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
    count = experiment.n_samples if most is None else min(most, experiment.n_samples)
    found = np.empty((count, rows.shape[0]))
    sampled, charts = experiment.sampled, experiment.charts
    last = len(sampled) - 1
    owners = [min(k, last) for k in range(rows.shape[0])] if outputs is None else list(outputs)
    for signal in dict.fromkeys(sampled[i] for i in owners):
        mine = [k for k, i in enumerate(owners) if sampled[i] is signal]
        if charts is None:
            _combine(experiment, bank, rows, found, mine, sampled.index(signal))
        else:
            chart = next(one for one in charts if sampled[one.outputs[0]] is signal)
            found[:, mine] = (rows[mine] @ _columns(bank, chart)[:, :count]).T
    return found


def _combine(
    experiment: Experiment, bank: Cascade, rows: Array, found: Array, mine: list[int], group: int
) -> None:
    """Combinations of the columns, block by block, into ``found``."""
    layout = _layout(experiment, bank)
    buffer = np.zeros((layout.n_signals, _block(experiment)))
    for start, stop, _ in _signals(experiment, bank, layout, buffer, group):
        if start >= len(found):
            break
        stop = min(stop, len(found))
        found[start:stop, mine] = (rows[mine] @ buffer[:, : stop - start]).T


_last_columns: list[tuple[Array, Array, Chart, Array]] = []


def _columns(bank: Cascade, chart: Chart) -> Array:
    """The columns themselves, (n_columns, n_samples); the last ones are kept.

    What is left of the outputs at an end and how they move with the coefficients are asked one
    after the other.
    """
    from tridentify.models.compiled_regression import triangles_of

    for a, b, one, columns in list(_last_columns):
        if a is bank.a and b is bank.b and one is chart:
            return columns
    found = np.asarray(triangles_of(bank.a[None], bank.b[None], *chart.without_outputs)[0])
    _last_columns[:] = [(bank.a, bank.b, chart, found)]
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
        r, scale = accumulators[k].r, whiteners[k].log_scale
        if experiment.scale is not None:
            r = r / experiment.scale_of(i)
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
    states = States(signal, bank.a, bank.b, upper=int(np.any(bank.poles.imag != 0)))
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
        buffer[row : row + layout.drift, :count] = experiment.drifts[:, start:stop]
        yield start, stop, first
        if layout.free and first == 0 and np.abs(impulse.state).max() < least:
            first = q
            buffer[:q] = 0.0
