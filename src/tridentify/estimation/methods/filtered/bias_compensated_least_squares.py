"""Bias-compensated least squares: the series-parallel model of the raw record, less its noise.

Fitted to the recorded ``y = y* + zeta``, the series-parallel model is biased because the square of
the filtered noise stands in the normal equations (paper, eq. 6-9). Which matrix that is on average
is known up to the noise variance (`methods.filtered.noise_through_filters`): with the unknowns of
input, initial state and constants eliminated, ``A = Y' (1 - Q Q') Y`` and ``alpha`` ending in the
monic 1,

    E A = A* + sigma^2 Lambda,        A* alpha_0 = 0  at the true coefficients.                  (1)

*Noise variance and coefficients at once.* ``A - sigma^2 Lambda`` must stay positive semi-definite,
as ``A*`` is, and be singular. The largest variance that may be subtracted is therefore the
estimate: the smallest generalised eigenvalue of ``(A, Lambda)``, whose vector is ``alpha``,

    sigma_hat^2 = min over alpha of (alpha' A alpha) / (alpha' Lambda alpha)                     (2)

(Koopmans 1937; Levin 1964; a Frisch scheme with noise on the output alone: Soderstrom 2018). It
is compensated least squares (Stoica & Soderstrom 1982; Zheng 1998) with this variance, and needs
no iteration, no start and no cap. The variance of the output error in its place gave no smaller
errors in trials, and no solution where the filter is much faster than the system. The eigenvalue
is computed as the smallest singular value of ``R_A R_Lambda^{-1}``, from triangles: neither ``A``
nor its compensated form is ever built.

*Several outputs* share ``a`` and have a noise level each. Their equations are weighted by one over
the standard deviations of the output error of the pass before, until these stand still; then
(2) is an estimate of one.

*Covariance.* To first order, with ``v = L_alpha zeta`` the filtered noise of the equation error and
``D* = [Y*_1, Z]`` the regressors without noise,

    dx = - (D*' D*)^{-1} (D*' v + zeta' S zeta),
    S_i = sym(L_i' L_alpha) - kappa_i L_alpha' L_alpha,
    kappa_i = tr(L_i' L_alpha) / tr(L_alpha' L_alpha),

where ``S`` has entries in the rows of ``a`` alone and its second term is what (2) takes off. So for
Gaussian noise the middle of the sandwich is ``sigma^2 (L_alpha' D*)' (L_alpha' D*) + 2 sigma^4
tr(S_i S_j)``. The operators being Toeplitz, the trace is a sum over lags of products of
correlation functions of the filters; the one at lag zero cancels, and with it the noise's
kurtosis. The second term is of higher order in the noise-to-signal ratio and is what limits the
method where there is much noise. What ``Q`` takes from ``S``, and that the filter was chosen by the
same record, are left out.

*Filter.* Where none is given, every ``(p + lambda)^n`` on the grid of `SvfLeastSquares` is solved
and the model with the lowest AICc of its simulated output is taken. A filter that suits the raw
fit, which has to keep the noise out, need not suit the compensated one.

What remains without noise is the error of joining samples of ``y`` by straight lines (``dt^2``). It
is in neither the covariance nor ``Lambda``: at two samples a radian of the fastest pole and little
noise it can be several standard errors, and make a lightly damped pair unstable.

References
----------
T. C. Koopmans, Linear Regression Analysis of Economic Time Series, De Erven Bohn 1937.
M. J. Levin, IEEE Trans. Automatic Control 9(3) (1964), 229-235.
P. Stoica, T. Soderstrom, Int. J. Control 35(3) (1982), 449-457.
W. X. Zheng, IEEE Trans. Signal Processing 46(6) (1998), 1631-1638.
T. Soderstrom, Errors-in-Variables Methods in System Identification, Springer 2018.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import scipy.linalg

from tridentify.errors import IdentifiabilityError, UnsupportedOrderError
from tridentify.estimation.answer.assemble import Request
from tridentify.estimation.answer.estimate import Estimate, Pass, Start, Status, Step, Trace
from tridentify.estimation.likelihood.held_model import HeldModel
from tridentify.estimation.likelihood.literal import literal_estimate
from tridentify.estimation.methods.base import Progress, check
from tridentify.estimation.methods.capability import Capability, refuse_missing
from tridentify.estimation.methods.filtered.filter_cascade import Filter, checked_filter
from tridentify.estimation.methods.filtered.noise_through_filters import (
    FilterColumns,
    Separated,
    factor,
    separate,
)
from tridentify.estimation.methods.filtered.state_variable_filters import (
    backward,
    coefficient_map,
    equation,
    unreduced,
    with_filtered,
)
from tridentify.estimation.methods.filtered.svf_least_squares import (
    Chosen,
    described,
    least_squares,
)
from tridentify.models.regression import Experiment
from tridentify.numerics.arrays import Array
from tridentify.numerics.correlation import products_at_shifts
from tridentify.numerics.least_squares import triangle
from tridentify.numerics.realization import cascade, roots_of, sort_poles
from tridentify.record.record import Record
from tridentify.structure import Structure

MOST_PASSES = 10
"""Passes over the noise levels of several outputs: it bounds the time."""
SETTLED = 1e-3
"""Largest difference between outputs in how the logarithm of the noise variance changed, a tenth of
a per cent: far less than its own error, sqrt(2 / N)."""
VANISHING = 1e-12
"""Share of the largest coefficient, each in the size of its noise, below which the highest one is
nothing: above the rounding of the eigenvector."""


@dataclass(frozen=True)
class BiasCompensatedLeastSquares:
    """Least squares on the filtered input and output, with the noise's expected share taken off.

    For white noise at the samples. Quick and consistent, but not efficient.

    Parameters
    ----------
    filter : sequence of float, optional
        Coefficients of ``c(p)``, descending powers; stable, of at least as many roots as there are
        poles. None: ``(p + lambda)^n`` with the ``lambda`` on the grid of `SvfLeastSquares` whose
        compensated model has the lowest AICc of its simulated output.

    Raises
    ------
    OptionError
        For a filter that makes no sense.

    References
    ----------
    .. [1] P. Stoica, T. Soderstrom, Bias correction in least-squares identification,
       Int. J. Control 35(3) (1982), 449-457.
    .. [2] M. J. Levin, Estimation of a system pulse transfer function in the presence of noise,
       IEEE Trans. Automatic Control 9(3) (1964), 229-235.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Record, Structure, TransferFunction, identify, simulate
    >>> u = np.sign(np.sin(np.arange(4000) ** 1.5))
    >>> y = simulate(TransferFunction([2.0], [1.0, 4.0]), Record(u, u, dt=0.01))
    >>> noisy = y[:, 0] + 0.05 * np.random.default_rng(0).standard_normal(u.size)
    >>> method = BiasCompensatedLeastSquares(filter=[1.0, 8.0])
    >>> estimate = identify(Record(u, noisy, dt=0.01), Structure(1, 0), method)
    >>> bool(np.all(np.abs(estimate.theta - [4.0, 2.0]) < 3 * estimate.std))
    True
    """

    filter: Sequence[float] | None = None

    name: ClassVar[str] = "BiasCompensatedLeastSquares"
    """What tables and files call it."""
    capabilities: ClassVar[Capability] = Capability.NONE
    """The plain case only."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "filter", checked_filter(self.filter))

    def estimate(
        self, records: Sequence[Record], structure: Structure, progress: Progress | None = None
    ) -> Estimate:
        """Estimate the coefficients.

        Parameters
        ----------
        records : sequence of Record
        structure : Structure
            Nuisance terms left open are decided as by `SvfLeastSquares`.
        progress : callable, optional

        Returns
        -------
        Estimate
            Its status is `Status.SETTLED`, as the equations solved are not those of the least
            output error; ``nan`` covariance if a pole was reflected. The last pass's note holds
            the estimated standard deviation of the noise.

        Raises
        ------
        DataError, StructureError
            If records and structure are not usable or not supported, such as missing outputs.
        IdentifiabilityError
            If the filtered signals are linearly dependent, or the record is too short for the
            filter.
        """
        check(records, structure, self.name, self.capabilities)
        refuse_missing(records, self.name)
        if progress:
            progress("least squares on the filtered record, less the noise")
        chosen = least_squares(records, structure, self.filter)
        chosen, found, passes, starts = _best(chosen)
        stopped = "the smallest generalised eigenvalue of signals and noise"
        literal = found.model.literal(chosen.nuisances)
        return literal_estimate(
            Request.of(records, structure, self.name),
            literal,
            Status.SETTLED,
            Trace(passes, starts, chosen.decisions, stopped),
            cov=_covariance(found, chosen, literal.noise_variance),
            aicc=found.model.criterion,
            condition=found.condition,
        )


@dataclass(frozen=True, eq=False)
class Compensated:
    """The compensated equations solved.

    Attributes
    ----------
    model : HeldModel
    weights : (n_outputs,) array
    unknowns : array
        Of the equation error.
    alpha : (n + 1,) array
        Those of ``a`` and the monic 1.
    level : float
        Estimated noise variance in units of the assumed ones.
    condition : float
    """

    model: HeldModel
    weights: Array
    unknowns: Array
    alpha: Array
    level: float
    condition: float


def _best(
    chosen: Chosen,
) -> tuple[Chosen, Compensated, tuple[Pass, ...], tuple[Start, ...]]:
    """The filter whose compensated model has the lowest AICc of its output, and all models tried.

    Raises
    ------
    IdentifiabilityError
        If no filter has a solution.
    """
    tried: list[tuple[Chosen, Compensated, tuple[Pass, ...]]] = []
    failed: list[IdentifiabilityError] = []
    for raw in chosen.tried:
        one = replace(chosen, experiments=raw.experiments, fit=raw.fit, label=raw.label)
        try:
            tried.append((one, *_compensated(one)))
        except IdentifiabilityError as error:
            failed.append(error)
    if not tried:
        raise failed[0]
    starts = tuple(Start(o.label, f.model.theta, f.model.mean_square) for o, f, _ in tried)
    return *min(tried, key=lambda entry: entry[1].model.criterion), starts


def _compensated(chosen: Chosen) -> tuple[Compensated, tuple[Pass, ...]]:
    """Solve, for several outputs until their noise levels stand still."""
    passes = [described(1, chosen.fit, f"recorded output, {chosen.label}")]
    variance = chosen.fit.model.variance
    for number in range(2, MOST_PASSES + 2):
        found = _solved(chosen, variance)
        passes.append(_pass(number, found, variance))
        before, variance = variance, found.model.variance
        change = np.ptp(np.log(variance / before))
        if change < SETTLED:
            break
    return found, tuple(passes)


def _solved(chosen: Chosen, variance: Array) -> Compensated:
    problem, c = chosen.problem, Filter.of(chosen.fit.c)
    weights = 1.0 / np.sqrt(variance)
    parts = separate(problem, chosen.experiments, c, weights, variance)
    alpha, level = smallest_pair(parts)
    unknowns = parts.unknowns(alpha[:-1])
    constant, matrix = coefficient_map(problem, c, parts.equation.width)
    theta = constant + matrix @ unknowns
    n = problem.n_poles
    if c.order == n:
        roots = roots_of(c, alpha[:-1] @ c.basis.rows[:n])
    else:
        roots = sort_poles(np.roots(np.append(1.0, theta[:n])).astype(np.complex128))
    poles, note = problem.admissible(roots)
    model = HeldModel(problem, poles, theta[n:], note)
    return Compensated(model, weights, unknowns, alpha, level, parts.condition)


def smallest_pair(parts: Separated) -> tuple[Array, float]:
    """Generalised eigenvector, ending in 1, and eigenvalue of (2).

    Raises
    ------
    UnsupportedOrderError
        If the vector has no monic part: one pole less would do.
    """
    noise = factor(parts.noise)
    ratio = scipy.linalg.solve_triangular(noise, parts.triangle.T, trans="T").T
    _, s, vt = np.linalg.svd(ratio)
    alpha = scipy.linalg.solve_triangular(noise, vt[-1])
    size = np.abs(alpha) * np.sqrt(np.diag(parts.noise))
    if not size[-1] > VANISHING * size.max():
        raise UnsupportedOrderError(
            "found compensated equations whose highest coefficient vanishes; expected an order "
            "that the record needs; lower the number of poles"
        )
    return np.asarray(alpha / alpha[-1]), float(s[-1] ** 2) if s.size == alpha.size else 0.0


def _pass(number: int, found: Compensated, variance: Array) -> Pass:
    deviations = ", ".join(f"{np.sqrt(found.level * v):.3g}" for v in variance)
    note = f"less the filtered noise of standard deviation {deviations}"
    cost = found.level
    step = Step("series-parallel", found.model.theta, cost, found.condition, note)
    model = found.model
    return Pass(number, (step,), model.theta, model.mean_square, note=model.note)


# ---------------------------------------------------------------------------------- covariance
def _covariance(found: Compensated, chosen: Chosen, noise: Array) -> Array:
    """Of the coefficients, for white Gaussian noise; ``nan`` where a pole was moved."""
    problem, c = chosen.problem, Filter.of(chosen.fit.c)
    if found.model.note:
        return np.full((problem.n_coefficients,) * 2, np.nan)
    clean = [with_filtered(e, c) for e in _noise_free(found.model)]
    eq = equation(problem, [unreduced(e, c) for e in clean], c, c, found.weights)
    columns = FilterColumns.of(c, problem.n_poles)
    row, direct = found.alpha @ columns.rows, float(found.alpha @ columns.direct)
    root = np.zeros_like(eq.matrix)
    for e, experiment in enumerate(clean):
        for i in range(problem.n_outputs):
            own = (eq.owner == (e, i)).all(axis=1)
            z = eq.matrix[own]
            size = found.weights[i] * np.sqrt(noise[i])
            root[own] = size * (direct * z + backward(z, row, c, experiment.dt))
    spread = _squares(found, columns, clean, found.weights**2 * noise)
    scale = np.linalg.norm(eq.matrix, axis=0)
    r = triangle(eq.matrix / scale)
    square = np.zeros((spread.shape[0], scale.size))
    square[:, eq.width["a"]] = spread
    middle = np.vstack([triangle(root / scale), square / scale]).T
    half = scipy.linalg.solve_triangular(r, scipy.linalg.solve_triangular(r, middle, trans="T"))
    gain = coefficient_map(problem, c, eq.width)[1] @ (half / scale[:, None])
    return np.asarray(gain @ gain.T)


def _noise_free(model: HeldModel) -> list[Experiment]:
    """The experiments with the model's output in place of the recorded one."""
    problem, inner = model.problem, cascade(model.poles)
    found = []
    for e, experiment in enumerate(problem.experiments):
        regression = unreduced(experiment, inner)
        y = np.empty_like(experiment.y)
        for i in range(problem.n_outputs):
            terms = list(model.rests[e, i].terms)
            y[:, i] = model.response.signal(regression, e, i)
            if experiment.offset:
                y[:, i] += terms.pop(0)
            y[:, i] += np.array(terms) @ experiment.drifts
        found.append(replace(experiment, y=y))
    return found


def _squares(
    found: Compensated, columns: FilterColumns, experiments: Sequence[Experiment], variance: Array
) -> Array:
    """(k, n) factor of ``2 sigma^4 tr(S_i S_j)``, summed over experiments and outputs."""
    n = found.alpha.size - 1
    grams = [columns.gram(e.n_samples, e.dt) for e in experiments]
    whole = sum(grams) @ found.alpha
    kappa = whole[:n] / (found.alpha @ whole)
    size = np.sqrt(2.0 * float(variance @ variance))
    parts = []
    for e in experiments:
        later = columns.answers(e.n_samples, e.dt)[0]
        error = later @ found.alpha
        lags = np.arange(1.0 - later.shape[0], later.shape[0])
        own = products_at_shifts(error, error)
        s = np.empty((lags.size, n))
        for i in range(n):
            cross = products_at_shifts(later[:, i], error)
            s[:, i] = 0.5 * (cross + cross[::-1]) - kappa[i] * own
        occurs = np.maximum(e.n_samples - np.abs(lags), 0.0)
        parts.append(triangle(size * np.sqrt(occurs)[:, None] * s))
    return np.vstack(parts)
