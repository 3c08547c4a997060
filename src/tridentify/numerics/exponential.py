"""Exponentials of many small matrices at once, and the step responses that they give.

``e^M = (e^{M / 2^s})^{2^s}``: every matrix is halved ``s`` times, until its 1-norm is below 5.37,
the diagonal Pade approximant of degree 13 is exact to rounding there, and the result is squared
``s`` times (Higham 2005, SIAM J. Matrix Analysis 26(4), 1179-1193). Each matrix has an ``s`` of its
own: too many squarings would cost digits.

The states of ``x' = A x + B`` from rest, at rising times, are carried from one time to the next by
the exponential of ``[[A, B], [0, 0]]`` times the step, one exponential for each different step. No
root is computed and nothing is inverted, so that repeated poles and poles at zero need no care.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_LARGEST = 5.371920351148152
_PADE = (
    64764752532480000.0, 32382376266240000.0, 7771770303897600.0, 1187353796428800.0,
    129060195264000.0, 10559470521600.0, 670442572800.0, 33522128640.0, 1323241920.0,
    40840800.0, 960960.0, 16380.0, 182.0, 1.0,
)  # fmt: skip
SAME_STEP = 1e-12


def exponentials(matrices: Array) -> Array:
    """Matrix exponentials of a stack.

    Parameters
    ----------
    matrices : ndarray, shape (n_matrices, n, n)

    Returns
    -------
    ndarray, shape (n_matrices, n, n)
        ``nan`` for a matrix that is not finite; infinite where the exponential overflows.

    Examples
    --------
    >>> exponentials(np.array([[[0.0, 1.0], [0.0, 0.0]], [[0.0, 0.0], [0.0, 1.0]]])).round(4)
    array([[[1.    , 1.    ],
            [0.    , 1.    ]],
           [[1.    , 0.    ],
            [0.    , 2.7183]]])
    """
    norm = np.abs(matrices).sum(axis=1).max(axis=1)
    sound = np.isfinite(norm)
    with np.errstate(divide="ignore"):
        halvings = np.ceil(np.log2(np.where(sound & (norm > 0), norm, 1.0) / _LARGEST))
    halvings = np.maximum(halvings, 0.0).astype(np.int64)
    scaled = np.where(sound[:, None, None], matrices, 0.0) / 2.0 ** halvings[:, None, None]
    result = _pade(scaled)
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(int(halvings.max(initial=0))):
            left = halvings > k
            result[left] = result[left] @ result[left]
    result[~sound] = np.nan
    return result


def _pade(x: Array) -> Array:
    """Degree 13, in even and odd powers."""
    c, one = _PADE, np.eye(x.shape[-1])
    x2 = x @ x
    x4 = x2 @ x2
    x6 = x4 @ x2
    high = x6 @ (c[13] * x6 + c[11] * x4 + c[9] * x2)
    odd = x @ (high + c[7] * x6 + c[5] * x4 + c[3] * x2 + c[1] * one)
    high = x6 @ (c[12] * x6 + c[10] * x4 + c[8] * x2)
    even = high + c[6] * x6 + c[4] * x4 + c[2] * x2 + c[0] * one
    return np.asarray(np.linalg.solve(even - odd, even + odd))


def step_states(a: Array, b: Array, times: Array) -> Array:
    """States of ``x' = A x + B`` from rest, for a stack of systems.

    Parameters
    ----------
    a : ndarray, shape (n_systems, n, n)
        State matrices [1/s].
    b : ndarray, shape (n_systems, n)
    times : ndarray, shape (n_times,)
        Rising, not negative [s].

    Returns
    -------
    ndarray, shape (n_times, n_systems, n)

    Examples
    --------
    >>> times = np.array([0.0, 1.0])
    >>> step_states(np.full((1, 1, 1), -2.0), np.ones((1, 1)), times).round(6).ravel()
    array([0.      , 0.432332])
    """
    count, n = b.shape
    augmented = np.zeros((count, n + 1, n + 1))
    augmented[:, :n, :n], augmented[:, :n, n] = a, b
    state = np.zeros((count, n + 1, 1))
    state[:, n] = 1.0
    steps = np.diff(times, prepend=0.0)
    resolution = SAME_STEP * max(float(times[-1]), 0.0) if times.size else 0.0
    marks = np.round(steps / resolution) if resolution > 0 else np.zeros_like(steps)
    known: dict[float, Array] = {}
    found = np.empty((times.size, count, n))
    with np.errstate(over="ignore", invalid="ignore"):
        for k, (mark, step) in enumerate(zip(marks.tolist(), steps.tolist(), strict=True)):
            if mark > 0:
                if mark not in known:
                    known[mark] = exponentials(augmented * step)
                state = known[mark] @ state
            found[k] = state[:, :n, 0]
    return found
