"""Exact discretisation of ``x' = A x + B u`` for inputs that are held or ramp between samples.

Over one sampling interval of length ``h`` the solution is

    x(t + h) = e^{A h} x(t) + int_0^h e^{A (h - s)} B u(t + s) ds.

Zero-order hold, ``u(t + s) = u_k``::

    x_{k+1} = F x_k + G0 u_k,                      F = e^{A h},  G0 = h phi_1(A h) B.

First-order hold, ``u(t + s) = u_k + (s / h) (u_{k+1} - u_k)``::

    x_{k+1} = F x_k + (G - G1) u_k + G1 u_{k+1},   G = h phi_1(A h) B,  G1 = h phi_2(A h) B,

with ``phi_1(z) = (e^z - 1) / z`` and ``phi_2(z) = (e^z - 1 - z) / z^2``. All of them are blocks
of one exponential of an augmented matrix (Van Loan, 1978, IEEE Trans. Automatic Control 23(3),
395-404), so nothing is inverted and a pole at the origin needs no special case.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tridentify.numerics.arrays import Array
from tridentify.numerics.exponential import exponential
from tridentify.numerics.recent import recent

KEPT = 256
"""Results that are kept: those of one search at a time."""


LARGER = 1024.0
"""How much larger an input matrix may be than the state matrix before it is scaled down: ten
squarings of the exponential, which cost three digits. Rates of 1e-6 per unit of time reach it."""


def weight_of(a: Array, b: Array) -> float:
    """Power of two that takes an input matrix down to the size of the state matrix, or 1.

    An exponential is squared as often as the size of its largest entry asks for, and each squaring
    doubles its error. The input has a unit of its own, so its size is no reason.

    Parameters
    ----------
    a, b : arrays
        Both multiplied by the step.

    Examples
    --------
    >>> weight_of(np.eye(1), 50.0 * np.ones(1)), weight_of(np.eye(1), 2.0**40 * np.ones(1))
    (1.0, 1099511627776.0)
    """
    own, other = max(float(np.abs(a).max(initial=0.0)), 1.0), float(np.abs(b).max(initial=0.0))
    return 2.0 ** round(math.log2(other / own)) if other > LARGER * own else 1.0


class Discrete(NamedTuple):
    """``x_{k+1} = transition x_k + from_current u_k + from_next u_{k+1}``."""

    transition: Array
    from_current: Array
    from_next: Array


@recent(KEPT)
def discretize(a: Array, b: Array, dt: float, intersample: str = "zoh") -> Discrete:
    """Exact discrete equivalent of a state equation.

    Parameters
    ----------
    a : (..., n, n) array
        State matrix [1/s]; one, or a stack of them.
    b : (..., n, m) array
        Input matrix [1/s per unit of input].
    dt : float
        Sampling interval [s].
    intersample : {"zoh", "foh"}
        What the input does between the samples.

    Returns
    -------
    Discrete
        ``transition`` (..., n, n), ``from_current`` (..., n, m), ``from_next`` (..., n, m).

    Raises
    ------
    ValueError
        For an unknown ``intersample``.

    Examples
    --------
    >>> import numpy as np
    >>> d = discretize(np.array([[-2.0]]), np.array([[2.0]]), 0.5)
    >>> bool(np.isclose(d.from_current[0, 0], 1 - np.exp(-1.0), rtol=1e-15))
    True
    """
    n, m = b.shape[-2:]
    stack = a.shape[:-2]
    weight = weight_of(a * dt, b * dt)
    if intersample == "zoh":
        augmented = np.zeros((*stack, n + m, n + m))
        augmented[..., :n, :n] = a * dt
        augmented[..., :n, n:] = b * dt / weight
        e = exponential(augmented)
        e[..., :n, n:] *= weight
        return Discrete(e[..., :n, :n], e[..., :n, n:], np.zeros((*stack, n, m)))
    if intersample != "foh":
        raise ValueError(f"intersample must be 'zoh' or 'foh', not {intersample!r}")
    augmented = np.zeros((*stack, n + 2 * m, n + 2 * m))
    augmented[..., :n, :n] = a * dt
    augmented[..., :n, n : n + m] = b * dt / weight
    augmented[..., n : n + m, n + m :] = np.eye(m)
    e = exponential(augmented)
    e[..., :n, n:] *= weight
    held, ramp = e[..., :n, n : n + m], e[..., :n, n + m :]
    return Discrete(e[..., :n, :n], held - ramp, ramp)
