"""Least squares under linear inequalities, by non-negative least squares.

    minimise |E x - f|  subject to  G x >= h

With ``E = Q R`` and ``y = R x - Q' f`` it is the point of a polyhedron nearest to the origin,
whose dual is a problem of non-negative least squares (Lawson & Hanson 1974, chapter 23): finite,
and its solution is the set of active inequalities and their multipliers. With these the point is
computed anew by orthogonal factors, so that active inequalities hold to rounding.

References: C. L. Lawson & R. J. Hanson, *Solving Least Squares Problems*, Prentice Hall 1974.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tridentify.numerics.arrays import Array
from tridentify.numerics.least_squares import column_norms

SLACK = 1e-12
"""Share of the sizes involved by which a bound may be missed: some thousand roundings."""
POSSIBLE = 1e-14
"""What the nonnegative solution leaves of a unit goal; where less than rounding is left, the
inequalities contradict each other."""


class Bounded(NamedTuple):
    """``x`` (n,), and the multiplier of each inequality (zero where it is not active)."""

    x: Array
    multipliers: Array


def bounded_least_squares(
    matrix: Array, target: Array, rows: Array, least: Array
) -> Bounded | None:
    """Minimise ``|matrix x - target|`` subject to ``rows x >= least``.

    Parameters
    ----------
    matrix : (m, n) array
    target : (m,) array
    rows : (k, n) array
    least : (k,) array

    Returns
    -------
    Bounded or None
        None where no point meets the inequalities.

    Examples
    --------
    >>> found = bounded_least_squares(np.eye(2), np.array([1.0, -1.0]), np.eye(2), np.zeros(2))
    >>> found.x.tolist(), found.multipliers.tolist()
    ([1.0, 0.0], [0.0, 1.0])
    """
    norms = column_norms(matrix)
    scaled = matrix / norms
    free = _least_squares(scaled, target)
    inside = rows / norms
    sizes = np.linalg.norm(inside, axis=1)
    kept = sizes > 0
    if np.any(least[~kept] > 0):
        return None
    inside, bottom = inside[kept] / sizes[kept, None], least[kept] / sizes[kept]
    multipliers = np.zeros(rows.shape[0])
    if np.all(inside @ free >= bottom):
        return Bounded(free / norms, multipliers)
    found = _dual(scaled, free, inside, bottom)
    if found is None:
        return None
    active = np.flatnonzero(found > 0)
    if not active.size:  # violated by no more than rounding
        return Bounded(free / norms, multipliers)
    x = _on(scaled, target, inside[active], bottom[active])
    slack = SLACK * (1.0 + np.abs(bottom) + np.linalg.norm(x))
    if np.any(inside @ x < bottom - slack):
        x = free + _inverse_gram(scaled, inside.T @ found)
    multipliers[np.flatnonzero(kept)] = found / sizes[kept]
    return Bounded(np.asarray(x / norms), multipliers)


def _least_squares(matrix: Array, target: Array) -> Array:
    return np.asarray(np.linalg.lstsq(matrix, target, rcond=1e-13)[0])


def _root(matrix: Array) -> Array:
    """A square ``R`` with ``R' R = matrix' matrix``, kept invertible."""
    _, s, vt = np.linalg.svd(matrix, full_matrices=False)
    return np.asarray(np.maximum(s, 1e-10 * s[0])[:, None] * vt)


def _inverse_gram(matrix: Array, vector: Array) -> Array:
    root = _root(matrix)
    return np.asarray(np.linalg.solve(root, np.linalg.solve(root.T, vector)))


def _dual(matrix: Array, free: Array, rows: Array, least: Array) -> Array | None:
    """Multipliers of the inequalities; None where they contradict each other."""
    turned = np.linalg.solve(_root(matrix).T, rows.T).T
    gap = least - rows @ free
    size = float(np.abs(gap).max())
    lengths = np.linalg.norm(turned, axis=1)
    unit, distance = turned / lengths[:, None], gap / size / lengths
    far = float(np.abs(distance).max())
    stacked = np.vstack([unit.T, distance / far])
    goal = np.zeros(stacked.shape[0])
    goal[-1] = 1.0
    # slow to import, seldom needed
    from scipy.optimize import nnls

    u, _ = nnls(stacked, goal, maxiter=100 * stacked.shape[1])
    rest = 1.0 - float(stacked[-1] @ u)
    if rest < POSSIBLE:
        return None
    return np.asarray(u / rest / lengths * size * far)


def _on(matrix: Array, target: Array, rows: Array, value: Array) -> Array:
    """Least squares on the planes ``rows x = value``."""
    u, s, vt = np.linalg.svd(rows)
    rank = int(np.sum(s > 1e-12 * s[0]))
    point = vt[:rank].T @ ((u[:, :rank].T @ value) / s[:rank])
    along = vt[rank:].T
    if not along.shape[1]:
        return np.asarray(point)
    return np.asarray(point + along @ _least_squares(matrix @ along, target - matrix @ point))
