"""The three-model strategy, made exact, efficient and free of tuning.

Steps 1 to 4 of Silvestrov, Ostroverkhov et al. (2025) with three changes:

1. *Everything is exact.* All three models act on the recorded input through continuous-time
   filters that are discretised without approximation (`regression`), and hand over functions of
   continuous time (`models.response`).
2. *Filter and basis follow the estimate.* Step 1 begins on operators whose poles and order the
   record chooses (`strategy.starts`, `strategy.search`); from then on the basis is the generalised
   orthonormal one on the poles of ``a_hat``, twice each, and Step 2 uses ``c = a_hat``
   (`strategy.passes`). The order of the parallel model then need not grow with the record.
3. *The end is checked.* The passes finish on a stationary point of the output-error cost: for
   white Gaussian noise the maximum-likelihood estimate, whose covariance is the Cramer-Rao bound.
   There the series model's weights are ``(1, 0, ..., 0)``, which is reported.

Nuisance terms (offset, drift, initial state) are columns in every step. Which of them a record
needs is decided by AICc among the choices that the structure leaves open.

Where the record is short and noisy, the end is the mean over the posterior (`posterior.mean`).

Where the residual is not white, the noise gets an autoregressive model and all steps are repeated
on whitened samples (`output_error.colour`).

Where something is known of the coefficients, all this is the search; the end is the maximum of the
likelihood (and of the priors) within the constraints (`constraints`).
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tridentify.constraints.solve import Seeds, constrain, resolve, seen, unmoved
from tridentify.errors import OptionError, UnsupportedError, UnsupportedOrderError
from tridentify.estimate import Estimate, Status, Step, Trace
from tridentify.methods.base import Progress, check, check_count
from tridentify.methods.capability import Capability
from tridentify.methods.output_error import OutputError
from tridentify.methods.paper import PaperThreeModel
from tridentify.methods.robust import check_loss, robust_estimate
from tridentify.numerics.realization import Complex
from tridentify.numerics.robust import Loss
from tridentify.output_error.colour import NoiseChoice, check_noise, settle
from tridentify.output_error.decide import Finished, decide
from tridentify.output_error.finish import Recorder, coefficients
from tridentify.output_error.nuisance import build_base, candidates
from tridentify.output_error.point import Point
from tridentify.output_error.problem import Problem
from tridentify.output_error.raster import on_raster
from tridentify.output_error.result import fingerprint
from tridentify.posterior.weigh import FinishChoice, check_finish, weigh
from tridentify.record import Record
from tridentify.strategy.delay_search import Place
from tridentify.strategy.delays import best_of_places
from tridentify.strategy.passes import series_model
from tridentify.strategy.search import Search
from tridentify.structure import Structure
from tridentify.trace import pairs

Array = NDArray[np.float64]

SOUND = (Status.CONVERGED, Status.WEAKLY_IDENTIFIABLE)


@dataclass(frozen=True)
class ThreeModel:
    """The three-model strategy; chooses operators, pole, order, filter and nuisance terms itself.

    Parameters
    ----------
    starts : int
        Laguerre starts that are followed up, the best by AICc.
    max_passes : int
        Most steps on the output error.
    noise : {"auto", "white", "ar"}
        What the measurement noise is taken for: white, autoregressive, or what a test of the
        residual says.
    finish : {"auto", "likelihood", "posterior"}
        Where to end: on the likelihood's maximum, on the posterior mean, or on the latter where
        the record is too short and noisy for the former (`posterior.weigh`).
    loss : {"squared", "huber", "student"}
        What is minimised: squares, for Gaussian noise; Huber's loss or the likelihood of Student's
        distribution, for records with outliers or noise with heavy tails (`methods.robust`). The
        noise is then taken as white, and the end is the minimum of the loss.

    References
    ----------
    .. [1] A. Silvestrov, M. Ostroverkhov, L. Spinul, O. Khalimovskyy, H. Veshchykov, System
       Research and Information Technologies 2025(2).

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Record, Structure, TransferFunction, identify, simulate
    >>> u = np.ones(100)
    >>> record = Record(u, u, dt=0.05)
    >>> y = simulate(TransferFunction([0.5], [1, 1, 3]), record)
    >>> estimate = identify(Record(u, y, dt=0.05), Structure(2, 0), ThreeModel())
    >>> estimate.theta.round(8).tolist()
    [1.0, 3.0, 0.5]
    """

    starts: int = 4
    max_passes: int = 60
    noise: NoiseChoice = "auto"
    finish: FinishChoice = "auto"
    loss: Loss = "squared"

    def __post_init__(self) -> None:
        check_count("starts", self.starts)
        check_count("max_passes", self.max_passes)
        check_noise(self.noise)
        check_finish(self.finish)
        check_loss(self.loss)
        if self.loss != "squared" and self.noise == "ar":
            raise OptionError(
                f"found noise='ar' with loss={self.loss!r}; expected one of the two, as whitening "
                "spreads an outlier over its neighbours; leave one out"
            )

    @classmethod
    def paper(
        cls,
        gamma: float,
        n_operators: int = 3,
        filter: Sequence[float] = (1.0, 5.0, 6.0, 7.0),
        passes: int = 20,
        *,
        operators: str = "allpass",
        solver: str = "least_squares",
        tolerance: float = 1e-8,
    ) -> PaperThreeModel:
        """Steps 1 to 4 as printed in the paper.

        Parameters
        ----------
        gamma : float
            Parameter of the operators [rad/s].
        n_operators : int
            How many operators ``W_i``, besides ``W_0 = 1`` in Step 3.
        filter : sequence of float
            Coefficients of ``c(p)``, descending powers, of higher degree than ``a``.
        passes : int
            Most repetitions of Steps 2 to 4.
        operators : {"allpass", "laguerre"}
            Equation (4), or orthonormal Laguerre functions.
        solver : {"least_squares", "one_at_a_time"}
            How Step 1 is solved; the second is the formula for orthogonal regressors.
        tolerance : float
            Stop rule on ``beta`` and on the relative movement of the coefficients.

        Returns
        -------
        PaperThreeModel
            A method for `identify`.

        Raises
        ------
        OptionError
            For options that make no sense.

        Examples
        --------
        >>> ThreeModel.paper(1.7).filter
        (1.0, 5.0, 6.0, 7.0)
        """
        return PaperThreeModel(
            gamma, n_operators, tuple(filter), passes, operators, solver, tolerance
        )

    @property
    def name(self) -> str:
        """``"ThreeModel"``."""
        return "ThreeModel"

    @property
    def capabilities(self) -> Capability:
        """All of them."""
        sampling = Capability.DELAY | Capability.NON_UNIFORM_TIME | Capability.BAND_LIMITED
        delays = sampling | Capability.FREE_DELAY
        return delays | Capability.SEPARATE_DENOMINATORS | Capability.CONSTRAINTS

    def estimate(
        self, records: Sequence[Record], structure: Structure, progress: Progress | None = None
    ) -> Estimate:
        """Estimate the coefficients.

        Parameters
        ----------
        records : sequence of Record
            One or several experiments on the same system, each with nuisance terms of its own.
        structure : Structure
        progress : callable, optional
            Told in words what is going on.

        Returns
        -------
        Estimate

        Raises
        ------
        DataError, StructureError
            If records and structure are not usable or not supported.
        IdentifiabilityError
            If the data cannot determine the coefficients.
        """
        say = progress or (lambda _: None)
        check(records, structure, self.name, self.capabilities)
        if self.loss != "squared":
            return self._robust(records, structure, say)
        full = records if self.noise == "white" else [on_raster(record) for record in records]
        found = self._squared(full, structure, say)
        return (
            found
            if all(a is b for a, b in zip(full, records, strict=True))
            else _as_recorded(found, full, records)
        )

    def _squared(self, records: Sequence[Record], structure: Structure, say: Progress) -> Estimate:
        """The method with squared loss."""
        if structure.constrained:
            return self._constrained(records, structure, say)
        if structure.delay != "free":
            return self._located(records, structure, structure, None, None, say)
        say("where the delays lie")
        return best_of_places(
            records,
            structure,
            lambda known, place, limits: self._located(
                records, structure, known, place, limits, say
            ),
        )

    def _located(
        self,
        records: Sequence[Record],
        structure: Structure,
        known: Structure,
        place: Place | None,
        limits: Array | None,
        say: Progress,
    ) -> Estimate:
        """With delays that are known, or known well enough to be refined with the poles."""
        best, search, trace = self._maximum(records, known, place, limits, say)
        return weigh(self.finish, best, records, structure, trace, self.name, say, search.scan)

    def _constrained(
        self, records: Sequence[Record], structure: Structure, say: Progress
    ) -> Estimate:
        """The search without the constraints, then the maximum within them."""
        if self.finish == "posterior":
            raise UnsupportedError(
                "found finish='posterior' together with knowledge of the coefficients; expected "
                "finish='auto' or 'likelihood', as the posterior mean keeps no constraints; choose "
                "one of them"
            )
        known = resolve(records, structure)
        looked_at = seen(records, structure, known)
        seeds = Seeds((), (), Trace(()))
        if looked_at is not None:
            best, search, trace = self._maximum(*looked_at, None, None, say)
            if known.only_bounds:
                with suppress(UnsupportedOrderError):
                    free = weigh(self.finish, best, *looked_at, trace, self.name, say, search.scan)
                    kept = unmoved(structure, free)
                    if kept is not None:
                        return kept
            tried = [s.theta for s in sorted(search.starts, key=lambda start: start.cost)]
            seeds = Seeds((coefficients(best.point), *tried), best.point.problem.noise, trace)
        return constrain(
            records, structure, known, seeds, self.name, say, self.max_passes, self.noise
        )

    def _maximum(
        self,
        records: Sequence[Record],
        known: Structure,
        place: Place | None,
        limits: Array | None,
        say: Progress,
    ) -> tuple[Finished, Search, Trace]:
        """The likelihood's maximum without constraints, and the way there."""
        choices = candidates(records, known)
        base, variants = build_base(records, known, choices)
        if place is not None:
            base = base.delayed(place.delays)
        say("the three models, from several starts")
        search = Search(self.starts)
        search.run(base, variants)
        if place is not None:
            base = base.freed(limits)
            if place.poles.size:
                search.seeds.append(place.poles)
                search.trails.append(())
        filtered = {search.known.poles.tobytes(): search.known.whole} if search.known else {}
        best, decisions, seed = decide(
            records, known, choices, base, variants, search.seeds, self.max_passes, say, filtered
        )
        if best.status not in SOUND:
            say("another search, as the end lies at a limit")
            variant = variants[choices.index(best.nuisances)]
            poles = search.again(base.freed(None), variant, best.point.poles)
            other, reasons, _ = decide(
                records, known, choices, base, variants, [poles], self.max_passes, say
            )
            if other.criterion < best.criterion:
                best, decisions = other, reasons

        def again(problem: Problem, seeds: Sequence[Complex]) -> tuple[Finished, tuple[str, ...]]:
            most = self.max_passes
            return decide(records, known, choices, problem, variants, seeds, most, say)[:2]

        def seek(problem: Problem) -> Sequence[Complex]:
            anew = Search(self.starts)
            anew.run(problem.freed(None), variants)
            search.starts += [replace(s, name=f"whitened: {s.name}") for s in anew.starts]
            return anew.seeds

        if limits is not None:
            base = base.delayed(best.point.problem.delays)
        coloured = settle(
            self.noise, best, decisions, base, again, seek, say, self.max_passes,
            white=search.saw_white(best.point),
        )  # fmt: skip
        best, decisions = coloured.best, coloured.decisions
        recorder = Recorder(list(search.trails[seed]))
        recorder.extend(best.recorder)
        self._certify(best.point, recorder)
        trace = Trace(tuple(recorder.passes), tuple(search.starts), decisions, best.why)
        return best, search, trace

    def _robust(self, records: Sequence[Record], structure: Structure, say: Progress) -> Estimate:
        """The same with another loss."""
        plain = replace(self, loss="squared", noise="white", finish="likelihood")

        def fit(seen: Sequence[Record], wanted: Structure) -> Estimate:
            return plain.estimate(seen, wanted, say)

        def refit(seen: Sequence[Record], wanted: Structure, near: Estimate) -> Estimate:
            return OutputError(near.model, self.max_passes).estimate(seen, wanted)

        found = robust_estimate(records, structure, self.loss, fit, refit, say)
        trace = found.trace
        if self.finish == "posterior":
            told = "the maximum of the robust likelihood: the posterior mean is for squared loss"
            trace = replace(trace, decisions=(*trace.decisions, told))
        return replace(found, method=self.name, trace=trace)

    def _certify(self, point: Point, recorder: Recorder) -> None:
        """Step 3 at the end: the weights must be (1, 0, ..., 0)."""
        series = series_model(point)
        step = Step(
            "series",
            series.beta.ravel(),
            float(series.cost.sum() / point.counts.sum()),
            series.condition,
            "W_0 = 1 and the orthonormal functions on the poles of a",
            "orthonormal",
            pairs(np.concatenate([branch.inner.poles for branch in point.branches])),
        )
        note = "check of the end: beta is (1, 0, ..., 0) at a stationary point"
        recorder.add(point, (step,), series.distance, note)


def _as_recorded(estimate: Estimate, full: Sequence[Record], records: Sequence[Record]) -> Estimate:
    """The estimate from records with their missing rows put back, as one of the records."""
    lost = sum(one.n_samples - own.n_samples for one, own in zip(full, records, strict=True))
    told = f"{lost} rows missing from a uniform raster: taken for samples without an output"
    return replace(
        estimate,
        n_samples=sum(record.n_samples for record in records),
        dt=records[0].dt,
        record_fingerprint=fingerprint(records),
        trace=replace(estimate.trace, decisions=(*estimate.trace.decisions, told)),
    )
