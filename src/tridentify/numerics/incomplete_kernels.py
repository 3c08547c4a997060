"""The loops of `numerics.incomplete` as machine code."""

from __future__ import annotations

import numba
import numpy as np

from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.compiled import compiled

_WHOLE, _NUMBER = numba.int64, numba.float64
_VECTOR, _TABLE, _PLACES = _NUMBER[::1], _NUMBER[:, ::1], numba.int64[::1]

SUFFICIENT, CURVED = 1e-4, 0.9
"""Of the Wolfe conditions: share of the slope that a step must gain, and that it leaves at most
where it tells of the curvature."""
SHORTEST = 0.1
"""Share of a step that is tried next, at least: a parabola says little of what is far off."""


@compiled(_TABLE(_VECTOR), any_order=True, inner=True)
def partial_sums(a: Array) -> Array:
    """``sum a_v a_{v + lag}`` over ``v = u .. p - lag``, at ``[u, lag]``.

    Of the inverse covariance of ``n > 2 p`` samples the entry ``(i, j)``, ``i <= j``, is the value
    at ``[0, j - i]`` less those at ``[i + 1, j - i]`` and ``[n - j, j - i]``, which are zero away
    from the ends.
    """
    p = a.size - 1
    found = np.zeros((p + 2, p + 1))
    for lag in range(p + 1):
        for u in range(p - lag, -1, -1):
            found[u, lag] = found[u + 1, lag] + a[u] * a[u + lag]
    return found


@compiled(_NUMBER(_TABLE, _VECTOR, _PLACES, _TABLE, _TABLE, _VECTOR), any_order=True, inner=True)
def complete(
    sums: Array, x: Array, missing: Indices, band: Array, inverse: Array, expected: Array
) -> float:
    """Put the conditional means into ``x`` and ``Q_mm^{-1}`` into ``inverse``; log det ``Q_mm``.

    ``band[i, l]`` and ``inverse[i, l]`` belong to the missing samples ``i`` and ``i + l``; ``x`` is
    zero at the missing samples. Infinite where rounding makes the matrix indefinite.
    """
    p, n, count = sums.shape[1] - 1, x.size, missing.size
    reach = np.zeros(count, dtype=np.int64)
    for i in range(count):
        at, width = missing[i], 0
        while i + width < count and missing[i + width] - at <= p:
            j = missing[i + width]
            lag = j - at
            band[i, width] = (
                sums[0, lag] - sums[min(at + 1, p + 1), lag] - sums[min(n - j, p + 1), lag]
            )
            width += 1
        reach[i] = width
        total = 0.0
        for t in range(max(at - p, 0), min(at + p, n - 1) + 1):
            low, high = min(t, at), max(t, at)
            lag = high - low
            entry = sums[0, lag]
            if low < p:
                entry -= sums[low + 1, lag]
            if n - high <= p:
                entry -= sums[n - high, lag]
            total += x[t] * entry
        expected[i] = -total
    log_determinant = 0.0
    for i in range(count):
        pivot = band[i, 0]
        if not pivot > 0.0:
            return np.inf
        log_determinant += np.log(pivot)
        for k in range(1, reach[i]):
            weight = band[i, k] / pivot
            for q in range(k, reach[i]):
                band[i + k, q - k] -= weight * band[i, q]
            expected[i + k] -= weight * expected[i]
        for k in range(1, reach[i]):
            band[i, k] /= pivot
        expected[i] /= pivot
    for i in range(count - 1, -1, -1):
        pivot = band[i, 0]
        corner = 1.0 / pivot
        for k in range(1, reach[i]):
            expected[i] -= band[i, k] * expected[i + k]
        for k in range(reach[i] - 1, 0, -1):
            total = 0.0
            for q in range(1, reach[i]):
                other = inverse[i + q, k - q] if q <= k else inverse[i + k, q - k]
                total -= band[i, q] * other
            inverse[i, k] = total
            corner -= band[i, k] * total
        inverse[i, 0] = corner
        x[missing[i]] = expected[i]
    return log_determinant


@compiled(numba.void(_WHOLE, _VECTOR, _PLACES, _TABLE, _TABLE, _TABLE), any_order=True, inner=True)
def tables(
    p: int, x: Array, missing: Indices, inverse: Array, products: Array, spread: Array
) -> None:
    """Add a series to the upper triangles of ``D`` (``products``) and of ``E`` (``spread``)."""
    n, count = x.size, missing.size
    along = np.zeros(p + 1)
    first, last = np.zeros((p + 1, p + 1)), np.zeros((p + 1, p + 1))
    for i in range(count):
        for k in range(count - i):
            lag = missing[i + k] - missing[i]
            if lag > p:
                break
            along[lag] += inverse[i, k]
            if missing[i + k] <= p:
                first[missing[i], lag] = inverse[i, k]
            if missing[i] >= n - 1 - p:
                last[n - 1 - missing[i + k], lag] = inverse[i, k]
    for lag in range(p + 1):
        total = 0.0
        for t in range(n - lag):
            total += x[t] * x[t + lag]
        for i in range(p + 1 - lag):
            products[i, i + lag] += total
            spread[i, i + lag] += along[lag]
            total -= x[i] * x[i + lag] + x[n - 1 - i - lag] * x[n - 1 - i]
            along[lag] -= first[i, lag] + last[i, lag]


@compiled(numba.void(_VECTOR, _VECTOR, _TABLE), any_order=True)
def levinson(k: Array, a: Array, slopes: Array) -> None:
    """``a_0 = 1, a_1 .. a_p`` of reflection coefficients, and ``slopes[i, j] = d a_{i+1} / d k_j``.

    Both are zero on entry.
    """
    p = k.size
    a[0] = 1.0
    old, turned = np.empty(p + 1), np.empty((p, p))
    for m in range(1, p + 1):
        for i in range(m):
            old[i] = a[i]
        old[m] = 0.0
        for i in range(1, m + 1):
            a[i] = old[i] + k[m - 1] * old[m - i]
        for i in range(m - 1):
            for j in range(m - 1):
                turned[i, j] = slopes[m - 2 - i, j]
        for i in range(m - 1):
            for j in range(m - 1):
                slopes[i, j] += k[m - 1] * turned[i, j]
            slopes[i, m - 1] = old[m - 1 - i]
        slopes[m - 1, m - 1] = 1.0


@compiled(numba.void(_TABLE, _VECTOR, _VECTOR, _VECTOR, _NUMBER), any_order=True, inner=True)
def update(inverse: Array, step: Array, before: Array, after: Array, length: float) -> None:
    """The inverse of the matrix of second derivatives after a step, in place (BFGS)."""
    p = step.size
    half, along, across = np.empty((p, p)), np.zeros(p), np.zeros(p)
    product = 0.0
    for i in range(p):
        product += length * step[i] * (after[i] - before[i])
        for j in range(p):
            along[i] += inverse[i, j] * (after[j] - before[j])
    weight = 1000.0 if product == 0.0 else 1.0 / product
    for i in range(p):
        for j in range(p):
            half[i, j] = inverse[i, j] - along[i] * length * step[j] * weight
            across[j] += (after[i] - before[i]) * half[i, j]
    for i in range(p):
        taken = length * step[i]
        for j in range(p):
            inverse[i, j] = half[i, j] - taken * across[j] * weight
            inverse[i, j] += weight * taken * length * step[j]


@compiled(_NUMBER(_VECTOR, _VECTOR, _PLACES, _PLACES, _PLACES, _WHOLE, _VECTOR), any_order=True)
def value(
    k: Array,
    filled: Array,
    ends: Indices,
    missing: Indices,
    gone: Indices,
    count: int,
    slope: Array,
) -> float:
    """``-2 log L`` of reflection coefficients, and its derivatives by them into ``slope``.

    Series ``i`` is ``filled[ends[i] : ends[i + 1]]``, zero at its missing samples, which are
    ``missing[gone[i] : gone[i + 1]]``; ``count`` samples are there in all.
    """
    p, several = k.size, ends.size - 1
    a, slopes = np.zeros(p + 1), np.zeros((p, p))
    levinson(k, a, slopes)
    sums = partial_sums(a)
    products, spread = np.zeros((p + 1, p + 1)), np.zeros((p + 1, p + 1))
    log_determinant = 0.0
    for i in range(p):
        log_determinant -= several * (i + 1.0) * np.log(1.0 - k[i] * k[i])
    for s in range(several):
        x, own = filled[ends[s] : ends[s + 1]].copy(), missing[gone[s] : gone[s + 1]]
        # the most of them that are within p samples
        width, last = 1, 0
        for i in range(own.size):
            while last < own.size and own[last] <= own[i] + p:
                last += 1
            width = max(width, last - i)
        band, inverse = np.zeros((own.size, width)), np.zeros((own.size, width))
        log_determinant += complete(sums, x, own, band, inverse, np.zeros(own.size))
        tables(p, x, own, inverse, products, spread)
    for j in range(p):
        slope[j] = 0.0
    if not np.isfinite(log_determinant):
        return np.inf
    energy, by_polynomial, by_spread = 0.0, np.zeros(p + 1), np.zeros(p + 1)
    for i in range(p + 1):
        for j in range(p + 1):
            low, high = min(i, j), max(i, j)
            by_polynomial[i] += products[low, high] * a[j]
            by_spread[i] += spread[low, high] * a[j]
        energy += a[i] * by_polynomial[i]
    energy = max(energy, 1e-300)
    n = max(count, 1)
    for j in range(p):
        total = 0.0
        for i in range(p):
            total += 2.0 * (n / energy * by_polynomial[i + 1] + by_spread[i + 1]) * slopes[i, j]
        slope[j] = total + several * 2.0 * (j + 1.0) * k[j] / (1.0 - k[j] * k[j])
    found: float = n * np.log(energy / n) + log_determinant
    return found


@compiled(_NUMBER(_NUMBER, _NUMBER), inner=True)
def _shortened(rise: float, down: float) -> float:
    """Share of a step by the parabola through its ends and its slope, a tenth to a half."""
    if not np.isfinite(rise):
        return SHORTEST
    return min(max(-0.5 * down / (rise - down), SHORTEST), 0.5)


@compiled(
    numba.void(
        _VECTOR, _TABLE, _VECTOR, _NUMBER, _NUMBER, _WHOLE,
        _VECTOR, _PLACES, _PLACES, _PLACES, _WHOLE,
    ),
    any_order=True,
)  # fmt: skip
def descend(
    start: Array, root: Array, moved: Array, farthest: float, still: float, most: int,
    filled: Array, ends: Indices, missing: Indices, gone: Indices, count: int,
) -> None:  # fmt: skip
    """Minimise half of `value` at ``tanh(start + root moved)`` over ``moved``, in place.

    By BFGS steps that are shortened until they gain enough (J. Nocedal & S. Wright, *Numerical
    Optimization*, 2nd ed., chapters 3 and 6, 2006). What a step tells of the curvature is taken
    where it tells any.
    """
    p = moved.size
    k, by_k, slope, after = np.empty(p), np.empty(p), np.zeros(p), np.zeros(p)
    step, trial, inverse = np.zeros(p), moved.copy(), np.zeros((p, p))
    now, before, down, length = np.inf, 0.0, 0.0, 0.0
    for turn in range(most + 1):
        for i in range(p):
            total = start[i]
            for j in range(p):
                total += root[i, j] * trial[j]
            k[i] = min(max(np.tanh(total), -farthest), farthest)
        there = 0.5 * value(k, filled, ends, missing, gone, count, by_k)
        if turn > 0 and not there <= now + SUFFICIENT * length * down:
            length *= _shortened(there - now, length * down)
        else:
            along, largest, square = 0.0, 0.0, 0.0
            for j in range(p):
                after[j] = 0.0
                for i in range(p):
                    after[j] += 0.5 * by_k[i] * (1.0 - k[i] * k[i]) * root[i, j]
                along += after[j] * step[j]
                largest = max(largest, abs(after[j]))
                square += after[j] * after[j]
            if turn == 0:
                now = there
                before = now + 0.5 * np.sqrt(square)
                for i in range(p):
                    inverse[i, i] = 1.0
            else:
                before = now
                if along > CURVED * down:
                    update(inverse, step, slope, after, length)
            now = there
            for i in range(p):
                moved[i], slope[i] = trial[i], after[i]
            if not largest > still:
                return
            down = 0.0
            for i in range(p):
                step[i] = 0.0
                for j in range(p):
                    step[i] -= inverse[i, j] * slope[j]
                down += slope[i] * step[i]
            if not down < 0.0:
                return
            length = min(1.0, 1.01 * 2.0 * (now - before) / down)
            if length < 0.0:
                length = 1.0
        for i in range(p):
            trial[i] = moved[i] + length * step[i]
