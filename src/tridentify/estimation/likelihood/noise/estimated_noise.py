"""What it costs the coefficients that the model of their noise is an estimate.

The information is block diagonal (`noise.noise_model`), so that in long records the covariance
is that of a noise that is known. In short ones it is not. With ``g`` the derivatives of the output
in coordinates in which the whitened ones ``A g`` are orthonormal, and ``W`` the covariance of the
coefficients ``a_j`` of ``A``, the estimate moves by ``h_j' e`` with ``a_j``,

    h_j = q^{-j} g + q^{j} A(q^{-1})^{-1} A g,

and what it moves by has the covariance ``L = sum_ij W_ij h_i' (I - H) h_j``, ``H`` the projection
on ``A g``. The inverse information falls short of that of the known noise by as much, on the mean,
as it is concave in the noise: twice ``L`` is added (Kenward & Roger 1997; Kackar & Harville 1984).

That variance itself is a random number, above all where the information lies in a band of
frequencies in which there is little noise: of 150 samples its error there is half of itself, and
small standard errors come with estimates that are far off. To first order it varies by

    d (l' I^{-1} l) / d a_j  =  -l' (g' A' q^{-j} g + its transpose) l

for a coefficient that moves by ``l``, and with the variance of the innovations. So it has the
degrees of freedom of a multiple of chi squared with the same mean and variance (Satterthwaite
1946), and the intervals are those of Student's distribution.

References: M. Kenward & J. Roger, Biometrics 53 (1997) 983-997. R. Kackar & D. Harville, J.
American Statistical Association 79 (1984) 853-862. F. Satterthwaite, Biometrics 2 (1946) 110-114.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_banded, toeplitz
from scipy.special import ndtri, stdtrit

from tridentify.estimation.likelihood.cost import Point
from tridentify.estimation.likelihood.scores import COVERED
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import whiten
from tridentify.numerics.levinson import autocovariance

LONGEST = 3000
"""Samples of all outputs beyond which it is not looked at: of the benchmarks' loops with as many it
adds two per cent to a standard error, and falls as one over their number."""
FEWEST = 4.0
"""Degrees of freedom of a variance, below which the first order says nothing of them."""


def estimated_noise(
    point: Point, root: Array, along: Array, variance: Array, freedom: Array
) -> tuple[Array, Array] | None:
    """What is added to the covariance, and by what its standard errors are multiplied.

    Parameters
    ----------
    point : Point
    root : (n_unknowns, k) array
        ``root root'`` is the covariance of the unknowns of `Point.jacobian`.
    along : (n_coefficients, k) array
        How the coefficients move along the directions.
    variance, freedom : (n_outputs,) arrays
        Of the innovations, and the degrees of freedom of these variances.

    Returns
    -------
    added : (k, k) array
        In coordinates in which the covariance is the identity.
    wider : (n_coefficients,) array
        Ends of the intervals over those of a known variance.

    None where the noise is white, or the record so long that it makes no difference.
    """
    models = point.problem.noise
    if not any(a.size for a in models) or point.counts.sum() > LONGEST:
        return None
    k = root.shape[1]
    added, varied = np.zeros((k, k)), np.zeros(len(along))
    for i, a in enumerate(models):
        cov = _covariance(a, float(point.counts[i]))
        known, bent = np.zeros((k, k)), np.zeros((a.size, k, k))
        moved, across = np.zeros((a.size * k,) * 2), np.zeros((a.size, k, k))
        moves = point.sensitivities(root, i)
        for e, table in zip(point.problem.experiments, moves, strict=True):
            lags, white, back = _lagged(table / (e.scale_of(i) * np.sqrt(variance[i])), a)
            known += white.T @ white
            both = np.einsum("nr,npc->prc", white, lags)
            bent += both + both.transpose(0, 2, 1)
            h = lags + back
            across += np.einsum("nr,npc->prc", white, h)
            flat = h.reshape(len(h), -1)
            moved += flat.T @ flat
        moved = moved.reshape(a.size, k, a.size, k)
        added += np.einsum("ij,icjd->cd", cov, moved)
        added -= np.einsum("ij,irc,jrd->cd", cov, across, across)
        slopes = np.einsum("cr,prs,cs->cp", along, bent, along)
        own = np.einsum("cr,rs,cs->c", along, known, along)
        varied += np.einsum("ci,ij,cj->c", slopes, cov, slopes) + 2.0 / freedom[i] * own**2
    sizes = np.sum(along**2, axis=1)
    freedoms = 2.0 * sizes**2 / np.maximum(varied, 1e-300)
    wider = stdtrit(np.maximum(freedoms, FEWEST), COVERED) / ndtri(COVERED)
    return 2.0 * added, np.where(sizes > 0, wider, 1.0)


def _covariance(a: Array, count: float) -> Array:
    """(p, p) of autoregressive coefficients."""
    if not a.size:
        return np.zeros((0, 0))
    return np.asarray(np.linalg.inv(toeplitz(autocovariance(a, a.size - 1))) / count)


def _lagged(table: Array, a: Array) -> tuple[Array, Array, Array]:
    """``q^{-j} g``, (n, p, k); ``A g``, (n, k); ``q^{j} A(q^{-1})^{-1} A g``, (n, p, k)."""
    n, k = table.shape
    white = np.nan_to_num(np.column_stack([whiten(one, a)[0] for one in table.T]))
    table = np.nan_to_num(table)
    bands = np.tile(np.append(1.0, a)[:, None], n)
    turned = solve_banded((a.size, 0), bands, white[::-1])[::-1]
    lags, back = np.zeros((2, n, a.size, k))
    for j in range(1, a.size + 1):
        lags[j:, j - 1] = table[:-j]
        back[:-j, j - 1] = turned[j:]
    return lags, white, back
