"""Derivatives of the innovations of an autoregression by its coefficients, the beginning included.

Reference: I. Gohberg & A. Semencul, Matematicheskie Issledovaniya 7 (1972) 201-223.
"""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array, Flags
from tridentify.numerics.autoregression import Whitener


def innovations_by(a: Array, series: Array, seen: Flags) -> Array:
    """Derivatives of the innovations of a series by the coefficients.

    Behind the first ``p`` samples they are those samples of the past. The first ones ``v`` have the
    innovations ``w = C v`` with a triangle ``C' C = G``, the inverse of their covariance, which is
    ``G = P P' - Q Q'`` with triangular Toeplitz matrices of ``1, a_1 ..`` and ``a_p, a_{p-1} ..``
    (Gohberg & Semencul 1972). From ``dC' C + C' dC = dG`` follows that ``dw = T w`` with ``T`` the
    lower triangle of ``C^-T dG C^-1``, half of its diagonal counted.

    Parameters
    ----------
    a : (p,) array
        Of a stationary process.
    series : (n_samples,) array
        Zero where a sample is missing.
    seen : (n_samples,) bool array
        Behind a gap, and where the first samples have one, the past alone is counted.

    Returns
    -------
    (n_samples, p) array

    Examples
    --------
    >>> innovations_by(np.array([-0.6]), np.array([1.0, 1.0, 3.0]), np.ones(3, bool)).round(3)
    array([[0.75],
           [1.  ],
           [1.  ]])
    """
    p, n = a.size, series.size
    found = np.zeros((n, p))
    for k in range(1, p + 1):
        found[k:, k - 1] = series[:-k]
    if p and seen[:p].all():
        triangle = Whitener(a, p).apply(np.eye(p), seen[:p]).T
        back = np.linalg.inv(triangle)
        moved = np.stack([np.eye(p, k=-k) for k in range(1, p + 1)])
        # the second one has its coefficients the other way round
        turned = np.concatenate([moved[-2::-1], np.eye(p)[None]])
        ahead, behind = np.eye(p) + np.tensordot(a, moved, 1), np.tensordot(a, turned, 1)
        half = moved @ ahead.T - turned @ behind.T
        inner = back.T @ (half + half.transpose(0, 2, 1)) @ back
        lower = np.tril(inner, -1) + 0.5 * inner * np.eye(p)
        found[:p] = (lower @ (triangle @ series[:p])).T
    return found * seen[:, None]
