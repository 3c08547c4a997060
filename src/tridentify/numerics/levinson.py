"""Levinson's recursion: reflection coefficients, the polynomial, and the covariance of a process.

A stationary autoregression ``v(k) + a_1 v(k-1) + ... + a_p v(k-p) = e(k)`` is known by its
polynomial or by ``p`` reflection coefficients below one in size, which any data leave stationary
(S. Kay, *Modern Spectral Estimation*, chapter 6, Prentice Hall 1988).
"""

from __future__ import annotations

from operator import mul

import numpy as np

from tridentify.numerics.arrays import Array

INWARDS = (0.0, 1e-9, 1e-7, 1e-5, 1e-3, 1e-1)
"""Shares by which roots are drawn inwards, the smallest one that suffices."""


def polynomial(reflection: Array) -> Array:
    """``a_1 .. a_p`` from reflection coefficients (Levinson's recursion).

    Examples
    --------
    >>> polynomial(np.array([-0.5, 0.2])).round(12).tolist()
    [-0.6, 0.2]
    """
    a: list[float] = []
    for k in np.asarray(reflection, dtype=np.float64).tolist():
        a = [one + k * other for one, other in zip(a, reversed(a), strict=True)]
        a.append(k)
    return np.array(a, dtype=np.float64)


def reflections(a: Array) -> Array:
    """Reflection coefficients of ``a_1 .. a_p``: all below one in size if it is stationary.

    Examples
    --------
    >>> reflections(np.array([-0.6, 0.2])).round(12).tolist()
    [-0.5, 0.2]
    """
    left, found = np.asarray(a, dtype=np.float64).tolist(), []
    while left:
        k = left.pop()
        found.append(k)
        if abs(k) >= 1.0:
            return np.full(a.size, np.nan)
        left = [
            (one - k * other) / (1.0 - k * k)
            for one, other in zip(left, reversed(left), strict=True)
        ]
    return np.array(found[::-1], dtype=np.float64)


def stationary_polynomial(reflection: Array) -> Array:
    """`polynomial`, stationary in its own rounding too.

    Where several reflection coefficients are close to one in size, those of the polynomial are
    known with few digits and may come out beyond it. Its roots are then drawn inwards by a little:
    those of ``a_k r^k`` are ``r`` times its own.

    Examples
    --------
    >>> stationary_polynomial(np.array([-0.5, 0.2])).round(12).tolist()
    [-0.6, 0.2]
    """
    a = polynomial(reflection)
    powers = np.arange(1, a.size + 1)
    for inwards in INWARDS:
        found = a * (1.0 - inwards) ** powers
        if np.isfinite(reflections(found)).all():
            return np.asarray(found)
    return np.zeros_like(a)


def autocovariance(a: Array, n_lags: int) -> Array:
    """``r(0) .. r(n_lags)`` of the stationary process, for innovations of variance one.

    Parameters
    ----------
    a : (p,) array
    n_lags : int

    Examples
    --------
    >>> autocovariance(np.array([-0.5]), 2).round(6).tolist()
    [1.333333, 0.666667, 0.333333]
    """
    k = reflections(np.asarray(a, dtype=np.float64))
    if np.isnan(k).any():
        raise ValueError("found a process that is not stationary; expected roots inside the circle")
    r = np.zeros(n_lags + 1)
    known = covariance(k)[: n_lags + 1]
    r[: known.size] = known
    for lag in range(known.size, n_lags + 1):
        r[lag] = -float(a @ r[lag - 1 : lag - a.size - 1 : -1]) if lag > a.size else 0.0
    return r


def covariance(reflection: Array) -> Array:
    """``r(0) .. r(p)`` of the process with these ``p`` reflection coefficients, all below one.

    Examples
    --------
    >>> covariance(np.array([-0.5])).round(6).tolist()
    [1.333333, 0.666667]
    """
    variance = 1.0 / float(np.prod(1.0 - reflection * reflection))
    r: list[float] = [variance]
    inner: list[float] = []
    for k in np.asarray(reflection, dtype=np.float64).tolist():
        # the newest first, without r(0)
        told = sum(map(mul, inner, r[:0:-1]))
        r.append(-k * variance - told)
        inner = [one + k * other for one, other in zip(inner, reversed(inner), strict=True)]
        inner.append(k)
        variance *= 1.0 - k**2
    return np.array(r)
