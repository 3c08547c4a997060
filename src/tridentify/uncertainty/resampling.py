"""The parametric bootstrap: simulate the record again and again, and identify every copy.

The estimate is taken for the truth. A copy of the record is its prediction (nuisance terms
included) plus Gaussian noise of the estimated variance, with the estimated colour where there is
one; samples that were missing are missing in the copy. Each copy is identified by the same method
with the same structure. How the new coefficients scatter around the estimate tells how the estimate
scatters around the truth, without any linearisation: bias, heavy tails and failures show.

*What is held.* The nuisance terms are those of ``estimate.structure``: which of them a record needs
is not decided anew for each copy, nor is whether the noise is coloured. The intervals hold given
these choices. Whether a copy ends on the likelihood or on a posterior mean is part of the
estimator, and decided for each.

*What is counted.* A copy whose identification raises is a failure: it has no coefficients (a row of
``nan``), it is listed with its reason, and intervals are those of the other copies. A share of
failures above the tails of the interval means that its ends are unknown; `Bootstrap.summary` says
so. A copy that was identified with a status that is not ok stays in, and is counted in
``n_flagged``: leaving it out would hide the tails.

Every copy has a random generator of its own, spawned from the seed by its number, so that results
depend neither on the order nor on the number of workers.

References: B. Efron & R. J. Tibshirani, *An Introduction to the Bootstrap* (1993), sec. 6.5; A. C.
Davison & D. V. Hinkley, *Bootstrap Methods and their Application* (1997), ch. 2.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from tridentify.errors import (
    ConvergenceError,
    DataError,
    OptionError,
    SampleTypeError,
    TridentifyError,
    shown,
)
from tridentify.estimation.answer.assemble import fingerprint
from tridentify.estimation.answer.estimate import Estimate, Status
from tridentify.estimation.answer.trace import freeze_arrays
from tridentify.estimation.methods.base import Method, Progress
from tridentify.estimation.methods.three_model import ThreeModel
from tridentify.identify import METHODS
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.executor import Executor, check_told, mapping_of
from tridentify.numerics.quantiles import ONE_SIGMA
from tridentify.numerics.realization import sort_poles
from tridentify.numerics.threads import one_blas_thread
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.uncertainty.bias import corrected
from tridentify.uncertainty.checks import checked_count
from tridentify.uncertainty.draws import unstable
from tridentify.uncertainty.intervals import Kind, intervals, quantiles
from tridentify.uncertainty.noise import NoiseModel
from tridentify.uncertainty.sampled import Sample
from tridentify.writing.layout import format_std, format_table, format_value


@dataclass(frozen=True)
class Failure:
    """A copy that could not be identified, and why."""

    draw: int
    reason: str


@dataclass(frozen=True, eq=False)
class Bootstrap:
    """Coefficients of the copies.

    Attributes
    ----------
    estimate : Estimate
    theta : ndarray, shape (n_draws, n_parameters)
        ``nan`` in the row of a failure.
    std_draws : ndarray, shape (n_draws, n_parameters)
        The standard errors that the copies stated.
    failures : tuple of Failure
    n_flagged : int
        Copies identified with a status that is not ok; they are in ``theta``.
    seed : int
    """

    estimate: Estimate
    theta: Array
    std_draws: Array
    failures: tuple[Failure, ...]
    n_flagged: int
    seed: int

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __repr__(self) -> str:
        names = ", ".join(self.estimate.names)
        return f"Bootstrap({self.n_draws} copies, {self.n_failed} failed, of {names})"

    @property
    def n_draws(self) -> int:
        """Number of copies, failures included."""
        return len(self.theta)

    @property
    def n_failed(self) -> int:
        """Copies without coefficients."""
        return len(self.failures)

    @property
    def _sound(self) -> Array:
        return self.theta[np.all(np.isfinite(self.theta), axis=1)]

    @property
    def sample(self) -> Sample:
        """The copies that have coefficients, for `sampled_derived` and the other quantities."""
        theta = self._sound
        return Sample(self.estimate, theta, int(unstable(self.estimate, theta).sum()), "bootstrap")

    @property
    def bias(self) -> Array:
        """Mean of the copies less the estimate, shape (n_parameters,); at the mercy of outliers."""
        return np.asarray(self._sound.mean(axis=0) - self.estimate.theta)

    @property
    def median_bias(self) -> Array:
        """Median of the copies less the estimate, shape (n_parameters,)."""
        return np.asarray(np.median(self._sound, axis=0) - self.estimate.theta)

    @property
    def std(self) -> Array:
        """Standard deviation of the copies, shape (n_parameters,); at the mercy of outliers."""
        theta = self._sound
        return np.asarray(theta.std(axis=0, ddof=min(1, len(theta) - 1)))

    @property
    def spread(self) -> Array:
        """Half the width of the central 68.27 % of the copies, shape (n_parameters,)."""
        low, high = intervals(self._sound, 0.0, ONE_SIGMA)
        return np.asarray(0.5 * (high - low))

    @property
    def bias_corrected(self) -> Array:
        """Coefficients less the bias of the median, shape (n_parameters,).

        The rule, and why it is not a difference of means, stands in `tridentify.uncertainty.bias`.
        """
        return corrected(self.estimate, self._sound)

    def intervals(
        self,
        level: float = 0.95,
        kind: Literal["percentile", "basic", "bca", "studentized"] = "bca",
    ) -> Array:
        """Intervals of the coefficients.

        Parameters
        ----------
        level : float
            Probability that each interval holds, by itself.
        kind : {"bca", "percentile", "basic", "studentized"}
            The first three as in `tridentify.uncertainty.intervals`. "studentized": quantiles of
            ``(theta* - theta_hat) / std*`` times the standard error of the estimate (bootstrap-t;
            Efron & Tibshirani 1993, sec. 12.5).

        Returns
        -------
        ndarray, shape (n_parameters, 2)

        Raises
        ------
        OptionError
            For another kind, or a level that is no probability.
        """
        centre = np.asarray(self.estimate.theta)
        if kind != "studentized":
            chosen: Kind = kind
            return np.stack(intervals(self._sound, centre, level, chosen), axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = (self.theta - centre) / self.std_draws
        low, high = intervals(ratio, 0.0, level)
        std = self.estimate.std
        return np.stack((centre - high * std, centre - low * std), axis=1)

    def summary(self, level: float = 0.95) -> str:
        """Fixed-width text: coefficients with bias, spread and BCa interval, and the counts."""
        (middle,) = quantiles(self._sound, np.full((1, len(self.estimate.names)), 0.5))
        ends, fixed = self.intervals(level), self.bias_corrected
        parameters = self.estimate.parameters.values()
        rows = []
        for k, p in enumerate(parameters):
            scale = float(self.spread[k])
            cells = (p.value, middle[k], fixed[k], ends[k, 0], ends[k, 1])
            value, centre, best, low, high = (format_value(float(cell), scale) for cell in cells)
            rows.append((p.name, value, centre, best, format_std(scale), low, high, p.unit))
        percent = f"{100 * level:g} % from"
        titles = ("coefficient", "value", "median", "corrected", "spread", percent, "to", "unit")
        lines = [
            f"parametric bootstrap of {self.estimate.method}: {self.n_draws} copies, "
            f"{self.n_failed} failed, {self.n_flagged} flagged (BCa intervals)",
            "",
            *format_table(titles, rows),
        ]
        if self.n_failed > 0.5 * (1.0 - level) * self.n_draws:
            lines += ["", "! more copies failed than a tail of the interval holds: its ends are"]
            lines += [f"  unknown; the first failure: {self.failures[0].reason[:60]}"]
        return "\n".join(lines)


@dataclass(frozen=True, eq=False)
class _Task:
    """One copy: the records without noise, what to add and what to do."""

    number: int
    clean: tuple[Record, ...]
    noise: NoiseModel
    structure: Structure
    method: Method
    seed: np.random.SeedSequence
    near: Complex | None = None


@dataclass(frozen=True, eq=False)
class _Outcome:
    theta: Array
    std: Array
    ok: bool
    reason: str


def bootstrap(
    estimate: Estimate,
    records: Record | Sequence[Record],
    method: Method | None = None,
    *,
    n_draws: int = 200,
    seed: int = 0,
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> Bootstrap:
    """Identify simulated copies of the records of an estimate.

    Parameters
    ----------
    estimate : Estimate
    records : Record or sequence of Record
        Those it was identified from.
    method : Method, optional
        Default: the method of that name in `tridentify.identify.METHODS`.
    n_draws : int
        200 for standard errors and bias, 1000 for the ends of intervals.
    seed : int
    progress : callable, optional
        Told in words how many copies are done.
    executor : executor of concurrent.futures, optional
        Runs the copies in parallel, with the same results.

    Returns
    -------
    Bootstrap

    Raises
    ------
    OptionError
        The method is not known by its name, or a number makes no sense.
    DataError
        The records are not those of the estimate.
    ConvergenceError
        Fewer than two copies could be identified.

    Examples
    --------
    >>> from tridentify import Record, Structure, TransferFunction, identify, simulate
    >>> rng = np.random.default_rng(0)
    >>> u = np.repeat(rng.choice([-1.0, 1.0], 10), 10)
    >>> y = simulate(TransferFunction([2.0], [1.0, 4.0]), Record(u, u, dt=0.02))[:, 0]
    >>> record = Record(u, y + 0.01 * rng.standard_normal(u.size), dt=0.02)
    >>> copies = bootstrap(identify(record, Structure(1, 0)), record, n_draws=20)
    >>> copies.theta.shape, copies.n_failed
    ((20, 2), 0)
    """
    mapped = mapping_of(executor)
    check_told(progress)
    count, own_seed = checked_count("n_draws", n_draws, 2), checked_count("seed", seed, 0)
    listed = _listed(estimate, records)
    chosen = _held(estimate, _method_of(estimate) if method is None else _checked(method))
    settled = [record.settled(estimate.intersample) for record in listed]
    clean = tuple(_clean(estimate, record, e) for e, record in enumerate(settled))
    noise, near = NoiseModel.of(estimate), _truth(estimate)
    tasks = [
        _Task(k, clean, noise, estimate.structure, chosen, own, near)
        for k, own in enumerate(np.random.SeedSequence(own_seed).spawn(count))
    ]
    outcomes: list[_Outcome] = []
    for outcome in mapped(identify_copy, tasks):
        outcomes.append(outcome)
        if progress is not None:
            progress(f"bootstrap: {len(outcomes)} of {count}")
    return _collected(estimate, outcomes, own_seed)


def identify_copy(task: _Task) -> _Outcome:
    """Draw the noise of one copy and identify it; an exception is an outcome, too."""
    rng = np.random.default_rng(task.seed)
    copies = [
        _with(r, r.y + task.noise.draw(rng, r.n_samples, e)) for e, r in enumerate(task.clean)
    ]
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            # without the judgement of each: copies are of the model by construction
            with one_blas_thread():
                estimate = _identified(task, copies)
    except (TridentifyError, ArithmeticError, ValueError) as error:
        return _Outcome(np.empty(0), np.empty(0), False, f"{type(error).__name__}: {error}")
    if not np.all(np.isfinite(estimate.theta)):
        return _Outcome(np.empty(0), np.empty(0), False, "coefficients are not finite")
    return _Outcome(np.asarray(estimate.theta), estimate.std, estimate.status.ok, "")


def _identified(task: _Task, copies: list[Record]) -> Estimate:
    if isinstance(task.method, ThreeModel):
        return task.method.estimate(copies, task.structure, near=task.near)
    return task.method.estimate(copies, task.structure)


def _truth(estimate: Estimate) -> Complex | None:
    """Poles that the copies have, to begin the search of each there.

    Where the record leaves them open a copy may well end elsewhere, and is searched as it was.
    """
    if estimate.status is not Status.CONVERGED or not estimate.structure.shared:
        return None
    return sort_poles(np.roots(estimate.model.den[0][0]).astype(np.complex128))


def _collected(estimate: Estimate, outcomes: Sequence[_Outcome], seed: int) -> Bootstrap:
    theta, std = np.full((2, len(outcomes), len(estimate.names)), np.nan)
    failures = []
    for k, outcome in enumerate(outcomes):
        if outcome.reason:
            failures.append(Failure(k, outcome.reason))
        else:
            theta[k], std[k] = outcome.theta, outcome.std
    if len(outcomes) - len(failures) < 2:
        raise ConvergenceError(
            f"found {len(failures)} of {len(outcomes)} simulated copies that could not be "
            f"identified ({failures[0].reason[:200]}); expected at least two that can; lower the "
            "number of poles or zeros, or record longer"
        )
    flagged = sum(not outcome.ok and not outcome.reason for outcome in outcomes)
    return Bootstrap(estimate, theta, std, tuple(failures), flagged, seed)


def _listed(estimate: Estimate, given: Record | Sequence[Record]) -> tuple[Record, ...]:
    """The records of the estimate, checked to be those."""
    records: tuple[Any, ...] = tuple(given) if isinstance(given, (list, tuple)) else (given,)
    wrong = [type(item).__name__ for item in records if not isinstance(item, Record)]
    if wrong:
        raise SampleTypeError(
            f"found {wrong[0]} in place of a record; expected the records that the estimate was "
            "identified from; pass a Record or a list of them"
        )
    if len(records) != len(estimate.nuisance):
        raise DataError(
            f"found {len(records)} records for an estimate from {len(estimate.nuisance)}; expected "
            "the records it was identified from; pass those"
        )
    if estimate.record_fingerprint and fingerprint(records) != estimate.record_fingerprint:
        raise DataError(
            "found records with other samples than the estimate was identified from; expected the "
            "same ones, in the same order; identify these records and pass that estimate"
        )
    return records


def _checked(method: Method) -> Method:
    if not isinstance(method, Method):
        raise OptionError(
            f"found method={shown(method)}; expected an estimation method such as ThreeModel(); "
            "pass one, or leave it out"
        )
    return method


def _method_of(estimate: Estimate) -> Method:
    known = [make() for make in METHODS.values()]
    for method in known:
        if method.name == estimate.method:
            return method
    raise OptionError(
        f"found an estimate of {shown(estimate.method)}; expected one of "
        f"{', '.join(m.name for m in known)}; pass the method with its options"
    )


def _held(estimate: Estimate, method: Method) -> Method:
    """The method with its choice of the noise's colour taken as made."""
    if getattr(method, "noise", None) != "auto" or not dataclasses.is_dataclass(method):
        return method
    coloured = any(row.size for row in NoiseModel.of(estimate).autoregression)
    if estimate.noise_levels and not coloured:
        return method  # "white" takes one level for all experiments
    held: Any = dataclasses.replace(method, noise="ar" if coloured else "white")
    return held


def _clean(estimate: Estimate, record: Record, experiment: int) -> Record:
    fitted = estimate.predict(record, experiment=experiment)
    return _with(record, np.where(np.isnan(record.y), np.nan, fitted))


def _with(record: Record, y: Array) -> Record:
    """The record with other outputs: all else is known to be sound."""
    return record._derive(y=y)
