"""The three-model strategy, made exact, efficient and free of tuning.

Steps 1 to 4 of Silvestrov, Ostroverkhov et al. (2025) with three changes:

1. *Everything is exact.* All three models act on the recorded input through continuous-time
   filters that are discretised without approximation (`regression`), and hand over functions of
   continuous time (`models.response`).
2. *Filter and basis follow the estimate.* Step 1 begins on operators whose poles and order the
   record chooses (`search.starts`, `search.search`); from then on the basis is the generalised
   orthonormal one on the poles of ``a_hat``, twice each, and Step 2 uses ``c = a_hat``
   (`search.passes`). The order of the parallel model then need not grow with the record.
3. *The end is checked.* The passes finish on a stationary point of the output-error cost: for
   white Gaussian noise the maximum-likelihood estimate, whose covariance is the Cramer-Rao bound.
   There the series model's weights are ``(1, 0, ..., 0)``, which is reported.

Nuisance terms (offset, drift, initial state) are columns in every step. Which of them a record
needs is decided by AICc among the choices that the structure leaves open.

Where the record is short and noisy, the end is the mean over the posterior (`posterior.mean`).

Where the residual is not white, the noise gets an autoregressive model and all steps are repeated
on whitened samples (`likelihood.noise.noise_model`); part of it that is slow and smooth is a
disturbance, estimated along as a polynomial in time.

Where something is known of the coefficients, all this is the search; the end is the maximum of the
likelihood (and of the priors) within the constraints (`knowledge`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

from tridentify.estimation.answer.assemble import Request
from tridentify.estimation.answer.estimate import Estimate, Trace
from tridentify.estimation.answer.trace import Awaited, Pass
from tridentify.estimation.likelihood.answer import Ending, estimate_from
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import Patience, Recorder
from tridentify.estimation.likelihood.noise.noise_model import NoiseChoice, check_noise
from tridentify.estimation.likelihood.question import Question, silently
from tridentify.estimation.likelihood.setup.raster import on_raster
from tridentify.estimation.likelihood.thresholds import SETTLED
from tridentify.estimation.methods.around_maximum.constrained import within_constraints
from tridentify.estimation.methods.around_maximum.delays import over_delays
from tridentify.estimation.methods.around_maximum.levels import (
    at_own_levels,
    constrained_at_own_levels,
)
from tridentify.estimation.methods.around_maximum.maximum import Maximum, Reached, maximum, nearby
from tridentify.estimation.methods.around_maximum.noise import with_noise_model
from tridentify.estimation.methods.around_maximum.robust import check_loss, robust_estimate
from tridentify.estimation.methods.around_maximum.slow_drift import drifting, smooth
from tridentify.estimation.methods.base import Progress, check, check_count, check_tolerance
from tridentify.estimation.methods.by_reference.controller_kind import Controller, check_controller
from tridentify.estimation.methods.by_reference.reference import reference_estimate
from tridentify.estimation.methods.capability import EVERYTHING, Capability
from tridentify.estimation.methods.output_error import OutputError
from tridentify.estimation.methods.paper import as_printed
from tridentify.estimation.methods.route import (
    Route,
    by_reference,
    check_route,
    having_left_out,
    referenced,
    refuse_without_reference,
    taken_by,
)
from tridentify.estimation.posterior.maximum_or_mean import (
    NOT_ROBUST,
    FinishChoice,
    check_finish,
    refuse_posterior,
    weigh,
)
from tridentify.estimation.search.delays import Located
from tridentify.estimation.search.passes import certify
from tridentify.estimation.search.search import search
from tridentify.estimation.search.stand_ins import is_large
from tridentify.numerics.arrays import Complex
from tridentify.numerics.robust import Loss
from tridentify.record.record import Record
from tridentify.structure import Structure


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
        What the measurement noise is taken for: white, of one level in all experiments;
        autoregressive; or what a test of the residual says. With the last two experiments of
        different noise have levels of their own (`likelihood.noise.noise_levels`), and with
        "auto" a slow disturbance is estimated along (`around_maximum.slow_drift`).
    finish : {"auto", "likelihood", "posterior"}
        Where to end: on the likelihood's maximum, on the posterior mean, or on the latter where
        the record is too short and noisy for the former (`posterior.maximum_or_mean`).
    loss : {"squared", "huber", "student"}
        What is minimised: squares, for Gaussian noise; Huber's loss or the likelihood of Student's
        distribution, for records with outliers or noise with heavy tails (`robust`). The
        noise is then taken as white, and the end is the minimum of the loss.
    tolerance : float
        The end is reached when the next step promises to lower ``-2 log L`` by less. Coefficients
        then move by less than its square root in standard errors: 1e-7 is below what is shown,
        1e-4 a hundredth of a standard error, which no record of 50,000 samples and more goes
        below.
    route : {"auto", "open-loop", "reference", "direct"}
        What to make of a controller that may have been running (`methods.route`): nothing; to fit
        what follows a recorded reference; to give the noise a model in any case, which a fit
        without a reference depends on; or what the record calls for.
    controller : {"unknown", "sampled", "continuous"} or TransferFunction
        How the controller works, for the reference route: held between samples, or continuous.
        Unknown, it is what explains a record that is stated to be held. A linear controller ``C``
        that is known may be given, as of ``u = r - C y`` or ``u = C (r - y)``: the estimate is
        then the maximum of the likelihood of the loop's noise, if the record does not speak against
        it (`methods.by_reference.given_controller`).

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
    tolerance: float = SETTLED
    route: Route = "auto"
    controller: Controller = "unknown"

    paper = staticmethod(as_printed)

    name: ClassVar[str] = "ThreeModel"
    """What tables and files call it."""
    capabilities: ClassVar[Capability] = EVERYTHING
    """All of them."""

    def __post_init__(self) -> None:
        check_count("starts", self.starts)
        check_count("max_passes", self.max_passes)
        check_tolerance(self.tolerance)
        check_noise(self.noise)
        check_finish(self.finish)
        check_loss(self.loss, self.noise)
        check_route(self.route, self.noise, self.loss)
        check_controller(self.controller)

    @property
    def patience(self) -> Patience:
        """How long steps on the output error go on."""
        return Patience(self.max_passes, self.tolerance)

    def estimate(
        self,
        records: Sequence[Record],
        structure: Structure,
        progress: Progress | None = None,
        *,
        near: Complex | None = None,
    ) -> Estimate:
        """Estimate the coefficients.

        Parameters
        ----------
        records : sequence of Record
            One or several experiments on the same system, each with nuisance terms of its own.
        structure : Structure
        progress : callable, optional
            Told in words what is going on.
        near : (n,) complex array, optional
            Poles that the record may well have: the search begins there and, on a record that is
            not long, ends there if nothing speaks against it; the trace then ends without the
            series model. Not used by the reference route, by other losses, nor within constraints
            or where delays are estimated along.

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
        say = progress or silently
        check(records, structure, self.name, self.capabilities)
        refuse_without_reference(self.route, records)
        own, left_out = referenced(self.route, records)
        if by_reference(self.route, own):
            return having_left_out(self._by_reference(own, structure, say), left_out)
        if self.loss != "squared":
            return self._robust(records, structure, say)
        route, noise = taken_by(self.route, self.noise)
        with_all_rows = records if noise == "white" else [on_raster(one) for one in records]
        asked = Request.of(records, structure, self.name, with_all_rows, route)
        if structure.constrained:
            refuse_posterior(self.finish)

            def within(own: Sequence[Record]) -> Estimate:
                again = replace(asked, records=tuple(own))
                return within_constraints(self, again, say, self.patience, noise)

            if noise == "white":
                return within(with_all_rows)
            return constrained_at_own_levels(within, with_all_rows)

        def ended(own: Sequence[Record], poles: Complex | None) -> Reached:
            near_them = partial(self.maximise, near=near if poles is None else poles)
            way = partial(over_delays, self) if structure.delay == "free" else near_them
            return way(own, structure, say)

        weighed = partial(self.weighed, say=say)
        if noise == "white":
            return estimate_from(weighed(ended(with_all_rows, None)), asked)
        ending, used = at_own_levels(ended, with_all_rows, weighed)
        return estimate_from(ending, replace(asked, records=tuple(used)))

    def maximise(
        self,
        records: Sequence[Record],
        structure: Structure,
        say: Progress,
        located: Located | None = None,
        *,
        near: Complex | None = None,
    ) -> Reached:
        """Steps 1 to 4 to the likelihood's maximum, and the check of the end.

        Parameters
        ----------
        records : sequence of Record
        structure : Structure
            With delays that are known, and nothing else.
        say : callable
            Is told what is going on.
        located : Located, optional
            Delays to take up, and how far they may go.
        near : (n,) complex array, optional
            Poles to begin from.
        """
        question = Question.of(records, structure, patience=self.patience, say=say)
        if located is not None:
            question = question.delayed(located.place.delays)
        route, noise = taken_by(self.route, self.noise)
        if near is not None and noise == "white":
            found = nearby(question, near)
            if found is not None:
                return found
        say("the three models, from several starts")
        # Steps 1 and 2, the parallel and the series-parallel model, from several operators
        starts = search(question, self.starts, whitened_later=noise != "white", near=near)
        if located is not None:
            question, starts = question.freed(located.limits), starts.beside(located.place.poles)
        # Step 4: repeated on adapted operators, to the stationary point of the output error
        white, in_loop = maximum(question, starts), route == "direct"
        # the noise modelled where it is not white, and all steps again on whitened samples
        ended = question.ended(white.end.point)
        best = with_noise_model(noise, ended, starts, white, in_loop=in_loop)
        # and again beside a drift, where a slow disturbance is left
        open_ = drifting(question, white) if noise == self.route == "auto" else None
        if open_ is not None:
            say("a slow disturbance")
            again = search(open_.held, self.starts, whitened_later=True, near=near)
            white = maximum(open_, again)
            ended = open_.ended(white.end.point)
            drifted = smooth(open_, with_noise_model(noise, ended, again, white), best)
            if drifted is not None:
                best, starts = drifted, again
        told = Trace(_way(best, near is None), best.tried, best.decisions, best.end.why)
        reached = Reached.of(best.end, told, starts.scan, best.moved)
        degree = 0 if open_ is None else max(choice.drift for choice in open_.choices)
        return replace(reached, reacts=in_loop, open_drift=degree)

    def weighed(self, reached: Reached, say: Progress) -> Ending:
        """Where to end: at the maximum or, where that is not to be trusted, beyond it."""
        return weigh(self.finish, reached, say, reached.scan)

    def _by_reference(
        self, records: Sequence[Record], structure: Structure, say: Progress
    ) -> Estimate:
        """In closed loop: the same on what the reference drives, pass by pass."""
        asked = Request.of(records, structure, self.name)
        open_loop = replace(self, route="open-loop", finish="likelihood")
        plain = replace(open_loop, noise="white")
        near = partial(
            OutputError, max_passes=self.max_passes, tolerance=self.tolerance, loss=self.loss
        )
        white = self.noise == "white" or self.loss != "squared"
        coloured = None if white else replace(open_loop, starts=1)
        robust = self.loss != "squared"
        return reference_estimate(asked, self.controller, plain, near, coloured, say, robust=robust)

    def _robust(self, records: Sequence[Record], structure: Structure, say: Progress) -> Estimate:
        """With another loss: the same on pseudo-samples, round by round."""
        plain = replace(self, loss="squared", noise="white", finish="likelihood")
        near = partial(OutputError, max_passes=self.max_passes, tolerance=self.tolerance)
        words = (NOT_ROBUST,) if self.finish == "posterior" else ()
        return robust_estimate(records, structure, self.loss, plain, near, say, words)


def _way(best: Maximum, checked: bool) -> Sequence[Pass]:
    """The passes to the maximum, and the check of the end; of a long record made at once."""

    def made() -> tuple[Pass, ...]:
        way = Recorder()
        way.extend(best.trail)
        way.extend(best.end.recorder)
        if checked:
            # Step 3, the series model, checks the end: its weights are (1, 0, ..., 0) there
            certify(best.end.point, way)
        return tuple(way.passes)

    # what they are made of holds the record's samples
    return made() if is_large(best.end.point.problem) else Awaited(made)
