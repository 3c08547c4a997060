"""Whether a residual holds columns that were not fitted: Lagrange-multiplier tests in F form.

For white Gaussian noise ``e`` of unknown variance and a model whose derivatives span ``B`` (all
unknowns, evaluated at the estimate), the residual of the fit is ``(I - Q Q') e`` to first order,
``Q`` an orthonormal basis of ``B``. Whether further columns ``Z`` belong into the model is told by
the part of ``Z`` that ``B`` does not hold: with ``P`` an orthonormal basis of ``(I - Q Q') Z``,

    F = (|P' r|^2 / k) / ((|r|^2 - |P' r|^2) / (N - p - k))

has the F distribution with ``k`` and ``N - p - k`` degrees of freedom, exactly for linear models
and to first order for others, whatever the columns are: inputs that are correlated with their own
past need no correction, and what the fit took away is allowed for. It is the score (Lagrange) test
of Rao, in the form that keeps its size in short samples.

References: C. R. Rao, Proc. Cambridge Phil. Soc. 44 (1948) 50-57. T. Breusch & A. Pagan, Review of
Economic Studies 47 (1980) 239-253. J. Kiviet, Review of Economic Studies 53 (1986) 241-261 (the F
form in short samples).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack
from scipy.special import fdtrc

from tridentify.numerics.arrays import Array, Flags
from tridentify.numerics.least_squares import ROUNDING, least, triangle, upper

SPAN_CUTOFF = 1e-6
"""Part of a column outside of the others, relative to it, below which it lies in their span."""


class Added(NamedTuple):
    """A test of columns.

    Attributes
    ----------
    statistic : float
        F.
    dimension, freedom : int
        Degrees of freedom; ``dimension`` is zero where the columns hold nothing new.
    share : float
        Of the residual's sum of squares that the columns explain.
    p_value : float
    """

    statistic: float
    dimension: int
    freedom: int
    share: float
    p_value: float


def span(columns: Array, basis: Array | None = None, cutoff: float = SPAN_CUTOFF) -> Array:
    """Orthonormal basis of what columns hold beyond a basis.

    Parameters
    ----------
    columns : (n, k) array
    basis : (n, p) array, optional
        Orthonormal.
    cutoff : float
        Directions of the columns, scaled to unit length, shorter than this count as none.

    Returns
    -------
    (n, r) array, r <= k

    Examples
    --------
    >>> columns = np.array([[1.0, 1.0], [0.0, 2.0], [0.0, 0.0]])
    >>> np.abs(span(columns, np.eye(3)[:, :1])).round(12).tolist()
    [[0.0], [1.0], [0.0]]
    """
    norms = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    used = columns / norms if norms.all() else columns[:, norms > 0] / norms[norms > 0]
    if used.shape[1] == 0:
        return np.zeros((columns.shape[0], 0))
    if basis is not None and basis.shape[1]:
        for _ in range(2):
            used = used - basis @ (basis.T @ used)
    found = _orthonormal(used, cutoff)
    if basis is not None and basis.shape[1]:
        found = found - basis @ (basis.T @ found)
    return np.asarray(found)


def _orthonormal(columns: Array, cutoff: float) -> Array:
    """Basis of some columns; of their singular values only the large ones where some are not."""
    n, k = columns.shape
    factors, tau, _, failed = lapack.dgeqrf(columns)
    of = upper(factors[:k])
    if n < k or failed or not _is_free(of, cutoff):
        u, s, _ = np.linalg.svd(columns, full_matrices=False)
        return np.asarray(u[:, s > cutoff])
    return np.asarray(lapack.dorgqr(factors, tau, overwrite_a=1)[0])


def _is_free(of: Array, cutoff: float) -> bool:
    """Whether no singular value of a square triangle is below a cutoff."""
    return least(of) > cutoff or bool(np.linalg.svd(of, compute_uv=False)[-1] > cutoff)


def added_each(
    residual: Array,
    basis: Array,
    groups: Sequence[Array],
    n_samples: int,
) -> list[Added]:
    """`added` for each of several groups of columns by itself, without a basis of any.

    Only the triangle of a group and the residual beside it is made: with ``[Z r] = Q R`` the part
    of ``r`` along ``Z`` has the length of the last column of ``R`` but for its last number.

    Parameters
    ----------
    residual : (n,) array
    basis : (n, p) array
        Orthonormal, of what was fitted.
    groups : sequence of (n, k) arrays
    n_samples : int
        Samples that are there.

    Examples
    --------
    >>> e, ones = np.array([1.0, -1.0, 1.0, -1.0, 3.0, 3.0]), np.ones((6, 2))
    >>> (test,) = added_each(e, np.zeros((6, 0)), [ones], 6)
    >>> round(test.statistic, 3), test.dimension, test.freedom, round(test.p_value, 3)
    (1.875, 1, 5, 0.229)
    """
    from tridentify.numerics.kernels.added_columns import explained_each

    left, p = residual - basis @ (basis.T @ residual), basis.shape[1]
    firsts = np.cumsum([0, *(group.shape[1] for group in groups)])
    columns = np.empty((int(firsts[-1]) + 1, left.size))
    for first, group in zip(firsts.tolist(), groups, strict=False):
        columns[first : first + group.shape[1]] = group.T
    columns[-1] = left
    # a bound on singular values is wrong by its rounding
    table = explained_each(
        columns, np.ascontiguousarray(basis.T), firsts, (1.0 + ROUNDING) * SPAN_CUTOFF
    )
    for g in np.flatnonzero(table[:, 1] < 0.0).tolist():
        some = [one for one in columns[firsts[g] : firsts[g + 1]] if one.any()]
        table[g] = _along(np.stack([*some, columns[-1]]).T, SPAN_CUTOFF)
    total = float(left @ left)
    found = [_judged(total, int(kept), p, part, n_samples) for part, kept in table.tolist()]
    asked = np.array([(one.dimension, one.freedom, one.statistic) for one in found])
    chances = fdtrc(*asked.reshape(-1, 3).T)
    return [
        one._replace(p_value=p_value) if one.dimension else one
        for one, p_value in zip(found, chances.tolist(), strict=True)
    ]


def _along(columns: Array, cutoff: float) -> tuple[float, int]:
    """What columns explain of the last one, and of how many dimensions, by singular values."""
    r = triangle(columns)
    u, s, _ = np.linalg.svd(r[:, :-1], full_matrices=False)
    along = u[:, s > cutoff].T @ r[:, -1]
    return float(along @ along), int(np.sum(s > cutoff))


def added(residual: Array, basis: Array, extra: Array, n_samples: int) -> Added:
    """Test whether a residual holds more than noise along further directions.

    Parameters
    ----------
    residual : (n,) array
        White but for what is tested; zero where a sample is missing.
    basis : (n, p) array
        Orthonormal, of what was fitted.
    extra : (n, k) array
        Orthonormal and orthogonal to ``basis`` (`span`).
    n_samples : int
        Samples that are there.

    Returns
    -------
    Added

    Examples
    --------
    >>> e = np.array([1.0, -1.0, 1.0, -1.0, 3.0, 3.0])
    >>> test = added(e, np.zeros((6, 0)), span(np.ones((6, 1))), 6)
    >>> round(test.statistic, 3), test.dimension, test.freedom, round(test.p_value, 3)
    (1.875, 1, 5, 0.229)
    """
    left = residual - basis @ (basis.T @ residual)
    explained = float(np.sum((extra.T @ left) ** 2))
    total = float(left @ left)
    one = _judged(total, extra.shape[1], basis.shape[1], explained, n_samples)
    chance = float(fdtrc(one.dimension, one.freedom, one.statistic))
    return one._replace(p_value=chance) if one.dimension else one


def _judged(total: float, k: int, p: int, explained: float, n_samples: int) -> Added:
    """F of what ``k`` directions explain of what a fit of ``p`` has left; not yet its chance."""
    freedom = n_samples - p - k
    if k == 0 or freedom < 1 or total == 0:
        return Added(0.0, 0, max(freedom, 0), 0.0, 1.0)
    explained = min(explained, total * (1.0 - 1e-15))
    statistic = (explained / k) / ((total - explained) / freedom)
    return Added(statistic, k, freedom, explained / total, 1.0)


def holm(p_values: Array, rate: float) -> Flags:
    """Which of several hypotheses are rejected, at most ``rate`` of all families wrongly.

    Notes
    -----
    S. Holm, Scandinavian Journal of Statistics 6 (1979) 65-70; whatever the dependence.

    Examples
    --------
    >>> holm(np.array([0.003, 0.5, 0.0004]), 0.01).tolist()
    [True, False, True]
    """
    order = np.argsort(p_values)
    limits = rate / np.arange(p_values.size, 0, -1)
    passed = np.logical_and.accumulate(p_values[order] <= limits)
    found = np.zeros(p_values.size, dtype=np.bool_)
    found[order] = passed
    return found
