"""Ratios of polynomials at complex points, evaluated without overflow.

Outside the unit circle both polynomials are evaluated by Horner's rule in ``1/s``, so that
``num(s)/den(s) = s^(m-n) num_reversed(1/s)/den_reversed(1/s)`` forms no power of a large number.
"""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array, Complex, Flags
from tridentify.numerics.recent import recent

FAR = 500.0
"""Coefficients are scaled where one is 2^500 times the first: the ratio squared is a float."""
MOST_POWER = 900.0
"""Largest power of two among scaled coefficients: a sum of several is a float."""
KEPT = 16
"""Polynomials whose roots are kept."""


def rational_response(num: Array, den: Array, s: Complex) -> Complex:
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


def _horner(coefficients: Array, x: Complex, reverse: Flags) -> Complex:
    value = np.zeros_like(x)
    for ascending, descending in zip(coefficients[::-1], coefficients, strict=True):
        value = value * x + np.where(reverse, ascending, descending)
    return value


# what is said of a model asks for its poles again and again
@recent(KEPT)
def scaled_roots(coefficients: Array) -> Complex:
    """Roots of a polynomial, in units of their mean size where the coefficients lie far apart.

    Parameters
    ----------
    coefficients : ndarray, shape (n + 1,)
        Descending powers, finite.

    Returns
    -------
    ndarray of complex, shape (at most n,)
        Without those that lie beyond the range of a float: the leading coefficient is as good as
        zero then. Nobody may write into them.

    Examples
    --------
    >>> scaled_roots(np.array([1e-200, 1.0])).real, scaled_roots(np.array([1e-300, 1e300]))
    (array([-1.e+200]), array([], dtype=complex128))
    """
    kept = np.asarray(coefficients, dtype=np.float64)
    found = np.flatnonzero(kept)
    if found.size < 2:
        return np.zeros(kept.size - 1 - found[0] if found.size else 0, dtype=np.complex128)
    kept, found = kept[found[0] :], found - found[0]
    sizes = np.log2(np.abs(kept[found]))
    logs = sizes - sizes[0]
    if np.abs(logs).max() < FAR:
        return _roots(kept, int(found[-1]))
    unit = round(float(logs[-1] / found[-1]))
    powers = logs - unit * found
    if powers.max() > MOST_POWER or unit > MOST_POWER:
        return scaled_roots(kept[1:])
    scaled = np.zeros(kept.size)
    scaled[found] = np.sign(kept[found]) * np.sign(kept[0]) * np.exp2(powers)
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        roots = _roots(scaled, int(found[-1]))
        roots = np.ldexp(roots.real, unit) + 1j * np.ldexp(roots.imag, unit)
    return roots[np.isfinite(roots)]


def _roots(coefficients: Array, last: int) -> Complex:
    """As `numpy.roots`, of a first coefficient that is not zero; ``last`` is the last such one."""
    companion = np.eye(last, k=-1)
    companion[:1] = -coefficients[1 : last + 1] / coefficients[0]
    found = np.zeros(coefficients.size - 1, dtype=np.complex128)
    found[:last] = np.linalg.eigvals(companion)
    return found
