"""From the last point to an `Estimate`: coefficients, covariance, nuisance terms, verdict.

An `Ending` is what an algorithm arrives at, with what is to be said of it. Loops around an
algorithm (delays that are estimated along, the choice between maximum and mean) hand on endings;
the estimate is made from the last one, once, by `estimate_from`.

The standard errors are those of the local curvature (`likelihood.curvature`), unless the scores
scatter more (`likelihood.scores`), other weights lead elsewhere (`noise.two_weights`), or the
ending brings an uncertainty of its own. The variance that
is reported is that of the noise itself, not of its innovations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from scipy.special import ndtri

from tridentify.estimation.answer.assemble import Request, Solved, assemble
from tridentify.estimation.answer.estimate import Estimate, Nuisance, Status, Trace
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.likelihood.cost import Point
from tridentify.estimation.likelihood.curvature import Curvature, degrees_of_freedom, output_rss
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import coefficients, mean_square
from tridentify.estimation.likelihood.noise.estimated_noise import estimated_noise
from tridentify.estimation.likelihood.noise.two_weights import in_words
from tridentify.estimation.likelihood.setup.nuisance import Nuisances, reference_of
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.models.experiment import MIDDLING
from tridentify.models.regression import Regression
from tridentify.numerics.arrays import Array
from tridentify.numerics.information import aicc_price
from tridentify.numerics.kept import Beside, cached_property
from tridentify.numerics.realization import numerators
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction

MOST_LEFT_OUT = 0.1
"""Share of the samples that delays may leave out before a caution says so."""


@dataclass(frozen=True, eq=False)
class Spread:
    """An uncertainty that is not the local curvature's: of a posterior, of several minima.

    Attributes
    ----------
    covariance : (n_coefficients, n_coefficients) array
    draws : (n_draws, n_coefficients) array
        Equally likely coefficients; empty where it is a covariance only.
    errors : {"likelihood", "scores"}
        What its size comes from.
    """

    covariance: Array
    draws: Array = field(default_factory=lambda: np.zeros((0, 0)))
    errors: str = "likelihood"


@dataclass(frozen=True, eq=False)
class Ending:
    """Where an algorithm ended: all that an estimate is made of, beside what was asked.

    Attributes
    ----------
    point : Point
    nuisances : Nuisances
    status : Status
    criterion : float
        AICc, the noise model not counted.
    trace : Trace
    spread : Spread, optional
        In place of that of the local curvature.
    moved : (n_coefficients,) array, optional
        Half of how far other weights lead, where that is more than chance
        (`likelihood.noise.two_weights`).
    reacts : bool
        Whether the inputs hold past noise (the direct route).
    levels : tuple of (n_outputs,) arrays
        Standard deviation of the noise of each experiment; empty where it is one.
    """

    point: Point
    nuisances: Nuisances
    status: Status
    criterion: float
    trace: Trace
    spread: Spread | None = None
    moved: Array | None = None
    reacts: bool = False
    levels: tuple[Array, ...] = ()

    @cached_property
    def curvature(self) -> Curvature:
        """Of the likelihood, there."""
        found = Curvature.at(self.point)
        return replace(found, reacts=True) if self.reacts else found

    @property
    def aicc(self) -> float:
        """AICc, the noise model counted."""
        point, problem = self.point, self.point.problem
        if not any(a.size for a in problem.noise):
            return self.criterion
        k = problem.n_coefficients + problem.n_nuisance + problem.n_outputs
        n = float(point.counts.sum())
        return self.criterion + noise_criterion(problem.noise, point.regressions, k, n)

    def told(self, *words: str) -> Self:
        """The same with further decisions."""
        return replace(self, trace=self.trace.told(*words))


def estimate_from(ending: Ending, asked: Request) -> Estimate:
    """The estimate.

    Parameters
    ----------
    ending : Ending
    asked : Request

    Raises
    ------
    UnsupportedOrderError
        If the data cannot tell the coefficients apart.
    """
    return assemble(asked, solved_at(ending, asked.records, asked.structure))


def solved_at(
    ending: Ending,
    records: Sequence[Record],
    structure: Structure,
    *,
    judged: bool = True,
    rss: Array | None = None,
) -> Solved:
    """What an ending says of coefficients, noise and nuisance terms.

    Parameters
    ----------
    ending : Ending
    records : sequence of Record
        As they were fitted.
    structure : Structure
    judged : bool
        Whether the scatter of the scores has a say in the covariance.
    rss : (n_outputs,) array, optional
        Sums of squares of the residual as it is, where they are known (`curvature.output_rss`).

    Raises
    ------
    UnsupportedOrderError
        If the data cannot tell the coefficients apart.
    """
    point, curvature, own = ending.point, ending.curvature, ending.spread
    curvature.refuse_undetermined()
    theta, freedom = coefficients(point), degrees_of_freedom(point)
    rss = output_rss(point) if rss is None else rss
    a = point.problem.denominator_places()
    weak = bool(np.any(curvature.std[a] > np.abs(theta[a])))
    converged = ending.status is Status.CONVERGED
    scattered = judged and (own is None or own.errors == "scores")
    scatter = curvature.scatter if scattered else None
    root = curvature.root
    inverse = root @ root.T if scatter is None else root @ scatter.covariance @ root.T
    contradicted = scatter is not None and scatter.contradicts
    wider = np.ones(len(theta))
    if judged and own is None and not contradicted and not ending.reacts:
        of_noise = estimated_noise(point, root, curvature.along, curvature.noise, freedom)
        if of_noise is not None:
            added, wider = of_noise
            inverse = inverse + root @ added @ root.T
    cov = curvature.physical @ inverse @ curvature.physical.T if own is None else own.covariance
    cov = cov * np.outer(wider, wider)
    words: tuple[str, ...] = () if scatter is None or own is not None else (scatter.in_words(),)
    scores = own.errors == "scores" if own is not None else contradicted
    draws = np.zeros((0, 0)) if own is None else own.draws
    if judged and ending.moved is not None:
        words += (in_words(ending.moved, np.sqrt(np.diag(cov))),)
        cov, draws, scores = *widened_by(cov, draws, (ending.moved,)), True
    model = model_of(point.problem, theta, records[0])
    if judged:
        _keep(model, records, structure, ending)
    return Solved(
        structure=ending.nuisances.resolved(structure),
        model=model,
        theta=theta,
        cov=0.5 * (cov + cov.T),
        noise_variance=rss / freedom,
        fit=fit_percent(point.problem, rss, point.counts),
        status=Status.WEAKLY_IDENTIFIABLE if converged and weak else ending.status,
        trace=ending.trace.told(*words, *_unused(point.problem)),
        nuisance=_nuisance(point, records, ending.nuisances, inverse, curvature.layout),
        degrees_of_freedom=round(float(freedom.sum())),
        cost=mean_square(point),
        aicc=ending.aicc,
        condition=curvature.condition,
        gradient=point.gradient,
        noise_model=point.problem.noise,
        noise_levels=ending.levels,
        findings=_left_out(point.problem),
        errors="scores" if scores else "likelihood",
        draws=draws,
    )


_ENDS = Beside[Point]("end")
"""Of a model: where it was found, with all that was worked out there."""


def _keep(
    model: TransferFunction, records: Sequence[Record], structure: Structure, ending: Ending
) -> None:
    """Keep where a model came from, unless other samples than the records' were fitted there."""
    problem = ending.point.problem
    samples = zip(problem.experiments, records, strict=True)
    whole = all(
        one.dt is not None and e.n_samples == one.n_samples <= MIDDLING for e, one in samples
    )
    if whole and problem.limits is None and structure.delay != "free":
        _ENDS.keep(ending.point, model, tuple(records), ending.nuisances)


def kept_point(
    model: TransferFunction, records: Sequence[Record], nuisances: Nuisances
) -> Point | None:
    """Where a model came from, with all that was worked out there.

    Parameters
    ----------
    model : TransferFunction
        Of an estimate.
    records : sequence of Record
        Those that were fitted.
    nuisances : Nuisances
        The terms that were estimated along.

    Returns
    -------
    Point or None
        None where it is not the last, or was fitted to anything else.
    """
    return _ENDS.find(model, tuple(records), nuisances)


def widened_by(cov: Array, draws: Array, moves: Sequence[Array]) -> tuple[Array, Array]:
    """Covariance and draws with moves of the coefficients, each as likely as a standard error."""
    rng = np.random.default_rng(0)
    steps = ndtri((np.arange(len(draws)) + 0.5) / len(draws)) if draws.size else np.empty(0)
    for moved in moves:
        cov = cov + np.outer(moved, moved)
        draws = draws + np.outer(rng.permutation(steps), moved) if draws.size else draws
    return cov, draws


def _unused(problem: Problem) -> tuple[str, ...]:
    """A word on output samples that delays leave without a known input."""
    late = [e.start for e in problem.experiments]
    if not any(late):
        return ()
    which = "of every experiment " if len(late) > 1 else ""
    several = str(max(late)) if min(late) == max(late) else f"{min(late)} to {max(late)}"
    one = several == "1"
    samples = "first output sample" if one else f"first {several} output samples"
    return (
        f"the {samples} {which}{'is' if one else 'are'} not used: the inputs that reached "
        f"{'it' if one else 'them'}, "
        "delayed, came before the record (initial_state='rest' or 'equilibrium' states them)",
    )


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


def noise_criterion(
    noise: Sequence[Array], regressions: Sequence[Regression], k: int, n: float
) -> float:
    """What the noise model adds to AICc: its coefficients, and the scale of the innovations.

    Parameters
    ----------
    noise : sequence of (p,) arrays
    regressions : sequence of Regression
    k : int
        All other unknowns.
    n : float
        Samples of all outputs.
    """
    added = sum(a.size for a in noise)
    if not added:
        return 0.0
    scale = float(sum(sum(r.log_scale) for r in regressions))
    return scale + aicc_price(float(k + added), n) - aicc_price(float(k), n)


def model_of(problem: Problem, theta: Array, record: Record) -> TransferFunction:
    """The transfer function of a parameter vector."""
    a_places, b_places = problem.places()
    num: list[list[Array]] = [[theta[:0]] * problem.n_inputs for _ in range(problem.n_outputs)]
    den: list[list[Array]] = [[theta[:0]] * problem.n_inputs for _ in range(problem.n_outputs)]
    for place, group in zip(a_places, problem.groups, strict=True):
        for i, j in group.channels:
            den[i][j] = np.concatenate([[1.0], theta[place]])
            num[i][j] = theta[b_places[i, j]].copy()
    delays = problem.experiments[0].delays
    if delays is None and np.isfinite(theta).all():
        return TransferFunction.of_monic(num, den, record.input_names, record.output_names)
    return TransferFunction(
        num,
        den,
        delay=0.0 if delays is None else delays,
        input_names=record.input_names,
        output_names=record.output_names,
    )


def fit_percent(problem: Problem, rss: Array, counts: Array) -> Array:
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
        bends = np.zeros((problem.n_outputs, max(nuisances.drift - 1, 0)))
        duration = problem.experiments[e].duration
        for i in range(problem.n_outputs):
            values = point.terms(("nuisance", e, i), i)
            where = keys.get((i, ("nuisance", e, i)), slice(0, 0))
            std = np.sqrt(np.diag(inverse)[where])
            offset[i], drift[i], bends[i] = nuisances.split(values, duration)
            offset_std[i], drift_std[i], _ = nuisances.split(std, duration)
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
                bends=bends,
                duration=duration,
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
    return e.instant(e.start) if e.free else 0.0
