"""Step 1: the parallel model, a weighted sum of fixed operators.

    y_M(t) = sum_i beta_i W_i(p) x(t)                                              (paper, eq. 3)

with operators ``W_i`` chosen beforehand. The model is linear in ``beta`` and its regressors
contain no measurement noise, so

    beta = argmin (1 / M) sum_k (y(k) - sum_i beta_i phi_i(k))^2,    phi_i = W_i x,

is a strictly convex problem with an unbiased solution, and by Pythagoras ``|y - G x|^2 = |y -
y_M|^2 + |y_M - G x|^2`` for every ``G x`` in the span of the regressors: all that the record
says about such a ``G`` is in ``y_M``.

When the regressors are mutually orthogonal (white input and the orthonormal Laguerre functions)
the normal equations are diagonal and each coefficient is one division, ``beta_i = sum phi_i y /
sum phi_i^2``. That formula is offered literally (``one_at_a_time``); it is the least-squares
solution only as far as the orthogonality holds, which the condition number tells.

Unknown offset, drift and initial state are estimated along, as further columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tridentify.models.regression import Regression
from tridentify.models.response import ColumnBlocks, Response, nuisance_blocks, outputs_of
from tridentify.numerics.arrays import Array, Flags
from tridentify.numerics.least_squares import solve


@dataclass(frozen=True, eq=False)
class ParallelFit:
    """What Step 1 found.

    Attributes
    ----------
    response : Response
        ``y_M`` without offset and drift: a function of continuous time.
    beta : (n_outputs, n_inputs, n_operators) array
    cost : (n_outputs,) array
        Residual sums of squares.
    condition : float
        Of the regressors scaled to unit length; the largest over the outputs.
    """

    response: Response
    beta: Array
    cost: Array
    condition: float


def fit_parallel(
    regressions: Sequence[Regression],
    rows: Array,
    direct: Array,
    *,
    free_rows: Array | None = None,
    one_at_a_time: bool = False,
    used: Flags | None = None,
    free_used: Flags | None = None,
) -> ParallelFit:
    """Fit the weights of the operators.

    Parameters
    ----------
    regressions : sequence of Regression
        One per experiment, all on the same bank of q states.
    rows : (n_operators, q) array
        Operators as combinations of the bank's states, the same for every input.
    direct : (n_operators,) array
        Their direct terms.
    free_rows : (k, q) array, optional
        Functions for the free response where the initial state is unknown (default: the first
        states as many as there are operators).
    one_at_a_time : bool
        The one-division-per-coefficient formula instead of least squares. Nuisance terms are
        then removed first.
    used : (n_outputs, n_inputs, n_operators) bool array, optional
        Which operators each channel has (default: all); the weights of the others are zero.
    free_used : (n_outputs, k) bool array, optional
        Which functions the free response of each output has (default: all).

    Returns
    -------
    ParallelFit

    References
    ----------
    .. [1] Silvestrov et al., System Research and Information Technologies 2025(2), eq. (3)-(4).
    """
    n_outputs = outputs_of(regressions)
    layout = regressions[0].layout
    q, n_inputs = layout.order, layout.n_inputs
    if free_rows is None:
        free_rows = np.eye(q)[: rows.shape[0]]
    beta = np.zeros((n_outputs, n_inputs, rows.shape[0]))
    has = np.ones(beta.shape, dtype=bool) if used is None else used
    starts = np.ones((n_outputs, len(free_rows)), dtype=bool) if free_used is None else free_used
    free = np.zeros((len(regressions), n_outputs, q))
    cost = np.zeros(n_outputs)
    condition = 1.0
    for i in range(n_outputs):
        columns = ColumnBlocks()
        for e, regression in enumerate(regressions):
            blocks: dict[object, Array] = {}
            for j in range(n_inputs):
                own = has[i, j]
                block = regression.input_signal(i, j, rows[own].T)
                block += np.outer(regression.signals[i][:, layout.direct(j)], direct[own])
                blocks["beta", j] = block
            if regression.layout.free:
                blocks["free", e] = regression.impulse_signal(i, free_rows[starts[i]].T)
            blocks |= nuisance_blocks(regression, e, i)
            columns.add(blocks, regression.targets[i])
        matrix, target = columns.assemble()
        solution = solve(matrix, target)
        x = solution.x
        if one_at_a_time:
            x = _one_at_a_time(matrix, target, int(has[i].sum()))
            residual = target - matrix @ x
            cost[i] = float(residual @ residual)
        else:
            cost[i] = solution.cost
        condition = max(condition, solution.condition)
        for j in range(n_inputs):
            beta[i, j, has[i, j]] = columns.pick(x, ("beta", j))
        for e, regression in enumerate(regressions):
            if regression.layout.free:
                free[e, i] = columns.pick(x, ("free", e)) @ free_rows[starts[i]]
    response = Response(beta @ rows, beta @ direct, free)
    return ParallelFit(response, beta, cost, condition)


def _one_at_a_time(matrix: Array, target: Array, n_operators: int) -> Array:
    """``beta_i = phi_i' y / phi_i' phi_i``, the nuisance columns projected out first."""
    operators, nuisance = matrix[:, :n_operators], matrix[:, n_operators:]
    if nuisance.shape[1]:
        basis = np.linalg.qr(nuisance)[0]
        operators = operators - basis @ (basis.T @ operators)
        cleaned = target - basis @ (basis.T @ target)
    else:
        cleaned = target
    beta = (operators.T @ cleaned) / np.einsum("ij,ij->j", operators, operators)
    rest = solve(nuisance, target - matrix[:, :n_operators] @ beta).x
    return np.concatenate([beta, rest])
