"""Reweighted least squares in machine code: `causes.signals.surprises`."""

from __future__ import annotations

import numpy as np
from numba import float64, int64

from tridentify.numerics.arrays import Array
from tridentify.numerics.compiled import compiled, read_only

DEPENDENT = 1e-12
"""Share of a direction's weight that those before it must leave for it to be fitted."""

NORMAL = 1.4826
"""Standard deviation of a Gaussian over the median of its absolute values."""


@compiled(float64(read_only(2), read_only(1), int64, float64, float64[::1]), any_order=True)
def robustly(basis: Array, wanted: Array, rounds: int, least: float, left: Array) -> float:
    """Fit by Huber's weights, which find the way from anywhere, then by none for what is large.

    Parameters
    ----------
    basis : (k, n) array
        Orthonormal rows.
    wanted : (n,) array
    rounds : int
        Of which the first half are by Huber's weights.
    least : float
        Scale from which what is left counts for rounding, and the fit ends.
    left : (n,) array
        Is given what the fit leaves.

    Returns
    -------
    float
        Scale of what is left, from the median of its absolute values.
    """
    k, n = basis.shape
    weight, weighted = np.ones(n), np.empty(n)
    table, found, scale = np.empty((k, k)), np.empty(k), 0.0
    for turn in range(rounds):
        for i in range(k):
            for t in range(n):
                weighted[t] = weight[t] * basis[i, t]
            total = 0.0
            for t in range(n):
                total += weighted[t] * wanted[t]
            found[i] = total
            for j in range(i + 1):
                total = 0.0
                for t in range(n):
                    total += weighted[t] * basis[j, t]
                table[i, j] = total
        # Cholesky's triangle in place, without directions that the weights leave none of
        for j in range(k):
            pivot = table[j, j]
            for m in range(j):
                pivot -= table[j, m] * table[j, m]
            free = pivot > DEPENDENT * table[j, j]
            table[j, j] = np.sqrt(pivot) if free else 0.0
            for i in range(j + 1, k):
                total = table[i, j]
                for m in range(j):
                    total -= table[i, m] * table[j, m]
                table[i, j] = total / table[j, j] if free else 0.0
            for m in range(j):
                found[j] -= table[j, m] * found[m]
            found[j] = found[j] / table[j, j] if free else 0.0
        for j in range(k - 1, -1, -1):
            for i in range(j + 1, k):
                found[j] -= table[i, j] * found[i]
            found[j] = found[j] / table[j, j] if table[j, j] > 0.0 else 0.0
        for t in range(n):
            left[t] = wanted[t]
        for i in range(k):
            for t in range(n):
                left[t] -= found[i] * basis[i, t]
        scale = NORMAL * np.median(np.abs(left))
        if scale <= least:
            break
        for t in range(n):
            size = np.abs(left[t]) / scale
            if turn < rounds // 2:
                weight[t] = 1.0 / max(size / 1.345, 1.0)
            else:
                weight[t] = max(1.0 - (size / 4.685) ** 2, 0.0) ** 2
    return scale
