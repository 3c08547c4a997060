"""Eigenvalues of small real matrices in machine code."""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.compiled import compiled


@compiled("complex128[::1](float64[:,::1])", inner=True)
def eigenvalues(matrix: Array) -> Complex:
    """Closed under conjugation to the last digit; ``nan`` where the matrix is not finite."""
    n = matrix.shape[0]
    found = np.empty(n, dtype=np.complex128)
    total = 0.0
    for i in range(n):
        for j in range(n):
            total += matrix[i, j]
    if not np.isfinite(total):
        for i in range(n):
            found[i] = np.nan
        return found
    if n == 1:
        found[0] = matrix[0, 0]
        return found
    if n == 2:
        a, d, product = matrix[0, 0], matrix[1, 1], matrix[0, 1] * matrix[1, 0]
        half = 0.5 * (a - d)
        square = half * half + product
        if square < 0.0:
            found[0] = complex(0.5 * (a + d), np.sqrt(-square))
            found[1] = found[0].conjugate()
            return found
        large = half + np.copysign(np.sqrt(square), half)
        found[0] = d + large
        found[1] = d - product / large if large != 0.0 else d
        return found
    raw, used = np.linalg.eigvals(matrix.astype(np.complex128)), np.zeros(n, dtype=np.bool_)
    for i in range(n):
        if used[i]:
            continue
        mate, nearest = i, 2.0 * abs(raw[i].imag)
        for j in range(i + 1, n):
            distance = abs(raw[j] - raw[i].conjugate())
            if not used[j] and distance < nearest:
                mate, nearest = j, distance
        used[i], used[mate] = True, True
        mean = 0.5 * (raw[i] + raw[mate].conjugate())
        if mate == i:
            found[i] = mean.real
        else:
            found[i], found[mate] = mean, mean.conjugate()
    return found
