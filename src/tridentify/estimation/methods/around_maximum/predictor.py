"""A first model of the noise from inside a loop: the predictor, by linear least squares.

With ``y = G u + H e`` the best prediction of the output is ``A y = B u + e`` with ``A = 1 / H`` and
``B = G / H``, whatever feedback there is. Least squares with enough lags finds it without a
search; ``A`` whitens the noise. The residual of a fit with white weights is no such start: feedback
has bent that fit, and it takes what it lost for noise.

References: L. Ljung & B. Wahlberg, Advances in Applied Probability 24 (1992) 412-440. U. Forssell &
L. Ljung, Automatica 35 (1999) 1215-1241.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tridentify.numerics.arrays import Array
from tridentify.numerics.information import aicc_price

ORDERS = (1, 2, 3, 4, 6, 8, 12, 16, 24)
"""Lags that are tried."""

SHORT = 4
"""Lags that foretell most of an output, so that all but the first samples have a past."""

PER_COLUMN = 4
"""Samples for each column, at least."""

FARTHEST = 0.995
"""Largest root of the filter, which has to be one of stationary noise."""


@dataclass(frozen=True, eq=False)
class Forecast:
    """The predictor of one output.

    Attributes
    ----------
    noise : (p,) array
        Autoregressive coefficients of the noise; empty where there are too few samples.
    criterion : float
        AICc of the forecasts, of the samples that all predictors tried have the past of.
    first : int
        Samples at the start of every experiment that these leave out.
    """

    noise: Array
    criterion: float
    first: int

    def excess(self, innovations: Sequence[Array], unknowns: float) -> float:
        """AICc of a model above that of the forecasts, on the same samples.

        Parameters
        ----------
        innovations : sequence of (n_samples,) arrays
            Of the model, per experiment; ``nan`` where a sample is missing.
        unknowns : float
            That were fitted for them.
        """
        left = np.concatenate([one[self.first :] for one in innovations])
        left = left[np.isfinite(left)]
        if not self.noise.size or left.size < unknowns + 2.0:
            return 0.0
        return _criterion(float(left @ left), unknowns, float(left.size)) - self.criterion


def forecasts(pairs: Sequence[tuple[Array, Array]]) -> tuple[Forecast, ...]:
    """The predictor of every output.

    Parameters
    ----------
    pairs : sequence of ((n_samples, n_inputs) array, (n_samples, n_outputs) array)
        Inputs and outputs of every experiment; ``nan`` marks a missing output.
    """
    return tuple(_predictor(pairs, i) for i in range(pairs[0][1].shape[1]))


def forecast_errors(u: Array, y: Array, output: int) -> Array:
    """(n_samples,) what the past alone does not tell of an output; ``nan`` where there is no past.

    Parameters
    ----------
    u : (n_samples, n_inputs) array
    y : (n_samples, n_outputs) array
        ``nan`` marks a missing sample.
    output : int
    """
    errors, p = np.full(y.shape[0], np.nan), SHORT
    known, now, seen = _regression([(u, y)], output, p, p, 1)
    if known.shape[0] > known.shape[1] + 1:
        fitted = np.linalg.lstsq(known, now, rcond=1e-12)[0]
        errors[p:][seen] = now - known @ fitted
    return errors


def predictor_noise(pairs: Sequence[tuple[Array, Array]]) -> tuple[Array, ...]:
    """Autoregressive coefficients of every output's noise.

    Parameters
    ----------
    pairs : sequence of ((n_samples, n_inputs) array, (n_samples, n_outputs) array)
        Inputs and outputs of every experiment; ``nan`` marks a missing output.

    Returns
    -------
    tuple of (p,) arrays
        Empty where there are too few samples.
    """
    return tuple(one.noise for one in forecasts(pairs))


def _predictor(pairs: Sequence[tuple[Array, Array]], output: int) -> Forecast:
    best = np.inf
    found: Array = np.zeros(0)
    n_inputs = pairs[0][0].shape[1]
    # the same samples for all orders, or AICc compares nothing
    rows = sum(u.shape[0] for u, _ in pairs)
    orders = [p for p in ORDERS if PER_COLUMN * (p * (1 + n_inputs) + n_inputs + 1) < rows - 2 * p]
    first = max(orders, default=0)
    for p in orders:
        known, now, _ = _regression(pairs, output, p, first)
        if known.shape[0] <= known.shape[1] + 1:
            break
        fitted = np.asarray(np.linalg.lstsq(known, now, rcond=1e-12)[0], dtype=np.float64)
        left = float(np.sum((now - known @ fitted) ** 2))
        criterion = _criterion(left, float(known.shape[1]), float(now.size))
        if criterion < best:
            best, found = criterion, np.asarray(-fitted[:p], dtype=np.float64)
    return Forecast(_stationary(found), best, first)


def _criterion(left: float, unknowns: float, count: float) -> float:
    return count * float(np.log(max(left / count, 1e-300))) + aicc_price(unknowns, count)


def _regression(
    pairs: Sequence[tuple[Array, Array]], output: int, p: int, first: int, acts: int = 0
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Past of the output, inputs from so many samples ago, and a level of each experiment's own.

    Beside these the output, and of which samples all that is there.
    """
    blocks, targets = [], []
    for e, (u, y) in enumerate(pairs):
        rows = y.shape[0] - first
        if rows < 1:
            continue
        own = y[:, output]
        past = [own[first - lag : first - lag + rows] for lag in range(1, p + 1)]
        moved = [u[first - lag : first - lag + rows] for lag in range(acts, p + 1)]
        levels = np.zeros((rows, len(pairs)))
        levels[:, e] = 1.0
        blocks.append(np.column_stack([*past, *moved, levels]))
        targets.append(own[first:])
    known, now = np.vstack(blocks), np.concatenate(targets)
    seen = np.isfinite(now) & np.all(np.isfinite(known), axis=1)
    return known[seen], now[seen], seen


def _stationary(a: Array) -> Array:
    """With roots outside of the unit circle mirrored into it."""
    if not a.size:
        return a
    roots = np.roots(np.append(1.0, a))
    sizes = np.abs(roots)
    roots = np.where(sizes > 1.0, roots / np.maximum(sizes, 1e-300) ** 2, roots)
    sizes = np.abs(roots)
    roots = np.where(sizes > FARTHEST, roots / np.maximum(sizes, 1e-300) * FARTHEST, roots)
    return np.asarray(np.real(np.poly(roots))[1:], dtype=np.float64)
