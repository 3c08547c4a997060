"""Exact likelihood of an autoregression where samples are missing, with its derivative.

With ``S`` the covariance of a whole series (innovations of variance one), ``Q = S^{-1}``, and the
index ``m`` for the samples that are missing, ``o`` for those that are there,

    log det S_oo = log det S + log det Q_mm,        y_o' S_oo^{-1} y_o = min x' Q x   over ``x_m``

(the second by completing the square: the minimum lies at the conditional mean ``x_m = -Q_mm^{-1}
Q_mo y_o``). ``Q`` of an autoregression of order ``p`` has ``p`` diagonals beside the main one
(Gohberg & Semencul 1972), so that ``Q_mm`` costs ``O(p^2)`` for each *missing* sample, and nothing
for the others. For a whole series ``x' Q x`` is a quadratic form in the coefficients,

    x' Q x = sum_ij a_i a_j D_ij,       D_ij = sum_s x_{s+i} x_{s+j},   s = 0 .. n - 1 - i - j

(Box, Jenkins & Reinsel, *Time Series Analysis*, 4th ed., section 7.4, 2008), and ``log det S = -
sum_i i log(1 - k_i^2)`` in the reflection coefficients. The derivative by the coefficients follows
from the same two tables: at the minimum that of ``x_m`` does not count, and ``d log det Q_mm = tr
Q_mm^{-1} dQ_mm`` has the table ``E`` that ``D`` would be with ``Q_mm^{-1}`` for the products of the
missing samples; of this inverse only the entries within the band are computed (Takahashi's
recursion, from the last backwards). One value with all derivatives therefore costs about as much
as one filtering of the series.

References: I. Gohberg & A. Semencul, Mat. Issled. 7 (1972) 201-223. R. Jones, Technometrics 22
(1980) 389-395. A. Erisman & W. Tinney, Communications of the ACM 18 (1975) 177-179.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular, toeplitz
from scipy.optimize import minimize

from tridentify.numerics.arrays import Array
from tridentify.numerics.levinson import covariance

Places = NDArray[np.int64]

GRADIENT_STILL = 1e-4
"""Of the derivative at the end, in units of the standard errors: the coefficients are as near."""
MOST_ITERATIONS = 60
"""From Burg's coefficients a handful is enough; many missing samples take some more."""
FARTHEST = 1.0 - 1e-5
"""Largest reflection coefficient: beyond it no series tells a process from one that drifts."""


def _partial_sums(a: Array) -> Array:
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


def _complete(
    sums: Array, x: Array, missing: Places, band: Array, inverse: Array, expected: Array
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


def _tables(
    p: int, x: Array, missing: Places, inverse: Array, products: Array, spread: Array
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


def _levinson(k: Array, a: Array, slopes: Array) -> None:
    """``a_0 = 1, a_1 .. a_p`` of reflection coefficients, and ``slopes[i, j] = d a_{i+1} / d k_j``.

    Both are zero on entry.
    """
    p = k.size
    a[0] = 1.0
    old, turned = np.empty(p + 1), np.empty((p, p))
    for m in range(1, p + 1):
        old[:m] = a[:m]
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


@cache
def _compiled() -> tuple[Callable[..., Any], ...]:
    """The loops as machine code (compiled at the first call, afterwards read from disk)."""
    import numba

    number, whole = numba.float64, numba.int64
    vector, table, places = number[::1], number[:, ::1], numba.int64[::1]
    loops = (
        (_partial_sums, table(vector)),
        (_complete, number(table, vector, places, table, table, vector)),
        (_tables, numba.void(whole, vector, places, table, table, table)),
        (_levinson, numba.void(vector, vector, table)),
    )
    found: list[Callable[..., Any]] = []
    # sums may be taken in any order, which lets the processor take several samples at once
    order = {"reassoc", "nsz", "contract"}
    for loop, signature in loops:
        try:
            found.append(numba.njit(signature, cache=True, fastmath=order)(loop))
        except RuntimeError:  # no folder on this machine can hold the cache
            found.append(numba.njit(signature, fastmath=order)(loop))
    return tuple(found)


class Incomplete:
    """The likelihood of autoregressions of one or several series in which samples are missing.

    Parameters
    ----------
    series : sequence of (n_samples,) arrays
        ``nan`` marks a missing sample. No mean is taken off.
    most : int
        Highest order that will be asked for.

    Attributes
    ----------
    count : int
        Samples that are there.

    Examples
    --------
    >>> series = np.array([2.0, 1.0, np.nan, 0.25, 0.125, 1.0, 0.5])
    >>> likelihood = Incomplete([series], 1)
    >>> likelihood.deviance(np.zeros(1)) > likelihood.deviance(np.array([-0.5]))
    True
    """

    def __init__(self, series: Sequence[Array], most: int) -> None:
        self._rows: list[tuple[Array, Places]] = []
        self.count = 0
        for one in series:
            # the forms hold from 2 p + 1 samples on; those that are not there do not count
            padded = np.pad(one, (0, max(2 * most + 1 - one.size, 0)), constant_values=np.nan)
            missing = np.flatnonzero(np.isnan(padded)).astype(np.int64)
            self._rows.append((np.nan_to_num(padded), missing))
            self.count += padded.size - missing.size

    def deviance(self, reflection: Array) -> float:
        """``-2 log L`` up to a constant, the innovations' variance at its best value.

        Parameters
        ----------
        reflection : (p,) array
            Reflection coefficients, below one in size.
        """
        return self.with_slopes(reflection)[0]

    def with_slopes(self, reflection: Array) -> tuple[float, Array]:
        """The same with its derivatives by the reflection coefficients."""
        partial_sums, complete, tables, levinson = _compiled()
        k, p = np.array(reflection, dtype=np.float64), reflection.size
        a, slopes = np.zeros(p + 1), np.zeros((p, p))
        levinson(k, a, slopes)
        sums = partial_sums(a)
        products, spread = np.zeros((2, p + 1, p + 1))
        orders = np.arange(1.0, p + 1.0)
        free = 1.0 - k * k
        log_determinant = -len(self._rows) * float(orders @ np.log(free))
        for zeros, missing in self._rows:
            x, size = zeros.copy(), missing.size
            # the most of them that are within p samples
            width = int(
                np.max(np.searchsorted(missing, missing + p + 1) - np.arange(size), initial=1)
            )
            band, inverse = np.zeros((2, size, width))
            log_determinant += complete(sums, x, missing, band, inverse, np.zeros(size))
            tables(p, x, missing, inverse, products, spread)
        if not math.isfinite(log_determinant):
            return math.inf, np.zeros(p)
        products += np.triu(products, 1).T
        spread += np.triu(spread, 1).T
        energy = max(float(a @ products @ a), 1e-300)
        n = max(self.count, 1)
        by_polynomial = 2.0 * ((n / energy * products + spread) @ a)[1:]
        slope = by_polynomial @ slopes + len(self._rows) * 2.0 * orders * k / free
        return n * math.log(energy / n) + log_determinant, slope

    def best(self, reflection: Array) -> Array:
        """Reflection coefficients of highest likelihood near the given ones.

        They are sought as ``tanh`` of what has no bounds, in units of its standard errors there.
        """
        start = np.arctanh(np.clip(reflection, -FARTHEST, FARTHEST))
        root = self._root(np.tanh(start))

        def halved(moved: Array) -> tuple[float, Array]:
            k = np.clip(np.tanh(start + root @ moved), -FARTHEST, FARTHEST)
            value, slope = self.with_slopes(k)
            return 0.5 * value, 0.5 * ((slope * (1.0 - k * k)) @ root)

        found = minimize(
            halved,
            np.zeros(start.size),
            jac=True,
            method="BFGS",
            options={"gtol": GRADIENT_STILL, "maxiter": MOST_ITERATIONS},
        )
        return np.clip(np.tanh(start + root @ found.x), -FARTHEST, FARTHEST)

    def _root(self, k: Array) -> Array:
        """A root of the covariance of ``arctanh k`` for a whole series (Fisher's information)."""
        levinson = _compiled()[3]
        a, slopes = np.zeros(k.size + 1), np.zeros((k.size, k.size))
        levinson(k, a, slopes)
        slopes *= 1.0 - k * k
        information = max(self.count, 1) * slopes.T @ toeplitz(covariance(k)[: k.size]) @ slopes
        try:
            upper = cholesky(information)
        except np.linalg.LinAlgError:
            return np.eye(k.size) / math.sqrt(max(self.count, 1))
        return np.asarray(solve_triangular(upper, np.eye(k.size)))
