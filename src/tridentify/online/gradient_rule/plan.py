"""Where the three models of the gradient rule stand, and the tables that say what they are.

All tables are rows on the columns of Step 1: states of the bank, inputs, constant
(`online.kernels.parallel`). A basis is either the fixed one of the paper, Laguerre functions and a
filter ``c`` beside them, or the adapted one, the poles of the model three times with ``c = a``:
twice for the output of the parallel and of the series model, once more for the filter behind it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tridentify.numerics.arrays import Array, Complex, Indices
from tridentify.numerics.realization import (
    Cascade,
    DegreeBasis,
    cascade,
    degree_basis,
    denominator,
    filter_map,
    numerators,
)
from tridentify.online.kernels import gradient_slots as places
from tridentify.online.kernels import slots
from tridentify.online.layout import Blueprint, NuisanceColumns, Setting, parallel, with_directions

REPEATS = 3
"""How often each pole stands in the bank: twice for the model and its slopes, and once for a move
of them."""
FLOOR = 1e-8
"""Eigenvalue of a correlation matrix at which directions are held: what is not excited does not run
away."""
LEARNING = 20
"""Blocks from which the usual size of the test for changes is learnt before it may tell one."""


@dataclass(frozen=True, eq=False)
class Basis:
    """A bank, the part of it that models use, and the filter of Step 2.

    Attributes
    ----------
    setting : Setting
    nuisance : NuisanceColumns
    poles : (q,) complex array
        Of the bank.
    filter_poles : (n_c,) complex array
    kept : int
        First states of the bank that the parallel and the series model use.
    adapted : bool
        Whether ``c`` is the denominator of a model.
    """

    setting: Setting
    nuisance: NuisanceColumns
    poles: Complex
    filter_poles: Complex
    kept: int
    adapted: bool

    @classmethod
    def on_model(cls, setting: Setting, nuisance: NuisanceColumns, poles: Complex) -> Basis:
        """The basis on the poles of a model."""
        bank = np.tile(poles, REPEATS)
        return cls(setting, nuisance, bank, poles, (REPEATS - 1) * poles.size, True)

    @classmethod
    def fixed(
        cls,
        setting: Setting,
        nuisance: NuisanceColumns,
        gamma: float,
        count: int,
        filter_poles: Complex,
    ) -> Basis:
        """The basis of the paper."""
        laguerre = np.full(count, -gamma, dtype=np.complex128)
        poles = np.concatenate([laguerre, filter_poles])
        return cls(setting, nuisance, poles, filter_poles, count, False)

    @classmethod
    def of(cls, setting: Setting, blueprint: Blueprint) -> Basis:
        """That of a blueprint."""
        kept = int(blueprint.ints[places.KEPT])
        adapted = bool(blueprint.ints[places.SERIES])
        poles = blueprint.poles
        own = poles[: setting.n_poles] if adapted else poles[kept:]
        return cls(setting, blueprint.nuisance, poles, own, kept, adapted)

    @cached_property
    def bank(self) -> Cascade:
        """Of all poles."""
        return cascade(self.poles)

    @cached_property
    def filter_bank(self) -> Cascade:
        """Of the filter."""
        return cascade(self.filter_poles)

    @cached_property
    def degrees(self) -> DegreeBasis:
        """Of the filter."""
        return degree_basis(self.filter_bank)

    @property
    def n_poles(self) -> int:
        """Degree of ``a``."""
        return self.setting.n_poles

    @property
    def monic(self) -> bool:
        """Whether ``p^n / c`` is a function of its own, ``c`` being of higher degree."""
        return self.filter_bank.order > self.n_poles

    @property
    def width(self) -> int:
        """Columns of a row."""
        m, free, offset = self.setting.n_inputs, self.nuisance.free, self.nuisance.offset
        return self.poles.size * (m + free) + m + offset

    @cached_property
    def counts(self) -> tuple[tuple[int, ...], ...]:
        """Unknowns of each numerator."""
        return tuple(tuple(m + 1 for m in row) for row in self.setting.zeros)

    @property
    def own(self) -> int:
        """Unknowns of Step 2 that belong to one output alone."""
        return max(sum(row) for row in self.counts) + self.n_poles * self.nuisance.free

    @property
    def unknowns(self) -> int:
        """Of Step 2."""
        return self.n_poles + self.setting.n_outputs * self.own

    # ------------------------------------------------------------------------------- columns
    def channel(self, j: int) -> slice:
        """States driven by input ``j``; -1 is the impulse."""
        q = self.poles.size
        at = (j + self.nuisance.free) * q if j >= 0 else 0
        return slice(at, at + q)

    def direct(self, j: int) -> int:
        """Column of input ``j`` itself."""
        return self.poles.size * (self.setting.n_inputs + self.nuisance.free) + j

    def on_channel(self, j: int, rows: Array) -> Array:
        """Rows on the first states of a channel as rows on all columns."""
        found = np.zeros((rows.shape[0], self.width))
        at = self.channel(j).start
        found[:, at : at + rows.shape[1]] = rows
        return found

    def at(self, column: int) -> Array:
        """One column as a row."""
        return np.eye(1, self.width, column)

    # -------------------------------------------------------------------------------- tables
    @cached_property
    def parallel(self) -> Array:
        """``T_1`` (k_1, n): the regressors of Step 1."""
        m, inner = self.setting.n_inputs, np.eye(self.kept)
        rows = [self.on_channel(j, inner) for j in range(-int(self.nuisance.free), m)]
        if any(degree == self.n_poles for row in self.setting.zeros for degree in row):
            rows += [self.at(self.direct(j)) for j in range(m)]
        if self.nuisance.offset:
            rows.append(self.at(self.width - 1))
        return np.vstack(rows)

    @cached_property
    def through(self) -> Array:
        """(q, n_c, q) the states of the filter driven by each state of the bank."""
        return filter_map(self.filter_bank, self.bank)

    @cached_property
    def driven(self) -> Array:
        """(n_c, q) the states of the filter driven by an input."""
        return np.tensordot(self.bank.b, self.through, 1)

    @cached_property
    def picked(self) -> Array:
        """(n or n + 1, n_c) the functions of the filter that ``a`` is a combination of."""
        n, rows = self.n_poles, self.degrees.rows
        if not self.monic:
            return rows[:n]
        return np.vstack([rows[:n], rows[n : n + 1] / self.degrees.leading[n]])

    def filtered(self, row: Array) -> Array:
        """(n or n + 1, n): these functions, driven by a signal that is a row."""
        table = np.einsum("dc,kcq->kdq", self.picked, self.through)
        found = np.zeros((self.picked.shape[0], self.width))
        for j in range(-int(self.nuisance.free), self.setting.n_inputs):
            own = self.channel(j)
            found[:, own] = np.tensordot(row[own], table, 1)
            if j >= 0:
                found[:, own] += row[self.direct(j)] * (self.picked @ self.driven)
        return found

    def numerators(self, output: int) -> Array:
        """``T_2`` (own, n): inputs and impulse through the filter, for one output."""
        rows: list[Array] = []
        for j, count in enumerate(self.counts[output]):
            proper = min(count, self.filter_bank.order)
            rows.append(self.on_channel(j, self.degrees.rows[:proper] @ self.driven))
            if count > proper:
                rows.append(self.at(self.direct(j)))
        if self.nuisance.free:
            rows.append(self.on_channel(-1, self.degrees.rows[: self.n_poles] @ self.driven))
        table = np.vstack(rows)
        return np.vstack([table, np.zeros((self.own - len(table), self.width))])

    def series(self, output: int, model: Array) -> Array:
        """``T_3`` (k_3, n): what may be added to the model's output."""
        rows = [self.filtered(without_constant(self, model)), self.numerators(output)]
        if self.nuisance.offset:
            rows.append(self.at(self.width - 1))
        return np.vstack(rows)

    def judged(self, output: int, model: Array) -> Array:
        """(k, n): how the output answers to each coefficient and to a constant."""
        own = self.numerators(output)[: sum(self.counts[output])]
        rows = [self.filtered(without_constant(self, model)), own]
        if self.nuisance.offset:
            rows.append(self.at(self.width - 1))
        return np.vstack(rows)

    def second(self, output: int, signal: Array) -> Array:
        """(unknowns, n): the regressors of Step 2 for one output, its noise-free signal a row."""
        n = self.n_poles
        table = np.zeros((self.unknowns, self.width))
        table[:n] = -self.filtered(without_constant(self, signal))[:n]
        table[n + output * self.own : n + (output + 1) * self.own] = self.numerators(output)
        return table

    @cached_property
    def physical(self) -> tuple[Array, Array]:
        """Constant and matrix that give the coefficients of ``a`` and ``b`` from Step 2's."""
        n, n_c = self.n_poles, self.filter_bank.order
        table, den = numerators(self.filter_poles), denominator(self.filter_poles)
        size = n + sum(sum(row) for row in self.counts)
        constant, matrix = np.zeros(size), np.zeros((size, self.unknowns))
        polynomials = self.picked @ table
        matrix[:n, :n] = polynomials[:n, n_c - n :].T
        constant[:n] = polynomials[n, n_c - n :] if self.monic else den[1:]
        at = n
        for i, row in enumerate(self.counts):
            place = n + i * self.own
            for count in row:
                proper = min(count, n_c)
                own = np.pad(self.degrees.rows[:proper] @ table, ((0, 0), (1, 0)))
                if count > proper:
                    own = np.vstack([own, den])
                matrix[at : at + count, place : place + count] = own[:, n_c + 1 - count :].T
                at, place = at + count, place + count
        return constant, matrix

    def unknowns_of(self, theta: Array) -> Array:
        """Unknowns of Step 2 from the coefficients."""
        constant, matrix = self.physical
        rows = np.abs(matrix).max(axis=1, keepdims=True)
        scaled = matrix / np.where(rows > 0, rows, 1.0)
        columns = np.abs(scaled).max(axis=0)
        columns = np.where(columns > 0, columns, 1.0)
        target = (theta - constant) / np.where(rows > 0, rows, 1.0)[:, 0]
        return np.asarray(np.linalg.lstsq(scaled / columns, target, rcond=None)[0] / columns)

    def output_of(self, output: int, unknowns: Array) -> Array:
        """(n,) the output of the model ``b / c`` as a row, its free response with it."""
        place = self.n_poles + output * self.own
        return np.asarray(unknowns[place : place + self.own] @ self.numerators(output))


def without_constant(basis: Basis, row: Array) -> Array:
    """A row without the constant."""
    if not basis.nuisance.offset:
        return row
    found = row.copy()
    found[-1] = 0.0
    return found


def gains(table: Array, moments: Array, orthogonal: bool) -> Array:
    """``P``: one over the mean squares of regressors, or of orthogonal combinations of them.

    Parameters
    ----------
    table : (k, n) array
        The regressors.
    moments : (n, n) array
        Mean of ``z z'``.
    orthogonal : bool

    Examples
    --------
    >>> gains(np.array([[1.0, 0.0], [0.0, 2.0]]), np.eye(2), True).tolist()
    [[1.0, 0.0], [0.0, 0.25]]
    """
    means = table @ moments @ table.T
    return inverse_of(means) if orthogonal else np.diag(_reciprocal(np.diagonal(means)))


def inverse_of(means: Array, floor: float = FLOOR) -> Array:
    """Inverse of a matrix of mean products; directions below ``floor`` are held at it."""
    root = np.sqrt(_reciprocal(np.diagonal(means)))
    values, vectors = np.linalg.eigh(means * root[:, None] * root)
    factor = root[:, None] * vectors / np.sqrt(np.maximum(values, floor))
    return np.asarray(factor @ factor.T)


def _reciprocal(values: Array) -> Array:
    live = np.isfinite(values) & (values > 1e-280)
    return np.where(live, 1.0 / np.where(live, values, 1.0), 0.0)


def plan(basis: Basis, keep: bool = False) -> Blueprint:
    """The plan of the vector, with no tables yet; ``keep``: samples are kept."""
    setting, nuisance = basis.setting, basis.nuisance
    base = parallel(setting, basis.poles, nuisance, keep)
    p, n = setting.n_outputs, base.n_columns
    ints = base.ints
    k1 = basis.parallel.shape[0]
    k3 = basis.n_poles + basis.own + nuisance.offset if basis.adapted else 0
    ints[places.SERIES] = basis.adapted
    ints[places.PARALLEL_UNKNOWNS], ints[places.SERIES_UNKNOWNS] = k1, k3
    ints[places.POLES], ints[places.ANSWERS] = basis.n_poles, basis.n_poles + basis.monic
    ints[places.KEPT], ints[places.OWN] = basis.kept, basis.own
    ints[places.C_FITS] = base.constants.size
    ints[places.C_SECOND] = base.constants.size + p * places.fits_stride(ints)
    ints[places.X_FITS] = base.size
    ints[places.X_SECOND] = base.size + p * (k1 + k3 + 2)
    ints[places.X_MOMENTS] = int(ints[places.X_SECOND]) + 2 * basis.unknowns + 1
    ints[places.X_ROOM] = int(ints[places.X_MOMENTS]) + n * (n + 1) // 2
    ints[slots.LEARNING], ints[slots.ALERT] = LEARNING, slots.LEVEL_OF_DOUBT
    d, q = int(ints[places.ANSWERS]), basis.poles.size
    tables = (basis.kept + 1) * d * q + basis.unknowns**2
    end = int(ints[places.C_SECOND]) + tables
    constants = np.concatenate([base.constants, np.zeros(end - base.constants.size)])
    return replace(base, constants=constants, size=_size(ints))


def _size(ints: Indices) -> int:
    channels = int(ints[slots.INPUTS] + ints[slots.FREE])
    unknowns = int(ints[places.POLES] + ints[slots.OUTPUTS] * ints[places.OWN])
    fits = 2 * int(ints[places.PARALLEL_UNKNOWNS] + ints[places.SERIES_UNKNOWNS])
    answers = channels * int(ints[places.KEPT] * ints[places.ANSWERS])
    room = max(fits, answers + int(ints[slots.COLUMNS]) + 2 * unknowns)
    return int(ints[places.X_ROOM]) + room


def with_tables(
    basis: Basis,
    blueprint: Blueprint,
    models: Array,
    signals: Array,
    moments: Array | None,
    noise: Array,
    *,
    orthogonal: bool,
    rate: float,
    ready: float = 0.0,
) -> Blueprint:
    """A blueprint with what the kernel reads, for all outputs.

    Parameters
    ----------
    basis : Basis
    blueprint : Blueprint
    models : (n_outputs, n) array
        ``t_0``.
    signals : (n_outputs, n) array
        What Step 2 works on at the present.
    moments : (n, n) array or None
        Mean of ``z z'``; None while it is not known.
    noise : (n_outputs,) array
        Variance of the noise, over which squared equation errors count.
    orthogonal : bool
    rate : float
        [1/s].
    ready : float
        Whether a sample may be doubted, and a change be told (`online.kernels.gradient`).
    """
    ints, c, known = blueprint.ints, blueprint.constants.copy(), moments is not None
    first, stride = int(ints[places.C_FITS]), places.fits_stride(ints)
    total = np.zeros((basis.unknowns, basis.unknowns))
    directions = np.zeros((basis.setting.n_outputs, basis.setting.n_directions, basis.width))
    weights = 1.0 / np.maximum(noise, 1e-12 * max(float(noise.max()), 1e-280))
    weights = weights / weights.mean() if known else np.ones(noise.size)

    def own_gains(table: Array) -> Array:
        return np.eye(len(table)) if moments is None else gains(table, moments, orthogonal)

    for i, (model, signal, weight) in enumerate(zip(models, signals, weights, strict=True)):
        one, own = basis.parallel, basis.numerators(i)
        third = basis.series(i, model) if basis.adapted else np.zeros((0, basis.width))
        parts = [one, own_gains(one), model, third, own_gains(third), own]
        block = np.concatenate([*(part.ravel() for part in parts), [weight]])
        c[first + i * stride : first + (i + 1) * stride] = block
        if moments is not None:
            table = basis.second(i, signal)
            total += weight * table @ moments @ table.T
        if basis.adapted:
            judged = basis.judged(i, model)
            directions[i, : len(judged)] = judged
    answers = np.einsum("dc,kcq->kdq", basis.picked, basis.through[: basis.kept])
    gain = gains(np.eye(basis.unknowns), total, orthogonal) if known else np.eye(basis.unknowns)
    block = np.concatenate([answers.ravel(), (basis.picked @ basis.driven).ravel(), gain.ravel()])
    at = int(ints[places.C_SECOND])
    c[at : at + block.size] = block
    c[places.RATE], c[places.KNOWN], c[places.READY] = rate, known, ready
    c[places.GRADIENT_PACE] = 0.0
    return with_directions(replace(blueprint, constants=c), directions)
