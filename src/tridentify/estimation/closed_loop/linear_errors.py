"""Errors of the mirrored predictor at a plant, and how they move with it.

What Steps 2 and 4 for a plant that is not stable share (`unstable`): the errors of every record,
their driven derivatives as instruments, their derivatives as they are, and what start and offset
make of them, whitened where the noise is coloured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tridentify.estimation.closed_loop.between_samples import Loop
from tridentify.estimation.closed_loop.driven import Driven
from tridentify.estimation.closed_loop.predictor import (
    Plant,
    Predictor,
    Signals,
    driven_signals,
    recorded,
    slopes,
)
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import whiten

AS_WELL = 1e4
"""Condition of the derivatives as the instruments see them, over that of the driven ones."""


@dataclass(frozen=True, eq=False)
class Linear:
    """Errors and columns at a plant, whitened; rows of missing samples are zero."""

    errors: Array
    slopes: Array
    full: Array
    rest: Array
    count: int

    @property
    def is_finite(self) -> bool:
        """Whether nothing ran away."""
        return bool(np.isfinite(self.errors).all() and np.isfinite(self.slopes).all())

    def step(self) -> tuple[Array, Array, Array]:
        """Change of all unknowns, the residual beside start and offset, and ``R`` of the columns.

        Newton's step for the root, with the derivatives of all of ``e`` beside the instruments;
        where these hardly know them, that of the driven part alone.
        """
        matrix = np.hstack([self.slopes, self.rest])
        norms = np.linalg.norm(matrix, axis=0)
        scale = np.where(norms > 0, norms, 1.0)
        q, r = np.linalg.qr(matrix / scale)
        full = q.T @ (np.hstack([self.full, self.rest]) / scale)
        sizes = np.abs(np.diag(r))
        dependent = sizes.min() <= np.finfo(float).eps * sizes.max()
        if dependent or np.linalg.cond(np.linalg.solve(r.T, full.T)) > AS_WELL:
            full = r
        change = np.linalg.lstsq(full, q.T @ self.errors, rcond=1e-13)[0] / scale
        own = np.linalg.qr(self.rest)[0]
        return change, self.errors - own @ (own.T @ self.errors), r * scale


def linear_errors(
    loops: Sequence[Loop], plant: Plant, noise: Array, *, fed_back: bool = True
) -> Linear:
    """Errors and columns at a plant, whitened by an autoregression of the noise.

    Parameters
    ----------
    loops : sequence of Loop
    plant : Plant
    noise : (p,) array
        Empty for white noise.
    fed_back : bool
        As of the `Predictor`.
    """
    edge = slowest(loops)
    errors, shared, own, count = [], [], [], 0
    with np.errstate(all="ignore"):
        for loop in loops:
            signals = recorded(loop)
            predictor = Predictor(plant, signals.dt, edge, fed_back)
            rest = predictor.starts(len(signals.y))
            seen = np.isfinite(loop.record.y[:, 0])
            e, every = _with_start(predictor, signals, rest, seen)
            _, z = _with_start(predictor, driven_signals(loop), rest, seen)
            count += int(seen.sum())
            table = _white(np.column_stack([e, z, every, rest]), seen, noise)
            errors.append(table[:, 0])
            shared.append(table[:, 1 : 1 + 2 * z.shape[1]])
            own.append(table[:, 1 + 2 * z.shape[1] :])
    blocks = stacked(shared, own)
    n = plant.theta.size
    both = (blocks[:, :n], blocks[:, n : 2 * n])
    return Linear(np.concatenate(errors), *both, blocks[:, 2 * n :], count)


def _with_start(
    predictor: Predictor, signals: Signals, rest: Array, seen: Array
) -> tuple[Array, Array]:
    """Errors from rest, and slopes at the start and offset that suit the signals best."""
    e = predictor.errors(signals)
    if not (np.isfinite(e).all() and np.isfinite(rest).all()):
        return e, np.full((len(e), predictor.plant.theta.size), np.nan)
    start = np.linalg.lstsq(rest[seen], e[seen], rcond=None)[0]
    return e, slopes(predictor, signals, start)


def _white(table: Array, seen: Array, noise: Array) -> Array:
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
        seen = np.isfinite(loop.record.y[:, 0])
        columns.append(_white(loop.driven.columns, seen, noise))
    return np.linalg.qr(stacked([one[:, :0] for one in columns], columns))[0]


def merit(linear: Linear, basis: Array | None) -> float:
    """Sum of squares of what the references explain of the errors beside start and offset."""
    q = np.linalg.qr(linear.rest)[0]
    left = linear.errors - q @ (q.T @ linear.errors)
    along = left if basis is None else basis.T @ left
    return float(along @ along) if np.isfinite(along).all() else np.inf


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
