"""Least squares by orthogonal factors: one triangle per record, and small solves on it.

A record of ``N`` samples and ``q`` columns ``Z`` enters every step only through the triangle
``R`` of ``Z = Q R``: for any combinations ``Z C`` of the columns, ``|Z C v - Z d| = |R C v - R
d|``. So the samples are touched once per bank of filters and each least-squares problem of a
pass is solved on a ``(q, q)`` matrix, without ever forming ``Z' Z`` (Golub & Van Loan, Matrix
Computations, 4th ed., sections 5.2-5.3). Triangles of chunks, records and workers add up by
factoring them once more.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from tridentify.numerics.arrays import Array, Flags

ROUNDING = 1e-6
"""By how much a bound on a singular value may be wrong, of itself: far above what the inverse of a
triangle that is not singular to rounding makes of it."""


class Solution(NamedTuple):
    """What `solve` found.

    ``x`` (n,); ``cost``, the residual sum of squares; ``condition`` of the matrix with unit
    columns; ``basis`` (m, rank), orthonormal columns spanning those of the matrix.
    """

    x: Array
    cost: float
    condition: float
    basis: Array


def triangle(rows: Array) -> Array:
    """Upper triangle ``R`` (min(m, n), n) of a QR factorisation of ``rows`` (m, n).

    Examples
    --------
    >>> r = triangle(np.array([[3.0, 0.0], [4.0, 5.0]]))
    >>> bool(np.allclose(r.T @ r, [[25.0, 20.0], [20.0, 25.0]]))
    True
    """
    m, n = rows.shape
    if not m or not n:
        return np.zeros((min(m, n), n))
    return upper(lapack.dgeqrf(rows)[0][: min(m, n)])


def upper(matrix: Array) -> Array:
    """As `numpy.triu`, in a tenth of its time for a few columns.

    Examples
    --------
    >>> upper(np.ones((2, 3))).tolist()
    [[1.0, 1.0, 1.0], [0.0, 1.0, 1.0]]
    """
    return np.asarray(np.where(_above(*matrix.shape), matrix, 0.0))


@lru_cache(maxsize=64)
def _above(m: int, n: int) -> Flags:
    """Which entries are on the diagonal or above it."""
    return np.arange(m)[:, None] <= np.arange(n)


class Accumulator:
    """Triangle of a tall matrix whose rows arrive in blocks, at the cost of one block of memory.

    Parameters
    ----------
    n_columns : int
        Width of the matrix.
    block : int
        Rows taken at a time; `buffer` gives the place to write them.

    Examples
    --------
    >>> accumulator = Accumulator(2, block=3)
    >>> rows = np.arange(12.0).reshape(6, 2)
    >>> for part in (rows[:3], rows[3:]):
    ...     accumulator.buffer[:, :3] = part.T
    ...     accumulator.absorb(3)
    >>> bool(np.allclose(accumulator.r.T @ accumulator.r, rows.T @ rows))
    True
    """

    def __init__(self, n_columns: int, block: int) -> None:
        self._buffer = np.zeros((n_columns, block))
        self._r = np.zeros((n_columns, n_columns), order="F")
        self._panel = min(n_columns, 2 if n_columns <= 8 else 4 if n_columns <= 20 else 8)

    @property
    def buffer(self) -> Array:
        """(n_columns, block) array to be filled, one row a column of the matrix."""
        return self._buffer

    def absorb(self, count: int, first: int = 0) -> None:
        """Fold ``count`` samples in; columns before ``first`` are known to be zero there.

        A triangle on top of a block is what LAPACK's ``tpqrt`` factors: it leaves the zeros of
        the triangle alone, and its narrow panels stay on one thread, which a block of this size
        needs.
        """
        rows = self._buffer[first:, :count].T
        block = rows if rows.flags.f_contiguous else np.asfortranarray(rows)
        corner = np.asfortranarray(self._r[first:, first:])
        panel = min(self._panel, corner.shape[0])
        updated, *_ = lapack.dtpqrt(0, panel, corner, block, overwrite_a=1, overwrite_b=1)
        self._r[first:, first:] = updated

    @property
    def r(self) -> Array:
        """(n_columns, n_columns) upper triangle."""
        return upper(self._r)


def least(of: Array) -> float:
    """No more than the smallest singular value of a square triangle: from its inverse, no SVD.

    Examples
    --------
    >>> least(np.diag([2.0, 4.0])) < 2.0
    True
    """
    inverse, failed = lapack.dtrtri(of)
    size = np.inf if failed else math.sqrt(float(np.einsum("ij,ij->", inverse, inverse)))
    return (1.0 - ROUNDING) / size if size > 0 else 0.0


CUTOFF = 1e-13
"""Singular values below this share of the largest are rounding: of unit columns it reaches some
hundreds of units of the last place."""


def column_norms(matrix: Array) -> Array:
    """Lengths of the columns, which are divided by them before they are solved for; 1 for none.

    Examples
    --------
    >>> column_norms(np.array([[3.0, 0.0], [4.0, 0.0]])).tolist()
    [5.0, 1.0]
    """
    norms = np.sqrt(np.einsum("ij,ij->j", matrix, matrix))
    return np.where(norms > 0, norms, 1.0)


def solve(matrix: Array, target: Array) -> Solution:
    """Least squares with unit columns, by SVD.

    Parameters
    ----------
    matrix : (m, n) array
    target : (m,) array

    Returns
    -------
    Solution
        ``condition`` is that of the matrix with columns of unit length (van der Sluis 1969:
        within sqrt(n) of the best column scaling). Singular values of that matrix below
        ``CUTOFF`` times the largest are left out.

    Examples
    --------
    >>> s = solve(np.array([[1.0, 0.0], [0.0, 1e-9], [0.0, 0.0]]), np.array([2.0, 3e-9, 1.0]))
    >>> s.x.round(9).tolist(), s.cost, s.condition
    ([2.0, 3.0], 1.0, 1.0)
    """
    n = matrix.shape[1]
    if n == 0:
        return Solution(np.zeros(0), float(target @ target), 1.0, matrix)
    scale = column_norms(matrix)
    u, s, vt = np.linalg.svd(matrix / scale, full_matrices=False)
    keep = s > CUTOFF * s[0]
    projection = u.T @ target
    coefficients = np.where(keep, projection / np.where(keep, s, 1.0), 0.0)
    x = (vt.T @ coefficients) / scale
    residual = target - matrix @ x
    condition = float(s[0] / s[-1]) if s[-1] > 0 else np.inf
    return Solution(x, float(residual @ residual), condition, u if keep.all() else u[:, keep])
