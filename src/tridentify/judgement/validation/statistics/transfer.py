"""How an estimate does on a record that it was not made from: as well as its errors say, or worse.

With the start of the record fitted, ``r = e + D w``: noise, and what the standard errors of the
coefficients let the residual hold (``w`` of covariance one). So the size of the residual to be
expected is ``s^2 (N - q) + |D|^2``, a bound that no better model could beat by more than
``|D|^2``. Whether the coefficients of this record are the same is told by the part of the residual
along ``D = U diag(d) V'``:

    sum (u_i' r)^2 / (s^2 + d_i^2)     is chi-square with rank(D) degrees of freedom,

all outputs together. The variance ``s^2`` is that of what is left on this record, so a noisier
record is not taken for another plant. It is the Wald test of equal coefficients in two records
(Chow, Econometrica 28, 1960, 591-605), without fitting the second.
"""

from __future__ import annotations

import numpy as np
from scipy.special import fdtrc, ndtr

from tridentify.estimation.answer.estimate import Estimate
from tridentify.judgement.validation.residuals import View
from tridentify.judgement.validation.result import Transfer
from tridentify.numerics.arrays import Array
from tridentify.numerics.lagrange import span
from tridentify.numerics.levinson import autocovariance


def carried_over(view: View, estimate: Estimate, noises: list[Array]) -> Transfer:
    """Compare another record with what the estimate leads to expect.

    Parameters
    ----------
    view : View
    estimate : Estimate
    noises : list of (p,) arrays
        Model of each output's noise on this record.
    """
    n_outputs = len(view.outputs)
    expected, ratio, p_size = np.zeros((3, n_outputs))
    residuals, moves, freedom = [], [], 0.0
    for i, output in enumerate(view.outputs):
        a = noises[i]
        rest = span(output.white(output.nuisance, a))
        r = output.white(tuple(np.nan_to_num(one) for one in output.residual), a)
        r = r - rest @ (rest.T @ r)
        d = output.white(output.coefficients, a)
        d = d - rest @ (rest.T @ d)
        wide = span(d)
        left = r - wide @ (wide.T @ r)
        # the noise's coefficients were fitted to this record, as the estimate's to its own
        own = max(output.count - rest.shape[1] - wide.shape[1] - a.size, 1)
        s = float(np.sqrt(left @ left / own))
        residuals.append(r / s)
        moves.append(d / s)
        freedom += own
        expected[i], ratio[i], p_size[i] = _size(view, estimate, i, s, own)
    p_value = np.nan
    if view.has_errors and moves[0].shape[1]:
        u, d, _ = np.linalg.svd(np.vstack(moves), full_matrices=False)
        kept = d > 1e-9 * d[0]
        along = u.T @ np.concatenate(residuals)
        statistic = float(np.sum((along**2 / (1.0 + d**2))[kept]))
        # no coefficient moves anything where the input rests and the start is free
        k = int(kept.sum())
        p_value = float(fdtrc(k, freedom, statistic / k)) if k else np.nan
    return Transfer(expected, ratio, p_size, p_value)


def _size(
    view: View, estimate: Estimate, i: int, s: float, own: float
) -> tuple[float, float, float]:
    """Fit to be expected, size of the residual over that, and the p-value of the noise's size."""
    output = view.outputs[i]
    n = output.count
    joined = np.concatenate(output.standardised)
    y = np.concatenate(output.y)[np.isfinite(joined)]
    r = joined[np.isfinite(joined)]
    moved = np.vstack(output.coefficients)[np.isfinite(joined)]
    rest = np.vstack(output.nuisance)[np.isfinite(joined)]
    q = span(rest)
    moved = moved - q @ (q.T @ moved) if view.has_errors else np.zeros((n, 0))
    variance = float(estimate.noise_variance[i])
    energy = variance * (n - q.shape[1]) + float(np.sum(moved**2))
    about = float(np.sum((y - y.mean()) ** 2))
    fit = 100.0 * (1.0 - np.sqrt(energy / about)) if about > 0 else np.nan
    ratio = float(np.sqrt(r @ r / energy)) if energy > 0 else np.nan
    # the innovations: of the estimate's noise model, and on this record
    before = variance / float(autocovariance(estimate.noise_model[i], 0)[0])
    if not (before > 0 and s > 0):
        return float(fit), ratio, 1.0
    kurtosis = float(np.mean((r - r.mean()) ** 4) / np.mean((r - r.mean()) ** 2) ** 2)
    theirs = max(estimate.degrees_of_freedom / len(view.outputs), 1.0)
    spread = np.sqrt(max(kurtosis - 1.0, 0.5) * (1.0 / own + 1.0 / theirs))
    z = np.log(s**2 / before) / spread
    return float(fit), ratio, float(2.0 * ndtr(-abs(z)))
