"""What groups of columns explain of a residual, in machine code: `numerics.lagrange.added_each`."""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.compiled import compiled
from tridentify.numerics.kernels.triangles import add_scaled, product, triangularise


@compiled(
    "float64[:,::1](float64[:,::1], float64[:,::1], int64[::1], float64)", wide=True, free=True
)
def explained_each(columns: Array, basis: Array, firsts: Indices, cutoff: float) -> Array:
    """Sums of squares of a residual along several groups of columns, each by itself.

    Parameters
    ----------
    columns : (m + 1, n) array
        One row a column, the residual last. They become what the basis does not hold of them, the
        others scaled to unit length before.
    basis : (p, n) array
        Orthonormal rows.
    firsts : (k + 1,) int array
        Where each group begins, and the last one ends.
    cutoff : float
        Singular values of a group that may be below this are left to the caller.

    Returns
    -------
    (k, 2) array
        For each group what it explains, and of how many dimensions; less than zero where singular
        values decide.
    """
    many, n = columns.shape[0] - 1, columns.shape[1]
    there = np.zeros(many, dtype=np.bool_)
    for j in range(many + 1):
        if j < many:
            size = np.sqrt(product(columns[j], columns[j]))
            there[j] = size > 0.0
            if there[j]:
                for t in range(n):
                    columns[j, t] /= size
        for _ in range(2):
            for k in range(basis.shape[0]):
                add_scaled(columns[j], -product(basis[k], columns[j]), basis[k])
    found = np.zeros((firsts.size - 1, 2))
    for g in range(firsts.size - 1):
        q = 0
        for j in range(firsts[g], firsts[g + 1]):
            q += there[j]
        if q == 0:
            continue
        if n <= q:
            found[g, 1] = -1.0
            continue
        own, r, at = np.empty((q + 1, n)), np.empty((q + 1, q + 1)), 0
        for j in range(firsts[g], firsts[g + 1]):
            if there[j]:
                for t in range(n):
                    own[at, t] = columns[j, t]
                at += 1
        for t in range(n):
            own[q, t] = columns[many, t]
        triangularise(own, n, 0, n, r)
        # one over the length of the inverse is no more than the smallest singular value
        square = 0.0
        inverse = np.zeros((q, q))
        for c in range(q):
            if r[c, c] == 0.0:
                square = np.inf
                break
            inverse[c, c] = 1.0 / r[c, c]
            for i in range(c - 1, -1, -1):
                total = 0.0
                for k in range(i + 1, c + 1):
                    total += r[i, k] * inverse[k, c]
                inverse[i, c] = -total / r[i, i]
            for i in range(c + 1):
                square += inverse[i, c] * inverse[i, c]
        if not cutoff * np.sqrt(square) < 1.0:
            found[g, 1] = -1.0
            continue
        for i in range(q):
            found[g, 0] += r[i, q] * r[i, q]
        found[g, 1] = q
    return found
