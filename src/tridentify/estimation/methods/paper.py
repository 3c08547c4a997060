"""Steps 1 to 4 as the paper prints them, for any orders n >= m.

    Step 1  y_M = sum_{i=1}^k beta_i W_i x                     parallel model (eq. 3)
    Step 2  min |(a / c) y_M - (b / c) x|,  deg c > deg a      series-parallel model (eq. 5)
    Step 3  y ~ sum_{i=0}^k beta_i W_i (b / a) x,  W_0 = 1     series model
    Step 4  Step 2 on the output of Step 3; repeat 2 to 4 until beta -> (1, 0, ..., 0)

with fixed operators (all-pass powers, eq. 4, or orthonormal Laguerre functions), a fixed filter
``c(p)``, and least squares or the one-coefficient-at-a-time formula in Step 1. The
liberties taken: all filters are computed exactly, nuisance terms are further columns, and poles of
a pass that are unstable or outside the band of the record are reflected and held (the trace says
so), so that Step 3 has an output to correct.

As the paper says, ``k`` is limited in practice, so the fixed point of these passes is an
approximation: with noise it is neither the least-squares nor the maximum-likelihood estimate,
and no covariance is claimed (it is ``nan``).
With too few operators ``beta`` may become (1, 0, ..., 0) away from the least-squares point; the end
is called converged only where a step on the output error would not lower its cost either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tridentify.errors import ConvergenceError, OptionError, shown
from tridentify.estimation.answer.assemble import Request
from tridentify.estimation.answer.estimate import Estimate, Pass, Status, Step, Trace
from tridentify.estimation.answer.trace import pairs
from tridentify.estimation.likelihood.cost import evaluate
from tridentify.estimation.likelihood.held_model import with_rests
from tridentify.estimation.likelihood.literal import Literal, Rests, literal_estimate
from tridentify.estimation.likelihood.setup.nuisance import Nuisances, build, candidates
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.estimation.likelihood.thresholds import SAME_END
from tridentify.estimation.methods.base import Progress, check, check_count
from tridentify.estimation.methods.capability import Capability
from tridentify.estimation.methods.filtered.filter_cascade import (
    check_rates,
    checked_filter,
    monic_filter,
)
from tridentify.models.operators import AllPass, Laguerre, OperatorBank
from tridentify.models.parallel import fit_parallel
from tridentify.models.regression import Regression, regress
from tridentify.models.response import Response
from tridentify.models.series import fit_series
from tridentify.models.series_parallel import SeriesParallelFit, fit_series_parallel
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.realization import Cascade, cascade, denominator, sort_poles
from tridentify.record.record import Record
from tridentify.structure import Structure

EXACT = 1e-16
"""Residual power over the output's below which the end counts as without residual: 1e-8 of its
size."""


@dataclass(frozen=True)
class PaperThreeModel:
    """The strategy as printed; made by `ThreeModel.paper`.

    Parameters
    ----------
    gamma : float
        Parameter of the operators [rad/s].
    n_operators : int
        How many.
    filter : tuple of float
        Coefficients of ``c(p)``, descending powers; stable, of higher degree than ``a``.
    passes : int
        Most repetitions of Steps 2 to 4.
    operators : {"allpass", "laguerre"}
        Equation (4), or orthonormal Laguerre functions.
    solver : {"least_squares", "one_at_a_time"}
        How Step 1 is solved.
    tolerance : float
        The passes stop when ``beta`` is this close to (1, 0, ..., 0), or when no coefficient
        moves by more than this relative to its size.

    Raises
    ------
    OptionError
        For options that make no sense.
    """

    gamma: float
    n_operators: int = 3
    filter: tuple[float, ...] = (1.0, 5.0, 6.0, 7.0)
    passes: int = 20
    operators: str = "allpass"
    solver: str = "least_squares"
    tolerance: float = 1e-8

    name: ClassVar[str] = "ThreeModel.paper"
    """What tables and files call it."""
    capabilities: ClassVar[Capability] = Capability.NONE
    """The plain case only."""

    def __post_init__(self) -> None:
        if self.operators not in ("allpass", "laguerre"):
            raise OptionError(
                f"found operators={self.operators!r}; expected 'allpass' or 'laguerre'; choose one"
            )
        if self.solver not in ("least_squares", "one_at_a_time"):
            raise OptionError(
                f"found solver={self.solver!r}; expected 'least_squares' or "
                "'one_at_a_time'; choose one"
            )
        check_count("passes", self.passes)
        if not isinstance(self.tolerance, (int, float)) or not self.tolerance >= 0.0:
            raise OptionError(
                f"found tolerance={shown(self.tolerance)}; expected a number, zero or more; "
                "correct it"
            )
        checked_filter(() if self.filter is None else self.filter)
        self.bank  # noqa: B018 - checks gamma and n_operators
        object.__setattr__(self, "filter", tuple(float(c) for c in self.filter))

    @property
    def bank(self) -> OperatorBank:
        """The operators."""
        kind = AllPass if self.operators == "allpass" else Laguerre
        return kind(self.gamma, self.n_operators)

    def estimate(
        self, records: Sequence[Record], structure: Structure, progress: Progress | None = None
    ) -> Estimate:
        """Run Steps 1 to 4.

        Parameters
        ----------
        records : sequence of Record
        structure : Structure
            Where nuisance terms are ``"auto"`` the leanest choice is taken.
        progress : callable, optional

        Returns
        -------
        Estimate
            With a covariance of ``nan``.

        Raises
        ------
        OptionError
            If the filter's degree does not exceed the number of poles.
        ConvergenceError
            If a pass gives coefficients that are not finite.
        """
        check(records, structure, self.name, self.capabilities)
        nuisances = candidates(records, structure)[0]
        problem = build(records, structure, nuisances)
        if len(self.filter) - 1 <= problem.n_poles:
            raise OptionError(
                f"found a filter of degree {len(self.filter) - 1} for {problem.n_poles} poles; "
                "expected a higher degree; add a root to c(p)"
            )
        if progress:
            progress("Steps 1 to 4")
        return _PaperRun(self, problem).estimate(records, structure, nuisances)


def as_printed(
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
    >>> from tridentify import ThreeModel
    >>> ThreeModel.paper(1.7).filter
    (1.0, 5.0, 6.0, 7.0)
    """
    return PaperThreeModel(gamma, n_operators, tuple(filter), passes, operators, solver, tolerance)


@dataclass(frozen=True, eq=False)
class _PaperModel:
    """A pass's b / a as polynomials."""

    poles: Complex
    b: tuple[tuple[Array, ...], ...]

    def theta(self) -> Array:
        return np.concatenate([denominator(self.poles)[1:], *(b for row in self.b for b in row)])


class _PaperRun:
    """One run over one problem; everything mutable lives here."""

    def __init__(self, options: PaperThreeModel, problem: Problem) -> None:
        self.options, self.problem = options, problem
        self.operators = options.bank
        self.operator_bank = cascade(self.operators.poles)
        roots = np.roots(monic_filter(np.asarray(options.filter))).astype(np.complex128)
        check_rates(roots, "filter", problem.experiments)
        check_rates(self.operators.poles, "gamma", problem.experiments)
        self.filter_bank = cascade(sort_poles(roots))
        self.passes: list[Pass] = []
        self.samples = float(sum(np.isfinite(e.y).sum() for e in problem.experiments))
        self.weights = np.ones(problem.n_outputs) / np.sqrt(np.maximum(problem.power, 1e-300))

    def estimate(
        self, records: Sequence[Record], structure: Structure, nuisances: Nuisances
    ) -> Estimate:
        model, steps, note = self._first()
        status, why = Status.MAX_PASSES, f"{self.options.passes} passes"
        for number in range(1, self.options.passes + 1):
            bank, regressions = self._regressions(model.poles)
            response, rest = self._output(bank, regressions, model)
            series = fit_series(
                regressions,
                bank,
                response,
                self.operator_bank,
                self.operators.rows,
                self.operators.direct,
            )
            step = self._step_2(bank, regressions, series.response)
            steps = (
                *steps,
                Step(
                    "series",
                    series.beta.ravel(),
                    float(series.cost.sum()) / self.samples,
                    series.condition,
                    kind=self.options.operators,
                    poles=pairs(self.operators.poles),
                ),
            )
            self._add(number, steps, model, rest, series.distance, note)
            before = model.theta()
            model, note = self._admitted(step)
            steps = (self._described(step, "Step 4: on the series model's output"),)
            moved = _relative(model.theta() - before, before, self.problem.n_poles)
            if series.distance < self.options.tolerance or moved < self.options.tolerance:
                status = Status.SETTLED
                why = (
                    f"beta is within {series.distance:.1e} of (1, 0, ..., 0), the coefficients "
                    f"moved by {moved:.1e}"
                )
                break
        bank, regressions = self._regressions(model.poles)
        response, rest = self._output(bank, regressions, model)
        self._add(len(self.passes) + 1, steps, model, rest, np.nan, note)
        if status is Status.SETTLED and self._is_stationary(model.poles, rest):
            status = Status.CONVERGED
        return literal_estimate(
            Request.of(records, structure, self.options.name),
            Literal(self.problem, nuisances, model.theta(), model.poles, rest),
            status,
            Trace(tuple(self.passes), stopped=why),
        )

    def _is_stationary(self, poles: Complex, rests: Rests) -> bool:
        """Whether the output error has (almost) nothing left to gain near the end."""
        point = evaluate(self.problem, poles)
        own = np.zeros(self.problem.n_outputs)
        for (_, i), rest in rests.items():
            own[i] += rest.cost
        if np.all(own / point.counts < EXACT * self.problem.size):
            return True
        above = float(point.counts @ np.log((own + 1e-300) / (point.rss + 1e-300)))
        return above + point.decrease() < SAME_END

    def _first(self) -> tuple[_PaperModel, tuple[Step, ...], str]:
        poles = np.concatenate([self.operators.poles, self.filter_bank.poles])
        bank = cascade(poles)
        regressions = [regress(e, bank) for e in self.problem.experiments]
        k = self.operators.rows.shape[1]
        rows = np.pad(self.operators.rows, ((0, 0), (0, bank.order - k)))
        parallel = fit_parallel(
            regressions,
            rows,
            self.operators.direct,
            free_rows=np.eye(k, bank.order),
            one_at_a_time=self.options.solver == "one_at_a_time",
        )
        step = self._step_2(bank, regressions, parallel.response)
        model, note = self._admitted(step)
        first = Step(
            "parallel",
            parallel.beta.ravel(),
            float(parallel.cost.sum()) / self.samples,
            parallel.condition,
            f"{self.options.operators}, gamma {self.options.gamma:g} rad/s",
            self.options.operators,
            pairs(self.operators.poles),
        )
        return model, (first, self._described(step, "on the parallel model's output")), note

    def _regressions(self, poles: Complex) -> tuple[Cascade, list[Regression]]:
        bank = cascade(np.concatenate([poles, self.operators.poles, self.filter_bank.poles]))
        return bank, [regress(e, bank) for e in self.problem.experiments]

    def _step_2(
        self, bank: Cascade, regressions: list[Regression], response: Response
    ) -> SeriesParallelFit:
        step = fit_series_parallel(
            regressions,
            bank,
            response,
            self.filter_bank,
            self.problem.n_poles,
            self.problem.n_zeros,
            self.weights,
        )
        if not np.all(np.isfinite(step.poles)):
            raise ConvergenceError(
                "Step 2 gave coefficients that are not finite; expected a usable pass; choose "
                "another gamma, filter or number of operators"
            )
        return step

    def _admitted(self, step: SeriesParallelFit) -> tuple[_PaperModel, str]:
        poles, note = self.problem.admissible(step.poles)
        return _PaperModel(poles, step.b), note

    def _described(self, step: SeriesParallelFit, note: str) -> Step:
        theta = _PaperModel(step.poles, step.b).theta()
        filter_ = pairs(self.filter_bank.poles)
        cost = step.cost / self.samples
        return Step("series-parallel", theta, cost, step.condition, note, poles=filter_)

    def _output(
        self, bank: Cascade, regressions: list[Regression], model: _PaperModel
    ) -> tuple[Response, Rests]:
        """``(b / a) x`` with the best free response, and what else is fitted to the remainder."""
        return with_rests(regressions, bank, model.poles, model.b)

    def _add(
        self,
        number: int,
        steps: tuple[Step, ...],
        model: _PaperModel,
        rests: Rests,
        distance: float,
        note: str,
    ) -> None:
        variance = [
            sum(r.cost for (_, output), r in rests.items() if output == i)
            / sum(r.count for (_, output), r in rests.items() if output == i)
            for i in range(self.problem.n_outputs)
        ]
        mean = float(np.exp(np.mean(np.log(np.maximum(variance, 1e-300)))))
        self.passes.append(Pass(number, steps, model.theta(), mean, distance, np.nan, note))


def _relative(change: Array, theta: Array, n_poles: int) -> float:
    """Largest change of a coefficient relative to itself, or to its polynomial if it is tiny."""
    found = 0.0
    for part in (slice(0, n_poles), slice(n_poles, None)):
        size = np.abs(theta[part])
        size = np.maximum(size, 1e-9 * size.max(initial=0.0))
        ratio = np.abs(change[part]) / np.where(size > 0, size, 1.0)
        found = max(found, float(ratio.max(initial=0.0)))
    return found
