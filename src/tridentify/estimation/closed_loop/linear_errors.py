"""Errors of the mirrored predictor at a plant, and how they move with it.

What Steps 2 and 4 for a plant that is not stable share (`unstable`): the errors of every record,
their driven derivatives as instruments, their derivatives as they are, and what start and offset
make of them, whitened where the noise is coloured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tridentify.estimation.closed_loop.between_samples import Loop
from tridentify.estimation.closed_loop.driven import Driven
from tridentify.estimation.closed_loop.predictor import (
    Plant,
    Predictor,
    Signals,
    driven_signals,
    observed,
    recorded,
    slopes,
)
from tridentify.numerics.arrays import Array, Complex, Flags
from tridentify.numerics.autoregression import whiten

AS_WELL = 1e4
"""Condition of the derivatives as the instruments see them, over that of the driven ones."""

TOLD_APART = 1e-2
"""Part of a start or an offset that the others do not make, of columns of unit length, from which
it counts: the position of an integrator is an offset, and what tells the two apart may be nothing
but rounding and the limits of what is driven, with derivatives that are as large as it is small."""

ROUNDING = 1e-13
"""The same of a record by itself: the errors at the best start are what is minimised there, and of
a plant that runs away all starts look alike."""


@dataclass(frozen=True, eq=False)
class Foreseen:
    """One record's predictor, what drives it, and what is there of its output.

    Attributes
    ----------
    loop : Loop
    predictor : Predictor
    signals : Signals
    errors : (n_samples,) array
        ``e`` from rest.
    rest : (n_samples, k) array
        Minus the derivatives of ``e`` by what makes up for the start.
    seen : (n_samples,) bool array
    """

    loop: Loop
    predictor: Predictor
    signals: Signals
    errors: Array
    rest: Array
    seen: Flags

    def derivatives(self) -> tuple[Array, Array]:
        """Minus those of the driven part of the errors, and of all of it."""
        driven = driven_signals(self.loop)
        if driven.is_same(self.signals):
            every = self._slopes(self.signals, self.errors, ROUNDING)
            return every, every
        every = self._slopes(self.signals, self.errors, TOLD_APART)
        return self._slopes(driven, self.predictor.errors(driven), TOLD_APART), every

    def _slopes(self, signals: Signals, errors: Array, apart: float) -> Array:
        """At the start and offset that suit the signals best, told apart beyond a cutoff."""
        if not (np.isfinite(errors).all() and np.isfinite(self.rest).all()):
            return np.full((len(errors), self.predictor.plant.free.shape[1]), np.nan)
        start = suiting(self.rest[self.seen], errors[self.seen], apart)
        if self.loop.drift:
            signals = replace(signals, y=signals.y - start[-1] * ramp(signals.y.size))
            start = start[:-1]
        return slopes(self.predictor, signals, start) @ self.predictor.plant.free


def suiting(rest: Array, errors: Array, apart: float = TOLD_APART) -> Array:
    """(k,) start and offset that suit errors best, the smallest where they are not told apart.

    Parameters
    ----------
    rest : (n_samples, k) array
        What start and offset make of the errors.
    errors : (n_samples,) array
    apart : float
        Part of a start or an offset that the others do not make, from which it counts.
    """
    size = np.linalg.norm(rest, axis=0) + 1e-300
    return np.asarray(np.linalg.lstsq(rest / size, errors, rcond=apart)[0] / size)


def ramp(count: int) -> Array:
    """(count,) a drift that adds up to one over the record."""
    return np.linspace(0.0, 1.0, count)


def _drifting(loop: Loop, predictor: Predictor, signals: Signals) -> list[Array]:
    """Minus the derivative of the errors by a drift, where there is one."""
    if not loop.drift:
        return []
    u, count = np.zeros_like(signals.u), signals.y.size
    return [predictor.errors(Signals(u, signals.fine[:0], ramp(count), signals.dt))[:, None]]


@dataclass(frozen=True, eq=False)
class Linear:
    """Errors and columns at a plant, whitened; rows of missing samples are zero.

    The derivatives by the coefficients are most of the work, and are not made before they are
    asked for: a step that does not lower the errors needs none.
    """

    errors: Array
    rest: Array
    count: int
    records: tuple[Foreseen, ...]
    noise: Array

    @cached_property
    def _derivatives(self) -> tuple[Array, Array]:
        shared, full = [], []
        with np.errstate(all="ignore"):
            for one in self.records:
                z, every = one.derivatives()
                shared.append(_white(z, one.seen, self.noise))
                full.append(shared[-1] if every is z else _white(every, one.seen, self.noise))
        return np.vstack(shared), np.vstack(full)

    @property
    def slopes(self) -> Array:
        """(n_samples, n_free) minus the derivatives of the driven part of the errors."""
        return self._derivatives[0]

    @property
    def full(self) -> Array:
        """The same of all of the errors."""
        return self._derivatives[1]

    @property
    def is_bounded(self) -> bool:
        """Whether the errors did not run away."""
        return bool(np.isfinite(self.errors).all() and np.isfinite(self.rest).all())

    @property
    def is_finite(self) -> bool:
        """Whether nothing ran away."""
        return self.is_bounded and bool(np.isfinite(self.slopes).all())

    @cached_property
    def _triangle(self) -> tuple[Array, Array, Array]:
        """Orthonormal instruments, their triangle, and the sizes that its columns are without."""
        matrix = np.hstack([self.slopes, self.rest])
        # of a plant that runs away the squares are beyond the largest float
        largest = np.abs(matrix).max(axis=0)
        largest = np.where(largest > 0, largest, 1.0)
        scale = largest * np.maximum(np.linalg.norm(matrix / largest, axis=0), 1.0)
        return *np.linalg.qr(matrix / scale), scale

    @property
    def instruments(self) -> Array:
        """(n_samples, n_unknowns) orthonormal ones, of coefficients, starts and offsets."""
        return self._triangle[0]

    def step(self) -> tuple[Array, Array, Array]:
        """Change of all unknowns, the residual beside start and offset, and what it is divided by.

        Newton's step for the root, with the derivatives of all of ``e`` beside the instruments;
        where these hardly know them, that of the driven part alone. They are what orthonormal
        instruments see of them, so that errors of the root are those of white noise divided by it.
        """
        q, r, scale = self._triangle
        full = q.T @ (np.hstack([self.full, self.rest]) / scale)
        sizes = np.abs(np.diag(r))
        dependent = sizes.min() <= np.finfo(float).eps * sizes.max()
        if (
            dependent
            or not np.isfinite(full).all()
            or np.linalg.cond(np.linalg.solve(r.T, full.T)) > AS_WELL
        ):
            full = r
        change = np.linalg.lstsq(full, q.T @ self.errors, rcond=1e-13)[0] / scale
        own = np.linalg.qr(self.rest)[0]
        return change, self.errors - own @ (own.T @ self.errors), full * scale


def linear_errors(
    loops: Sequence[Loop],
    plant: Plant,
    noise: Array,
    *,
    fed_back: bool = True,
    held: Complex | None = None,
) -> Linear:
    """Errors and columns at a plant, whitened by an autoregression of the noise.

    Parameters
    ----------
    loops : sequence of Loop
    plant : Plant
    noise : (p,) array
        Empty for white noise.
    fed_back : bool
    held : (n,) complex array, optional
        As of the `Predictor`.
    """
    edge = slowest(loops)
    records, errors, own = [], [], []
    with np.errstate(all="ignore"):
        for loop in loops:
            signals = recorded(loop)
            predictor = Predictor(plant, signals.dt, edge, fed_back, held)
            rest, e = predictor.starts(len(signals.y)), predictor.errors(signals)
            rest = np.hstack([rest, *_drifting(loop, predictor, signals)])
            seen = observed(loop)
            records.append(Foreseen(loop, predictor, signals, e, rest, seen))
            table = _white(np.column_stack([e, rest]), seen, noise)
            errors.append(table[:, 0])
            own.append(table[:, 1:])
    count = sum(int(one.seen.sum()) for one in records)
    rest = stacked([one[:, :0] for one in own], own)
    return Linear(np.concatenate(errors), rest, count, tuple(records), noise)


def _white(table: Array, seen: Flags, noise: Array) -> Array:
    if not noise.size:
        return np.where(seen[:, None], table, 0.0)
    found = [whiten(np.where(seen, column, np.nan), noise)[0] for column in table.T]
    return np.nan_to_num(np.column_stack(found))


def driven_basis(loops: Sequence[Loop], noise: Array) -> Array | None:
    """Orthonormal columns of all that the references drive, experiments below each other.

    Parameters
    ----------
    loops : sequence of Loop
    noise : (p,) array
        By which they are whitened, as the errors are.

    Returns
    -------
    (n, n_columns) array or None
        None where no reference drives anything, and all errors count.
    """
    columns = []
    for loop in loops:
        if not isinstance(loop.driven, Driven):
            return None
        seen = observed(loop)
        columns.append(_white(loop.driven.columns, seen, noise))
    return np.linalg.qr(stacked([one[:, :0] for one in columns], columns))[0]


def merit(linear: Linear, basis: Array | None) -> float:
    """Sum of squares of what the references explain of the errors beside start and offset."""
    q = np.linalg.qr(linear.rest)[0]
    with np.errstate(over="ignore", invalid="ignore"):
        left = linear.errors - q @ (q.T @ linear.errors)
        along = left if basis is None else basis.T @ left
        size = float(along @ along)
    return size if np.isfinite(size) else np.inf


def stacked(shared: Sequence[Array], own: Sequence[Array]) -> Array:
    """Columns of all experiments, and columns of each alone."""
    blocks = []
    width = sum(one.shape[1] for one in own)
    at = 0
    for left, right in zip(shared, own, strict=True):
        block = np.zeros((len(left), width))
        block[:, at : at + right.shape[1]] = right
        at += right.shape[1]
        blocks.append(np.hstack([left, block]))
    return np.vstack(blocks)


def slowest(loops: Sequence[Loop]) -> float:
    """Slowest decay of a predictor: once within the shortest record [rad/s]."""
    return 1.0 / min(loop.record.duration for loop in loops)
