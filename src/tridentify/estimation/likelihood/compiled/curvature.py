"""How coefficients move with the unknowns of a point in machine code (`likelihood.curvature`)."""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array, Complex, Indices
from tridentify.numerics.compiled import compiled
from tridentify.numerics.kernels.polynomials import expanded, numerator_table


@compiled(
    "float64[:,::1](complex128[::1], int64[::1], int64[::1], int64[:,::1], int64[:,::1],"
    " float64[:,::1], int64[::1], int64)"
)
def physical_of(
    poles: Complex, orders: Indices, firsts: Indices, group: Indices, zeros: Indices,
    basis: Array, starts: Indices, width: int,
) -> Array:  # fmt: skip
    """How coefficients, in the order of `Structure.names`, move with the unknowns of a point.

    Parameters
    ----------
    poles : (n_poles,) complex array
    orders, firsts, group, zeros
        Of `Problem.pattern`.
    basis : (n_poles, largest order) array
        Each group's numerators sorted by degree.
    starts : (n_outputs,) int array
        The first of the unknowns of each output's fit.
    width : int
        Of all unknowns.
    """
    count = poles.size
    for i in range(group.shape[0]):
        for j in range(group.shape[1]):
            count += zeros[i, j] + 1
    found, told = np.zeros((count, width)), np.zeros(orders.size, dtype=np.int64)
    place = 0
    for i in range(group.shape[0]):
        at = starts[i]
        for j in range(group.shape[1]):
            g, m = group[i, j], zeros[i, j]
            n, pole = orders[g], firsts[g]
            whole, table = expanded(poles[pole : pole + n]), numerator_table(poles[pole : pole + n])
            if not told[g]:
                told[g] = 1
                for k in range(n):
                    for d in range(n):
                        found[place + k, pole + d] = table[d, k]
                place += n
            for d in range(min(m + 1, n)):
                for k in range(max(m - n + 1, 0), m + 1):
                    for c in range(n):
                        found[place + k, at + d] += basis[pole + d, c] * table[c, n - m + k - 1]
            if m == n:
                for k in range(m + 1):
                    found[place + k, at + m] = whole[k]
            place += m + 1
            at += m + 1
    return found
