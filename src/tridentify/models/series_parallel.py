"""Step 2: the series-parallel model, fitted to a noise-free output.

    eps(t) = (a(p) / c(p)) y_M(t) - (b(p) / c(p)) x(t)                              (paper, eq. 5)

is linear in the coefficients of ``a`` and ``b``. Here ``y_M`` is the output of the parallel or
the series model, a known function of continuous time, so ``p^k y_M / c`` is computed exactly
and the equation error carries no noise of its own; fitted to the recorded ``y`` instead, the
square of the noise enters the normal equations and biases ``a`` (paper, eq. 6-9).

With ``c = a_hat`` of the pass before, ``eps = (a / a_hat)(y_M - (b / a) x)``: at a fixed point
the equation error *is* the output error (Steiglitz & McBride 1965; for a high-order noise-free
output, MORSM: Everitt, Galrinho & Hjalmarsson 2018; weighted null-space fitting: Galrinho,
Rojas & Hjalmarsson 2019).

Unknowns are not the monomial coefficients. On the orthonormal cascade of ``c`` the numerators
of degree at most ``d`` are spanned by orthonormal rows (`numerics.realization.degree_basis`),
so ``a / c = monic + sum_k alpha_k K_k`` and ``b / c = sum_k beta_k K_k`` with regressors of
comparable size whatever the spread of the poles.

A free initial state enters as ``- (c_0(p) / c(p)) delta`` with its own numerator of degree ``n
- 1``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tridentify.models.response import Columns, Response, outputs_of
from tridentify.numerics.least_squares import solve
from tridentify.numerics.realization import (
    Cascade,
    Complex,
    DegreeBasis,
    degree_basis,
    denominator,
    filter_map,
    numerators,
    roots_of,
    sort_poles,
)
from tridentify.regression import Regression

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SeriesParallelFit:
    """What Step 2 found.

    Attributes
    ----------
    poles : (n,) complex array
        Roots of ``a`` [rad/s]; not necessarily stable.
    b : nested tuple of arrays
        ``b[output][input]``: coefficients of the numerators, descending powers.
    cost : float
        Sum of squares of the (weighted) equation error.
    condition : float
        Of the regressors scaled to unit length.
    """

    poles: Complex
    b: tuple[tuple[Array, ...], ...]
    cost: float
    condition: float


def fit_series_parallel(
    regressions: Sequence[Regression],
    bank: Cascade,
    response: Response,
    filter_bank: Cascade,
    n_poles: int,
    n_zeros: Sequence[Sequence[int]],
    weights: Array,
) -> SeriesParallelFit:
    """Fit ``a`` (and ``b``) to a noise-free output through the filter ``1 / c``.

    Parameters
    ----------
    regressions : sequence of Regression
        One per experiment, on ``bank``.
    bank : Cascade
        Holds the poles that ``response`` uses and those of the filter.
    response : Response
        ``y_M``, on ``bank``.
    filter_bank : Cascade
        Cascade of ``c``, degree at least ``n_poles``.
    n_poles : int
        Degree of ``a``.
    n_zeros : (n_outputs, n_inputs) nested sequence of int
        Degrees of ``b``.
    weights : (n_outputs,) array
        Weights of the outputs (one over the noise standard deviation).

    Returns
    -------
    SeriesParallelFit

    References
    ----------
    .. [1] Silvestrov et al., System Research and Information Technologies 2025(2), eq. (5).
    """
    basis = degree_basis(filter_bank)
    map_ = filter_map(filter_bank, bank)
    output_states = response.filtered(bank, map_)
    input_rows = np.tensordot(bank.b, map_, 1)
    columns = Columns()
    for e, regression in enumerate(regressions):
        for i in range(outputs_of(regressions)):
            w = weights[i]
            states = output_states.signals(regression, e, i)
            monic = _monic(regression, response, states, basis, n_poles, e, i)
            blocks: dict[object, Array] = {"a": w * (states @ basis.rows[:n_poles].T)}
            for j, m in enumerate(n_zeros[i]):
                blocks["b", i, j] = -w * _numerator(regression, i, j, input_rows, basis, m)
            if regression.layout.free:
                rows = basis.rows[:n_poles] @ input_rows
                blocks["free", e, i] = -w * regression.impulse_signal(i, rows.T)
            columns.add(blocks, -w * monic)
    matrix, target = columns.assemble()
    solution = solve(matrix, target)
    alpha = columns.pick(solution.x, "a")
    poles = _roots(filter_bank, basis, alpha, n_poles)
    b = tuple(
        tuple(
            _polynomial(filter_bank, basis, columns.pick(solution.x, ("b", i, j)), m)
            for j, m in enumerate(row)
        )
        for i, row in enumerate(n_zeros)
    )
    return SeriesParallelFit(poles, b, solution.cost, solution.condition)


def _polynomial(filter_bank: Cascade, basis: DegreeBasis, beta: Array, degree: int) -> Array:
    """Coefficients of a numerator, descending powers."""
    q = filter_bank.order
    count = min(degree + 1, q)
    proper = (beta[:count] @ basis.rows[:count]) @ numerators(filter_bank.poles)
    if degree < q:
        return np.asarray(proper[q - degree - 1 :])
    return np.asarray(np.append(0.0, proper) + beta[q] * denominator(filter_bank.poles))


def _monic(
    regression: Regression,
    response: Response,
    states: Array,
    basis: DegreeBasis,
    n_poles: int,
    experiment: int,
    output: int,
) -> Array:
    """``p^n / c`` applied to ``y_M``, up to lower powers."""
    if basis.leading.size == n_poles:
        return response.signal(regression, experiment, output)
    return np.asarray(states @ (basis.rows[n_poles] / basis.leading[n_poles]))


def _numerator(
    regression: Regression, i: int, j: int, input_rows: Array, basis: DegreeBasis, degree: int
) -> Array:
    """Columns spanning ``b / c`` applied to input ``j``."""
    count = min(degree + 1, basis.leading.size)
    block = regression.input_signal(i, j, (basis.rows[:count] @ input_rows).T)
    if degree == basis.leading.size:
        block = np.column_stack([block, regression.signals[i][:, regression.layout.direct(j)]])
    return block


def _roots(filter_bank: Cascade, basis: DegreeBasis, alpha: Array, n_poles: int) -> Complex:
    row = alpha @ basis.rows[:n_poles]
    if filter_bank.order == n_poles:
        return roots_of(filter_bank, row)
    row = row + basis.rows[n_poles] / basis.leading[n_poles]
    coefficients = (row @ numerators(filter_bank.poles))[-(n_poles + 1) :]
    return sort_poles(np.roots(coefficients).astype(np.complex128))
