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

from typing import NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from tridentify.numerics.recent import recent

Array = NDArray[np.float64]


KEPT = 256
"""Results that are kept: those of one search at a time."""


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
    if intersample == "zoh":
        augmented = np.zeros((*stack, n + m, n + m))
        augmented[..., :n, :n] = a * dt
        augmented[..., :n, n:] = b * dt
        e = scipy.linalg.expm(augmented)
        return Discrete(e[..., :n, :n], e[..., :n, n:], np.zeros((*stack, n, m)))
    if intersample != "foh":
        raise ValueError(f"intersample must be 'zoh' or 'foh', not {intersample!r}")
    augmented = np.zeros((*stack, n + 2 * m, n + 2 * m))
    augmented[..., :n, :n] = a * dt
    augmented[..., :n, n : n + m] = b * dt
    augmented[..., n : n + m, n + m :] = np.eye(m)
    e = scipy.linalg.expm(augmented)
    held, ramp = e[..., :n, n : n + m], e[..., :n, n + m :]
    return Discrete(e[..., :n, :n], held - ramp, ramp)
