"""Gross outliers, found before there is a model: Step 1 by least absolute values.

Least squares follows a few samples that are far off, so a search on the output error could be
misled before any weighting begins. The parallel model (`models.parallel`) is linear in its
weights whatever the system, so its M-estimates are convex problems and need no start: the sum of
absolute residuals has one minimum, which no sample of the output can move at will as long as
most are right (Huber 1981, section 7.3; Rousseeuw & Leroy 1987). Samples that lie far from that
fit, in units of the scale of its residuals, are set aside for the search. Nothing else depends on
them: the estimate is made of all samples, each with the weight that the final model gives it.

The record is taken in windows, each with a free response of its own. Several banks are tried in
the first of them (poles in the band at several dampings, and Laguerre functions), and the one
with the least absolute residual serves all. The fit is iteratively reweighted least squares
(Holland & Welsch 1977) in an orthonormal basis of the columns, finished with Tukey's biweight,
which takes what is far off out of the scale. A sample that its own columns fit, whatever its value
(a leverage near one: the first ones, by the free response), cannot be judged; it is set aside too.

References: P. Huber, *Robust Statistics*, Wiley (1981). P. Rousseeuw & A. Leroy, *Robust
Regression and Outlier Detection*, Wiley (1987). P. Holland & R. Welsch, Communications in
Statistics A6 (1977) 813-827.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from tridentify.estimation.likelihood.setup.nuisance import Nuisances, build
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.estimation.search.band import SPREAD_DAMPING, rate_limits, spread_poles
from tridentify.models.regression import Layout, response_of
from tridentify.numerics.arrays import Array, Complex, Flags
from tridentify.numerics.converter import quantum
from tridentify.numerics.least_squares import column_norms
from tridentify.numerics.realization import Cascade, cascade
from tridentify.numerics.robust import median_scale
from tridentify.numerics.slices import Slices, drain
from tridentify.record.record import Record
from tridentify.structure import Structure

WINDOW_SAMPLES = 4_000
"""Samples of a window: far more than its columns, and few enough that a bank over the band of the
window serves it."""
MOST_COLUMNS = 24
"""Poles of the bank."""
PER_COLUMN = 6
"""Samples for each column at least: with fewer a fit follows its outliers."""
LAGUERRE_RATES = 4
"""Laguerre banks that are tried beside those of `SPREAD_DAMPING`."""
FAR = 4.0
"""Robust standard deviations from which a sample is set aside: one of 16,000 good ones is."""
BIWEIGHT = 4.685
"""Tukey's constant [robust standard deviations]: 95 % efficient with Gaussian noise (Holland &
Welsch 1977)."""
ABSOLUTE_ROUNDS = 12
"""Rounds of weights towards least absolute values: a way in for the biweight, not an end."""
BIWEIGHT_ROUNDS = 8
"""Rounds of biweights: only the set of samples that are far off matters, not the last digits."""
NEAR_ZERO = 0.05
"""Share of the median residual below which a residual gets no more weight: weights of one over
nothing would fit some samples exactly."""
RIDGE = 1e-12
"""Share of the trace added to the normal equations, where weights take a column away."""
MOST_SET_ASIDE = 0.4
"""Share of an output's samples that are set aside at most: no fit bears half of them wrong."""
SELF_FITTED = 0.7
"""Leverage above which a sample mostly decides its own fit, and its residual says little."""


def gross_outliers(records: Sequence[Record], structure: Structure) -> tuple[Flags, ...]:
    """Samples too far off to be shown to a search.

    Parameters
    ----------
    records : sequence of Record
    structure : Structure
        Of the model that is wanted.

    Returns
    -------
    tuple of (n_samples, n_outputs) bool arrays
        One per record.
    """
    return drain(outlier_slices(records, structure))


def outlier_slices(records: Sequence[Record], structure: Structure) -> Slices[tuple[Flags, ...]]:
    """`gross_outliers` in slices, one a round of weights."""
    found, poles = [], None
    for record in records:
        flags = np.zeros(record.y.shape, dtype=np.bool_)
        for first, last in _windows(record.n_samples):
            if np.isnan(record.y[first:last]).all(axis=0).any():
                continue
            piece = record.slice(float(record.t[first]), float(record.t[last - 1]))
            problem = build([piece], structure, Nuisances("free", True, False))
            if poles is None:
                poles = yield from _best_poles(problem)
            residuals, leverage, _ = yield from _residuals(problem, poles)
            far = _far(residuals, 2 * poles.size, problem.experiments[0].y)
            flags[first:last] = far | (leverage > SELF_FITTED)
        found.append(flags)
    return tuple(found)


def _windows(n_samples: int) -> list[tuple[int, int]]:
    count = -(-n_samples // WINDOW_SAMPLES)
    return list(pairwise(np.linspace(0, n_samples, count + 1).astype(int).tolist()))


def _best_poles(problem: Problem) -> Slices[Complex]:
    """Poles of the bank whose least absolute residual is the smallest, over all outputs."""
    low, high = rate_limits(problem)
    samples = problem.experiments[0].n_samples
    count = min(MOST_COLUMNS, samples // (PER_COLUMN * (problem.n_inputs + 1)))
    count = max(count, min(problem.n_poles + 1, samples // 4), 1)
    tried = [spread_poles(problem, damping, count) for damping in SPREAD_DAMPING]
    tried += [
        np.full(count, -g, dtype=np.complex128) for g in np.geomspace(low, high, LAGUERRE_RATES)
    ]
    left = []
    for poles in tried:
        left.append((yield from _residuals(problem, poles, 0))[2])
    return tried[left.index(min(left))]


def _residuals(
    problem: Problem, poles: Complex, rounds: int = BIWEIGHT_ROUNDS
) -> Slices[tuple[Array, Array, float]]:
    """Residuals and leverages (n_samples, n_outputs), and the sum of log absolute residuals."""
    experiment = problem.experiments[0]
    bank = cascade(poles)
    residuals = np.full(experiment.y.shape, np.nan)
    leverage = np.zeros(experiment.y.shape)
    total = 0.0
    known: dict[int, Array] = {}
    for i, y in enumerate(experiment.y.T):
        seen = np.isfinite(y)
        if not seen.any():
            continue
        signal = experiment.sampled.index(experiment.sampled[i])
        if signal not in known:
            yield
            known[signal] = _basis(problem, bank, i)
        own = known[signal] if seen.all() else np.linalg.qr(known[signal][seen])[0]
        rounding = quantum(y) / np.sqrt(12.0)
        residuals[seen, i], absolute = yield from _robust_fit(own, y[seen], rounds, rounding)
        leverage[seen, i] = np.einsum("ij,ij->i", own, own)
        total += float(np.log(absolute + 1e-12 * float(np.abs(y[seen]).mean()) + 1e-300))
    return residuals, leverage, total


def _basis(problem: Problem, bank: Cascade, output: int) -> Array:
    """Orthonormal basis of all columns of one output's parallel model."""
    experiment = problem.experiments[0]
    layout = Layout(bank.order, problem.n_inputs, True, experiment.offset, experiment.drift)
    n = layout.n_signals
    columns = response_of(experiment, bank, np.eye(n), outputs=(output,) * n)
    if not problem.biproper:
        columns = np.delete(columns, np.s_[layout.states : layout.states + problem.n_inputs], 1)
    u, s, _ = np.linalg.svd(columns / column_norms(columns), full_matrices=False)
    return np.asarray(u[:, s > 1e-10 * s[0]])


def _robust_fit(
    basis: Array, y: Array, rounds: int, rounding: float
) -> Slices[tuple[Array, float]]:
    """Residuals by least absolute values, then the biweight; mean absolute one of the former.

    ``rounding``: standard deviation that the converter alone leaves.
    """
    residual = y - np.median(y)
    for _ in range(ABSOLUTE_ROUNDS):
        yield
        size = np.abs(residual)
        floor = max(NEAR_ZERO * float(np.median(size)), rounding) + 1e-300
        residual = y - basis @ _weighted(basis, y, 1.0 / np.maximum(size, floor))
    absolute = float(np.abs(residual).mean())
    for _ in range(rounds):
        yield
        scale = max(median_scale(residual, basis.shape[1]), rounding)
        if scale == 0:
            break
        # cut before it is squared: coarse samples that mostly fit exactly have next to no scale
        weights = (1.0 - np.minimum(np.abs(residual) / (BIWEIGHT * scale), 1.0) ** 2) ** 2
        residual = y - basis @ _weighted(basis, y, weights)
    return residual, absolute


def _weighted(basis: Array, y: Array, weights: Array) -> Array:
    # of an orthonormal basis, the normal equations have at most the condition of the weights
    scaled = basis.T * (weights / weights.max())
    gram = scaled @ basis
    gram[np.diag_indices_from(gram)] += RIDGE * np.trace(gram)
    return np.asarray(np.linalg.solve(gram, scaled @ y))


def _far(residuals: Array, unknowns: int, y: Array) -> Flags:
    """Which residuals lie far off; at most 40 % of an output's, the farthest.

    The scale is at least that of the rounding: of an output that rests on one step of its
    converter for most of the time, half the residuals are next to nothing.
    """
    flags = np.zeros(residuals.shape, dtype=np.bool_)
    for i, column in enumerate(residuals.T):
        seen = np.isfinite(column)
        if not seen.any():
            continue
        size = np.where(seen, np.abs(column), 0.0)
        rounding = quantum(y[:, i]) / np.sqrt(12.0)
        limit = FAR * max(median_scale(column[seen], unknowns), rounding)
        limit = max(limit, float(np.quantile(size[seen], 1.0 - MOST_SET_ASIDE)))
        flags[:, i] = size > limit
    return flags
