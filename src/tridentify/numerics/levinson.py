"""Levinson's recursion: reflection coefficients, the polynomial, and the covariance of a process.

A stationary autoregression ``v(k) + a_1 v(k-1) + ... + a_p v(k-p) = e(k)`` is known by its
polynomial or by ``p`` reflection coefficients below one in size, which any data leave stationary
(S. Kay, *Modern Spectral Estimation*, chapter 6, Prentice Hall 1988).
"""

from __future__ import annotations

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
    a = np.zeros(0)
    for k in reflection:
        a = np.append(a + k * a[::-1], k)
    return a


def reflections(a: Array) -> Array:
    """Reflection coefficients of ``a_1 .. a_p``: all below one in size if it is stationary.

    Examples
    --------
    >>> reflections(np.array([-0.6, 0.2])).round(12).tolist()
    [-0.5, 0.2]
    """
    found = np.zeros(a.size)
    for p in range(a.size, 0, -1):
        k = a[p - 1]
        found[p - 1] = k
        if abs(k) >= 1.0:
            return np.full(found.size, np.nan)
        a = (a[: p - 1] - k * a[: p - 1][::-1]) / (1.0 - k * k)
    return found


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
    k = reflection
    r = np.zeros(k.size + 1)
    r[0] = 1.0 / float(np.prod(1.0 - k * k))
    inner, variance = np.zeros(0), float(r[0])
    for lag in range(1, k.size + 1):
        r[lag] = -k[lag - 1] * variance - float(inner @ r[lag - 1 : 0 : -1])
        inner = np.append(inner + k[lag - 1] * inner[::-1], k[lag - 1])
        variance *= 1.0 - k[lag - 1] ** 2
    return r
