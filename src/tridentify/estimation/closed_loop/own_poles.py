"""Poles of a loop, from operators that describe it.

An orthonormal cascade of operators with the poles ``p`` and any weights ``C`` is a model
``x' = A x + b r``, ``s = C x`` of the whole loop, of higher order than it has. Its controllability
Gramian is the unit matrix, so that the eigenvectors of the observability Gramian with the largest
eigenvalues span the states that matter, and ``A`` there has the poles of the loop: balanced
truncation (Moore 1981), by one symmetric eigenvalue problem.

Reference: B. Moore, IEEE Transactions on Automatic Control 26 (1981) 17-32.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.realization import cascade, sort_poles

SLOWEST = 0.3
"""Decay of the loop within the record."""
FASTEST = 4.0
"""Rate of the loop times sampling interval: beyond it nothing of a mode is seen."""
LEAST_DAMPED = 0.1
"""Of a mode of the loop: with less it is mostly noise at one frequency."""


def own_poles(
    poles: Complex,
    weights: Array,
    count: int,
    duration: float,
    step: float,
    *,
    least_damped: float = LEAST_DAMPED,
) -> Complex | None:
    """Poles of a description that is cut off at so many; None where it has fewer.

    Parameters
    ----------
    poles : (order,) complex array
        Of the operators on each reference [rad/s].
    weights : (order * n_references, n_signals) array
        Of the operators, each signal over the level of its noise.
    count : int
    duration, step : float
        Of the record and of its sampling [s]. What decays more slowly than the former, or faster
        than the latter, is brought back to them.
    least_damped : float
        Decay over swing, to which a mode is brought back.

    Returns
    -------
    (count,) complex array, or None

    Examples
    --------
    >>> two = own_poles(np.full(4, -1.0 + 0j), np.eye(4)[:, :1], 1, 100.0, 0.1)
    >>> two.real.round(9).tolist()
    [-1.0]
    """
    references = len(weights) // poles.size
    a = np.kron(np.eye(references), cascade(poles).a)
    if count > len(a):
        return None
    gramian = solve_continuous_lyapunov(a.T, -weights @ weights.T)
    if not np.isfinite(gramian).all():
        return None
    turned = np.linalg.eigh(0.5 * (gramian + gramian.T))[1][:, ::-1][:, :count]
    found = np.linalg.eigvals(turned.T @ a @ turned).astype(np.complex128)
    decay = np.clip(-found.real, 2.0 * SLOWEST / duration, 0.5 * FASTEST / step)
    swing = np.clip(found.imag, -0.5 * FASTEST / step, 0.5 * FASTEST / step)
    return sort_poles(-np.maximum(decay, least_damped * np.abs(swing)) + 1j * swing)
