"""The three-model strategy, made exact, efficient and free of tuning.

Steps 1 to 4 of Silvestrov, Ostroverkhov et al. (2025) with three changes:

1. *Everything is exact.* All three models act on the recorded input through continuous-time
filters that are
   discretised without approximation (`regression`), and hand over functions of continuous time
   (`models.response`).
2. *Filter and basis follow the estimate.* Step 1 begins on Laguerre functions whose pole and
order the record chooses
   (`methods.starts`); from then on the basis is the generalised orthonormal one on the poles of
   ``a_hat``, twice each, and Step 2 uses ``c = a_hat`` (`methods.passes`). The order of the
   parallel model then need not grow with the record.
3. *The end is checked.* The passes finish on a stationary point of the output-error cost: for
white Gaussian noise the
   maximum-likelihood estimate, whose covariance is the Cramer-Rao bound. There the series
   model's weights are ``(1, 0, ..., 0)``, which is reported.

Nuisance terms (offset, drift, initial state) are columns in every step. Which of them a record
needs is decided by AICc among the choices that the structure leaves open.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from tridentify.estimate import Estimate, Step, Trace
from tridentify.methods.base import Progress, check
from tridentify.methods.nuisance import Nuisances, build, build_base, candidates
from tridentify.methods.paper import PaperThreeModel
from tridentify.methods.passes import Recorder, at_rounding, finish, series_model
from tridentify.methods.point import Point, evaluate
from tridentify.methods.problem import Problem, Variant
from tridentify.methods.result import estimate_from
from tridentify.methods.search import Search, criterion
from tridentify.numerics.realization import Complex, cascade
from tridentify.record import Record
from tridentify.regression import regress
from tridentify.structure import Structure

MOST_DECISIONS = 3
TRUSTED = np.log(4.0)


@dataclass(frozen=True)
class ThreeModel:
    """The three-model strategy; chooses operators, pole, order, filter and nuisance terms itself.

    Parameters
    ----------
    starts : int
        Laguerre starts that are followed up, the best by AICc.
    max_passes : int
        Most steps on the output error.

    References
    ----------
    .. [1] A. Silvestrov, M. Ostroverkhov, L. Spinul, O. Khalimovskyy, H. Veshchykov, System
    Research and Information
       Technologies 2025(2).

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
        check(records, structure, self.name)
        choices = candidates(records, structure)
        base, variants = build_base(records, structure, choices)
        say("Steps 1 to 4 from several starts")
        search = Search(self.starts)
        search.run(base, variants)
        say("which offsets and initial states the record needs")
        chosen, point, table = self._decide(base, variants, search.seeds)
        for _ in range(MOST_DECISIONS):
            say(f"output error ({choices[chosen].label})")
            problem = build(records, structure, choices[chosen])
            at = partial(evaluate, problem)
            if not _same_input(problem, base, variants[chosen]):
                point = at(point.poles)
            point, status, why = finish(at, point, search.recorder, self.max_passes)
            settled = criterion(point) < table[chosen] + 1.0 and not at_rounding(point)
            if len(choices) == 1 or settled:
                break
            again, other, table = self._decide(base, variants, [point.poles])
            if again == chosen:
                break
            chosen, point = again, other
        table[chosen] = criterion(point)
        self._certify(point, search.recorder)
        trace = Trace(
            tuple(search.recorder.passes),
            tuple(search.starts),
            _decisions(choices, chosen, table),
            why,
        )
        return estimate_from(
            point, records, structure, choices[chosen], status, trace, self.name, table[chosen]
        )

    def _decide(
        self, base: Problem, variants: Sequence[Variant], seeds: Sequence[Complex]
    ) -> tuple[int, Point, list[float]]:
        """The variant with the lowest AICc, predicted one step ahead of the best seed."""
        found = []
        for poles in seeds:
            bank = cascade(np.tile(poles, 2))
            whole = tuple(regress(e, bank) for e in base.experiments)
            points = [
                evaluate(v.problem(base), poles, 2, v.regressions(whole, bank)) for v in variants
            ]
            found.append(points)
        points = min(found, key=lambda some: min(point.objective for point in some))
        exact = any(at_rounding(point) for point in points)
        trusted = np.inf if exact else TRUSTED * float(points[0].counts.sum())
        table = [criterion(point, min(point.step(0.0)[1], trusted)) for point in points]
        chosen = int(np.argmin(table))
        return chosen, points[chosen], table

    def _certify(self, point: Point, recorder: Recorder) -> None:
        """Step 3 at the end: the weights must be (1, 0, ..., 0)."""
        series = series_model(point)
        step = Step(
            "series",
            series.beta.ravel(),
            float(series.cost.sum() / point.counts.sum()),
            series.condition,
            "W_0 = 1 and the orthonormal functions on the poles of a",
        )
        note = "check of the end: beta is (1, 0, ..., 0) at a stationary point"
        recorder.add(point, (step,), series.distance, note)


def _same_input(problem: Problem, base: Problem, variant: Variant) -> bool:
    """Whether the variant's points are the problem's: both count the input from one value."""
    for own, whole, constants in zip(
        problem.experiments, base.experiments, variant.constants, strict=True
    ):
        shift = np.zeros(own.u.shape[1]) if constants is None else constants
        if not np.array_equal(own.u[0], whole.u[0] + shift):
            return False
    return True


def _decisions(
    choices: Sequence[Nuisances], chosen: int, table: Sequence[float]
) -> tuple[str, ...]:
    if len(choices) == 1:
        return ()
    others = sorted((k for k in range(len(choices)) if k != chosen), key=lambda k: table[k])
    listed = "; ".join(f"{choices[k].label} {table[k] - table[chosen]:+.1f}" for k in others)
    return (f"{choices[chosen].label}: lowest AICc ({listed})",)
