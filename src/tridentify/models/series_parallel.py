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

*Separate denominators.* Let the channels of denominator ``g`` make the part ``y_g`` of an output,
``y = sum_g y_g``, and let the parallel model say which part is which. The output error of ``a_g =
c_g (1 + alpha_g X_g)`` is ``sum_g (y_M,g - (b_g / a_g) x_g)``, and each term is ``c_g / a_g`` times
its equation error. To first order in ``alpha`` and ``y_M,g - (b_g / c_g) x_g``, which both vanish
at the solution, that factor is one, so

    eps = sum_g [(a_g / c_g) y_M,g - (b_g / c_g) x_g]

is the output error expanded there, and with ``c_g`` held it is linear in all ``a_g`` and ``b_g``:
one convex problem for all channels of an output together. The parts need not be right one by one;
what one of them lacks another's ``b`` makes good. With a single denominator it is the equation
error above.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tridentify.models.regression import Regression
from tridentify.models.response import (
    Branch,
    ColumnBlocks,
    FilteredResponse,
    Response,
    outputs_of,
    spread,
)
from tridentify.numerics.arrays import Array, Complex, Flags
from tridentify.numerics.kept import cached_property
from tridentify.numerics.least_squares import solve
from tridentify.numerics.realization import (
    Cascade,
    DegreeBasis,
    degree_basis,
    denominator,
    filter_map,
    numerators,
    roots_of,
    sort_poles,
)


@dataclass(frozen=True, eq=False)
class SeriesParallelFit:
    """What Step 2 found.

    Attributes
    ----------
    poles : (n,) complex array
        Roots of ``a`` [rad/s], of all denominators one after the other; not necessarily stable.
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


@dataclass(frozen=True, eq=False)
class Filtering:
    """One denominator to be found, and the filter that it is found through.

    Attributes
    ----------
    filter_bank : Cascade
        Cascade of ``c``, degree at least ``n_poles``.
    n_poles : int
        Degree of ``a``.
    bank : Cascade
        Holds the poles that the parallel model uses and those of the filter.
    states : slice
        Where the states of ``bank`` stand in the regression.
    channels : (n_outputs, n_inputs) bool array
        Which channels have this denominator.
    """

    filter_bank: Cascade
    n_poles: int
    bank: Cascade
    states: slice
    channels: Flags

    @classmethod
    def adapted(cls, branch: Branch) -> Filtering:
        """The filter ``c = a_hat`` of a branch."""
        return cls(branch.inner, branch.inner.order, branch.bank, branch.states, branch.channels)

    @cached_property
    def basis(self) -> DegreeBasis:
        """Of the filter's cascade."""
        return degree_basis(self.filter_bank)

    @cached_property
    def map(self) -> Array:
        """How the filter answers to the states of the bank."""
        return filter_map(self.filter_bank, self.bank)


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
    every = np.ones((len(n_zeros), len(n_zeros[0])), dtype=bool)
    whole = Filtering(filter_bank, n_poles, bank, slice(0, bank.order), every)
    return fit_denominators(regressions, response, [whole], n_zeros, weights)


def fit_denominators(
    regressions: Sequence[Regression],
    response: Response,
    filterings: Sequence[Filtering],
    n_zeros: Sequence[Sequence[int]],
    weights: Array,
) -> SeriesParallelFit:
    """Fit all denominators (and ``b``) to noise-free outputs, each through its own filter.

    Parameters
    ----------
    regressions : sequence of Regression
        One per experiment.
    response : Response
        ``y_M``, on the bank of the regressions.
    filterings : sequence of Filtering
        One per denominator; a channel that none of them has is left out.
    n_zeros : (n_outputs, n_inputs) nested sequence of int
        Degrees of ``b``.
    weights : (n_outputs,) array
        Weights of the outputs (one over the noise standard deviation).

    Returns
    -------
    SeriesParallelFit
    """
    columns, matrix, target = equation_error(regressions, response, filterings, n_zeros, weights)
    solution = solve(matrix, target)
    owner = {(i, j): one for one in filterings for i, j in np.argwhere(one.channels).tolist()}
    poles = [
        _roots(one.filter_bank, one.basis, columns.pick(solution.x, ("a", g)), one.n_poles)
        for g, one in enumerate(filterings)
    ]
    b = tuple(
        tuple(
            polynomial(
                owner[i, j].filter_bank, owner[i, j].basis, columns.pick(solution.x, ("b", i, j)), m
            )
            if (i, j) in owner
            else np.zeros(0)
            for j, m in enumerate(row)
        )
        for i, row in enumerate(n_zeros)
    )
    return SeriesParallelFit(np.concatenate(poles), b, solution.cost, solution.condition)


def equation_error(
    regressions: Sequence[Regression],
    response: Response,
    filterings: Sequence[Filtering],
    n_zeros: Sequence[Sequence[int]],
    weights: Array,
) -> tuple[ColumnBlocks, Array, Array]:
    """The linear least-squares problem that `fit_denominators` solves, with its arguments.

    Returns
    -------
    columns : ColumnBlocks
        ``("a", g)`` are the weights of ``a_g / c_g``, ``("b", i, j)`` those of the numerators.
    matrix : (m, n_unknowns) array
    target : (m,) array
    """
    q = regressions[0].layout.order
    columns = ColumnBlocks()
    parts = [_part(one, response, q) for one in filterings]
    for e, regression in enumerate(regressions):
        for i in range(outputs_of(regressions)):
            blocks: dict[object, Array] = {}
            monic = np.zeros(regression.targets[i].size)
            for g, (one, part) in enumerate(zip(filterings, parts, strict=True)):
                if one.channels[i].any():
                    found, leading = _blocks(regression, one, part, n_zeros[i], (g, e, i))
                    blocks |= {key: weights[i] * block for key, block in found.items()}
                    monic = monic + leading
            if blocks:
                columns.add(blocks, -weights[i] * monic)
    return (columns, *columns.assemble())


class _Part(NamedTuple):
    """What the channels of one denominator contribute, the filter driven by it, and by an input."""

    response: Response
    states: FilteredResponse
    input_rows: Array


def _part(one: Filtering, response: Response, order: int) -> _Part:
    own = response.part(one.states, one.channels)
    driven = np.tensordot(one.bank.b, one.map, 1)
    return _Part(
        own.spread(one.states, order),
        own.filtered(one.bank, one.map).spread(one.states, order),
        spread(driven, one.states, order),
    )


def _blocks(
    regression: Regression,
    one: Filtering,
    part: _Part,
    n_zeros: Sequence[int],
    where: tuple[int, int, int],
) -> tuple[dict[object, Array], Array]:
    """Columns of one denominator and its numerators in one output, and ``p^n / c`` of its part."""
    g, e, i = where
    n, basis = one.n_poles, one.basis
    states = part.states.signals(regression, e, i)
    blocks: dict[object, Array] = {("a", g): states @ basis.rows[:n].T}
    for j in np.flatnonzero(one.channels[i]).tolist():
        blocks["b", i, j] = -_numerator(regression, i, j, part.input_rows, basis, n_zeros[j])
    if regression.layout.free:
        rows = basis.rows[:n] @ part.input_rows
        blocks["free", e, i, g] = -regression.impulse_signal(i, rows.T)
    return blocks, _monic(regression, part.response, states, basis, n, e, i)


def polynomial(filter_bank: Cascade, basis: DegreeBasis, beta: Array, degree: int) -> Array:
    """Coefficients of a numerator, descending powers; linear in its weights ``beta``."""
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
