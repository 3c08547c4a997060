"""From the last point to an `Estimate`: coefficients, covariance, nuisance terms, verdict.

With ``J`` the derivatives of the outputs, each divided by its noise standard deviation, with
respect to every unknown (``alpha``, ``b``, free responses, offsets, drifts), ``cov = (J'
J)^{-1}`` is the Cramer-Rao bound for white Gaussian noise of the estimated variance, and the
covariance of the maximum-likelihood estimate for long records. It is formed from the SVD of
``J`` with unit columns. Where the noise has a model (`likelihood.noise_model`), ``J`` is that of
the whitened outputs and the variance that of the innovations, and the variance that is reported
is that of the noise itself. ``a = c (1 + alpha X)`` and ``b / c = beta X + d`` are linear in the
unknowns at ``c = a``, so the physical coefficients take it over by one matrix product.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from tridentify.errors import UnsupportedOrderError
from tridentify.estimation.answer.estimate import Estimate, Nuisance, Status, Trace
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.likelihood.cost import Point
from tridentify.estimation.likelihood.levenberg_marquardt import (
    ROUNDING_SQUARED,
    coefficients,
    mean_square,
)
from tridentify.estimation.likelihood.nuisance import Nuisances, reference_of
from tridentify.estimation.likelihood.problem import Problem
from tridentify.estimation.likelihood.scores import ScoreScatter, scatter_of_scores
from tridentify.models.regression import Regression
from tridentify.models.response import Response, nuisance_blocks
from tridentify.numerics.least_squares import solve
from tridentify.numerics.realization import Complex, denominator, numerators
from tridentify.record.record import Record
from tridentify.structure import InitialState, Structure
from tridentify.transfer_function import TransferFunction

Array = NDArray[np.float64]

SINGULAR = 1e12
# share of the samples that delays may leave out before a caution says so
MOST_LEFT_OUT = 0.1


def estimate_from(
    point: Point,
    records: Sequence[Record],
    structure: Structure,
    nuisances: Nuisances,
    status: Status,
    trace: Trace,
    method: str,
    criterion: float,
    *,
    judged: bool = True,
) -> Estimate:
    """Assemble the estimate.

    ``judged`` says whether the scatter of the scores has a say in the covariance.

    Raises
    ------
    UnsupportedOrderError
        If the data cannot tell the coefficients apart.
    """
    first = records[0]
    names = structure.names(first.input_names, first.output_names)
    theta = coefficients(point)
    freedom = degrees_of_freedom(point)
    noise = point.rss / freedom
    rss = output_rss(point)
    root, condition, keys = _root(point, noise)
    if condition > SINGULAR:
        raise UnsupportedOrderError(
            f"found score columns of condition {condition:.1e} with {structure.poles} poles; "
            f"expected coefficients that the record can tell apart (below {SINGULAR:.0e}); lower "
            "the number of poles or zeros, or excite the system more richly"
        )
    transform = physical_transform(point, keys, root.shape[0])
    _refuse_invisible(point, structure, theta, transform, noise)
    a = point.problem.denominator_places()
    std = np.linalg.norm(transform @ root, axis=1)
    weak = bool(np.any(std[a] > np.abs(theta[a])))
    if status is Status.CONVERGED and weak:
        status = Status.WEAKLY_IDENTIFIABLE
    scatter = scatter_of_scores(point, root, noise) if judged else None
    inverse = root @ root.T if scatter is None else root @ scatter.covariance @ root.T
    cov = transform @ inverse @ transform.T
    cov = 0.5 * (cov + cov.T)
    trace = trace if scatter is None else with_decision(trace, scatter.in_words())
    return Estimate(
        model=model_of(point.problem, theta, first),
        structure=_resolved(structure, nuisances),
        theta=theta,
        names=names,
        cov=cov,
        noise_variance=rss / freedom,
        fit=_fit(point.problem, rss, point.counts),
        status=status,
        trace=_told(trace, point.problem),
        method=method,
        n_samples=sum(record.n_samples for record in records),
        nuisance=_nuisance(point, records, nuisances, inverse, keys),
        degrees_of_freedom=round(float(freedom.sum())),
        cost=mean_square(point),
        aicc=criterion + _noise_criterion(point),
        condition=condition,
        gradient=point.gradient,
        input_names=first.input_names,
        output_names=first.output_names,
        units=dict(first.units),
        intersample=first.behaviour,
        dt=first.dt,
        record_fingerprint=fingerprint(records),
        noise_model=point.problem.noise,
        findings=_left_out(point.problem),
        errors="likelihood" if scatter is None else "scores",
    )


def scatter_at(point: Point) -> ScoreScatter | None:
    """What the scores say of the covariance (`likelihood.scores`)."""
    noise = point.rss / degrees_of_freedom(point)
    return scatter_of_scores(point, _root(point, noise)[0], noise)


def with_decision(trace: Trace, told: str) -> Trace:
    """The trace with one more decision."""
    return replace(trace, decisions=(*trace.decisions, told))


def _told(trace: Trace, problem: Problem) -> Trace:
    """The trace, with a word on output samples that delays leave without a known input."""
    late = [e.start for e in problem.experiments]
    if not any(late):
        return trace
    which = "of every experiment " if len(late) > 1 else ""
    several = str(max(late)) if min(late) == max(late) else f"{min(late)} to {max(late)}"
    one = several == "1"
    samples = "first output sample" if one else f"first {several} output samples"
    told = (
        f"the {samples} {which}{'is' if one else 'are'} not used: the inputs that reached "
        f"{'it' if one else 'them'}, "
        "delayed, came before the record (initial_state='rest' or 'equilibrium' states them)"
    )
    return with_decision(trace, told)


def _left_out(problem: Problem) -> tuple[Finding, ...]:
    """A word where delays leave out more of the output than goes without saying."""
    lost = sum(e.start for e in problem.experiments)
    samples = sum(e.n_samples for e in problem.experiments)
    if lost <= MOST_LEFT_OUT * samples:
        return ()
    return (
        Finding(
            "samples-left-out",
            "warning",
            f"{100.0 * lost / samples:.0f} % of the output samples ({lost} of {samples}) are left "
            "out, as the inputs that reached them, delayed, came before the record: fit and "
            "coefficients say nothing of them.",
            "Check the delay, and compare with a shorter one; or state what was before "
            "(--initial-state rest or equilibrium, in Python initial_state=...), which uses all "
            "samples.",
        ),
    )


def output_rss(point: Point) -> Array:
    """(n_outputs,) sums of squares of the residual as it is, not whitened."""
    if not any(a.size for a in point.problem.noise):
        return point.rss
    return np.asarray(np.sum([np.nansum(one**2, axis=0) for one in point.residuals()], axis=0))


def standard_errors(point: Point) -> Array:
    """(n_coefficients,) of the physical coefficients."""
    inverse, _, keys = _covariance(point, point.rss / degrees_of_freedom(point))
    transform = physical_transform(point, keys, inverse.shape[0])
    variance: Array = np.einsum("ij,jk,ik->i", transform, inverse, transform)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def covariance(point: Point, held: Array | None = None) -> Array:
    """Covariance of the physical coefficients from the local curvature.

    Parameters
    ----------
    point : Point
    held : (k, n_coefficients) array, optional
        Combinations of the coefficients that do not move.

    Returns
    -------
    (n_coefficients, n_coefficients) array
    """
    root, _, keys = _root(point, point.rss / degrees_of_freedom(point), held)
    factor = physical_transform(point, keys, root.shape[0]) @ root
    return np.asarray(factor @ factor.T)


def taken(point: Point, output: int) -> list[Array]:
    """Series whose products are the covariance that the fit took from the noise of one output."""
    root = _root(point, point.rss / degrees_of_freedom(point))[0]
    return [one[:, k] for one in point.sensitivities(root, output) for k in range(root.shape[1])]


def _noise_criterion(point: Point) -> float:
    """What the noise model adds to AICc: its coefficients, and the scale of the innovations."""
    added = sum(a.size for a in point.problem.noise)
    if not added:
        return 0.0
    problem, n = point.problem, float(point.counts.sum())
    k = problem.n_coefficients + problem.n_nuisance + problem.n_outputs

    def penalty(unknowns: float) -> float:
        return 2.0 * unknowns + 2.0 * unknowns * (unknowns + 1.0) / max(n - unknowns - 1.0, 0.5)

    scale = float(sum(sum(r.log_scale) for r in point.regressions))
    return scale + penalty(k + added) - penalty(k)


def _refuse_invisible(
    point: Point, structure: Structure, theta: Array, transform: Array, noise: Array
) -> None:
    """Refuse poles that only rounding determines, as superfluous ones are without noise."""
    floor = ROUNDING_SQUARED * point.problem.size
    if np.all(noise > floor):
        return
    inverse = _covariance(point, np.maximum(noise, floor))[0]
    a = point.problem.denominator_places()
    std = np.sqrt(np.diag(transform @ inverse @ transform.T))[a]
    if np.any(std > 0.5 * np.abs(theta[a])):
        raise UnsupportedOrderError(
            f"found a record without noise that does not determine {structure.poles} poles; "
            "expected an order that the record needs; lower the number of poles"
        )


def degrees_of_freedom(point: Point) -> Array:
    """(n_outputs,) samples less unknowns, those of the noise model included.

    A denominator is split evenly among the outputs that share it.
    """
    own = np.array([fit.matrix.shape[1] for fit in point.fits], dtype=np.float64)
    shared = np.zeros(own.size)
    for group in point.problem.groups:
        outputs = sorted({i for i, _ in group.channels})
        shared[outputs] += group.order / len(outputs)
    shared += point.problem.n_delays / own.size
    sizes = [a.size for a in point.problem.noise]
    noise = np.array(sizes or np.zeros(own.size), dtype=np.float64)
    return np.asarray(np.maximum(point.counts - own - shared - noise, 1.0))


def model_of(problem: Problem, theta: Array, record: Record) -> TransferFunction:
    """The transfer function of a parameter vector."""
    a_places, b_places = problem.places()
    num: list[list[Array]] = [[theta[:0]] * problem.n_inputs for _ in range(problem.n_outputs)]
    den: list[list[Array]] = [[theta[:0]] * problem.n_inputs for _ in range(problem.n_outputs)]
    for place, group in zip(a_places, problem.groups, strict=True):
        for i, j in group.channels:
            den[i][j] = np.concatenate([[1.0], theta[place]])
            num[i][j] = theta[b_places[i, j]]
    delays = problem.experiments[0].delays
    return TransferFunction(
        num,
        den,
        delay=0.0 if delays is None else delays,
        input_names=record.input_names,
        output_names=record.output_names,
    )


def _covariance(point: Point, noise: Array) -> tuple[Array, float, dict[object, slice]]:
    """``(J' J)^{-1}`` over all unknowns, the condition of the scaled ``J``, and its layout."""
    root, condition, width = _root(point, noise)
    return root @ root.T, condition, width


def _root(
    point: Point, noise: Array, held: Array | None = None
) -> tuple[Array, float, dict[object, slice]]:
    """A factor of the covariance over all unknowns, the condition of ``J``, and its layout."""
    columns, matrix, output = point.jacobian()
    rows = matrix / np.sqrt(np.maximum(noise, 1e-300))[output][:, None]
    norms = np.sqrt(np.einsum("ij,ij->j", rows, rows))
    norms = np.where(norms > 0, norms, 1.0)
    rows = rows / norms
    free = None
    if held is not None and held.size:
        fixed = (held @ physical_transform(point, columns.width, norms.size)) / norms
        fixed /= np.linalg.norm(fixed, axis=1, keepdims=True)
        free = np.linalg.qr(fixed.T, mode="complete")[0][:, held.shape[0] :]
        rows = rows @ free
    _, s, vt = np.linalg.svd(rows, full_matrices=False)
    condition = float(s[0] / s[-1]) if s[-1] > 0 else np.inf
    root = vt.T / np.where(s > 0, s, np.inf)
    root = (root if free is None else free @ root) / norms[:, None]
    return root, condition, columns.width


def physical_transform(point: Point, keys: dict[object, slice], width: int) -> Array:
    """d(physical coefficients) / d(unknowns)."""
    problem = point.problem
    transform = np.zeros((problem.n_coefficients, width))
    a_places, b_places = problem.places()
    first = keys["a"].start
    for place, branch in zip(a_places, point.branches, strict=True):
        n, a = branch.inner.order, denominator(branch.inner.poles)
        table = numerators(branch.inner.poles)
        own = slice(first + branch.poles.start, first + branch.poles.stop)
        transform[place, own] = table.T
        for i, j in np.argwhere(branch.channels).tolist():
            m = problem.n_zeros[i][j]
            proper = branch.basis.rows[: min(m + 1, n)] @ table
            block = np.pad(proper, ((0, 0), (1, 0)))
            if m == n:
                block = np.vstack([block, a])
            transform[b_places[i, j], keys[i, ("b", j)]] = block[:, n - m :].T
    if problem.n_delays:
        transform[-problem.n_delays :, keys["delay"]] = np.eye(problem.n_delays)
    return transform


def physical_map(point: Point) -> tuple[Array, dict[object, slice]]:
    """How the physical coefficients move with the unknowns of `Point.jacobian`.

    Parameters
    ----------
    point : Point

    Returns
    -------
    map : (n_coefficients, n_unknowns) array
    layout : dict
        Which unknowns stand where.
    """
    keys = point.jacobian()[0].width
    width = max(place.stop for place in keys.values())
    return physical_transform(point, keys, width), keys


def _resolved(structure: Structure, nuisances: Nuisances) -> Structure:
    return replace(
        structure,
        offset=nuisances.offset,
        drift=nuisances.drift,
        initial_state=cast("InitialState", nuisances.initial_state),
    )


def _fit(problem: Problem, rss: Array, counts: Array) -> Array:
    """NRMSE fit in percent, over all experiments."""
    spread = problem.power * counts
    return np.asarray(100.0 * (1.0 - np.sqrt(rss / np.where(spread > 0, spread, np.inf))))


def _nuisance(
    point: Point,
    records: Sequence[Record],
    nuisances: Nuisances,
    inverse: Array,
    keys: dict[object, slice],
) -> tuple[Nuisance, ...]:
    problem = point.problem
    found = []
    for e, record in enumerate(records):
        offset, drift, offset_std, drift_std = np.zeros((4, problem.n_outputs))
        for i, fit in enumerate(point.fits):
            values = fit.columns.pick(fit.solution.x, ("nuisance", e, i))
            where = keys.get((i, ("nuisance", e, i)), slice(0, 0))
            std = np.sqrt(np.diag(inverse)[where])
            at = 0
            if nuisances.offset:
                offset[i], offset_std[i] = values[at], std[at]
                at += 1
            if nuisances.drift:
                duration = problem.experiments[e].duration
                drift[i], drift_std[i] = values[at] / duration, std[at] / duration
        found.append(
            Nuisance(
                input_reference=reference_of(record, nuisances),
                offset=offset,
                drift=drift,
                free_response=_free_response(point, e),
                offset_std=offset_std,
                drift_std=drift_std,
                initial_state=nuisances.initial_state,
                t0=float(record.t[0]),
                free_after=free_after(problem, e),
            )
        )
    return tuple(found)


def _free_response(point: Point, experiment: int) -> Array:
    """Numerators of the free response: of every output, or of every channel on its own."""
    problem = point.problem
    free = point.response.free[experiment]
    if len(problem.groups) == 1:
        (branch,) = point.branches
        return np.asarray(free[:, branch.own] @ numerators(branch.inner.poles))
    longest = max(group.order for group in problem.groups)
    found = np.zeros((problem.n_outputs, problem.n_inputs, longest))
    for branch in point.branches:
        table = numerators(branch.inner.poles)
        for i, j in np.argwhere(branch.channels).tolist():
            found[i, j, longest - branch.inner.order :] = free[i, branch.own] @ table
    return found


def free_after(problem: Problem, experiment: int) -> float:
    """When the free response of an experiment begins, after its first sample [s]."""
    e = problem.experiments[experiment]
    return float(e.instants[e.start]) if e.free else 0.0


def fingerprint(records: Sequence[Record]) -> str:
    """SHA-256 of the samples and their times, in hexadecimal."""
    digest = hashlib.sha256()
    for record in records:
        digest.update(np.array([record.t[0], record.dt or 0.0]).tobytes())
        if record.dt is None:
            digest.update(record.t)  # type: ignore[arg-type]
        digest.update(record.u)  # type: ignore[arg-type]
        digest.update(record.y)  # type: ignore[arg-type]
    return digest.hexdigest()


@dataclass(frozen=True, eq=False)
class Rest:
    """What is fitted to one output of one experiment beside a given model.

    Attributes
    ----------
    free_row : (n,) array
        Free response on the cascade of the model's poles (zero at rest).
    terms : (0 to 2,) array
        Offset and slope over the whole record, where estimated.
    cost : float
        Residual sum of squares.
    count : int
        Samples used.
    """

    free_row: Array
    terms: Array
    cost: float
    count: int


Rests: TypeAlias = dict[tuple[int, int], Rest]


def fit_rests(regressions: Sequence[Regression], response: Response, poles: Complex) -> Rests:
    """Free response, offset and drift of every (experiment, output) for a model that is held.

    Parameters
    ----------
    regressions : sequence of Regression
        On a bank that begins with ``poles``.
    response : Response
        The model's output, without free response.
    poles : (n,) complex array
    """
    n = len(poles)
    found: Rests = {}
    for e, regression in enumerate(regressions):
        for i, target in enumerate(regression.targets):
            free = regression.signals[i][:, : n if regression.layout.free else 0]
            blocks = [free, *nuisance_blocks(regression, e, i).values()]
            left = target - response.signal(regression, e, i)
            solution = solve(np.hstack(blocks), left)
            row = np.zeros(n)
            row[: free.shape[1]] = solution.x[: free.shape[1]]
            terms = solution.x[free.shape[1] :]
            found[e, i] = Rest(row, terms, solution.cost, regression.counts[i])
    return found


def literal_estimate(
    problem: Problem,
    records: Sequence[Record],
    structure: Structure,
    nuisances: Nuisances,
    theta: Array,
    poles: Complex,
    rests: Rests,
    status: Status,
    trace: Trace,
    method: str,
) -> Estimate:
    """An estimate away from a stationary point: no covariance is claimed (``nan``)."""
    first = records[0]
    n_outputs = problem.n_outputs
    rss, counts = np.zeros((2, n_outputs))
    for (_, i), rest in rests.items():
        rss[i] += rest.cost
        counts[i] += rest.count
    unknowns = problem.n_coefficients + problem.n_nuisance
    freedom = np.maximum(counts - unknowns / n_outputs, 1.0)
    names = structure.names(first.input_names, first.output_names)
    return Estimate(
        model=model_of(problem, theta, first),
        structure=_resolved(structure, nuisances),
        theta=theta,
        names=names,
        cov=np.full((len(names), len(names)), np.nan),
        noise_variance=rss / freedom,
        fit=_fit(problem, rss, counts),
        status=status,
        trace=trace,
        method=method,
        n_samples=sum(record.n_samples for record in records),
        nuisance=tuple(
            _held_nuisance(problem, record, nuisances, poles, rests, e)
            for e, record in enumerate(records)
        ),
        degrees_of_freedom=round(float(freedom.sum())),
        cost=trace.passes[-1].cost,
        aicc=np.nan,
        condition=max(step.condition for step in trace.passes[-1].steps),
        gradient=np.nan,
        input_names=first.input_names,
        output_names=first.output_names,
        units=dict(first.units),
        intersample=first.behaviour,
        dt=first.dt,
        record_fingerprint=fingerprint(records),
    )


def _held_nuisance(
    problem: Problem, record: Record, nuisances: Nuisances, poles: Complex, rests: Rests, e: int
) -> Nuisance:
    n = problem.n_poles
    table = numerators(poles)
    offset, drift = np.zeros((2, problem.n_outputs))
    free = np.zeros((problem.n_outputs, n))
    for i in range(problem.n_outputs):
        rest = rests[e, i]
        terms = list(rest.terms)
        offset[i] = terms.pop(0) if nuisances.offset else 0.0
        drift[i] = terms.pop(0) / problem.experiments[e].duration if nuisances.drift else 0.0
        free[i] = rest.free_row @ table
    return Nuisance(
        input_reference=reference_of(record, nuisances),
        offset=offset,
        drift=drift,
        free_response=free,
        offset_std=np.full(problem.n_outputs, np.nan if nuisances.offset else 0.0),
        drift_std=np.full(problem.n_outputs, np.nan if nuisances.drift else 0.0),
        initial_state=nuisances.initial_state,
        t0=float(record.t[0]),
        free_after=free_after(problem, e),
    )


def as_recorded(
    estimate: Estimate, with_all_rows: Sequence[Record], records: Sequence[Record]
) -> Estimate:
    """The estimate from records with their missing rows put back, as one of the records."""
    pairs = list(zip(with_all_rows, records, strict=True))
    if all(full is own for full, own in pairs):
        return estimate
    lost = sum(full.n_samples - own.n_samples for full, own in pairs)
    told = f"{lost} rows missing from a uniform raster: taken for samples without an output"
    return replace(
        estimate,
        n_samples=sum(record.n_samples for record in records),
        dt=records[0].dt,
        record_fingerprint=fingerprint(records),
        trace=replace(estimate.trace, decisions=(*estimate.trace.decisions, told)),
    )
