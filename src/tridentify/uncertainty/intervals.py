"""Intervals from draws of a quantity ``q`` around its value ``q_0`` at the estimate.

With ``F`` the distribution of the draws and ``alpha = (1 - level) / 2``:

- *percentile*: ``F^{-1}(alpha)`` to ``F^{-1}(1 - alpha)``;
- *basic*: reflected at the estimate, ``2 q_0 - F^{-1}(1 - alpha)`` to ``2 q_0 - F^{-1}(alpha)``,
  which takes the draws' offset from ``q_0`` for the estimator's bias;
- *bca*: percentile at corrected probabilities ``Phi(z_0 + (z_0 + z) / (1 - a (z_0 + z)))``, ``z =
  Phi^{-1}(alpha)``, with ``z_0 = Phi^{-1}(F(q_0))``.

The acceleration ``a`` is a sixth of the skewness of the score along the least favourable direction
(Efron 1987, eq. 4.4). Here the records are Gaussian around a model response, so that the score is
``J' Sigma^{-1} e`` and linear in Gaussian noise: its skewness, and with it ``a``, is zero for every
quantity. What is left is a correction for the bias of the median, the same for every monotone scale
that a quantity may be measured on.

A probability below ``1 / (n + 1)`` falls on the lowest draw: at level 0.95 some 200 draws are the
least and 1000 are good (Davison & Hinkley 1997, sec. 5.2).

References: B. Efron, J. American Statistical Association 82, 171-185 (1987); B. Efron & R. J.
Tibshirani, *An Introduction to the Bootstrap* (1993), ch. 13-14; A. C. Davison & D. V. Hinkley,
*Bootstrap Methods and their Application* (1997), ch. 5.
"""

from __future__ import annotations

from statistics import NormalDist
from typing import Literal

import numpy as np
import numpy.typing as npt

from tridentify.errors import OptionError
from tridentify.estimation.answer.parameter import checked_level
from tridentify.numerics.arrays import Array

Kind = Literal["percentile", "basic", "bca"]


def intervals(
    values: Array, at: npt.ArrayLike, level: float = 0.95, kind: Kind = "percentile"
) -> tuple[Array, Array]:
    """Ends of the intervals of many quantities at once.

    Parameters
    ----------
    values : ndarray, shape (n_draws, ...)
        A draw that is ``nan`` does not count; an infinite one is the largest or smallest.
    at : array_like, shape (...)
        The values at the estimate.
    level : float
    kind : {"percentile", "basic", "bca"}

    Returns
    -------
    low, high : ndarray, shape (...)
        ``nan`` where no draw is left.

    Raises
    ------
    OptionError
        For an unknown kind, or a level that is no probability.

    Examples
    --------
    >>> low, high = intervals(np.arange(1.0, 1000.0), 500.0, 0.9)
    >>> round(float(low), 6), round(float(high), 6)
    (50.0, 950.0)
    >>> low, high = intervals(np.arange(1.0, 1000.0), 400.0, 0.9, "basic")
    >>> round(float(low), 6), round(float(high), 6)
    (-150.0, 750.0)
    """
    tail = 0.5 * (1.0 - checked_level(level))
    draws, centre = np.asarray(values, dtype=np.float64), np.asarray(at, dtype=np.float64)
    flat = draws.reshape(len(draws), -1)
    middle = np.broadcast_to(centre, draws.shape[1:]).ravel()
    if kind in ("percentile", "basic"):
        probabilities = np.tile([[tail], [1.0 - tail]], flat.shape[1])
    elif kind == "bca":
        probabilities = _corrected(flat, middle, tail)
    else:
        raise OptionError.found("kind=", kind, "'percentile', 'basic' or 'bca'", "choose one")
    low, high = quantiles(flat, probabilities)
    if kind == "basic":
        low, high = 2.0 * middle - high, 2.0 * middle - low
    return low.reshape(draws.shape[1:]), high.reshape(draws.shape[1:])


def _corrected(flat: Array, middle: Array, tail: float) -> Array:
    """Probabilities (2, n_quantities) of the BCa interval with acceleration zero."""
    normal = NormalDist()
    count = np.sum(~np.isnan(flat), axis=0)
    below = np.sum(flat < middle, axis=0) + 0.5 * np.sum(flat == middle, axis=0)
    # one draw's worth of room keeps z_0 finite when all draws lie on one side
    share = (below + 0.5) / (count + 1.0)
    shift = [2.0 * normal.inv_cdf(p) for p in share.tolist()]
    ends = normal.inv_cdf(tail), normal.inv_cdf(1.0 - tail)
    return np.array([[normal.cdf(two + end) for two in shift] for end in ends])


def quantiles(flat: Array, probabilities: Array) -> Array:
    """Quantile ``p`` is order statistic ``p (n + 1)`` of the draws that count, interpolated.

    Parameters
    ----------
    flat : ndarray, shape (n_draws, n_quantities)
        ``nan`` does not count.
    probabilities : ndarray, shape (n_probabilities, n_quantities)

    Returns
    -------
    ndarray, shape (n_probabilities, n_quantities)
        ``nan`` where no draw is left.

    Examples
    --------
    >>> quantiles(np.array([[3.0], [1.0], [np.nan], [2.0]]), np.array([[0.5], [0.25]]))
    array([[2.],
           [1.]])
    """
    ordered = np.sort(flat, axis=0)  # nan goes last
    count = np.sum(~np.isnan(flat), axis=0)
    place = np.clip(probabilities * (count + 1.0), 1.0, np.maximum(count, 1.0)) - 1.0
    below = np.floor(place).astype(np.intp)
    above = np.minimum(below + 1, np.maximum(count - 1, 0))
    part = place - below
    low = np.take_along_axis(ordered, below, axis=0)
    high = np.take_along_axis(ordered, above, axis=0)
    with np.errstate(invalid="ignore"):
        found = np.where((part == 0) | (low == high), low, (1.0 - part) * low + part * high)
    found[:, count == 0] = np.nan
    return np.asarray(found)
