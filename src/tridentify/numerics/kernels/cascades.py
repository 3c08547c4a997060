"""Orthonormal cascades in machine code: what `numerics.realization` derives, without Python.

One call builds all of a bank: for each denominator (a group of poles) the cascade of its poles
repeated, the basis of its numerators sorted by degree, and how its filter answers to each state.

*The map.* ``A_c P + P A' = - B_c r`` for some rows ``r`` (`realization.filter_map`: every unit
row). ``A`` is lower triangular but for the pairs on its diagonal, so the columns of ``P`` follow
one another, section by section: a real pole at state ``m`` gives

    (A_c + a_mm I) P_m = - B_c r_m - sum_{d < m} a_md P_d,

a pair two such systems coupled by its block. All rows are right-hand sides of the same matrix.
The systems have the size of the filter, or twice that, instead of its product with the bank's.
"""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array, Complex, Indices
from tridentify.numerics.compiled import compiled


@compiled("void(float64[:,:], float64[:,:])")
def solve_in_place(matrix: Array, sides: Array) -> None:
    """Gaussian elimination with row pivots; ``sides`` (n, k) become the solutions."""
    n, k = sides.shape
    for c in range(n):
        best, size = c, abs(matrix[c, c])
        for i in range(c + 1, n):
            if abs(matrix[i, c]) > size:
                best, size = i, abs(matrix[i, c])
        if best != c:
            for j in range(c, n):
                matrix[c, j], matrix[best, j] = matrix[best, j], matrix[c, j]
            for j in range(k):
                sides[c, j], sides[best, j] = sides[best, j], sides[c, j]
        pivot = matrix[c, c]
        if pivot == 0.0:
            for j in range(k):
                for i in range(n):
                    sides[i, j] = np.nan
            return
        for i in range(c + 1, n):
            share = matrix[i, c] / pivot
            if share != 0.0:
                for j in range(c + 1, n):
                    matrix[i, j] -= share * matrix[c, j]
                for j in range(k):
                    sides[i, j] -= share * sides[c, j]
    for c in range(n - 1, -1, -1):
        for j in range(k):
            total = sides[c, j]
            for i in range(c + 1, n):
                total -= matrix[c, i] * sides[i, j]
            sides[c, j] = total / matrix[c, c]


@compiled("void(complex128[:], int64, float64[:,:], float64[:])")
def fill_cascade(poles: Complex, repeats: int, a: Array, b: Array) -> None:
    """``A`` and ``B`` of the poles, ``repeats`` times each, into arrays of zeros."""
    n = poles.size
    q = n * repeats
    section = np.empty(q, dtype=np.int64)
    number = 0
    for i in range(q):
        z = poles[i % n]
        if not z.real < 0.0:
            raise ValueError("a cascade needs poles with negative real parts")
        if z.imag == 0.0:
            a[i, i] = z.real
            b[i] = np.sqrt(-2.0 * z.real)
            number += 1
        elif z.imag > 0.0:
            if i % n + 1 == n or poles[i % n + 1] != z.conjugate():
                raise ValueError("conjugate poles must stand side by side, the upper one first")
            size = np.hypot(z.real, z.imag)
            a[i, i], a[i, i + 1], a[i + 1, i] = 2.0 * z.real, -size, size
            b[i] = np.sqrt(-4.0 * z.real)
            number += 1
        elif i % n == 0 or poles[i % n - 1] != z.conjugate():
            raise ValueError("conjugate poles must stand side by side, the upper one first")
        section[i] = number
    for i in range(q):
        for j in range(i):
            if section[i] > section[j]:
                a[i, j] -= b[i] * b[j]


@compiled("void(float64[:,:], float64[:], float64[:,:], float64[:])")
def fill_basis(a: Array, b: Array, rows: Array, leading: Array) -> None:
    """Numerators sorted by degree, as of `realization.degree_basis`: Arnoldi, twice orthogonal."""
    n = b.size
    vector, gain = b.copy(), 1.0
    for k in range(n):
        for _ in range(2):
            for d in range(k):
                row = rows[n - 1 - d]
                share = 0.0
                for i in range(n):
                    share += row[i] * vector[i]
                for i in range(n):
                    vector[i] -= share * row[i]
        norm = 0.0
        for i in range(n):
            norm += vector[i] * vector[i]
        norm = np.sqrt(norm)
        gain *= norm
        row = rows[n - 1 - k]
        for i in range(n):
            row[i] = vector[i] / norm
        leading[n - 1 - k] = gain
        for i in range(n):
            total = 0.0
            for j in range(n):
                total += a[i, j] * row[j]
            vector[i] = total


@compiled("void(float64[:,:], float64[:], float64[:,:], float64[:,:], float64[:,:,:])")
def fill_map(inner: Array, drive: Array, a: Array, rows: Array, found: Array) -> None:
    """How a filter answers to rows (k, q) of a bank's states: ``found`` (k, n, q), from zeros."""
    n, q, count = drive.size, a.shape[0], rows.shape[0]
    m = 0
    while m < q:
        width = 2 if m + 1 < q and a[m, m + 1] != 0.0 else 1
        matrix = np.zeros((width * n, width * n))
        sides = np.zeros((width * n, count))
        for w in range(width):
            state = m + w
            for i in range(n):
                for j in range(n):
                    matrix[w * n + i, w * n + j] = inner[i, j]
                for v in range(width):
                    matrix[w * n + i, v * n + i] += a[state, m + v]
                for k in range(count):
                    sides[w * n + i, k] = -drive[i] * rows[k, state]
            for d in range(m):
                weight = a[state, d]
                if weight != 0.0:
                    for k in range(count):
                        for i in range(n):
                            sides[w * n + i, k] -= weight * found[k, i, d]
        solve_in_place(matrix, sides)
        for w in range(width):
            for k in range(count):
                for i in range(n):
                    found[k, i, m + w] = sides[w * n + i, k]
        m += width


@compiled("(complex128[::1], int64[::1], int64, int64)", free=True)
def bank_parts(
    poles: Complex, orders: Indices, repeats: int, most: int
) -> tuple[Array, Array, Array, Array, Array]:
    """A bank of several denominators side by side.

    Parameters
    ----------
    poles : (n_poles,) complex array
        Group by group, pairs side by side.
    orders : (n_groups,) int array
    repeats : int
        How often each pole stands in the bank.
    most : int
        The largest order.

    Returns
    -------
    a : (q, q) array
    b : (q,) array
    rows : (n_poles, most) array
        The degree basis of each group.
    leading : (n_poles,) array
    maps : flat array
        (q_g, n_g, q_g) of each group, one after the other.
    """
    total, size = 0, 0
    for g in range(orders.size):
        total += orders[g]
        size += orders[g] ** 3 * repeats**2
    q = total * repeats
    a, b = np.zeros((q, q)), np.zeros(q)
    rows, leading, maps = np.zeros((total, most)), np.zeros(total), np.zeros(size)
    pole, place = 0, 0
    for g in range(orders.size):
        n = orders[g]
        own, at = n * repeats, pole * repeats
        block, drive = a[at : at + own, at : at + own], b[at : at + own]
        fill_cascade(poles[pole : pole + n], repeats, block, drive)
        inner, first = block[:n, :n], drive[:n]
        fill_basis(inner, first, rows[pole : pole + n, :n], leading[pole : pole + n])
        found = maps[place : place + own * n * own].reshape((own, n, own))
        fill_map(inner, first, block, np.eye(own), found)
        pole, place = pole + n, place + own * n * own
    return a, b, rows, leading, maps
