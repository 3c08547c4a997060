"""Exact likelihood of an autoregression where samples are missing, with its derivative.

With ``S`` the covariance of a whole series (innovations of variance one), ``Q = S^{-1}``, and the
index ``m`` for the samples that are missing, ``o`` for those that are there,

    log det S_oo = log det S + log det Q_mm,        y_o' S_oo^{-1} y_o = min x' Q x   over ``x_m``

(the second by completing the square: the minimum lies at the conditional mean ``x_m = -Q_mm^{-1}
Q_mo y_o``). ``Q`` of an autoregression of order ``p`` has ``p`` diagonals beside the main one
(Gohberg & Semencul 1972), so that ``Q_mm`` costs ``O(p^2)`` for each *missing* sample, and nothing
for the others. For a whole series ``x' Q x`` is a quadratic form in the coefficients,

    x' Q x = sum_ij a_i a_j D_ij,       D_ij = sum_s x_{s+i} x_{s+j},   s = 0 .. n - 1 - i - j

(Box, Jenkins & Reinsel, *Time Series Analysis*, 4th ed., section 7.4, 2008), and ``log det S = -
sum_i i log(1 - k_i^2)`` in the reflection coefficients. The derivative by the coefficients follows
from the same two tables: at the minimum that of ``x_m`` does not count, and ``d log det Q_mm = tr
Q_mm^{-1} dQ_mm`` has the table ``E`` that ``D`` would be with ``Q_mm^{-1}`` for the products of the
missing samples; of this inverse only the entries within the band are computed (Takahashi's
recursion, from the last backwards). One value with all derivatives therefore costs about as much
as one filtering of the series.

References: I. Gohberg & A. Semencul, Mat. Issled. 7 (1972) 201-223. R. Jones, Technometrics 22
(1980) 389-395. A. Erisman & W. Tinney, Communications of the ACM 18 (1975) 177-179.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from types import ModuleType

import numpy as np
from scipy.linalg import cholesky, solve_triangular, toeplitz

from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.levinson import covariance

GRADIENT_STILL = 1e-4
"""Of the derivative at the end, in units of the standard errors: the coefficients are as near."""
MOST_ITERATIONS = 60
"""From Burg's coefficients a handful is enough; many missing samples take some more."""
FARTHEST = 1.0 - 1e-5
"""Largest reflection coefficient: beyond it no series tells a process from one that drifts."""


@cache
def _kernels() -> ModuleType:
    """The loops as machine code, which takes numba: loaded where it is first needed."""
    from tridentify.numerics import incomplete_kernels

    return incomplete_kernels


class Incomplete:
    """The likelihood of autoregressions of one or several series in which samples are missing.

    Parameters
    ----------
    series : sequence of (n_samples,) arrays
        ``nan`` marks a missing sample. No mean is taken off.
    most : int
        Highest order that will be asked for.

    Attributes
    ----------
    count : int
        Samples that are there.

    Examples
    --------
    >>> series = np.array([2.0, 1.0, np.nan, 0.25, 0.125, 1.0, 0.5])
    >>> likelihood = Incomplete([series], 1)
    >>> likelihood.deviance(np.zeros(1)) > likelihood.deviance(np.array([-0.5]))
    True
    """

    def __init__(self, series: Sequence[Array], most: int) -> None:
        filled, missing = [], []
        for one in series:
            # the forms hold from 2 p + 1 samples on; those that are not there do not count
            row = np.full(max(2 * most + 1, one.size), np.nan)
            row[: one.size] = one
            gone = np.isnan(row)
            missing.append(np.flatnonzero(gone))
            row[gone] = 0.0
            filled.append(row)
        self.count = sum(one.size for one in filled) - sum(one.size for one in missing)
        self._samples: tuple[Array, Indices, Indices, Indices, int] = (
            np.concatenate(filled),
            np.cumsum([0, *(one.size for one in filled)]),
            np.concatenate(missing),
            np.cumsum([0, *(one.size for one in missing)]),
            self.count,
        )

    def deviance(self, reflection: Array) -> float:
        """``-2 log L`` up to a constant, the innovations' variance at its best value.

        Parameters
        ----------
        reflection : (p,) array
            Reflection coefficients, below one in size.
        """
        return self.with_slopes(reflection)[0]

    def deviances(self, reflection: Array) -> Array:
        """``-2 log L`` of the first ``0 .. p`` reflection coefficients.

        Parameters
        ----------
        reflection : (p,) array

        Returns
        -------
        (p + 1,) array
        """
        orders = range(reflection.size + 1)
        return np.array([self.with_slopes(reflection[:p])[0] for p in orders])

    def with_slopes(self, reflection: Array) -> tuple[float, Array]:
        """The same with its derivatives by the reflection coefficients."""
        slope = np.empty(reflection.size)
        return float(_kernels().value(_vector(reflection), *self._samples, slope)), slope

    def best(self, reflection: Array) -> Array:
        """Reflection coefficients of highest likelihood near the given ones.

        They are sought as ``tanh`` of what has no bounds, in units of its standard errors there.
        """
        start = np.arctanh(np.clip(reflection, -FARTHEST, FARTHEST))
        root = self._root(np.tanh(start))
        moved, limits = np.zeros(start.size), (GRADIENT_STILL, MOST_ITERATIONS)
        _kernels().descend(start, root, moved, FARTHEST, *limits, *self._samples)
        return np.clip(np.tanh(start + root @ moved), -FARTHEST, FARTHEST)

    def _root(self, k: Array) -> Array:
        """A root of the covariance of ``arctanh k`` for a whole series (Fisher's information)."""
        a, slopes = np.zeros(k.size + 1), np.zeros((k.size, k.size))
        _kernels().levinson(k, a, slopes)
        slopes *= 1.0 - k * k
        information = max(self.count, 1) * slopes.T @ toeplitz(covariance(k)[: k.size]) @ slopes
        try:
            upper = cholesky(information)
        except np.linalg.LinAlgError:
            return np.eye(k.size) / math.sqrt(max(self.count, 1))
        return np.ascontiguousarray(solve_triangular(upper, np.eye(k.size)))


def _vector(values: Array) -> Array:
    """As the loops take them."""
    return np.ascontiguousarray(values, dtype=np.float64)
