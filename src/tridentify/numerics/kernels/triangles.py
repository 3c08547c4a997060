"""Triangles of tall matrices in machine code, for records of middling length.

Householder's reflections (Golub & Van Loan, Matrix Computations, 4th ed., section 5.2), column by
column along time, where the processor takes several samples at once. For a few dozen columns of
some hundred samples this takes half the time of LAPACK, which is made for larger ones.
"""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array
from tridentify.numerics.compiled import compiled

SMALLEST = 1e-290
"""Sum of squares below which a column counts as zero: one over it would not be finite."""


@compiled("float64(float64[::1], float64[::1])", inline=True, wide=True, any_order=True, inner=True)
def product(one: Array, other: Array) -> float:
    """Inner product."""
    total = 0.0
    for i in range(one.size):
        total += one[i] * other[i]
    return total


@compiled(
    "void(float64[::1], float64, float64[::1])", inline=True, wide=True, any_order=True, inner=True
)
def add_scaled(total: Array, weight: float, one: Array) -> None:
    """``total += weight one``."""
    for i in range(one.size):
        total[i] += weight * one[i]


@compiled("void(float64[:,::1], int64, int64, int64, float64[:,::1])", wide=True)
def triangularise(columns: Array, count: int, short: int, length: int, r: Array) -> None:
    """Upper triangle of a QR factorisation.

    Parameters
    ----------
    columns : (n, >= count) array
        One row a column of the matrix; is used up.
    count : int
        Rows of the matrix.
    short, length : int
        The first so many columns are zero from row ``length`` on.
    r : (n, n) array
        Receives the triangle.
    """
    n = columns.shape[0]
    for k in range(n):
        for j in range(k):
            r[k, j] = 0.0
        end = min(length, count) if k < short else count
        if k >= count:
            for j in range(k, n):
                r[k, j] = 0.0
            continue
        if k < end:
            own = columns[k, k:end]
            square = product(own, own)
            if square > SMALLEST:
                beta = -np.copysign(np.sqrt(square), own[0])
                own[0] -= beta
                scale = 1.0 / (beta * own[0])
                for j in range(k + 1, n):
                    other = columns[j, k:end]
                    add_scaled(other, scale * product(own, other), own)
                own[0] = beta
        for j in range(k, n):
            r[k, j] = columns[j, k]
