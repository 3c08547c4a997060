"""Ratios of polynomials at complex points, evaluated without overflow.

Outside the unit circle both polynomials are evaluated by Horner's rule in ``1/s``, so that
``num(s)/den(s) = s^(m-n) num_reversed(1/s)/den_reversed(1/s)`` forms no power of a large number.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


def rational_response(num: FloatArray, den: FloatArray, s: ComplexArray) -> ComplexArray:
    """Evaluate ``num(s)/den(s)``.

    Parameters
    ----------
    num, den : ndarray, shape (degree + 1,)
        Descending powers, the numerator no longer than the denominator.
    s : ndarray of complex, shape (n_points,)
        Finite points [rad/s].

    Returns
    -------
    ndarray of complex, shape (n_points,)
        Infinite at a pole.

    Examples
    --------
    >>> rational_response(np.array([1.0]), np.array([1.0, 0.0]), np.array([2.0j, 0.0]))
    array([ 0.-0.5j, inf+0.j ])
    """
    outside = np.abs(s) > 1.0
    x = s.copy()
    x[outside] = 1.0 / s[outside]
    top, bottom = _horner(num, x, outside), _horner(den, x, outside)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore", under="ignore"):
        ratio = top / bottom
        ratio[outside] *= x[outside] ** (len(den) - len(num))
    ratio[(bottom == 0.0) & (top != 0.0)] = np.inf
    return ratio


def _horner(coefficients: FloatArray, x: ComplexArray, reverse: NDArray[np.bool_]) -> ComplexArray:
    value = np.zeros_like(x)
    for ascending, descending in zip(coefficients[::-1], coefficients, strict=True):
        value = value * x + np.where(reverse, ascending, descending)
    return value
