"""Medians and quantiles of samples: numpy's, without what those do for any other array.

On a few hundred samples numpy spends ten times as long on axes, masks and ``nan`` as on the numbers
themselves, and a look at a residual asks for some twenty of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tridentify.numerics.arrays import Array

ONE_SIGMA = 0.6826894921370859
"""Probability within one standard deviation of a Gaussian, erf(1 / sqrt 2)."""
ROOM = 0.1
"""Least distance of a value from one end of its interval, over that from the other end: what stands
at the very end of an interval looks like a mistake, and is not where half of the rest may be."""


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


def around(values: Array, at: Array, level: float) -> tuple[Array, Array]:
    """Intervals of draws that leave out as much on either side of a value as lies there.

    With ``p`` the share of the draws below the value, the interval leaves ``(1 - level) p`` of the
    draws below it and ``(1 - level) (1 - p)`` above: it holds ``level`` of all, and the value
    divides what is inside as it divides the whole. For a value at the median it is the central
    interval. Every monotone function of the quantity, its value along, has the interval's image: a
    natural frequency that of its square, a time constant that of its pole.

    An interval is drawn out where the value lies beyond, or nearly beyond, all draws, so that it is
    `ROOM` away from the end; where all have one sign this is measured by the logarithm.

    Parameters
    ----------
    values : (n_draws, ...) array
        ``nan`` does not count.
    at : (...) array
        The values; of one that is not finite the interval is the central one.
    level : float

    Returns
    -------
    low, high : (...) arrays
        ``nan`` where no draw counts.

    Examples
    --------
    >>> draws = np.arange(1.0, 1002.0)
    >>> [round(float(end), 9) for end in around(draws, np.array(501.0), 0.9)]
    [51.0, 951.0]
    >>> [round(float(end), 2) for end in around(draws, np.array(101.0), 0.9)]
    [11.04, 911.04]
    >>> [round(float(end) ** 0.5, 2) for end in around(draws**2, np.array(101.0**2), 0.9)]
    [11.04, 911.04]
    """
    shape = values.shape[1:]
    flat = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
    middle = np.broadcast_to(np.asarray(at, dtype=np.float64), shape).ravel()
    ordered = np.sort(flat, axis=0)  # nan goes last
    count = np.sum(~np.isnan(flat), axis=0)
    lower = np.sum(flat < middle, axis=0) + 0.5 * np.sum(flat == middle, axis=0)
    share = np.where(np.isfinite(middle), lower / np.maximum(count, 1), 0.5)
    low = _ordered_at(ordered, count, (1.0 - level) * share)
    high = _ordered_at(ordered, count, 1.0 - (1.0 - level) * (1.0 - share))
    last = np.take_along_axis(ordered, np.maximum(count - 1, 0)[None], axis=0)[0]
    positive = (ordered[0] > 0.0) & (middle > 0.0)
    negative = (last < 0.0) & (middle < 0.0)
    low, high = _with_room(low, high, middle, np.where(positive, 1, np.where(negative, -1, 0)))
    return low.reshape(shape), high.reshape(shape)


def _ordered_at(ordered: Array, count: Array, share: Array) -> Array:
    """Quantile of every column, by numpy's linear rule."""
    place = share * np.maximum(count - 1, 0)
    below = np.floor(place).astype(np.intp)
    above = np.minimum(below + 1, np.maximum(count - 1, 0))
    near = np.take_along_axis(ordered, below[None], axis=0)[0]
    far = np.take_along_axis(ordered, above[None], axis=0)[0]
    part = place - below
    with np.errstate(invalid="ignore"):
        mixed = near + (far - near) * part
    lost = np.isinf(near) | np.isinf(far)
    mixed = np.where(lost, np.where(part < 0.5, near, far), mixed)
    return np.asarray(np.where((near == far) | (part == 0.0), near, mixed))


def _with_room(low: Array, high: Array, middle: Array, sign: Array) -> tuple[Array, Array]:
    """The ends at least `ROOM` away from the value, by logarithms where there is one sign."""

    def scale(x: Array) -> Array:
        return np.where(sign == 0, x, sign * np.log(np.where(sign == 0, 1.0, np.abs(x))))

    def back(x: Array) -> Array:
        return np.where(sign == 0, x, sign * np.exp(np.where(sign == 0, 0.0, sign * x)))

    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        start, value, end = scale(low), scale(middle), scale(high)
        below, above = np.maximum(end - value, 0.0), np.maximum(value - start, 0.0)
        below, above = (ROOM * np.where(np.isfinite(one), one, 0.0) for one in (below, above))
        known = np.isfinite(value)
        return (
            np.where(known & (value - start < below), back(value - below), low),
            np.where(known & (end - value < above), back(value + above), high),
        )
