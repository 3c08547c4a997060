"""A model that is held as it was solved: what is fitted beside it, and the estimate of it.

Methods whose equations are not those of the least output error, and the paper's own recursion, end
away from a stationary point of the likelihood. The model then stands as it is, and only free
response, offset and drift are fitted to the record beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from tridentify.estimation.answer.assemble import Request, Solved, assemble
from tridentify.estimation.answer.estimate import Estimate, Nuisance, Status, Trace
from tridentify.estimation.likelihood.answer import fit_percent, free_after, model_of
from tridentify.estimation.likelihood.setup.nuisance import Nuisances, reference_of
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.models.regression import Regression
from tridentify.models.response import Response, nuisance_blocks
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.least_squares import solve
from tridentify.numerics.realization import numerators
from tridentify.record.record import Record


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


@dataclass(frozen=True, eq=False)
class Literal:
    """A model that is held, and what was fitted beside it.

    Attributes
    ----------
    problem : Problem
    nuisances : Nuisances
    theta : (n_coefficients,) array
    poles : (n,) complex array
    rests : dict
        `fit_rests`.
    """

    problem: Problem
    nuisances: Nuisances
    theta: Array
    poles: Complex
    rests: Rests

    @property
    def counts(self) -> Array:
        """(n_outputs,) samples used."""
        return self._summed([float(rest.count) for rest in self.rests.values()])

    @property
    def rss(self) -> Array:
        """(n_outputs,) residual sums of squares."""
        return self._summed([rest.cost for rest in self.rests.values()])

    @property
    def degrees_of_freedom(self) -> Array:
        """(n_outputs,) samples less unknowns, evenly shared."""
        unknowns = self.problem.n_coefficients + self.problem.n_nuisance
        return np.asarray(np.maximum(self.counts - unknowns / self.problem.n_outputs, 1.0))

    @property
    def noise_variance(self) -> Array:
        """(n_outputs,) of the residual."""
        return np.asarray(self.rss / self.degrees_of_freedom)

    def _summed(self, values: Sequence[float]) -> Array:
        found = np.zeros(self.problem.n_outputs)
        for (_, output), value in zip(self.rests, values, strict=True):
            found[output] += value
        return found


def literal_estimate(
    asked: Request,
    literal: Literal,
    status: Status,
    trace: Trace,
    *,
    cov: Array | None = None,
    aicc: float = np.nan,
    condition: float | None = None,
) -> Estimate:
    """An estimate away from a stationary point.

    Parameters
    ----------
    asked : Request
    literal : Literal
    status : Status
    trace : Trace
    cov : (n_coefficients, n_coefficients) array, optional
        Without it no covariance is claimed (``nan``).
    aicc : float
    condition : float, optional
        Without it the worst of the last pass.
    """
    problem, theta = literal.problem, literal.theta
    if cov is None:
        cov = np.full((theta.size, theta.size), np.nan)
    if condition is None:
        condition = max(step.condition for step in trace.passes[-1].steps)
    solved = Solved(
        structure=literal.nuisances.resolved(asked.structure),
        model=model_of(problem, theta, asked.records[0]),
        theta=theta,
        cov=0.5 * (cov + cov.T),
        noise_variance=literal.noise_variance,
        fit=fit_percent(problem, literal.rss, literal.counts),
        status=status,
        trace=trace,
        nuisance=tuple(_nuisance(literal, record, e) for e, record in enumerate(asked.records)),
        degrees_of_freedom=round(float(literal.degrees_of_freedom.sum())),
        cost=trace.passes[-1].cost,
        aicc=aicc,
        condition=condition,
        gradient=np.nan,
    )
    return assemble(asked, solved)


def _nuisance(literal: Literal, record: Record, e: int) -> Nuisance:
    problem, nuisances = literal.problem, literal.nuisances
    table = numerators(literal.poles)
    offset, drift = np.zeros((2, problem.n_outputs))
    bends = np.zeros((problem.n_outputs, max(nuisances.drift - 1, 0)))
    duration = problem.experiments[e].duration
    free = np.zeros((problem.n_outputs, problem.n_poles))
    for i in range(problem.n_outputs):
        rest = literal.rests[e, i]
        offset[i], drift[i], bends[i] = nuisances.split(rest.terms, duration)
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
        bends=bends,
        duration=duration,
    )
