"""All that the samples so far say, on the bank that was running and on any other nearby.

The triangle of Step 1 (`online.kernels.parallel`) holds what the three models need of the samples:
the output of the parallel model, and of every model after it, is a combination of the states of
the bank, and so is each of their filtered derivatives. Steps 2 to 4 are therefore solved on the
triangle alone, on *all* samples so far, whenever they are asked for: nothing that an early, poor
stage of the cascade made is kept.

*Another bank.* The states ``x`` of an orthonormal cascade have orthonormal impulse responses, so
those of another, ``x'``, are ``T x`` with ``T = int x'(t) x(t)' dt``, the solution of ``A' T + T
A^T + B' B^T = 0``, as far as they lie in the span of the first. A bank with every pole ``m``
times holds ``1 / (p - p_i)^k, k <= m``: the first terms of the Taylor series of a function with a
pole nearby, and what is lost by a move ``delta`` of a pole is of the order ``|delta / Re
p_i|^m``. With ``T`` the triangle and the states that are running go over to the new bank: the
models do not see a jump.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.linalg

from tridentify.models.regression import Experiment, Layout, Regression
from tridentify.numerics.arrays import Array
from tridentify.numerics.least_squares import triangle
from tridentify.numerics.realization import Cascade
from tridentify.online.kernels import slots
from tridentify.online.layout import Blueprint, Setting, factor_of, fresh, watch_of
from tridentify.online.scatter import keep_expected, take_scatter


@dataclass(frozen=True, eq=False)
class Seen(Experiment):
    """An experiment whose samples are gone; their number and duration are known.

    Attributes
    ----------
    samples : int
        How many the triangle remembers.
    seconds : float
        Time that they took.
    summary : Summary
    """

    samples: int = 0
    seconds: float = 0.0
    summary: Summary | None = None

    @property
    def at_hand(self) -> bool:
        """Whether its samples are there: they are gone."""
        return False

    def reduced(self, bank: Cascade) -> Regression | None:
        """What was seen, on a bank."""
        return None if self.summary is None else self.summary.on(bank)

    @property
    def n_samples(self) -> int:
        """Number of samples."""
        return self.samples

    @property
    def duration(self) -> float:
        """Length [s]."""
        return self.seconds


@dataclass(frozen=True, eq=False)
class Summary:
    """The triangles of all outputs.

    Attributes
    ----------
    bank : Cascade
    layout : Layout
    rows : tuple of (n_columns + 1, n_columns) arrays
        Triangle of each output, and a row of zeros.
    targets : tuple of (n_columns + 1,) arrays
        The last entry is what no combination of columns explains.
    weights : (n_outputs,) array
        Samples that each triangle remembers.
    shares : (n_outputs,) array
        Sum of squared weights over sum of weights: below one where the past is forgotten.
    mean, power : (n_outputs,) array
        Of the outputs, over the samples remembered: mean, mean square about it.
    known : dict
        What was last asked for: choices of nuisance terms are compared at the same poles.
    """

    bank: Cascade
    layout: Layout
    rows: tuple[Array, ...]
    targets: tuple[Array, ...]
    weights: Array
    shares: Array
    mean: Array
    power: Array
    known: dict[bytes, Regression] = field(default_factory=dict)

    def on(self, bank: Cascade) -> Regression:
        """What was seen, in the columns of another bank; the last of them is remembered."""
        key = bank.poles.tobytes()
        if key not in self.known:
            found = self._on(bank)
            self.known.clear()
            self.known[key] = found
        return self.known[key]

    def _on(self, bank: Cascade) -> Regression:
        move = transfer(self.bank, bank)
        new = on_order(self.layout, bank.order)
        found = [change_columns(own, self.layout, move) for own in self.rows]
        counts = tuple(max(round(weight), 1) for weight in self.weights.tolist())
        return Regression(new, tuple(found), self.targets, counts)


def on_order(layout: Layout, order: int) -> Layout:
    """The same columns on a bank of another order."""
    return Layout(order, layout.n_inputs, layout.free, layout.offset, layout.drift)


def change_columns(rows: Array, layout: Layout, move: Array) -> Array:
    """Columns on one bank as columns on another, whose states are ``move`` times those."""
    order = move.shape[0]
    new = on_order(layout, order)
    found = np.empty((rows.shape[0], new.n_signals))
    for k in range(layout.n_inputs + layout.free):
        own = rows[:, k * layout.order : (k + 1) * layout.order]
        found[:, k * order : (k + 1) * order] = own @ move.T
    found[:, new.states :] = rows[:, layout.states :]
    return found


def transfer(old: Cascade, new: Cascade) -> Array:
    """``T`` (new order, old order): the states of one bank by those of another.

    Examples
    --------
    >>> from tridentify.numerics.realization import cascade
    >>> wide = cascade(np.array([-1.0, -2.0, -1.0, -2.0]))
    >>> bool(np.allclose(transfer(wide, cascade(np.array([-1.0, -2.0]))), np.eye(2, 4)))
    True
    """
    if old.order == new.order and np.array_equal(old.poles, new.poles):
        return np.eye(old.order)
    unit = float(np.exp(np.mean(np.log(np.abs(old.poles)))))
    drive = -np.outer(new.b, old.b) / unit
    return np.asarray(scipy.linalg.solve_sylvester(new.a / unit, old.a.T / unit, drive))


def summarise(blueprint: Blueprint, x: Array) -> Summary:
    """Read the triangles out of the vector of an estimator."""
    ints, n = blueprint.ints, blueprint.n_columns
    nuisance = blueprint.nuisance
    n_outputs = int(ints[slots.OUTPUTS])
    layout = Layout(blueprint.poles.size, int(ints[slots.INPUTS]), *nuisance)
    rows, targets = [], []
    weights, shares, mean, power = np.zeros((4, n_outputs))
    for i in range(n_outputs):
        at, w = factor_of(blueprint, i), watch_of(blueprint, i)
        root = np.sqrt(x[at : at + n])
        upper = np.eye(n + 1, n)
        upper[np.triu_indices(n, 1)] = x[at + 4 * n : at + int(ints[slots.FACTOR])]
        upper[:n] *= root[:, None]
        if nuisance.drift:
            upper[:, -1] /= max(float(x[slots.TIME] - x[slots.BORN]), 1e-300)
        rows.append(upper)
        targets.append(np.append(root * x[at + n : at + 2 * n], np.sqrt(x[w + slots.SQUARES])))
        weights[i] = x[w + slots.WEIGHT]
        shares[i] = x[w + slots.WEIGHT2] / max(x[w + slots.WEIGHT], 1.0)
        mean[i] = x[w + slots.MEAN]
        power[i] = x[w + slots.SPREAD] / max(x[w + slots.WEIGHT], 1.0)
    return Summary(
        blueprint.bank, layout, tuple(rows), tuple(targets), weights, shares, mean, power
    )


def moved(old: Blueprint, x: Array, new: Blueprint) -> Array:
    """The vector of an estimator on another bank: triangles and states go over.

    Parameters
    ----------
    old : Blueprint
    x : array
        On the old plan.
    new : Blueprint
        With the same channels and nuisance terms.

    Returns
    -------
    array
        On the new plan.
    """
    found = carried(old, x, new)
    summary = summarise(old, x)
    if old.nuisance.drift:
        # the column is the time, not the share of it
        for rows in summary.rows:
            rows[:, -1] *= max(float(x[slots.TIME] - x[slots.BORN]), 1e-300)
    regression = summary.on(new.bank)
    n = new.n_columns
    for i, (rows, target) in enumerate(zip(regression.signals, regression.targets, strict=True)):
        r = triangle(np.column_stack([rows, target]))
        write_triangle(new, found, i, r, float(summary.weights[i]))
    take_scatter(old, x, new, found)
    move = transfer(old.bank, new.bank)
    at, to = int(old.ints[slots.AT_ROW]), int(new.ints[slots.AT_ROW])
    q, k = old.poles.size, new.poles.size
    for channel in range(regression.layout.n_inputs + regression.layout.free):
        states = x[at + channel * q : at + (channel + 1) * q]
        found[to + channel * k : to + (channel + 1) * k] = move @ states
    found[to + regression.layout.states : to + n] = x[
        at + (regression.layout.n_inputs + regression.layout.free) * q : at + old.n_columns
    ]
    if found[slots.FIRST]:
        found[slots.FIRST] = k
    return found


def write_triangle(blueprint: Blueprint, x: Array, output: int, r: Array, weight: float) -> None:
    """Put the triangle of ``[columns | target]`` where the kernel looks for it.

    Parameters
    ----------
    blueprint : Blueprint
    x : array
        Is written to.
    output : int
    r : (>= n, n + 1) array
        Upper triangle of a QR factorisation.
    weight : float
        Samples in it.
    """
    n, at, w = blueprint.n_columns, factor_of(blueprint, output), watch_of(blueprint, output)
    diagonal = np.zeros(n)
    k = min(n, r.shape[0])
    diagonal[:k] = np.diagonal(r)[:k]
    sizes = np.linalg.norm(r[:, :n], axis=0)
    live = np.abs(diagonal) > 1e-13 * sizes
    safe = np.where(live, diagonal, 1.0)
    square = np.zeros((n, n + 1))
    square[:k] = r[:k]
    unit = np.where(live[:, None], square / safe[:, None], 0.0)
    x[at : at + n] = np.where(live, diagonal**2, 0.0)
    x[at + n : at + 2 * n] = unit[:, n]
    x[at + 2 * n : at + 3 * n] = sizes / np.sqrt(max(weight, 1.0))
    x[at + 3 * n : at + 4 * n] = 0.0
    x[at + 4 * n : at + int(blueprint.ints[slots.FACTOR])] = unit[:, :n][np.triu_indices(n, 1)]
    left = square[~live, n]
    beyond = r[k:, n] if r.shape[0] > k else np.zeros(0)
    x[w + slots.SQUARES] = float(left @ left + beyond @ beyond)


def carried(old: Blueprint, x: Array, new: Blueprint) -> Array:
    """A new vector with what does not depend on the bank: clocks, delay line, watch, chunk.

    What is usual of the scores goes over, too: without it coloured noise looks like changes.
    """
    found = fresh(new)
    a, b = old.ints, new.ints
    head = int(a[slots.AT_CHUNK])
    found[:head] = x[:head]
    width = int(a[slots.INPUTS] + a[slots.OUTPUTS] + 1)
    if a[slots.CHUNK] and b[slots.CHUNK]:
        kept = int(a[slots.CHUNK]) * width
        found[int(b[slots.AT_CHUNK]) : int(b[slots.AT_CHUNK]) + kept] = x[head : head + kept]
    elif not b[slots.CHUNK]:
        found[slots.FILLED] = 0.0
    for i in range(int(a[slots.OUTPUTS])):
        was, is_ = watch_of(old, i), watch_of(new, i)
        found[is_ : is_ + slots.SCORES] = x[was : was + slots.SCORES]
        found[is_ + slots.INSIDE] = 0.0
        count = int(a[slots.DIRECTIONS])
        if count and count == b[slots.DIRECTIONS]:
            end, stop = was + int(a[slots.WATCH]), is_ + int(b[slots.WATCH])
            found[stop - count : stop] = x[end - count : end]
    keep_expected(old, x, new, found)
    return found


def seen(setting: Setting, summary: Summary, seconds: float) -> Seen:
    """The experiment that a problem is about."""
    m, p = setting.n_inputs, setting.n_outputs
    delays = np.tile(setting.delays, (p, 1))
    return Seen(
        np.zeros((1, m)),
        np.zeros((1, p)),
        setting.dt,
        setting.intersample,
        summary.layout.free,
        summary.layout.offset,
        summary.layout.drift,
        delays=delays if np.any(delays) else None,
        samples=max(round(float(summary.weights.max())), 1),
        seconds=max(seconds, setting.dt),
        summary=summary,
    )
