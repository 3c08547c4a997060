"""Exact discretisation of cascades in machine code: what `numerics.discretize` derives.

``A`` of a bank is lower triangular but for the pairs on its diagonal. With the input's own
differential equation *before* the states,

    d/dt [u; x] = [0, 0; B, A] [u; x],    d/dt [u'; u; x] = [0, 0, 0; 1, 0, 0; 0, B, A] [u'; u; x],

the augmented matrix is so too, and so are all of its powers and its exponential: a product costs a
sixth. The exponential is the diagonal Pade approximant of degree 13 with scaling and squaring
(Higham, SIAM J. Matrix Analysis 26 (2005) 1179-1193).
"""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array
from tridentify.numerics.compiled import compiled

LARGEST = 5.371920351148152
"""Norm up to which the approximant of degree 13 is exact to rounding (Higham 2005, table 2.3)."""
LARGER = 1024.0
"""As in `numerics.discretize`."""


@compiled("void(float64[:,::1], float64[:,::1], float64[:,::1])", inner=True, linked=True)
def multiply(a: Array, b: Array, out: Array) -> None:
    """``out = a b`` of lower triangular matrices with pairs."""
    n = a.shape[0]
    for i in range(n):
        for j in range(n):
            out[i, j] = 0.0
        for m in range(min(i + 2, n)):
            weight = a[i, m]
            if weight != 0.0:
                for j in range(min(m + 2, n)):
                    out[i, j] += weight * b[m, j]


@compiled("void(float64[:,::1], float64[:,::1])", inner=True)
def solve_lower(matrix: Array, sides: Array) -> None:
    """Solve with a lower triangular matrix with pairs; ``sides`` (n, k) become the solutions."""
    n, k = sides.shape
    i = 0
    while i < n:
        width = 2 if i + 1 < n and matrix[i, i + 1] != 0.0 else 1
        for r in range(i, i + width):
            for m in range(i):
                weight = matrix[r, m]
                if weight != 0.0:
                    for j in range(k):
                        sides[r, j] -= weight * sides[m, j]
        if width == 1:
            for j in range(k):
                sides[i, j] /= matrix[i, i]
        else:
            a, b, c, d = matrix[i, i], matrix[i, i + 1], matrix[i + 1, i], matrix[i + 1, i + 1]
            determinant = a * d - b * c
            for j in range(k):
                one, other = sides[i, j], sides[i + 1, j]
                sides[i, j] = (d * one - b * other) / determinant
                sides[i + 1, j] = (a * other - c * one) / determinant
        i += width


@compiled("float64(float64[:,::1])", inner=True)
def size_of(matrix: Array) -> float:
    """The smaller of the largest absolute sums over rows and over columns."""
    n = matrix.shape[0]
    by_rows, by_columns = 0.0, 0.0
    for i in range(n):
        along, across = 0.0, 0.0
        for j in range(n):
            along += abs(matrix[i, j])
            across += abs(matrix[j, i])
        by_rows, by_columns = max(by_rows, along), max(by_columns, across)
    return min(by_rows, by_columns)


@compiled("float64[:,::1](float64[:,::1])")
def exponential(matrix: Array) -> Array:
    """``e^A`` of a lower triangular matrix with pairs; ``nan`` where it is not finite."""
    n, size, doublings = matrix.shape[0], size_of(matrix), 0
    found, even = np.empty((n, n)), np.empty((n, n))
    if not np.isfinite(size):
        for i in range(n):
            for j in range(n):
                found[i, j] = np.nan
        return found
    while size > LARGEST:
        size *= 0.5
        doublings += 1
    x, inner, odd = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    share = 0.5**doublings
    for i in range(n):
        for j in range(n):
            x[i, j] = matrix[i, j] * share
    x2, x4, x6 = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    multiply(x, x, x2)
    multiply(x2, x2, x4)
    multiply(x2, x4, x6)
    for i in range(n):
        for j in range(n):
            inner[i, j] = x6[i, j] + 16380.0 * x4[i, j] + 40840800.0 * x2[i, j]
    multiply(x6, inner, found)
    for i in range(n):
        for j in range(n):
            found[i, j] += 33522128640.0 * x6[i, j] + 10559470521600.0 * x4[i, j]
            found[i, j] += 1187353796428800.0 * x2[i, j]
        found[i, i] += 32382376266240000.0
    multiply(x, found, odd)
    for i in range(n):
        for j in range(n):
            inner[i, j] = 182.0 * x6[i, j] + 960960.0 * x4[i, j] + 1323241920.0 * x2[i, j]
    multiply(x6, inner, even)
    for i in range(n):
        for j in range(n):
            even[i, j] += 670442572800.0 * x6[i, j] + 129060195264000.0 * x4[i, j]
            even[i, j] += 7771770303897600.0 * x2[i, j]
        even[i, i] += 64764752532480000.0
    for i in range(n):
        for j in range(n):
            found[i, j] = even[i, j] + odd[i, j]
            inner[i, j] = even[i, j] - odd[i, j]
    solve_lower(inner, found)
    for _ in range(doublings):
        multiply(found, found, inner)
        found, inner = inner, found
    return found


@compiled("(float64[:,::1], float64[::1], float64, int64)")
def of_powers(a: Array, b: Array, dt: float, degree: int) -> tuple[Array, Array]:
    """``x_{k+1} = F x_k + sum_p G_p c_p`` over a step, for an input ``sum_p c_p (s / h)^p``.

    The signals ``v_p``, ``h v_p' = (p + 1) v_{p+1}``, stand before the states
    (`numerics.interpolation`), the highest first.

    Parameters
    ----------
    a : (q, q) array
        Lower triangular with pairs.
    b : (q,) array
    dt : float
    degree : int

    Returns
    -------
    F : (q, q) array
    G : (degree + 1, q) array
    """
    q, at = b.size, degree + 1
    own, other = 1.0, 0.0
    for i in range(q):
        other = max(other, abs(b[i] * dt))
        for j in range(q):
            own = max(own, abs(a[i, j] * dt))
    weight = 2.0 ** np.floor(np.log2(other / own) + 0.5) if other > LARGER * own else 1.0
    matrix = np.zeros((q + at, q + at))
    for p in range(degree):
        matrix[degree - p, degree - p - 1] = p + 1.0
    for i in range(q):
        matrix[at + i, degree] = b[i] * dt / weight
        for j in range(q):
            matrix[at + i, at + j] = a[i, j] * dt
    whole = exponential(matrix)
    step, taps = np.empty((q, q)), np.empty((at, q))
    for i in range(q):
        for p in range(at):
            taps[p, i] = whole[at + i, degree - p] * weight
        for j in range(q):
            step[i, j] = whole[at + i, at + j]
    return step, taps


@compiled("(float64[:,::1], float64[::1], float64, boolean)")
def discrete(a: Array, b: Array, dt: float, ramps: bool) -> tuple[Array, Array, Array]:
    """``x_{k+1} = F x_k + G0 u_k + G1 u_{k+1}`` over a step, for an input that is held or ramps.

    Parameters
    ----------
    a : (q, q) array
        Lower triangular with pairs.
    b : (q,) array
    dt : float
    ramps : bool
        First-order hold.

    Returns
    -------
    F : (q, q) array
    G0, G1 : (q,) arrays
    """
    step, taps = of_powers(a, b, dt, 1 if ramps else 0)
    now, after = taps[0].copy(), np.zeros(b.size)
    if ramps:
        for i in range(b.size):
            after[i] = taps[1, i]
            now[i] -= after[i]
    return step, now, after


@compiled("float64[:,:,::1](float64[:,::1], float64[::1], float64[::1], float64[::1])")
def crossings(a: Array, b: Array, lengths: Array, slopes: Array) -> Array:
    """``e^M``, ``M = [[h A, h B, 0], [0, 0, c], [0, 0, 0]]``, for lengths ``h`` and slopes ``c``.

    Parameters
    ----------
    a : (q, q) array
        Lower triangular with pairs.
    b : (q,) array
    lengths, slopes : (m,) arrays

    Returns
    -------
    (m, q + 2, q + 2) array
    """
    q, m = b.size, lengths.size
    found, matrix = np.zeros((m, q + 2, q + 2)), np.zeros((q + 2, q + 2))
    for k in range(m):
        matrix[1, 0] = slopes[k]
        for i in range(q):
            matrix[2 + i, 1] = b[i] * lengths[k]
            for j in range(q):
                matrix[2 + i, 2 + j] = a[i, j] * lengths[k]
        whole = exponential(matrix)
        for i in range(q):
            found[k, i, q] = whole[2 + i, 1]
            found[k, i, q + 1] = whole[2 + i, 0]
            for j in range(q):
                found[k, i, j] = whole[2 + i, 2 + j]
        found[k, q, q] = found[k, q + 1, q + 1] = 1.0
        found[k, q, q + 1] = slopes[k]
    return found
