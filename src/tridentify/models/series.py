"""Step 3: the series model, which corrects what ``b / a`` still misses.

    y(t) ~ sum_i beta_i W_i(p) (b(p) / a(p)) x(t),    W_0 = 1

maps the output ``y_0 = (b / a) x`` of the model just found onto the record. It is linear in
``beta`` with noise-free regressors, as in Step 1, but easier: when ``b / a`` is right, ``beta =
(1, 0, ..., 0)``. The corrected output is again a function of continuous time and goes back to
Step 2.

With ``W_i`` the orthonormal functions on the poles of ``a_hat`` the regressors ``W_i y_0`` span
the derivatives of the output error with respect to ``a`` (``dy / da_k = -(p^k / a) y_0``). At a
stationary point of the output-error cost the residual is orthogonal to them and ``beta`` is
``(1, 0, ..., 0)`` exactly: its distance from there is a certificate that needs no further
computation.

Where channels have denominators of their own, every denominator's part of the output has weights
of its own, ``y ~ sum_g sum_i beta_gi W_gi y_0g``, and the ``W_g0 = 1`` stand first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tridentify.models.regression import Regression
from tridentify.models.response import (
    ColumnBlocks,
    FilteredResponse,
    Response,
    nuisance_blocks,
    outputs_of,
)
from tridentify.numerics.arrays import Array, Flags
from tridentify.numerics.least_squares import solve
from tridentify.numerics.realization import Cascade, filter_map


@dataclass(frozen=True, eq=False)
class SeriesFit:
    """What Step 3 found.

    Attributes
    ----------
    response : Response
        The corrected output.
    beta : (n_outputs, 1 + n_operators) array
        ``beta_0`` belongs to ``W_0 = 1``, of every denominator.
    cost : (n_outputs,) array
    condition : float
    heads : int
        How many ``W_0`` there are.
    """

    response: Response
    beta: Array
    cost: Array
    condition: float
    heads: int = 1

    @property
    def distance(self) -> float:
        """Largest deviation of ``beta`` from (1, 0, ..., 0)."""
        target = np.zeros_like(self.beta)
        target[:, : self.heads] = 1.0
        return float(np.abs(self.beta - target).max())


def fit_series(
    regressions: Sequence[Regression],
    bank: Cascade,
    response: Response,
    operator_bank: Cascade,
    operator_rows: Array,
    operator_direct: Array,
    *,
    free_rows: Array | None = None,
    weights: Array | None = None,
    parts: Sequence[Response] | None = None,
    states: FilteredResponse | None = None,
    free_used: Flags | None = None,
) -> SeriesFit:
    """Fit the weights of operators connected in series with a model.

    Parameters
    ----------
    regressions : sequence of Regression
        One per experiment, on ``bank``.
    bank : Cascade
        Holds the poles of the model and of the operators.
    response : Response
        ``y_0``, the model's output, on ``bank``.
    operator_bank : Cascade
        States of the operators (k_s).
    operator_rows : (k, k_s) array
    operator_direct : (k,) array
        ``W_i = operator_rows[i] X_s + operator_direct[i]``, ``i = 1 .. k``; ``W_0 = 1`` is added.
    free_rows : (n, q) array, optional
        Functions for a re-estimated free response (rows on ``bank``).
    weights : (n_outputs,) array, optional
        With weights the outputs share one ``beta``, as they share one ``a``; without, each has
        its own.
    parts : sequence of Response, optional
        What every denominator contributes to ``y_0``, on ``bank`` (default: one contributes all).
    states : FilteredResponse, optional
        The states of ``operator_bank``, each driven by its own part (default: by ``y_0``).
    free_used : (n_outputs, n) bool array, optional
        Which of ``free_rows`` each output has (default: all).

    Returns
    -------
    SeriesFit
    """
    n_outputs = outputs_of(regressions)
    if states is None:
        states = response.filtered(bank, filter_map(operator_bank, bank))
    heads = [response] if parts is None else list(parts)
    count = operator_rows.shape[0]
    beta = np.zeros((n_outputs, count + len(heads)))
    cost = np.zeros(n_outputs)
    condition = 1.0
    free_correction = np.zeros_like(response.free)
    together = weights is not None
    scale = np.ones(n_outputs) if weights is None else weights
    for group in [range(n_outputs)] if together else [[i] for i in range(n_outputs)]:
        columns = ColumnBlocks()
        for i in group:
            for e, regression in enumerate(regressions):
                y_0 = np.column_stack([head.signal(regression, e, i) for head in heads])
                block = states.signals(regression, e, i) @ operator_rows.T
                block += np.outer(y_0.sum(axis=1), operator_direct)
                blocks: dict[object, Array] = {"beta": np.column_stack([y_0, block])}
                if regression.layout.free and free_rows is not None:
                    own = free_rows if free_used is None else free_rows[free_used[i]]
                    blocks["free", e, i] = regression.impulse_signal(i, own.T)
                blocks |= nuisance_blocks(regression, e, i)
                scaled = {key: scale[i] * block for key, block in blocks.items()}
                columns.add(scaled, scale[i] * regression.targets[i])
        matrix, target = columns.assemble()
        solution = solve(matrix, target)
        residual = target - matrix @ solution.x
        at = 0
        condition = max(condition, solution.condition)
        for i in group:
            beta[i] = columns.pick(solution.x, "beta")
            for e, regression in enumerate(regressions):
                rows = regression.targets[i].size
                cost[i] += float(np.sum((residual[at : at + rows] / scale[i]) ** 2))
                at += rows
                if regression.layout.free and free_rows is not None:
                    c_0 = columns.pick(solution.x, ("free", e, i))
                    own = free_rows if free_used is None else free_rows[free_used[i]]
                    free_correction[e, i] = c_0 @ own
    corrected = _corrected(heads, states, beta, operator_rows, operator_direct)
    corrected = Response(corrected.rows, corrected.direct, corrected.free + free_correction)
    return SeriesFit(corrected, beta, cost, condition, len(heads))


def _corrected(
    heads: Sequence[Response],
    states: FilteredResponse,
    beta: Array,
    operators: Array,
    direct: Array,
) -> Response:
    own = beta[:, len(heads) :]
    gains = beta[:, : len(heads)].T + own @ direct
    weights = own @ operators
    rows = np.einsum("ik,ijkq->ijq", weights, states.rows)
    free = np.einsum("ik,eikq->eiq", weights, states.free)
    through = np.zeros_like(heads[0].direct)
    for gain, head in zip(gains, heads, strict=True):
        rows = rows + gain[:, None, None] * head.rows
        through = through + gain[:, None] * head.direct
        free = free + gain[None, :, None] * head.free
    return Response(rows, through, free)
