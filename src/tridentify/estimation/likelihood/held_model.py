"""A model that a linear step found, and the output error it leaves when it is held.

Methods that do not minimise the output error are judged by it all the same: the model's
coefficients stay as they are, free responses, offsets and drifts are fitted to what remains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tridentify.estimation.likelihood.fitted_point import ROUNDING_SQUARED
from tridentify.estimation.likelihood.literal import Literal, Rests, fit_rests
from tridentify.estimation.likelihood.setup.nuisance import Nuisances
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.models.regression import Regression, regress
from tridentify.models.response import Response
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.information import aicc_price
from tridentify.numerics.kept import cached_property
from tridentify.numerics.realization import Cascade, cascade, denominator, monomials

TINY = 1e-300
"""Keeps the logarithm of a residual of nothing a number: near the smallest double."""


@dataclass(frozen=True, eq=False)
class HeldModel:
    """A model and the output error it leaves when it is held.

    Attributes
    ----------
    problem : Problem
    poles : (n,) complex array
        Admissible (`Problem.admissible`); ``note`` says what was moved.
    numerator : array
        All coefficients of ``b``, in the order of `Structure.names`.
    note : str
    """

    problem: Problem
    poles: Complex
    numerator: Array
    note: str

    @cached_property
    def theta(self) -> Array:
        """Physical coefficients."""
        return np.concatenate([denominator(self.poles)[1:], self.numerator])

    @cached_property
    def _fitted(self) -> tuple[Response, Rests]:
        problem, inner = self.problem, cascade(self.poles)
        last = np.cumsum([m + 1 for line in problem.n_zeros for m in line])
        flat = iter(np.split(self.numerator, last[:-1]))
        b = [[next(flat) for _ in line] for line in problem.n_zeros]
        regressions = [regress(e, inner) for e in problem.experiments]
        return with_rests(regressions, inner, self.poles, b)

    @property
    def response(self) -> Response:
        """``(b / a) u`` with the best free response, on the cascade of the poles."""
        return self._fitted[0]

    @property
    def rests(self) -> Rests:
        """Free responses, offsets and drifts."""
        return self._fitted[1]

    def literal(self, nuisances: Nuisances) -> Literal:
        """The same with what was fitted beside it, for an estimate of it as it is."""
        return Literal(self.problem, nuisances, self.theta, self.poles, self.rests)

    @cached_property
    def counts(self) -> Array:
        """(n_outputs,) samples."""
        samples = sum(e.n_samples for e in self.problem.experiments)
        return np.full(self.problem.n_outputs, float(samples))

    @cached_property
    def rss(self) -> Array:
        """(n_outputs,) sums of squares of the output error."""
        total = np.zeros(self.problem.n_outputs)
        for (_, i), rest in self.rests.items():
            total[i] += rest.cost
        return total

    @property
    def variance(self) -> Array:
        """(n_outputs,) mean squares of the output error, kept above rounding."""
        return np.asarray(self.rss / self.counts + ROUNDING_SQUARED * self.problem.size)

    @property
    def mean_square(self) -> float:
        """Geometric mean of the mean squares of the outputs."""
        return float(np.exp(np.mean(np.log(self.rss / self.counts + TINY))))

    @cached_property
    def criterion(self) -> float:
        """AICc of the output error, as in `likelihood.minimum.levenberg_marquardt.criterion`."""
        problem, n = self.problem, float(self.counts.sum())
        k = problem.n_coefficients + problem.n_nuisance + problem.n_outputs
        return float(self.counts @ np.log(self.variance)) + aicc_price(float(k), n)


def with_rests(
    regressions: Sequence[Regression], bank: Cascade, poles: Complex, b: Sequence[Sequence[Array]]
) -> tuple[Response, Rests]:
    """``(b / a) u`` with the best free response, and what else is fitted to the remainder.

    Parameters
    ----------
    regressions : sequence of Regression
        On the bank.
    bank : Cascade
        Begins with the poles.
    poles : (n,) complex array
        Of ``a``.
    b : nested sequence of arrays
        ``[output][input]``, descending powers.
    """
    n, a, powers = poles.size, denominator(poles), monomials(cascade(poles), poles.size)
    direct = np.zeros((len(b), len(b[0])))
    rows = np.zeros((*direct.shape, bank.order))
    for i, j in np.ndindex(direct.shape):
        own = np.pad(b[i][j], (n + 1 - b[i][j].size, 0))
        direct[i, j] = own[0]
        rows[i, j, :n] = (own[1:] - own[0] * a[1:])[::-1] @ powers
    free = np.zeros((len(regressions), len(b), bank.order))
    rests = fit_rests(regressions, Response(rows, direct, free), poles)
    for (e, i), rest in rests.items():
        free[e, i, :n] = rest.free_row
    return Response(rows, direct, free), rests
