"""How the errors of input and output of a loop are weighed, and what that makes of their noise.

Input and output carry one noise, the input ``- C S v`` and the output ``S v``, and weights that
know it well are all but singular; whatever else is left of the input then counts beyond measure.
Instead the two rows

    w_1  =  a(z) / c(z) (e_y  -  G e_u),        w_2  =  e_u  -  sum_l f_l w_1(k - l)            (1)

are taken as unrelated: the first is ``v`` through an all-pass where the plant ``G`` is right
(`predictor`), and nothing that is left of the input at the samples counts in it; the second tells
what the input does between the samples, less a short filter of the first, with a share of its
variance added. The plant in (1), the filter, and the autoregression that whitens the first row are
held: any stable ones give an estimate without bias, as all of them act on noise alone.

So the covariance is that of least squares with other weights than the noise has, ``M' S M``, with
the autocovariances of both rows as they are found, tapered (Newey & West, Econometrica 55 (1987)
703-708).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tridentify.estimation.closed_loop.between_samples import Loop
from tridentify.estimation.closed_loop.linear_errors import ramp
from tridentify.estimation.closed_loop.predictor import Plant, Predictor, Signals, later
from tridentify.numerics.arrays import Array

LAGS = 4
"""Of the filter from the first row to the second."""
SHARE = 0.03
"""Of the input's noise, added to what the filter leaves of it."""
MOST_LAGS = 30
"""Of the autocovariances."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Equation (1), and its weights.

    Attributes
    ----------
    loop : Loop
        Any one: delay and sampling interval count.
    predictor : Predictor
    weights : (n_lags + 1, 2, 2) array
        Of the two rows and their past.
    """

    loop: Loop
    predictor: Predictor
    weights: Array

    @classmethod
    def plain(cls, loop: Loop, plant: Plant, edge: float) -> Rows:
        """Without weights."""
        return cls(loop, Predictor(plant, float(loop.record.dt or 0.0), edge), np.eye(2)[None])

    def of(self, table: Array) -> Array:
        """(n_samples, k, 2) ``w_1`` and ``e_u`` of columns of input and output."""
        found = np.empty_like(table)
        found[:, :, 1] = table[:, :, 0]
        for j in range(table.shape[1]):
            found[:, j, 0] = self._first(table[:, j, 0], table[:, j, 1])
        return found

    def _first(self, u: Array, y: Array) -> Array:
        """The input counts as straight between its samples: with its mean, to second order."""
        mean = np.append(0.5 * (u[:-1] + u[1:]), u[-1])[:, None]
        signals = Signals(mean, np.zeros((0, 1)), y, self.predictor.dt)
        return self.predictor.errors(later(self.loop, signals))

    def starts(self, loop: Loop, free: Array) -> Array:
        """(n_samples, k, 2) what start, offset and drift make of both rows."""
        count = len(free)
        first = [self.predictor.starts(count)]
        if loop.drift:
            first += [self._first(np.zeros(count), ramp(count))[:, None]]
            first += [self._first(ramp(count), np.zeros(count))[:, None]]
        one = np.hstack(first)
        table = np.zeros((count, one.shape[1] + free.shape[1], 2))
        table[:, : one.shape[1], 0] = one
        table[:, one.shape[1] :, 1] = free
        return table

    def white(self, table: Array) -> Array:
        """(2 * n, k) weighed; the first samples are past alone."""
        lags, count = len(self.weights) - 1, len(table)
        found = np.zeros((count - lags, 2, table.shape[1]))
        for lag, row, column in zip(*np.nonzero(self.weights), strict=True):
            part = table[lags - lag : count - lag, :, column]
            found[:, row] += self.weights[lag, row, column] * part
        return found.reshape(-1, table.shape[1])


def weighed(
    rows: Rows,
    left: Sequence[Array],
    choose_noise: Callable[[Sequence[Array]], Array] | None,
) -> Rows:
    """Rows with the weights of what is left of them.

    Parameters
    ----------
    rows : Rows
        Unweighed.
    left : sequence of (n_samples, 2) arrays
        Per record.
    choose_noise : callable, optional
        Gives the autoregressive coefficients of the first row; white without it.
    """
    levels = np.sqrt(np.mean(np.concatenate(left) ** 2, axis=0)) + 1e-300
    scaled = [one / levels for one in left]
    noise = np.zeros(0) if choose_noise is None else choose_noise([one[:, 0] for one in scaled])
    past = [
        np.column_stack([one[LAGS - k : len(one) - k, 0] for k in range(LAGS + 1)])
        for one in scaled
    ]
    table, target = np.vstack(past), np.concatenate([one[LAGS:, 1] for one in scaled])
    taps = np.linalg.lstsq(table, target, rcond=1e-10)[0]
    rest = np.sqrt(np.mean((target - table @ taps) ** 2) + SHARE)
    weights = np.zeros((max(noise.size, LAGS) + 1, 2, 2))
    weights[0, 0, 0] = weights[0, 1, 1] = 1.0
    weights[1 : noise.size + 1, 0, 0] = noise
    weights[: LAGS + 1, 1, 0] = -taps
    white = [np.convolve(one[:, 0], np.append(1.0, noise), "valid") for one in scaled]
    innovation = np.sqrt(np.mean(np.concatenate(white) ** 2))
    weights[:, 0] /= innovation
    weights[:, 1] /= rest
    return Rows(rows.loop, rows.predictor, weights / levels)


def covariance(slopes: Array, errors: Array, counts: Sequence[int]) -> Array:
    """Of what least squares make of errors whose two rows are noise of any colour.

    Parameters
    ----------
    slopes : (2 * n, k) array
        Two rows of a sample side by side.
    errors : (2 * n,) array
    counts : sequence of int
        Samples of each record.
    """
    size = np.linalg.norm(slopes, axis=0) + 1e-300
    inverse = np.linalg.pinv(slopes / size, rcond=1e-7)
    ends = np.cumsum(counts)[:-1]
    pairs = np.split(errors.reshape(-1, 2), ends)
    maps = np.split(inverse.reshape(size.size, -1, 2), ends, axis=1)
    lags = min(MOST_LAGS, min(counts) // 10)
    total = float(sum(counts) - size.size)
    along = np.zeros((lags + 1, 2, 2))
    for one in pairs:
        for lag in range(lags + 1):
            along[lag] += one[lag:].T @ one[: len(one) - lag] / total
    along *= (1.0 - np.arange(lags + 1) / (lags + 1.0))[:, None, None]
    found = np.zeros((size.size,) * 2)
    for own in maps:
        for lag in range(lags + 1):
            seen = own[:, lag:] @ along[lag]
            term = np.einsum("kni,jni->kj", seen, own[:, : own.shape[1] - lag])
            found += term if lag == 0 else term + term.T
    return np.asarray(found / np.outer(size, size))
