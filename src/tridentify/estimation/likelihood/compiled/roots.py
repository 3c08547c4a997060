"""Poles that a step or a pass leads to, in machine code."""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array, Complex, Indices
from tridentify.numerics.compiled import compiled
from tridentify.numerics.kernels.cascades import fill_cascade
from tridentify.numerics.kernels.small_eigenvalues import eigenvalues

NOTHING, MIRRORED, HELD_FAST, HELD_SLOW = 0, 1, 2, 3
"""What was done to poles."""


@compiled("complex128[::1](complex128[::1])", inner=True)
def sorted_poles(poles: Complex) -> Complex:
    """As `numerics.realization.sort_poles`."""
    n, count = poles.size, 0
    units = np.empty(n, dtype=np.complex128)
    for i in range(n):
        z = poles[i]
        if z.imag < 0.0:
            continue
        k = count
        while k > 0 and (abs(z), z.imag) < (abs(units[k - 1]), units[k - 1].imag):
            units[k] = units[k - 1]
            k -= 1
        units[k] = z
        count += 1
    found, at = np.empty(n, dtype=np.complex128), 0
    for k in range(count):
        found[at] = units[k]
        at += 1
        if units[k].imag > 0.0:
            found[at] = units[k].conjugate()
            at += 1
    return found


@compiled("(complex128[::1], int64[::1], int64[::1])", inner=True)
def inner_cascades(poles: Complex, orders: Indices, firsts: Indices) -> tuple[Array, Array]:
    """The cascade of every denominator, each pole once, side by side."""
    a, b = np.zeros((poles.size, poles.size)), np.zeros(poles.size)
    for g in range(orders.size):
        at, end = firsts[g], firsts[g] + orders[g]
        fill_cascade(poles[at:end], 1, a[at:end, at:end], b[at:end])
    return a, b


@compiled("int64(complex128[::1], float64[::1])", inner=True)
def admit(poles: Complex, limits: Array) -> int:
    """Put poles where the record can see them, as `Problem.admissible`; what was done to them.

    ``limits``: the fastest and the slowest pole, the largest imaginary part, the least damping.
    """
    reflected, fast, slow = False, False, False
    for k in range(poles.size):
        size = abs(poles[k])
        real = poles[k].real if np.isfinite(poles[k].real) else -limits[0]
        imag = poles[k].imag if np.isfinite(poles[k].imag) else 0.0
        reflected = reflected or real > 0.0
        factor = limits[0] / max(size, limits[0]) if np.isfinite(size) else 1.0
        real, imag = -abs(real) * factor, imag * factor
        fast = fast or factor < 1.0 or abs(imag) > limits[2]
        imag = min(max(imag, -limits[2]), limits[2])
        floor = max(limits[1], limits[3] * abs(imag))
        slow = slow or -real < floor
        poles[k] = complex(-max(-real, floor), imag)
    if slow:
        return HELD_SLOW
    if fast:
        return HELD_FAST
    return MIRRORED if reflected else NOTHING


@compiled(
    "(float64[:,::1], float64[::1], float64[::1], int64[::1], int64[::1], int64, float64[::1])",
    inner=True,
)
def led_to(
    a: Array, b: Array, row: Array, orders: Indices, firsts: Indices, repeats: int, limits: Array
) -> tuple[Complex, int]:
    """Admissible roots of ``1 + row X`` of every denominator, and what was done to them.

    Parameters
    ----------
    a, b : arrays
        Of a bank that holds the poles ``repeats`` times.
    row : (n_poles,) array
    orders, firsts : (n_groups,) int arrays
    repeats : int
    limits : (4,) array
        As of `admit`.
    """
    found, note = np.empty(row.size, dtype=np.complex128), NOTHING
    for g in range(orders.size):
        n, at, pole = orders[g], firsts[g] * repeats, firsts[g]
        matrix = np.empty((n, n))
        for i in range(n):
            for j in range(n):
                matrix[i, j] = a[at + i, at + j] - b[at + i] * row[pole + j]
        roots = eigenvalues(matrix)
        note = max(note, admit(roots, limits))
        roots = sorted_poles(roots)
        for k in range(n):
            found[pole + k] = roots[k]
    return found, note
