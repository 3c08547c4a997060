"""Everything that is linear at one denominator ``p^k a'(p)``: columns, fit and derivatives.

The poles of ``a'`` stand in an orthonormal cascade, each several times over, as elsewhere
(`likelihood.cost`). The ``k`` poles at the origin cannot: a chain of integrators ``v_i' =
v_{i-1} / T``, ``v_0 = u``, is driven beside the cascade by the same input, and the two together
are one state equation, discretised exactly whatever the input does between the samples. By
partial fractions all ``p^d / (p^k a') u`` are combinations of its states: with ``X`` the states
of the cascade per unit input,

    X v_i = - A^{-1} B v_i + (A^{-1} / T) X v_{i-1},

so filtering a signal of the chain once more stays within the states. For an unknown initial state
the input is ``delta(t - t0)``, and the chain gives ``1, t, t^2 / 2, ...``: a constant and a ramp
that are estimated anyway are not taken twice.

In physical coefficients the derivatives of ``y_0 = b / a u`` are ``p^d / a u`` with respect to
``b_d`` and ``- p^d / a y_0`` with respect to ``a_d``; offsets, drifts and free responses are
eliminated by least squares (Golub & Pereyra 1973; Kaufman 1975).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tridentify.estimation.likelihood.fitted_point import FLOOR
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.models.regression import Regression, regress, response_of
from tridentify.models.response import Response
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.least_squares import solve
from tridentify.numerics.realization import Cascade, cascade, filter_map, monomials, sort_poles


def poles_from(a: Array) -> Complex:
    """Roots of the monic polynomial with the lower coefficients ``a``, descending powers.

    Examples
    --------
    >>> poles_from(np.array([3.0, 2.0])).tolist()
    [(-1+0j), (-2+0j)]
    """
    n = a.size
    if n == 0:
        return np.zeros(0, dtype=np.complex128)
    rate = abs(a[-1]) ** (1.0 / n) or 1.0
    scaled = a / rate ** np.arange(1, n + 1)
    return sort_poles(rate * np.roots(np.concatenate([[1.0], scaled])).astype(np.complex128))


@dataclass(frozen=True, eq=False)
class Denominator:
    """A denominator, and the records seen through it.

    Attributes
    ----------
    problem : Problem
    a : (n - k,) array
        Coefficients of ``a'`` below the leading one, descending powers.
    integrators : int
        ``k``.
    poles : (n - k,) complex array
        Roots of ``a'``.
    inner : Cascade
        They, once.
    orthonormal : Cascade
        They, several times.
    bank : Cascade
        The same with the chain of integrators behind it.
    span : float
        ``T`` [s].
    regressions : tuple of Regression
        On ``bank``.
    """

    problem: Problem
    a: Array
    integrators: int
    poles: Complex
    inner: Cascade
    orthonormal: Cascade
    bank: Cascade
    span: float
    regressions: tuple[Regression, ...]

    @cached_property
    def _powers(self) -> Array:
        """(n', n') rows of ``p^d / a'`` on the inner cascade, rising ``d``."""
        n = self.inner.order
        return monomials(self.inner, n) if n else np.zeros((0, 0))

    @cached_property
    def _chained(self) -> list[Array]:
        """``X v_i`` on the bank, ``i = 0 .. k``; (n', q + k) each."""
        n, q = self.inner.order, self.orthonormal.order
        first = np.zeros((n, self.bank.order))
        first[:, :n] = np.eye(n)
        found = [first]
        for i in range(self.integrators):
            following = np.asarray(np.linalg.solve(self.inner.a, found[-1] / self.span), float)
            following[:, q + i] -= np.linalg.solve(self.inner.a, self.inner.b)
            found.append(following)
        return found

    @cached_property
    def _map(self) -> Array:
        """(q + k, n', q + k): the inner states driven by each state of the bank."""
        q, k = self.orthonormal.order, self.integrators
        whole = np.zeros((q + k, self.inner.order, q + k))
        if q:
            whole[:q, :, :q] = filter_map(self.inner, self.orthonormal)
        for i in range(k):
            whole[q + i] = self._chained[i + 1]
        return whole

    @cached_property
    def numerators(self) -> tuple[Array, Array]:
        """Rows (n + 1, q + k) and direct terms (n + 1,) of ``p^d / (p^k a')``, rising ``d``."""
        n, k, q = self.inner.order, self.integrators, self.orthonormal.order
        rows, direct = np.zeros((n + k + 1, self.bank.order)), np.zeros(n + k + 1)
        for d in range(k):
            if n:
                rows[d] = self.span ** (k - d) * (self._powers[0] @ self._chained[k - d])
            else:
                rows[d, q + k - d - 1] = self.span ** (k - d)
        rows[k : k + n, :n] = self._powers
        direct[-1] = 1.0
        rows[-1, :n] = -self.a[::-1] @ self._powers
        return rows, direct

    def numerator_columns(self, e: int, i: int, j: int, m: int) -> Array:
        """(r, m + 1): ``p^m / a u_j, ..., 1 / a u_j`` for output ``i`` of experiment ``e``."""
        rows, direct = self.numerators
        regression = self.regressions[e]
        block = regression.input_signal(i, j, rows[m::-1].T)
        own = regression.signals[i][:, regression.layout.direct(j)]
        return np.asarray(block + np.outer(own, direct[m::-1]))

    def nuisance_columns(self, e: int, i: int) -> Array:
        """Free response (inner states, then chain), constant and ramp."""
        regression = self.regressions[e]
        layout = regression.layout
        found = [regression.nuisance_signals(i)]
        if layout.free:
            q, first = self.orthonormal.order, self.first_chained(e)
            impulse = regression.signals[i]
            chain = impulse[:, q + first : q + self.integrators]
            found = [impulse[:, : self.inner.order], chain, *found]
        return np.hstack(found)

    def first_chained(self, e: int) -> int:
        """How many of the chain's free responses the constant and the ramp stand for."""
        layout = self.regressions[e].layout
        return min(self.integrators, layout.offset + layout.offset * layout.drift)

    def free_row(self, e: int, terms: Array) -> Array:
        """Free response on the bank from the first of the nuisance terms; zero at rest."""
        row = np.zeros(self.bank.order)
        if self.regressions[e].layout.free:
            n, q, first = self.inner.order, self.orthonormal.order, self.first_chained(e)
            row[:n] = terms[:n]
            row[q + first :] = terms[n : n + self.integrators - first]
        return row

    def response(self, theta: Array, terms: dict[tuple[int, int], Array]) -> Response:
        """The model's output without offset and drift, on the bank."""
        problem = self.problem
        rows = np.zeros((problem.n_outputs, problem.n_inputs, self.bank.order))
        direct = np.zeros((problem.n_outputs, problem.n_inputs))
        free = np.zeros((len(self.regressions), problem.n_outputs, self.bank.order))
        table, straight = self.numerators
        at = problem.n_poles
        for i in range(problem.n_outputs):
            for j, m in enumerate(problem.n_zeros[i]):
                b = theta[at : at + m + 1]
                rows[i, j], direct[i, j] = b @ table[m::-1], b @ straight[m::-1]
                at += m + 1
            for e in range(len(self.regressions)):
                free[e, i] = self.free_row(e, terms[e, i])
        return Response(rows, direct, free)

    def filtered(self, response: Response, e: int, i: int) -> Array:
        """(r, n'): ``p^{n'-1} / a' y_i, ..., 1 / a' y_i`` of a response on the bank."""
        regression = self.regressions[e]
        total = np.zeros((regression.signals[i].shape[0], self.inner.order))
        for j in range(self.problem.n_inputs):
            states = np.tensordot(response.rows[i, j], self._map, 1)
            states += response.direct[i, j] * self._chained[0]
            total += regression.input_signal(i, j, states.T)
        if regression.layout.free:
            states = np.tensordot(response.free[e, i], self._map, 1)
            total += regression.impulse_signal(i, states.T)
        return np.asarray(total @ self._powers[::-1].T)


def place(problem: Problem, a: Array, integrators: int, repeats: int = 2) -> Denominator:
    """Filter the records on a stable ``a'`` and a chain of integrators."""
    poles = poles_from(a)
    inner, orthonormal = cascade(poles), cascade(np.tile(poles, repeats))
    q, k = orthonormal.order, integrators
    span = max(e.duration for e in problem.experiments)
    matrix, drive = np.zeros((q + k, q + k)), np.zeros(q + k)
    matrix[:q, :q], drive[:q] = orthonormal.a, orthonormal.b
    if k:
        drive[q] = 1.0 / span
        matrix[range(q + 1, q + k), range(q, q + k - 1)] = 1.0 / span
    bank = Cascade(matrix, drive, np.concatenate([orthonormal.poles, np.zeros(k)]))
    bank = bank if k else orthonormal
    regressions = tuple(regress(e, bank) for e in problem.experiments)
    return Denominator(problem, a, k, poles, inner, orthonormal, bank, span, regressions)


@dataclass(frozen=True, eq=False)
class HeldFit:
    """Coefficients, and the best nuisance terms beside them.

    Attributes
    ----------
    place : Denominator
    theta : (p,) array
    terms : dict
        Nuisance terms by (experiment, output).
    raw, columns : tuple of (r, p) arrays
        Derivatives of each output with respect to ``theta``; the nuisance terms projected off in
        ``columns``. Experiments one after the other.
    residuals : tuple of (r,) arrays
    """

    place: Denominator
    theta: Array
    terms: dict[tuple[int, int], Array]
    raw: tuple[Array, ...]
    columns: tuple[Array, ...]
    residuals: tuple[Array, ...]

    @property
    def problem(self) -> Problem:
        """The problem solved."""
        return self.place.problem

    @cached_property
    def counts(self) -> Array:
        """(n_outputs,) samples used."""
        n = self.problem.n_outputs
        return np.array([sum(r.counts[i] for r in self.place.regressions) for i in range(n)], float)

    @cached_property
    def rss(self) -> Array:
        """(n_outputs,) residual sums of squares."""
        return np.array([r @ r for r in self.residuals])

    @cached_property
    def variance(self) -> Array:
        """(n_outputs,) residual mean squares, kept above rounding."""
        return self.rss / self.counts + FLOOR * self.problem.power

    @cached_property
    def likelihood(self) -> float:
        """Minus two log likelihood, up to a constant."""
        return float(self.counts @ np.log(self.variance))

    def weighted(self) -> tuple[Array, Array]:
        """Projected derivatives and residuals of all outputs over their noise."""
        w = 1.0 / np.sqrt(self.variance)
        matrix = np.vstack([w[i] * c for i, c in enumerate(self.columns)])
        return matrix, np.concatenate([w[i] * r for i, r in enumerate(self.residuals)])

    def over_time(self, most: int | None = None) -> tuple[Array, ...]:
        """Recorded minus fitted outputs, (n_samples, n_outputs) per experiment; not whitened."""
        here, problem = self.place, self.problem
        response = here.response(self.theta, self.terms)
        found = []
        for e, experiment in enumerate(problem.experiments):
            layout = here.regressions[e].layout
            rows = np.zeros((problem.n_outputs, layout.n_signals))
            for i in range(problem.n_outputs):
                for j in range(layout.n_inputs):
                    rows[i, layout.input_states(j)] = response.rows[i, j]
                    rows[i, layout.direct(j)] = response.direct[i, j]
                if layout.free:
                    rows[i, : layout.order] = response.free[e, i]
                own = layout.nuisance.stop - layout.nuisance.start
                rows[i, layout.nuisance] = self.terms[e, i][self.terms[e, i].size - own :]
            found.append(experiment.y[:most] - response_of(experiment, here.bank, rows, most))
        return tuple(found)


def fit(here: Denominator, theta: Array) -> HeldFit:
    """Residuals and derivatives at given coefficients, whose denominator is that of the place."""
    problem, n = here.problem, here.problem.n_poles
    p = theta.size
    n_experiments = len(here.regressions)
    terms: dict[tuple[int, int], Array] = {}
    bases: dict[tuple[int, int], Array] = {}
    parts: list[list[Array]] = []
    left: list[list[Array]] = []
    at = n
    for i in range(problem.n_outputs):
        width = sum(m + 1 for m in problem.n_zeros[i])
        own: list[Array] = []
        rest: list[Array] = []
        for e in range(n_experiments):
            zeros = problem.n_zeros[i]
            blocks = [here.numerator_columns(e, i, j, m) for j, m in enumerate(zeros)]
            matrix = np.zeros((here.regressions[e].targets[i].size, p))
            matrix[:, at : at + width] = np.hstack(blocks)
            target = (
                here.regressions[e].targets[i] - matrix[:, at : at + width] @ theta[at : at + width]
            )
            nuisance = here.nuisance_columns(e, i)
            solution = solve(nuisance, target)
            terms[e, i], bases[e, i] = solution.x, solution.basis
            own.append(matrix)
            rest.append(target - nuisance @ solution.x)
        parts.append(own)
        left.append(rest)
        at += width
    response = here.response(theta, terms)
    for i in range(problem.n_outputs):
        for e in range(n_experiments):
            parts[i][e][:, : here.inner.order] = -here.filtered(response, e, i)
    raw = tuple(np.vstack(own) for own in parts)
    columns = tuple(
        np.vstack([_off(bases[e, i], one) for e, one in enumerate(own)])
        for i, own in enumerate(parts)
    )
    residuals = tuple(np.concatenate(rest) for rest in left)
    return HeldFit(here, theta, terms, raw, columns, residuals)


def _off(basis: Array, matrix: Array) -> Array:
    return np.asarray(matrix - basis @ (basis.T @ matrix))
