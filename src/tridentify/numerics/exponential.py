"""Exponentials of many small matrices at once, and the step responses that they give.

The states of ``x' = A x + B`` from rest, at rising times, are carried from one time to the next by
the exponential of ``[[A, B], [0, 0]]`` times the step, one exponential for each different step. No
root is computed and nothing is inverted, so that repeated poles and poles at zero need no care.
"""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array

SAME_STEP = 1e-12
"""Steps that differ by less, relative to the last time, share one exponential: rounding of
times."""


def exponential(a: Array) -> Array:
    """``exp(a)`` of a matrix or a stack of them."""
    from scipy.linalg import expm  # slow to import, and who only reads a file needs none of it

    return np.asarray(expm(a))


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
    sound = np.asarray(np.isfinite(matrices).all(axis=(1, 2)))
    with np.errstate(over="ignore", invalid="ignore"):
        result = exponential(np.where(sound[:, None, None], matrices, 0.0))
    result[~sound] = np.nan
    return result


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
