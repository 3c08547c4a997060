"""Least squares of small problems in machine code: `numerics.least_squares.solve`."""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array
from tridentify.numerics.compiled import compiled

CUTOFF = 1e-13
"""As in `numerics.least_squares`."""


@compiled("(float64[:,::1],)", inner=True)
def singular(matrix: Array) -> tuple[Array, Array, Array]:
    """Singular values and vectors."""
    u, s, vt = np.linalg.svd(matrix, full_matrices=False)
    return u, s, vt


@compiled("float64[:,::1](float64[:,:])", inner=True, linked=True)
def contiguous(matrix: Array) -> Array:
    """A copy row by row."""
    found = np.empty(matrix.shape)
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            found[i, j] = matrix[i, j]
    return found


@compiled("(float64[:,::1], float64[::1])")
def solve_small(matrix: Array, target: Array) -> tuple[Array, float, float, Array, Array]:
    """Least squares with unit columns, by SVD.

    Parameters
    ----------
    matrix : (m, n) array
    target : (m,) array

    Returns
    -------
    x : (n,) array
    cost : float
    condition : float
    basis : (m, rank) array
    residual : (m,) array
    """
    m, n = matrix.shape
    residual = target.copy()
    x = np.zeros(n)
    if n == 0:
        cost = 0.0
        for i in range(m):
            cost += target[i] * target[i]
        return x, cost, 1.0, np.zeros((m, 0)), residual
    scale = np.zeros(n)
    for i in range(m):
        for j in range(n):
            scale[j] += matrix[i, j] * matrix[i, j]
    for j in range(n):
        scale[j] = np.sqrt(scale[j]) if scale[j] > 0.0 else 1.0
    scaled = np.empty((m, n))
    for i in range(m):
        for j in range(n):
            scaled[i, j] = matrix[i, j] / scale[j]
    u, s, vt = singular(scaled)
    rank = 0
    for k in range(s.size):
        if s[k] > CUTOFF * s[0]:
            rank += 1
            share = 0.0
            for i in range(m):
                share += u[i, k] * target[i]
            share /= s[k]
            for j in range(n):
                x[j] += vt[k, j] * share
    for j in range(n):
        x[j] /= scale[j]
    cost = 0.0
    for i in range(m):
        fitted = 0.0
        for j in range(n):
            fitted += matrix[i, j] * x[j]
        residual[i] = target[i] - fitted
        cost += residual[i] * residual[i]
    condition = s[0] / s[-1] if s[-1] > 0.0 else np.inf
    basis = np.empty((m, rank))
    for i in range(m):
        for k in range(rank):
            basis[i, k] = u[i, k]
    return x, cost, condition, basis, residual
