r"""What the coefficients of the noise take from the information, where inputs hold past noise.

With noise ``v = y - G u`` and innovations ``e = A v`` the derivatives of ``e`` are ``-A dG u`` for
the coefficients of the plant and ``v_{t-1}, ..., v_{t-p}`` for those of ``A``. In open loop the
input knows nothing of past noise, the two kinds are orthogonal, and whatever the noise costs the
plant is of lower order. A controller puts past noise into the input. Then the information is that
of both together, and the covariance of the plant's coefficients the block of its inverse,

.. math:: (G'G - G'V (V'V)^{-1} V'G)^{-1}

(Ljung, System Identification, 2nd ed., 1999, section 9.4 and problem 9G.2), which is that of the
derivatives with the past of the noise projected out. A plant that integrates, in noise that does so
as well, has errors that are several times those with a known model of the noise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tridentify.estimation.likelihood.cost import Point
from tridentify.numerics.arrays import Array

LARGEST_SHARE = 1.0 - 1e-8
"""Of the information on a direction, that the noise may take: what is left are digits."""


def past_noise(point: Point) -> Array:
    """Orthonormal columns that span the past of the noise.

    Parameters
    ----------
    point : Point

    Returns
    -------
    (rows, k) array
        Rows by experiment, sample and output, as of the scores; without columns where no output
        has a model of its noise.
    """
    models = point.problem.noise
    blocks = []
    for residual in point.residuals():
        v = np.nan_to_num(residual)
        columns = []
        for i, a in enumerate(models):
            for lag in range(1, a.size + 1):
                column = np.zeros_like(v)
                column[lag:, i] = v[:-lag, i]
                columns.append(column.ravel())
        blocks.append(np.array(columns).T.reshape(v.size, len(columns)))
    found = np.vstack(blocks)
    size = np.linalg.norm(found, axis=0)
    return np.asarray(np.linalg.qr(found[:, size > 0.0] / size[size > 0.0])[0])


def turned(directions: Sequence[Array], past: Array) -> Array:
    """What the root of the covariance is multiplied with.

    Parameters
    ----------
    directions : sequence of (n_samples, n_outputs, k) arrays
        Derivatives ``g`` with ``sum g g' = I``.
    past : (rows, p) array
        As of `past_noise`.

    Returns
    -------
    (k, k) array

    Examples
    --------
    >>> g = np.eye(4)[:, :2].reshape(4, 1, 2)
    >>> past = np.array([[np.sqrt(0.75), 0.0, 0.5, 0.0]]).T
    >>> np.round(turned([g], past), 3).tolist()  # the first has four times the variance
    [[2.0, 0.0], [0.0, 1.0]]
    """
    shared = past.T @ _stacked(directions)
    taken, axes = np.linalg.eigh(shared.T @ shared)
    return np.asarray((axes / np.sqrt(1.0 - np.clip(taken, 0.0, LARGEST_SHARE))) @ axes.T)


def without(directions: Sequence[Array], past: Array) -> list[Array]:
    """Directions with the past of the noise projected out; arguments as of `turned`."""
    g = _stacked(directions)
    left = g - past @ (past.T @ g)
    ends = np.cumsum([one.shape[0] * one.shape[1] for one in directions])[:-1]
    parts = zip(np.split(left, ends), directions, strict=True)
    return [part.reshape(one.shape) for part, one in parts]


def _stacked(directions: Sequence[Array]) -> Array:
    return np.vstack([one.reshape(-1, one.shape[-1]) for one in directions])
