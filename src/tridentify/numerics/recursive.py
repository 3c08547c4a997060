"""Least squares that takes one sample at a time, without ever squaring the condition number.

*Triangle.* For rows ``z_k`` with targets ``y_k`` and weights ``w_k`` the triangle ``R`` and ``Q'
y`` of a QR factorisation are kept as ``R = D^{1/2} U`` and ``D^{1/2} t`` with unit upper
triangular ``U``: the square-root-free Givens rotations of Gentleman (1973). A new row ``(x, y)``
of weight ``w`` is turned into the triangle column by column,

    d_i' = d_i + w x_i^2,  c = d_i / d_i',  s = w x_i / d_i', x_l <- x_l - x_i u_il,  u_il <- c
    u_il + s x_l(old),  y <- y - x_i t_i,  t_i <- c t_i + s y(old), w <- c w.

Nothing is subtracted from ``D``: it stays positive whatever the number of samples, and an unknown
of which nothing has been seen has ``d_i = 0`` without need of a prior. What is left of ``y`` at the
end is the *innovation* ``e = y - z' theta`` with the coefficients before the row, and what is left
of ``w = 1`` is ``1 / (1 + z' P z)`` with ``P = (U' D U)^{-1}``. So ``v = e / sqrt(1 + z' P z)`` has
the variance of the noise, whatever has been learnt so far, and successive ones are independent.

*Forgetting.* Multiplying ``d_i`` by a factor below one leaves ``theta`` as it is and takes weight
off the past. A row of the triangle is forgotten only as long as it is renewed: where the
information that arrives falls below a share of what is forgotten, the factor is one (``forget``).
So nothing is lost, and the covariance does not grow, while the input rests.

*Directional forgetting* (Kulhavy 1987) forgets along the regressor only: with ``h = z' P z`` the
information becomes ``P^{-1} + beta z z'``, ``beta = f - (1 - f) / h``, and ``theta`` moves as
without forgetting. The triangle takes it in two rotations, of weight one with ``y``, and of
weight ``beta - 1`` with the new fit, which moves no coefficient. Since ``1 + beta h = f (1 + h)``
it stays positive.

*Covariance.* A random walk of the coefficients adds to ``P``, so a Kalman filter keeps ``P = V D
V'`` with ``V`` unit upper triangular (Bierman 1977): the measurement update of Bierman and the
time update of Thornton by weighted Gram-Schmidt; both keep ``D`` positive.

*Gradient.* The rule ``d theta_i / dt = lambda_i eps phi_i`` over one interval ``h`` by the
backward Euler method is ``theta' = theta + h lambda phi eps / (1 + h sum lambda_i phi_i^2)``: a
normalised step that is stable for any ``lambda >= 0``, as the error after it is ``eps / (1 +
...)``. With operators that are combinations ``S phi`` the rule moves ``theta`` along ``P phi, P =
S' lambda S``, and the same holds with ``phi' P phi`` for any ``P`` without negative eigenvalues.

All of them work in place on one vector, at offsets, so that a whole estimator is one plain array.
They are compiled when this module is imported, so it is imported where it is needed.

References
----------
W. M. Gentleman, J. Inst. Maths Applics 12 (1973), 329-336; Algorithm AS 75, Applied Statistics 23
(1974), 448-454.
G. J. Bierman, Factorization Methods for Discrete Sequential Estimation, Academic Press 1977.
R. Kulhavy, Automatica 23(5) (1987), 589-600.
"""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array
from tridentify.numerics.compiled import linked as compiled

NEGLIGIBLE = 1e-11
"""Part of a row outside of what came before, relative to its largest entry, below which it is
rounding."""
RENEWED, LOST = 0.05, 1e-20
"""Share of what is forgotten that has to arrive anew for it to be forgotten at all; and what is
left of a column that is gone, relative to the first of the others."""
TINY = 1e-250
"""Squares below it are no numbers that can be divided by."""


@compiled("UniTuple(float64, 2)(float64[::1], int64, int64, int64, int64, int64)", inline=True)
def innovate(x: Array, at: int, n: int, first: int, row: int, work: int) -> tuple[float, float]:
    """Prediction ``z' theta`` and ``z' P z`` of a row, before it is absorbed.

    Parameters
    ----------
    x : array
        Holds everything.
    at : int
        Where the triangle begins.
    n, first : int
        Columns, and the first one that is not zero any more.
    row : int
        Where the row ``z`` stands; it is left alone.
    work : int
        Room for ``n`` numbers; on return the coordinates of the row on the triangle.
    """
    w, z = x[work : work + n], x[row : row + n]
    d, t, largest = x[at : at + n], x[at + n : at + 2 * n], x[at + 2 * n : at + 3 * n]
    for i in range(first, n):
        w[i] = z[i]
    fitted = 0.0
    leverage = 0.0
    u = at + 4 * n + first * (n - 1) - first * (first - 1) // 2
    for i in range(first, n):
        xi = w[i]
        k = n - 1 - i
        if abs(xi) <= NEGLIGIBLE * max(largest[i], abs(z[i])):
            w[i] = 0.0
        else:
            right, upper = x[work + i + 1 : work + n], x[u : u + k]
            for m in range(k):
                right[m] -= xi * upper[m]
            if d[i] > 0.0:
                fitted += xi * t[i]
                leverage += xi * xi / d[i]
            else:
                leverage = np.inf
        u += k
    return fitted, leverage


@compiled("void(float64[::1], int64, int64, int64, int64, int64, float64, float64)", inline=True)
def rotate(
    x: Array, at: int, n: int, first: int, row: int, work: int, target: float, weight: float
) -> None:
    """Turn a row of some weight into the triangle."""
    now, z = x[work : work + n], x[row : row + n]
    d, t, largest = x[at : at + n], x[at + n : at + 2 * n], x[at + 2 * n : at + 3 * n]
    for i in range(first, n):
        now[i] = z[i]
    left = target
    w = weight
    u = at + 4 * n + first * (n - 1) - first * (first - 1) // 2
    for i in range(first, n):
        xi = now[i]
        k = n - 1 - i
        if weight > 0.0 and abs(z[i]) > largest[i]:
            largest[i] = abs(z[i])
        if w != 0.0 and abs(xi) > NEGLIGIBLE * largest[i]:
            new = d[i] + w * xi * xi
            if new > TINY:
                share = 1.0 / new
                s = w * xi * share
                c = d[i] * share
                w = w * c
                d[i] = new
                right, upper = x[work + i + 1 : work + n], x[u : u + k]
                for m in range(k):
                    old = right[m]
                    right[m] = old - xi * upper[m]
                    upper[m] = c * upper[m] + s * old
                old = left
                left = old - xi * t[i]
                t[i] = c * t[i] + s * old
        u += k


@compiled("void(float64[::1], int64, int64, int64, int64, float64, float64)")
def forget(x: Array, at: int, n: int, first: int, work: int, factor: float, pace: float) -> None:
    """Multiply the rows of the triangle by ``factor``, but for those that are not renewed.

    A row receives the square of its coordinate over one plus the leverage of the rows above. Rows
    above ``first`` belong to unknowns of the past; each can be met exactly, so that their weight
    matters little, but it must not vanish, or the triangle becomes singular.

    Parameters
    ----------
    work : int
        Where the coordinates of the row that arrives stand (`innovate`).
    factor : float
    pace : float
        Share of the newest in the running mean of what arrives.
    """
    lost = (1.0 - factor) * RENEWED
    leverage = 0.0
    for i in range(first, n):
        xi = x[work + i]
        arrived = at + 3 * n + i
        x[arrived] += pace * (xi * xi / (1.0 + leverage) - x[arrived])
        if x[at + i] > 0.0:
            leverage += xi * xi / x[at + i]
        if x[arrived] >= lost * x[at + i]:
            x[at + i] *= factor
    least = LOST * x[at + first]
    for i in range(first):
        if x[at + i] > least:
            x[at + i] *= factor


@compiled("void(float64[::1], int64, int64, int64)")
def solve_triangle(x: Array, at: int, n: int, out: int) -> None:
    """``theta = U^{-1} t`` written to ``x[out : out + n]``; zero where nothing has been seen."""
    u = at + 4 * n + n * (n - 1) // 2
    for i in range(n - 1, -1, -1):
        u -= n - 1 - i
        value = x[at + n + i]
        for m in range(i + 1, n):
            value -= x[u + m - i - 1] * x[out + m]
        x[out + i] = value if x[at + i] > 0.0 else 0.0


@compiled("UniTuple(float64, 2)(float64[::1], int64, int64, int64, int64, int64)", inline=True)
def predict(x: Array, theta: int, at: int, n: int, row: int, work: int) -> tuple[float, float]:
    """``z' theta`` and ``z' P z`` with ``P = V D V'``; ``V' z`` is left in ``work``.

    ``D`` stands at ``at``, then the columns of ``V`` above the diagonal, one after the other.
    """
    fitted = 0.0
    spread = 0.0
    v = at + n
    for j in range(n):
        value = x[row + j]
        for i in range(j):
            value += x[v + i] * x[row + i]
        x[work + j] = value
        spread += x[at + j] * value * value
        fitted += x[row + j] * x[theta + j]
        v += j
    return fitted, spread


@compiled("void(float64[::1], int64, int64, int64, int64, int64, float64, float64)")
def correct(
    x: Array, theta: int, at: int, n: int, work: int, gain: int, error: float, noise: float
) -> None:
    """Measurement update of Bierman for a row whose ``V' z`` stands in ``work``."""
    alpha = noise
    v = at + n
    for j in range(n):
        f = x[work + j]
        g = x[at + j] * f
        before = alpha
        alpha = alpha + f * g
        x[gain + j] = g
        if alpha > 0.0:
            x[at + j] = x[at + j] * before / alpha
            share = -f / before if before > 0.0 else 0.0
            for i in range(j):
                old = x[v + i]
                x[v + i] = old + x[gain + i] * share
                x[gain + i] = x[gain + i] + g * old
        v += j
    if alpha > 0.0:
        for j in range(n):
            x[theta + j] += x[gain + j] * error / alpha


@compiled("void(float64[::1], int64, int64, float64[::1], int64, int64, int64, float64, int64)")
def drift(
    x: Array, at: int, n: int, c: Array, walk: int, widths: int, k: int, scale: float, work: int
) -> None:
    """Time update of Thornton: ``P + scale W Q W'``, by weighted Gram-Schmidt.

    Parameters
    ----------
    c : array
        Holds ``W`` (n, k), row by row, from ``walk`` on and the diagonal of ``Q`` from ``widths``.
    work : int
        Room for ``n (n + k)`` numbers.
    """
    m = n + k
    v = at + n
    for j in range(n):
        for i in range(n):
            value = 0.0
            if i < j:
                value = x[v + i]
            elif i == j:
                value = 1.0
            x[work + i * m + j] = value
        v += j
    for i in range(n):
        for j in range(k):
            x[work + i * m + n + j] = c[walk + i * k + j]
    for j in range(n - 1, -1, -1):
        v -= j
        total = 0.0
        for s in range(n):
            total += x[work + j * m + s] ** 2 * x[at + s]
        for s in range(k):
            total += x[work + j * m + n + s] ** 2 * scale * c[widths + s]
        for i in range(j):
            cross = 0.0
            for s in range(n):
                cross += x[work + i * m + s] * x[at + s] * x[work + j * m + s]
            for s in range(k):
                cross += x[work + i * m + n + s] * scale * c[widths + s] * x[work + j * m + n + s]
            ratio = cross / total if total > 0.0 else 0.0
            x[v + i] = ratio
            for s in range(m):
                x[work + i * m + s] -= ratio * x[work + j * m + s]
        # the old D is needed to the end: the new one waits in the row that is done with
        x[work + j * m] = total
    for j in range(n):
        x[at + j] = x[work + j * m]


@compiled("float64(float64[::1], int64, int64, float64[::1], int64, int64)")
def along(x: Array, row: int, n: int, c: Array, gains: int, out: int) -> float:
    """``P phi`` for a row, written to ``x[out : out + n]``; gives ``phi' P phi``.

    Parameters
    ----------
    c : array
        Holds ``P`` (n, n), row by row, from ``gains`` on.
    """
    total = 0.0
    for i in range(n):
        value = 0.0
        at = gains + i * n
        for j in range(n):
            value += c[at + j] * x[row + j]
        x[out + i] = value
        total += x[row + i] * value
    return total


@compiled("void(float64[::1], int64, int64, int64, float64, float64, float64, float64)")
def descend(
    x: Array,
    theta: int,
    n: int,
    direction: int,
    size: float,
    gain: float,
    error: float,
    weight: float,
) -> None:
    """One step of the gradient rule by the backward Euler method.

    Parameters
    ----------
    direction : int
        Where ``P phi`` stands (`along`).
    size : float
        ``phi' P phi`` times the weight.
    gain : float
        Rate times interval.
    error : float
        ``y - phi' theta`` before the step.
    weight : float
        Of its square.
    """
    share = gain * weight * error / (1.0 + gain * size)
    if abs(share) < np.inf:
        for i in range(n):
            x[theta + i] += share * x[direction + i]
