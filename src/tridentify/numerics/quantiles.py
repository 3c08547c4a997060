"""Medians and quantiles of samples: numpy's, without what those do for any other array.

On a few hundred samples numpy spends ten times as long on axes, masks and ``nan`` as on the numbers
themselves, and a look at a residual asks for some twenty of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tridentify.numerics.arrays import Array


def median(values: Array) -> float:
    """As `numpy.median`.

    Parameters
    ----------
    values : (n,) array
        No ``nan``; that of none is ``nan``.

    Examples
    --------
    >>> median(np.array([3.0, 1.0, 2.0])), median(np.array([4.0, 3.0, 1.0, 2.0]))
    (2.0, 2.5)
    """
    if not values.size:
        return math.nan
    half = values.size // 2
    if values.size % 2:
        return float(np.partition(values, half)[half])
    low, high = np.partition(values, (half - 1, half))[half - 1 : half + 1]
    return float(0.5 * (low + high))


def root_mean_square(values: Array) -> float:
    """Of the samples that are there.

    Parameters
    ----------
    values : (n,) array
        ``nan`` marks a missing sample; that of none is ``nan``.

    Examples
    --------
    >>> root_mean_square(np.array([3.0, np.nan, -3.0]))
    3.0
    """
    seen = values[np.isfinite(values)]
    return math.sqrt(float(seen @ seen) / seen.size) if seen.size else math.nan


def quantiles(values: Array, shares: Sequence[float]) -> Array:
    """As `numpy.quantile` with its linear rule.

    Parameters
    ----------
    values : (n,) array
        Not empty, no ``nan``; between infinite ones there is nothing, so that the nearer counts.
    shares : sequence of float
        Of the samples that lie below, 0 to 1.

    Returns
    -------
    (n_shares,) array

    Examples
    --------
    >>> quantiles(np.array([3.0, 1.0, 2.0]), (0.5, 0.75)).tolist()
    [2.0, 2.5]
    >>> quantiles(np.array([-np.inf, 1.0, np.inf, np.inf]), (0.1, 0.9)).tolist()
    [-inf, inf]
    """
    at = [share * (values.size - 1) for share in shares]
    below = [min(int(one), values.size - 1) for one in at]
    above = [min(one + 1, values.size - 1) for one in below]
    ordered = np.partition(values, sorted({*below, *above}))
    found = []
    for one, i, j in zip(at, below, above, strict=True):
        low, high = float(ordered[i]), float(ordered[j])
        part = one - i
        if low == high or part == 0.0:
            found.append(low)
        elif math.isinf(low) or math.isinf(high):
            found.append(low if part < 0.5 else high)
        else:  # from the nearer side, so that the ends are met exactly
            near = low + (high - low) * part if part < 0.5 else high - (high - low) * (1.0 - part)
            found.append(near)
    return np.array(found)
