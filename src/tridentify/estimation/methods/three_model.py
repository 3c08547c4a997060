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
on whitened samples (`likelihood.noise_model`).

Where something is known of the coefficients, all this is the search; the end is the maximum of the
likelihood (and of the priors) within the constraints (`constraints`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

from tridentify.errors import OptionError
from tridentify.estimation.answer.estimate import Estimate, Trace
from tridentify.estimation.likelihood.answer import as_recorded
from tridentify.estimation.likelihood.noise_model import NoiseChoice, check_noise
from tridentify.estimation.likelihood.question import Question, silently
from tridentify.estimation.likelihood.raster import on_raster
from tridentify.estimation.methods.base import Progress, check, check_count
from tridentify.estimation.methods.capability import Capability
from tridentify.estimation.methods.constrained import within_constraints
from tridentify.estimation.methods.delays import over_delays
from tridentify.estimation.methods.maximum import Reached, maximum
from tridentify.estimation.methods.noise import with_noise_model
from tridentify.estimation.methods.output_error import OutputError
from tridentify.estimation.methods.paper import PaperThreeModel
from tridentify.estimation.methods.robust import check_loss, robust_estimate
from tridentify.estimation.posterior.maximum_or_mean import (
    FinishChoice,
    check_finish,
    refuse_posterior,
    told_of_posterior,
    weigh,
)
from tridentify.estimation.search.delays import Located
from tridentify.estimation.search.passes import certified
from tridentify.estimation.search.search import search
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
        What the measurement noise is taken for: white, autoregressive, or what a test of the
        residual says.
    finish : {"auto", "likelihood", "posterior"}
        Where to end: on the likelihood's maximum, on the posterior mean, or on the latter where
        the record is too short and noisy for the former (`posterior.maximum_or_mean`).
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
        say = progress or silently
        check(records, structure, self.name, self.capabilities)
        if self.loss != "squared":
            return self._robust(records, structure, say)
        with_all_rows = records if self.noise == "white" else [on_raster(one) for one in records]
        return as_recorded(self._squared(with_all_rows, structure, say), with_all_rows, records)

    def _squared(self, records: Sequence[Record], structure: Structure, say: Progress) -> Estimate:
        """With squared loss; what is known, and delays that are not, are loops around it."""
        if structure.constrained:
            refuse_posterior(self.finish)
            return within_constraints(self, records, structure, say, self.max_passes, self.noise)
        if structure.delay == "free":
            return over_delays(self, records, structure, say)
        return self.answer(self.maximise(records, structure, say), records, structure, say)

    def _robust(self, records: Sequence[Record], structure: Structure, say: Progress) -> Estimate:
        """With another loss: the same on pseudo-samples, round by round."""
        plain = replace(self, loss="squared", noise="white", finish="likelihood")
        near = partial(OutputError, max_passes=self.max_passes)
        found = robust_estimate(records, structure, self.loss, plain, near, say)
        return told_of_posterior(found) if self.finish == "posterior" else found

    def maximise(
        self,
        records: Sequence[Record],
        structure: Structure,
        say: Progress,
        located: Located | None = None,
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
        """
        question = Question.of(records, structure, most=self.max_passes, say=say)
        if located is not None:
            question = question.delayed(located.place.delays)
        say("the three models, from several starts")
        # Steps 1 and 2, the parallel and the series-parallel model, from several operators
        starts = search(question, self.starts)
        if located is not None:
            question, starts = question.freed(located.limits), starts.beside(located.place.poles)
        # Step 4: repeated on adapted operators, to the stationary point of the output error
        best = maximum(question, starts)
        # the noise modelled where it is not white, and all steps again on whitened samples
        best = with_noise_model(self.noise, question.ended(best.end.point), starts, best)
        # Step 3, the series model, checks the end: its weights are (1, 0, ..., 0) there
        trail = certified(best.end.point, [*best.trail, *best.end.recorder.passes])
        trace = Trace(trail, best.tried, best.decisions, best.end.why)
        return Reached(best.end, trace, starts.scan)

    def answer(
        self, reached: Reached, records: Sequence[Record], structure: Structure, say: Progress
    ) -> Estimate:
        """The estimate at the maximum or, where that is not to be trusted, beyond it."""
        end, trace, scan = reached.end, reached.trace, reached.scan
        return weigh(self.finish, end, records, structure, trace, self.name, say, scan)
