"""Polynomials of given poles in machine code, by real sections."""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.compiled import compiled


@compiled("int64(float64[::1], int64, float64, float64, boolean)", inner=True, linked=True)
def times_section(
    coefficients: Array, size: int, first: float, second: float, is_pair: bool
) -> int:
    """Multiply ``size`` descending coefficients by ``p + first`` or ``p^2 + first p + second``.

    In place; gives the new size.
    """
    for k in range(size + 1, -1, -1):
        value = coefficients[k] if k < size else 0.0
        if k >= 1 and k - 1 < size:
            value += first * coefficients[k - 1]
        if is_pair and k >= 2:
            value += second * coefficients[k - 2]
        if k < size + (2 if is_pair else 1):
            coefficients[k] = value
    return size + (2 if is_pair else 1)


@compiled("float64[::1](complex128[::1])")
def expanded(poles: Complex) -> Array:
    """Coefficients of ``prod (p - pole)``, descending powers; of a pair the upper pole counts."""
    found = np.zeros(poles.size + 2)
    found[0] = 1.0
    size = 1
    for i in range(poles.size):
        z = poles[i]
        if z.imag > 0.0:
            length = np.hypot(z.real, z.imag)
            size = times_section(found, size, -2.0 * z.real, length * length, True)
        elif z.imag == 0.0:
            size = times_section(found, size, -z.real, 0.0, False)
    whole = np.empty(size)
    for k in range(size):
        whole[k] = found[k]
    return whole


@compiled("float64[:,::1](complex128[::1])")
def numerator_table(poles: Complex) -> Array:
    """Numerators of the states of a cascade, as of `numerics.realization.numerators`."""
    q = poles.size
    rows = np.zeros((q, q))
    before = np.zeros(q + 2)
    before[0] = 1.0
    size, i = 1, 0
    while i < q:
        z = poles[i]
        is_pair = z.imag > 0.0
        width = 2 if is_pair else 1
        rest = np.zeros(q + 2)
        for k in range(size):
            rest[k] = before[k]
        length = size
        for k in range(i + width, q):
            after = poles[k]
            if after.imag > 0.0:
                far = np.hypot(after.real, after.imag)
                length = times_section(rest, length, -2.0 * after.real, far * far, True)
            elif after.imag == 0.0:
                length = times_section(rest, length, -after.real, 0.0, False)
        if is_pair:
            gain, frequency = np.sqrt(-4.0 * z.real), np.hypot(z.real, z.imag)
            for k in range(length):
                rows[i, k] = gain * rest[k]
                rows[i + 1, 1 + k] = gain * frequency * rest[k]
            size = times_section(before, size, 2.0 * z.real, frequency * frequency, True)
        else:
            gain = np.sqrt(-2.0 * z.real)
            for k in range(length):
                rows[i, k] = gain * rest[k]
            size = times_section(before, size, z.real, 0.0, False)
        i += width
    return rows
