"""From the constrained maximum to an `Estimate`.

With ``N`` the free directions (along the equalities and the active bounds), ``J`` the derivatives
over the noise's standard deviation, nuisance terms among them, and ``P`` the information of the
priors, the covariance is ``N (N' (J' J + P) N)^{-1} N'``: the constrained Cramer-Rao bound where
there are no priors (Gorman & Hero 1990; Stoica & Ng 1998). It is zero for what is fixed. An
active bound counts as fixed; what that means is said among the cautions. Where the scores scatter
more than the noise model says, they give the covariance (`likelihood.scores`), as without
constraints; with priors they do not, since the priors' part of it has no scores.

References: J. D. Gorman & A. O. Hero, IEEE Trans. Information Theory 36(6) (1990) 1285-1301. P.
Stoica & B. C. Ng, IEEE Signal Processing Letters 5(7) (1998) 177-179.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tridentify.errors import UnsupportedOrderError
from tridentify.estimation.answer.assemble import Request, Solved, assemble
from tridentify.estimation.answer.estimate import Estimate, Nuisance, Pass, Status, Step, Trace
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.knowledge.affine import Knowledge
from tridentify.estimation.knowledge.descend import ConstrainedEnd, free_directions
from tridentify.estimation.knowledge.fixed_denominator import Denominator, HeldFit
from tridentify.estimation.knowledge.scores import constrained_scatter
from tridentify.estimation.likelihood.answer import (
    fit_percent,
    free_after,
    model_of,
    noise_criterion,
)
from tridentify.estimation.likelihood.curvature import SINGULAR
from tridentify.estimation.likelihood.fitted_point import ROUNDING_SQUARED
from tridentify.estimation.likelihood.scores import ScoreScatter
from tridentify.estimation.likelihood.setup.nuisance import Nuisances, reference_of
from tridentify.numerics.arrays import Array
from tridentify.numerics.information import aicc_price
from tridentify.numerics.least_squares import column_norms
from tridentify.numerics.realization import numerators
from tridentify.record.record import Record

LARGEST_EXPONENT = 700.0
"""A step that promises a rise beyond e^700, where floats end, is as good as none."""


@dataclass(frozen=True, eq=False)
class ConstrainedSpread:
    """Covariances at the end.

    Attributes
    ----------
    cov : (p, p) array
        Of the coefficients.
    terms : dict
        Standard errors of the nuisance terms by (experiment, output).
    condition : float
        Of the scaled derivatives along the free directions.
    along : (p, k) array
        ``along along' = cov``: directions in which the covariance is the identity.
    beside : dict
        The nuisance terms along these, (n_terms, k) by (experiment, output).
    """

    cov: Array
    terms: dict[tuple[int, int], Array]
    condition: float
    along: Array
    beside: dict[tuple[int, int], Array]

    @classmethod
    def of(
        cls, along: Array, beside: dict[tuple[int, int], Array], condition: float
    ) -> ConstrainedSpread:
        """From the directions."""
        cov = along @ along.T
        errors = {key: np.sqrt(np.einsum("ij,ij->i", one, one)) for key, one in beside.items()}
        return cls(0.5 * (cov + cov.T), errors, condition, along, beside)

    def scattered(self, scatter: ScoreScatter) -> ConstrainedSpread:
        """The same with another covariance along the directions."""
        size, axes = np.linalg.eigh(scatter.covariance)
        turn = axes * np.sqrt(size)
        beside = {key: one @ turn for key, one in self.beside.items()}
        return ConstrainedSpread.of(self.along @ turn, beside, self.condition)


def reference(record: Record, nuisances: Nuisances, known: Knowledge) -> Array:
    """(n_inputs,) what is subtracted from the input.

    An integrator turns a constant into a ramp, which offset and free state do not absorb; with one,
    the input counts from its first value in equilibrium only.
    """
    if known.integrators and nuisances.initial_state != "equilibrium":
        return np.zeros(record.n_inputs)
    return reference_of(record, nuisances)


def unknowns(here: HeldFit, known: Knowledge) -> int:
    """Free coefficients, nuisance terms and noise variances."""
    own = sum(terms.size for terms in here.terms.values())
    return known.n_free + own + here.problem.n_outputs


def criterion(here: HeldFit, known: Knowledge, fall: float = 0.0) -> float:
    """AICc with free coefficients counted only, and the penalty of the priors.

    ``fall`` is what further steps are expected to take off the cost.
    """
    n = here.counts
    floor = ROUNDING_SQUARED * here.problem.size
    left = np.exp(min(-fall / n.sum(), LARGEST_EXPONENT))
    likelihood = float(n @ np.log(left * here.rss / n + floor)) + known.penalty(here.theta)
    return likelihood + aicc_price(float(unknowns(here, known)), float(n.sum()))


def freedom(here: HeldFit, known: Knowledge) -> Array:
    """(n_outputs,) samples less unknowns; free coefficients split as the coefficients are."""
    problem = here.problem
    sizes = [a.size for a in problem.noise] or [0] * problem.n_outputs
    found = np.zeros(problem.n_outputs)
    for i, zeros in enumerate(problem.n_zeros):
        own = sum(m + 1 for m in zeros) + problem.n_poles / problem.n_outputs
        nuisance = sum(t.size for (_, output), t in here.terms.items() if output == i)
        share = known.n_free * own / problem.n_coefficients
        found[i] = max(here.counts[i] - share - nuisance - sizes[i], 1.0)
    return found


def estimate_of(
    reached: ConstrainedEnd,
    asked: Request,
    nuisances: Nuisances,
    trace: Trace,
    doubts: tuple[Finding, ...] = (),
) -> Estimate:
    """The estimate.

    Parameters
    ----------
    reached : ConstrainedEnd
    asked : Request
    nuisances : Nuisances
    trace : Trace
    doubts : tuple of Finding
        What speaks against the constraints.

    Raises
    ------
    UnsupportedOrderError
        If the data cannot tell the free coefficients apart.
    """
    here, known, records = reached.fit, reached.known, asked.records
    problem, theta = here.problem, here.theta
    left = freedom(here, known)
    rss = _plain_rss(here)
    spread = spread_of(reached, here.rss / left)
    if spread.condition > SINGULAR:
        raise UnsupportedOrderError(
            f"found free coefficients of condition {spread.condition:.1e}; expected coefficients "
            f"that the record can tell apart (below {SINGULAR:.0e}); lower the number of poles or "
            "zeros, fix more of them, or excite the system more richly"
        )
    _refuse_invisible(reached, here.rss / left)
    scatter = _scatter(reached, spread, here.rss / left)
    std = np.sqrt(np.diag(spread.cov))[: problem.n_poles]
    status = reached.status
    if status is Status.CONVERGED and np.any(std > np.abs(theta[: problem.n_poles])):
        status = Status.WEAKLY_IDENTIFIABLE
    if scatter is not None:
        spread, trace = spread.scattered(scatter), trace.told(scatter.in_words())
    n = float(here.counts.sum())
    solved = Solved(
        structure=nuisances.resolved(asked.structure),
        model=model_of(problem, theta, records[0]),
        theta=theta,
        cov=spread.cov,
        noise_variance=rss / left,
        fit=fit_percent(problem, rss, here.counts),
        status=status,
        trace=trace,
        nuisance=tuple(
            _nuisance(here, known, record, nuisances, spread, e) for e, record in enumerate(records)
        ),
        degrees_of_freedom=round(float(left.sum())),
        cost=_mean_square(here),
        aicc=criterion(here, known)
        + noise_criterion(problem.noise, here.place.regressions, unknowns(here, known), n),
        condition=spread.condition,
        gradient=reached.gradient,
        noise_model=problem.noise,
        findings=doubts,
        errors="scores" if scatter is not None and scatter.contradicts else "likelihood",
    )
    return assemble(asked, solved)


def _scatter(
    reached: ConstrainedEnd, spread: ConstrainedSpread, noise: Array
) -> ScoreScatter | None:
    """What the scores say of the covariance; None with priors, whose part of it is no scatter."""
    if np.any(np.isfinite(reached.known.spread)):
        return None
    return constrained_scatter(reached.fit, spread.along, spread.beside, noise)


def spread_of(reached: ConstrainedEnd, noise: Array) -> ConstrainedSpread:
    """Covariance of coefficients and nuisance terms for noise variances (n_outputs,)."""
    here, known = reached.fit, reached.known
    free = free_directions(known, reached.active)
    where, matrix = _joint(here, free, noise)
    held = known.prior_rows(free, here.theta)[0]
    held = np.pad(held, ((0, 0), (0, matrix.shape[1] - free.shape[1])))
    matrix = np.vstack([matrix, held])
    norms = column_norms(matrix)
    _, s, vt = np.linalg.svd(matrix / norms, full_matrices=False)
    condition = float(s[0] / s[-1]) if s.size and s[-1] > 0 else np.inf
    root = (vt.T / np.where(s > 0, s, np.inf)) / norms[:, None]
    beside = {key: root[at] for key, at in where.items()}
    return ConstrainedSpread.of(free @ root[: free.shape[1]], beside, condition)


def _joint(here: HeldFit, free: Array, noise: Array) -> tuple[dict[tuple[int, int], slice], Array]:
    """Derivatives of all outputs with respect to the free directions and every nuisance term."""
    where: dict[tuple[int, int], slice] = {}
    at = free.shape[1]
    for key, terms in here.terms.items():
        where[key] = slice(at, at + terms.size)
        at += terms.size
    parts = []
    for i, raw in enumerate(here.raw):
        weight = 1.0 / np.sqrt(max(noise[i], 1e-300))
        row = 0
        for e, regression in enumerate(here.place.regressions):
            height = regression.targets[i].size
            part = np.zeros((height, at))
            part[:, : free.shape[1]] = raw[row : row + height] @ free
            part[:, where[e, i]] = here.place.nuisance_columns(e, i)
            parts.append(weight * part)
            row += height
    return where, np.vstack(parts)


def standard_errors(reached: ConstrainedEnd) -> Array:
    """(p,) of the coefficients."""
    noise = reached.fit.rss / freedom(reached.fit, reached.known)
    return np.asarray(np.sqrt(np.diag(spread_of(reached, noise).cov)))


def _refuse_invisible(reached: ConstrainedEnd, noise: Array) -> None:
    """Refuse poles that only rounding determines, as superfluous ones are without noise."""
    problem = reached.fit.problem
    floor = ROUNDING_SQUARED * problem.size
    if np.all(noise > floor):
        return
    cov = spread_of(reached, np.maximum(noise, floor)).cov
    std = np.sqrt(np.diag(cov))[: problem.n_poles]
    if np.any(std > 0.5 * np.abs(reached.fit.theta[: problem.n_poles])):
        raise UnsupportedOrderError(
            f"found a record without noise that does not determine {problem.n_poles} poles; "
            "expected an order that the record needs; lower the number of poles"
        )


def _plain_rss(here: HeldFit) -> Array:
    weighted = any(e.scale is not None for e in here.problem.experiments)
    if not (weighted or any(a.size for a in here.problem.noise)):
        return here.rss
    return np.asarray(np.sum([np.nansum(one**2, axis=0) for one in here.over_time()], axis=0))


def _mean_square(here: HeldFit) -> float:
    """Residual mean square; the geometric mean over several outputs."""
    variance = here.rss / here.counts
    if np.any(variance == 0):
        return 0.0
    return float(np.exp(here.counts @ np.log(variance) / here.counts.sum()))


def _nuisance(
    here: HeldFit,
    known: Knowledge,
    record: Record,
    nuisances: Nuisances,
    spread: ConstrainedSpread,
    e: int,
) -> Nuisance:
    problem, place = here.problem, here.place
    offset, drift, offset_std, drift_std = np.zeros((4, problem.n_outputs))
    free = np.zeros((problem.n_outputs, problem.n_poles))
    bends = np.zeros((problem.n_outputs, max(nuisances.drift - 1, 0)))
    duration, constants = problem.experiments[e].duration, nuisances.offset + nuisances.drift
    for i in range(problem.n_outputs):
        terms, std = here.terms[e, i], spread.terms[e, i]
        own = slice(terms.size - constants, None)
        offset[i], drift[i], bends[i] = nuisances.split(terms[own], duration)
        offset_std[i], drift_std[i], _ = nuisances.split(std[own], duration)
        free[i] = free_numerator(place, place.free_row(e, terms))
    return Nuisance(
        input_reference=reference(record, nuisances, known),
        offset=offset,
        drift=drift,
        free_response=free,
        offset_std=offset_std,
        drift_std=drift_std,
        initial_state=nuisances.initial_state,
        t0=float(record.t[0]),
        free_after=free_after(problem, e),
        bends=bends,
        duration=duration,
    )


def free_numerator(place: Denominator, row: Array) -> Array:
    """(n,) coefficients ``c_0`` of a free response ``c_0 / (p^k a')``, descending powers."""
    n, k, q = place.inner.order, place.integrators, place.orthonormal.order
    found = np.zeros(n + k)
    if n:
        found[:n] = row[:n] @ numerators(place.poles)
    a = np.concatenate([[1.0], place.a])
    for i in range(1, k + 1):
        # 1 / (p T)^i = p^(k - i) a' / (p^k a') / T^i
        found[i - 1 : i + n] += row[q + i - 1] * a / place.span**i
    return found


def passes_of(reached: ConstrainedEnd) -> tuple[Pass, ...]:
    """The steps taken, as passes numbered from 1."""
    found = []
    for number, (here, damping) in enumerate(reached.steps, 1):
        note = "within the constraints" + (f", damping {damping:.1e}" if damping else "")
        step = Step(
            "output error",
            here.theta[: here.problem.n_poles],
            float(here.rss.sum() / here.counts.sum()),
            np.nan,
            note,
        )
        found.append(Pass(number, (step,), here.theta, _mean_square(here), note=note))
    if found:
        last = found[-1]
        found[-1] = replace(last, gradient=reached.gradient)
    return tuple(found)


def described(reached: ConstrainedEnd) -> tuple[str, ...]:
    """What the constraints came to, and the first-order conditions at the end."""
    known, theta = reached.known, reached.fit.theta
    parts = []
    determined = [known.names[k] for k in np.flatnonzero(known.determined)]
    if determined:
        parts.append(f"determined beforehand: {', '.join(determined)}")
    if known.integrators:
        parts.append(f"{known.integrators} pole{'s' * (known.integrators > 1)} at the origin")
    coupled = theta.size - len(determined) - known.n_free
    if coupled:
        parts.append(f"{coupled} equalit{'y' if coupled == 1 else 'ies'} between the others")
    priors = [known.names[k] for k in np.flatnonzero(np.isfinite(known.spread))]
    if priors:
        parts.append(f"Gaussian priors on {', '.join(priors)}")
    bounded = np.isfinite(known.low) | np.isfinite(known.high)
    if bounded.any():
        held = [
            f"{known.names[k]} = {theta[k]:.6g} (multiplier {reached.multipliers[k]:+.2g})"
            for k in np.flatnonzero(reached.active)
        ]
        parts.append(f"active bounds: {', '.join(held) if held else 'none'}")
    parts.append(f"share of the residual along the free directions {reached.gradient:.1e}")
    return (
        f"constraints: {'; '.join(parts)}",
        "constrained maximum of the likelihood"
        + (" and the priors" if priors else "")
        + ": the posterior mean of other estimates knows no constraints",
    )
