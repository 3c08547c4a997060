"""White noise through the state-variable filters: its expected share in the normal equations.

In the equation error of `methods.filtered.state_variable_filters` a recorded output enters through
``n + 1`` filters, the columns of ``a`` and the monic one. Write ``Y`` for these columns, ``Z`` for
all others (input, initial state, constants; free of noise), ``Q`` for an orthonormal basis of
``Z``, and ``L_i zeta`` for what column ``i`` of ``Y`` holds of the noise ``zeta``, white at the
samples. Eliminating the unknowns of ``Z`` leaves the matrix ``Y' (1 - Q Q') Y``, in which the noise
has the expected share

    sigma^2 Lambda,    Lambda_ij = tr(L_i' L_j) - tr((L_i' Q)(L_j' Q)'):

this is the square of the noise in equations (6) and (7) of the paper. Both traces are
exact for the record at hand.

*Filters.* The output joined by straight lines drives ``x_{k+1} = F x_k + G0 zeta_k + G1
zeta_{k+1}``, ``x_0 = 0``, and the column is ``w x + d zeta``. Its answer to one sample of noise is

    h_0 = w G1 + d,    h_m = w F^{m-1} (F G1 + G0),  m >= 1.

It fits ``N - 1 - m`` times into ``N`` samples. No line leads up to the first sample, whose answer
is ``h_0 = d``, ``h_m = w F^{m-1} G0``. So ``tr(L_i' L_j) = sum_m (N - 1 - m) h_m^i h_m^j`` and the
first sample's part, transients included.

*What Z takes.* A fit of ``Z`` beside takes the noise along it, a share of about one over the number
of independent samples that the *filtered* noise has: much more than the number of columns over
``N`` when the filter is slow. ``L_i' Q`` is the same recursion run backwards (`filtered.backward`).

References
----------
A. Silvestrov et al., System Research and Information Technologies 2025(2), equations (6)-(9).
T. Soderstrom, Errors-in-Variables Methods in System Identification, Springer 2018, chapter 6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tridentify.errors import UnsupportedOrderError
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.estimation.methods.filtered.filter_cascade import Filter
from tridentify.estimation.methods.filtered.state_variable_filters import (
    Equation,
    backward,
    equation,
    solve_equation,
    unreduced,
)
from tridentify.models.regression import Experiment
from tridentify.numerics.arrays import Array
from tridentify.numerics.discretize import discretize
from tridentify.numerics.least_squares import solve, triangle
from tridentify.numerics.propagate import propagate
from tridentify.numerics.realization import Cascade, degree_basis

FADED = 1e-18
"""Share of its beginning at which an impulse response has ended: below rounding."""
BLOCK = 4096
"""Samples made at once: enough that the loop over blocks does not show, and few numbers too many at
the end."""


@dataclass(frozen=True, eq=False)
class FilterColumns:
    """The filters through which an output enters, on the cascade of ``c``.

    Attributes
    ----------
    c : Cascade
        q states.
    rows : (n + 1, q) array
        ``w``; the last row belongs to the monic column.
    direct : (n + 1,) array
        ``d``.
    """

    c: Cascade
    rows: Array
    direct: Array

    @classmethod
    def of(cls, c: Cascade, n_poles: int) -> FilterColumns:
        """Those of a denominator of degree ``n_poles``, at most q."""
        basis, q = degree_basis(c), c.order
        same = q == n_poles
        monic = np.zeros(q) if same else basis.rows[n_poles] / basis.leading[n_poles]
        direct = np.zeros(n_poles + 1)
        direct[-1] = float(same)
        return cls(c, np.vstack([basis.rows[:n_poles], monic]), direct)

    def answers(self, n_samples: int, dt: float) -> tuple[Array, Array]:
        """Answers ``h`` to one sample of noise, later ones and the first, until they fade.

        Returns
        -------
        later, first : (<= n_samples, n + 1) arrays
            One row a lag.
        """
        step = discretize(self.c.a, self.c.b[:, None], dt, "foh")
        now, after = step.from_current[:, 0], step.from_next[:, 0]
        lead = step.transition @ after + now
        later = _powers(step.transition, lead, n_samples - 2) @ self.rows.T
        first = _powers(step.transition, now, n_samples - 1) @ self.rows.T
        own = self.rows @ after + self.direct
        return np.vstack([own, later]), np.vstack([self.direct, first])

    def gram(self, n_samples: int, dt: float) -> Array:
        """(n + 1, n + 1) array of ``tr(L_i' L_j)``."""
        later, first = self.answers(n_samples, dt)
        counts = np.arange(n_samples - 1.0, n_samples - 1.0 - later.shape[0], -1.0)
        return np.asarray((later.T * counts) @ later + first.T @ first)

    def taken(self, q: Array, dt: float) -> Array:
        """(n + 1, n + 1) array of ``tr((L_i' Q)(L_j' Q)')`` for ``q`` (n_samples, r)."""
        back = [
            (backward(q, row, self.c, dt) + d * q).ravel()
            for row, d in zip(self.rows, self.direct, strict=True)
        ]
        stacked = np.array(back)
        return np.asarray(stacked @ stacked.T)


def _powers(transition: Array, start: Array, most: int) -> Array:
    """``F^m start``, m = 0, 1, ..., until it has faded; at most ``most`` rows."""
    found = [np.zeros((0, start.size))]
    state, size = start[None, :].copy(), FADED**2 * float(start @ start)
    nothing, left = np.zeros(start.size), most
    while left > 0 and float(np.sum(state**2)) > size:
        count = min(BLOCK, left)
        out = np.empty((start.size, count))
        propagate(transition, nothing, nothing, np.zeros((count, 1)), state, out)
        found.append(out.T)
        left -= count
    return np.vstack(found)


@dataclass(frozen=True, eq=False)
class Separated:
    """The equation error with the unknowns of ``Z`` eliminated.

    Attributes
    ----------
    equation : Equation
        All samples, in their order.
    columns : FilterColumns
    outputs, others : (rows, n + 1) and (rows, r) arrays
        ``Y`` and ``Z``, weighted.
    triangle : (n + 1, n + 1) array
        Of ``(1 - Q Q') Y``.
    noise : (n + 1, n + 1) array
        ``Lambda`` for noise of variance one in the weighted outputs.
    whole_noise : (n + 1, n + 1) array
        The same without what ``Z`` takes.
    condition : float
        Of ``Y`` without the monic column and ``Z`` together, columns of unit length.
    """

    equation: Equation
    columns: FilterColumns
    outputs: Array
    others: Array
    triangle: Array
    noise: Array
    whole_noise: Array
    condition: float

    def unknowns(self, alpha: Array) -> Array:
        """All unknowns of the equation, given those of ``a``."""
        found = np.zeros(self.equation.matrix.shape[1])
        own = self.equation.width["a"]
        found[own] = alpha
        rest = np.ones(found.size, dtype=bool)
        rest[own] = False
        left = self.equation.target - self.outputs[:, :-1] @ alpha
        found[rest] = solve(self.others, left).x
        return found


def separate(
    problem: Problem,
    experiments: Sequence[Experiment],
    c: Filter,
    weights: Array,
    variance: Array,
) -> Separated:
    """Eliminate all but the denominator, and expect the noise.

    Parameters
    ----------
    problem : Problem
    experiments : sequence of Experiment
        Those of the problem, `filtered.with_filtered` by ``c``.
    c : Cascade
        Of the filter.
    weights : (n_outputs,) array
    variance : (n_outputs,) array
        Noise variances, up to a common factor.

    Raises
    ------
    UnsupportedOrderError
        If the columns are linearly dependent.
    """
    eq = equation(problem, [unreduced(e, c) for e in experiments], c, c, weights)
    own = eq.width["a"]
    outputs = np.column_stack([eq.matrix[:, own], -eq.target])
    others = np.delete(eq.matrix, np.arange(own.start, own.stop), axis=1)
    condition = solve_equation(eq, problem.n_poles)[2]
    q = solve(others, eq.target).basis
    left = outputs - q @ (q.T @ outputs)
    columns = FilterColumns.of(c, problem.n_poles)
    whole = np.zeros((problem.n_poles + 1,) * 2)
    taken = np.zeros_like(whole)
    for e, experiment in enumerate(experiments):
        gram = columns.gram(experiment.n_samples, experiment.dt)
        for i in range(problem.n_outputs):
            size = weights[i] ** 2 * variance[i]
            rows = q[(eq.owner == (e, i)).all(axis=1)]
            whole += size * gram
            taken += size * columns.taken(rows, experiment.dt)
    return Separated(eq, columns, outputs, others, triangle(left), whole - taken, whole, condition)


def factor(noise: Array) -> Array:
    """Upper triangle ``R`` with ``R' R`` the noise matrix, in balanced units.

    Raises
    ------
    UnsupportedOrderError
        If the matrix is not positive definite: the other columns take all of the noise.
    """
    scale = np.sqrt(np.maximum(np.diag(noise), 1e-300))
    try:
        lower = np.linalg.cholesky(noise / np.outer(scale, scale))
    except np.linalg.LinAlgError as trouble:
        raise UnsupportedOrderError(
            "found a record so short for the filter that noise cannot be told from the other "
            "terms; expected several time constants of the filter; choose a faster filter, record "
            "longer, or leave out nuisance terms"
        ) from trouble
    return np.asarray(lower.T * scale)
