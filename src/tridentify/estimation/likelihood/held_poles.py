"""Poles at the slowest decay that the record can show, and steps that leave them there.

`Problem.admissible` holds poles at the slowest decay and the least damping. A Gauss-Newton step
that would take such a pole across the axis is cut there, and what it promised for the others is
lost with it: the steps crawl. Such poles are therefore taken out of the step (an active set;
Nocedal & Wright 2006, section 16.5), to first order: with ``A r = z r``, ``l A = z l`` and
``l r = 1`` a change of ``alpha`` moves a pole ``z`` by

    dz = -(l B) (alpha r),

so that it stays there in steps with ``Re(dz) = 0``: one linear condition a pole. The steps are
taken in an orthonormal basis of what all conditions leave.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tridentify.estimation.likelihood.setup.problem import LEAST_DAMPED
from tridentify.models.response import Branch
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.realization import APART

AT_LIMIT = 1e-6
"""Relative distance to a limit within which a pole counts as being there: `admissible` puts poles
on limits up to rounding, and the curvature of a step leaves them no closer."""


def at_slow_limit(poles: Complex, slowest: float) -> NDArray[np.bool_]:
    """Whether a pole lies at the slowest decay or the least damping; of a pair the upper one.

    The fast limits are not held: a pole there has next to no effect on the samples, and held to
    one side of a limit that only the sampling draws it would not come back.

    Parameters
    ----------
    poles : (n,) complex array
        Admissible.
    slowest : float
        Slowest decay that can be told from a constant [rad/s].

    Returns
    -------
    (n,) bool array

    Examples
    --------
    >>> at_slow_limit(np.array([-0.01 + 0j, -1.0 + 0j]), 0.01).tolist()
    [True, False]
    """
    floor = np.maximum(slowest, LEAST_DAMPED * np.abs(poles.imag))
    return np.asarray((-poles.real <= floor * (1.0 + AT_LIMIT)) & (poles.imag >= 0))


def moved(branch: Branch) -> Complex | None:
    """(n, n) derivatives of every pole of a branch by its ``alpha``; None where poles coincide."""
    z, right = np.linalg.eig(branch.inner.a)
    order = [int(np.argmin(np.abs(z - pole))) for pole in branch.inner.poles]
    distance = np.abs(z[:, None] - z[None, :]) + np.diag(np.full(z.size, np.inf))
    if len(set(order)) < z.size or np.any(distance < APART * np.abs(z)[:, None]):
        return None
    drive = np.linalg.solve(right, branch.inner.b.astype(np.complex128))
    return np.asarray(-drive[order, None] * right[:, order].T)


def conditions(branches: Sequence[Branch], slowest: float, n_unknowns: int) -> Array:
    """Linear conditions on a step, one for each pole that lies at a slow limit.

    Parameters
    ----------
    branches : sequence of Branch
    slowest : float
        Slowest decay that can be told from a constant [rad/s].
    n_unknowns : int
        Of the step: ``alpha`` of all branches, and what stands behind.

    Returns
    -------
    (k, n_unknowns) array
        A step whose product with a row is positive takes that pole out of what is admissible.
    """
    rows = []
    for branch in branches:
        slow = at_slow_limit(branch.inner.poles, slowest)
        slopes = moved(branch) if slow.any() else None
        if slopes is None:
            continue
        for slope in slopes[slow].real:
            row = np.zeros(n_unknowns)
            row[branch.poles] = slope
            if row.any():
                rows.append(row / np.linalg.norm(row))
    return np.array(rows).reshape(-1, n_unknowns)


def left_by(rows: Array, kept: NDArray[np.intp]) -> Array:
    """Orthonormal directions of the kept unknowns in which no row changes.

    Parameters
    ----------
    rows : (k, n) array
    kept : (m,) int array
        Unknowns that may change.

    Returns
    -------
    (n, m') array

    Examples
    --------
    >>> left_by(np.array([[1.0, 0.0, 0.0]]), np.array([0, 1]))[:, 0].round(12).tolist()
    [0.0, 1.0, 0.0]
    """
    found = np.zeros((rows.shape[1], kept.size))
    found[kept, np.arange(kept.size)] = 1.0
    if rows.shape[0] == 0:
        return found
    u, s, _ = np.linalg.svd(rows[:, kept].T, full_matrices=True)
    rank = int(np.sum(s > 1e-10 * max(s[0], 1e-300)))
    return np.asarray(found @ u[:, rank:])
