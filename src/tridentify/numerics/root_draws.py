"""Roots of many polynomials at once, and which of them belong together.

Roots are eigenvalues of companion matrices. Which root of a draw belongs to which root of a
reference is the assignment with the smallest sum of distances, relative to the size of the root. A
pair of conjugate roots that became two real ones keeps its meaning through its quadratic factor
``s^2 + 2 z w s + w^2 = (s - p1)(s - p2)``: the natural frequency is ``sqrt(p1 p2)`` and the damping
exceeds one. Two real roots that became a pair count with their real part. Of a saddle (one pole on
either side) the frequency counts as zero and the damping as infinite: beyond every other draw.
"""

from __future__ import annotations

import itertools

import numpy as np

from tridentify.numerics import delta_method
from tridentify.numerics.arrays import Array, Complex

FEW = 4
"""Up to so many roots every assignment is tried for all draws at once (24 of them)."""


def stacked_roots(polynomials: Array) -> Complex:
    """Roots of a stack of polynomials of one degree.

    Parameters
    ----------
    polynomials : ndarray, shape (n_draws, n + 1)
        Descending powers.

    Returns
    -------
    ndarray, shape (n_draws, n)
        In no particular order; ``nan`` where a coefficient is not finite or the leading one is 0.

    Examples
    --------
    >>> np.sort(stacked_roots(np.array([[1.0, 3.0, 2.0], [2.0, 4.0, 0.0]])), axis=1).real
    array([[-2., -1.],
           [-2.,  0.]])
    """
    count, n = polynomials.shape[0], polynomials.shape[1] - 1
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        monic = polynomials[:, 1:] / polynomials[:, :1]
    sound = np.all(np.isfinite(monic), axis=1)
    companion = np.zeros((count, n, n))
    companion[:, 1:, :-1] = np.eye(max(n - 1, 0))
    if n:
        companion[:, 0, :] = -np.where(sound[:, None], monic, 0.0)
    roots = np.linalg.eigvals(companion).astype(np.complex128)
    roots[~sound] = np.nan
    return roots


def matched(roots: Complex, reference: Complex) -> Complex:
    """Reorder the roots of every draw: root ``i`` is the one that belongs to ``reference[i]``.

    Parameters
    ----------
    roots : ndarray, shape (n_draws, n)
    reference : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n_draws, n)

    Examples
    --------
    >>> matched(np.array([[-5.2 + 0j, -0.9]]), np.array([-1.0 + 0j, -5.0])).real
    array([[-0.9, -5.2]])
    """
    n = reference.size
    if n < 2:
        return roots.copy()
    scale = np.where(np.abs(reference) > 0, np.abs(reference), 1.0)
    cost = np.abs(roots[:, None, :] - reference[:, None]) / scale[:, None]
    cost = np.nan_to_num(cost, nan=0.0, posinf=1e300)
    if n <= FEW:
        orders = np.array(list(itertools.permutations(range(n))), dtype=np.intp)
        total = sum((cost[:, i, orders[:, i]] for i in range(n)), np.zeros((len(roots), 1)))
        chosen = orders[np.argmin(total, axis=1)]
    else:
        # slow to import, seldom needed
        from scipy.optimize import linear_sum_assignment

        chosen = np.array([linear_sum_assignment(one)[1] for one in cost], dtype=np.intp)
    return np.take_along_axis(roots, chosen, axis=1)


def pole_values(den: Array, reference: Array) -> Array:
    """Natural frequencies, dampings, real poles and time constants of every draw.

    Parameters
    ----------
    den : ndarray, shape (n_draws, n + 1)
    reference : ndarray, shape (n + 1,)
        The estimate's denominator, which says which quantities there are.

    Returns
    -------
    ndarray, shape (n_draws, n_quantities)
        In the order of `delta_method.pole_quantities`.

    Examples
    --------
    >>> pole_values(np.array([[1.0, 1.0, 4.0], [1.0, 5.0, 4.0]]), np.array([1.0, 1.0, 4.0]))
    array([[2.  , 0.25],
           [2.  , 1.25]])
    """
    centre = delta_method.root_sensitivity(reference)[0]
    roots = matched(stacked_roots(den), centre)
    columns: list[Array] = []
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for k, pole in enumerate(centre):
            if pole.imag > 0:
                product = (roots[:, k] * roots[:, k + 1]).real
                frequency = np.sqrt(np.where(product < 0, 0.0, product))
                total = (roots[:, k] + roots[:, k + 1]).real
                columns += [frequency, -total / (2.0 * frequency)]
            elif pole.imag == 0:
                columns.append(roots[:, k].real)
                if pole.real != 0:
                    columns.append(-1.0 / roots[:, k].real)
    return np.stack(columns, axis=1)
