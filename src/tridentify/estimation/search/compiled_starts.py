"""Many banks at once in machine code: orders of parallel models, and costs at many places.

*Orders.* Functions are nested, so that the residuals of all orders follow from one triangle: its
columns are those that every order has (nuisance terms, inputs), then the first function of every
channel, the second of every channel, and so on.

*Places.* The output-error cost at several denominators, and nothing but the cost.

Columns of the triangles are those of `compiled_cost`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tridentify.estimation.likelihood.compiled.cost import fill_columns, unknowns
from tridentify.estimation.likelihood.compiled.fit import CHARTS, SHAPE, triangles_there
from tridentify.numerics.arrays import Array, Complex, Flags, Indices
from tridentify.numerics.compiled import compiled
from tridentify.numerics.kernels.cascades import fill_basis, fill_cascade
from tridentify.numerics.kernels.triangles import triangularise


@compiled(f"({CHARTS}, {SHAPE}, float64[:,:,::1], float64[:,::1])", free=True)
def triangles_on(charts: Any, shape: Any, a: Array, b: Array) -> tuple[Array, Array]:
    """The triangles of all experiments on several banks, and the targets.

    Parameters
    ----------
    charts, shape : tuples
        As of `compiled_fit`.
    a, b : (n_banks, q, q), (n_banks, q) arrays

    Returns
    -------
    stack : (n_banks, n_triangles, r, n_columns) array
    targets : (n_banks, n_experiments, n_outputs, r) array
    """
    some, own = triangles_there(charts, shape, a[0], b[0])
    stack, targets = np.empty((len(b), *some.shape)), np.empty((len(b), *own.shape))
    for k in range(len(b)):
        if k > 0:
            some, own = triangles_there(charts, shape, a[k], b[k])
        for t in range(some.shape[1]):
            for e in range(some.shape[0]):
                for c in range(some.shape[2]):
                    stack[k, e, t, c] = some[e, t, c]
            for e in range(own.shape[0]):
                for i in range(own.shape[1]):
                    targets[k, e, i, t] = own[e, i, t]
    return stack, targets


@compiled(
    "(float64[:,:,:,::1], int64[:,::1], float64[:,:,:,::1], boolean[::1], int64[:,::1], boolean,"
    " int64, int64, int64, int64, int64, float64[::1], float64[::1], float64[:,::1])",
    free=True,
)
def orders_of(
    stack: Array, which: Indices, targets: Array, free: Flags, nuisance: Indices, biproper: bool,
    n_inputs: int, order: int, most: int, fewest: int, first_input: int, counts: Array,
    floors: Array, prices: Array,
) -> tuple[Indices, Array]:  # fmt: skip
    """Number of functions of lowest AICc, and that AICc.

    Parameters
    ----------
    stack : (n_banks, n_triangles, r, n_columns) array
    which : (n_experiments, n_outputs) int array
        The triangle of each.
    targets : (n_banks, n_experiments, n_outputs, r) array
    free : (n_variants,) bool array
        Whether each choice of nuisance terms has a free initial state.
    nuisance : (n_variants, 2) int array
        Columns of constant and ramp that each keeps, and -1 for none, behind them.
    biproper : bool
    n_inputs, order : int
        Inputs, and states of a bank.
    most, fewest : int
        Numbers of functions.
    first_input : int
        One where the first states of a triangle are those of an impulse, else zero.
    counts, floors : (n_outputs,) arrays
        Samples, and what is added to a mean square.
    prices : (n_variants, most) array
        Of the unknowns.

    Returns
    -------
    orders : (n_banks, n_variants) int array
    criteria : (n_banks, n_variants) array
    """
    n_banks, n_variants = stack.shape[0], free.size
    n_experiments, n_outputs, height = targets.shape[1], targets.shape[2], targets.shape[3]
    orders, criteria = np.zeros((n_banks, n_variants), np.int64), np.zeros((n_banks, n_variants))
    total = np.empty(most)
    for v in range(n_variants):
        own = 0
        for c in range(nuisance.shape[1]):
            own += nuisance[v, c] >= 0
        fixed = own * n_experiments + (n_inputs if biproper else 0)
        step = n_inputs + (n_experiments if free[v] else 0)
        width = fixed + step * most + 1
        r = np.empty((width, width))
        for k in range(n_banks):
            for d in range(most):
                total[d] = prices[v, d]
            for i in range(n_outputs):
                columns = np.zeros((width, n_experiments * height))
                for e in range(n_experiments):
                    s = stack[k, which[e, i]]
                    for t in range(height):
                        top = e * height + t
                        columns[-1, top] = targets[k, e, i, t]
                        for c in range(own):
                            columns[own * e + c, top] = s[t, nuisance[v, c]]
                        for j in range(n_inputs):
                            if biproper:
                                direct = order * (n_inputs + first_input) + j
                                columns[own * n_experiments + j, top] = s[t, direct]
                            for d in range(most):
                                place = fixed + d * step + j
                                columns[place, top] = s[t, order * (j + first_input) + d]
                        if free[v]:
                            for d in range(most):
                                columns[fixed + d * step + n_inputs + e, top] = s[t, d]
                triangularise(columns, n_experiments * height, 0, 0, r)
                rss, last = 0.0, width
                for d in range(most - 1, -1, -1):
                    first = fixed + step * (d + 1)
                    for t in range(first, last):
                        rss += r[t, -1] * r[t, -1]
                    last = first
                    total[d] += counts[i] * np.log(rss / counts[i] + floors[i])
            best = fewest - 1
            for d in range(fewest, most):
                if total[d] < total[best]:
                    best = d
            orders[k, v], criteria[k, v] = best + 1, total[best]
    return orders, criteria


@compiled("(complex128[:,::1], int64[::1], int64)", free=True)
def banks_at(poles: Complex, orders: Indices, most: int) -> tuple[Array, Array, Array]:
    """The banks of several denominators, each pole once.

    Parameters
    ----------
    poles : (n_banks, n_poles) complex array
        Of every bank group by group, pairs side by side.
    orders : (n_groups,) int array
    most : int
        The largest order.

    Returns
    -------
    a, b : (n_banks, n_poles, n_poles), (n_banks, n_poles) arrays
    bases : (n_banks, n_poles, most) array
        Degree bases (`numerics.kernels.cascades.bank_parts`).
    """
    count, q = poles.shape
    a, b = np.zeros((count, q, q)), np.zeros((count, q))
    bases, leading = np.zeros((count, q, most)), np.zeros(q)
    for k in range(count):
        at = 0
        for g in range(orders.size):
            end = at + orders[g]
            block, drive = a[k, at:end, at:end], b[k, at:end]
            fill_cascade(poles[k, at:end], 1, block, drive)
            fill_basis(block, drive, bases[k, at:end, : orders[g]], leading[at:end])
            at = end
    return a, b, bases


@compiled(
    "float64[::1](float64[:,:,:,::1], int64[:,::1], float64[:,:,:,::1], int64, boolean, int64[::1],"
    " int64[::1], int64[::1], int64[:,::1], int64[:,::1], float64[:,:,::1], float64[::1],"
    " float64[::1])",
    free=True,
)
def costs_at(
    stack: Array, which: Indices, targets: Array, first_input: int, free: bool, nuisance: Indices,
    orders: Indices, firsts: Indices, group: Indices, zeros: Indices, bases: Array, counts: Array,
    floors: Array,
) -> Array:  # fmt: skip
    """Minus two log likelihood on every bank, as of `likelihood.cost`.

    Parameters
    ----------
    stack : (n_banks, n_triangles, r, n_columns) array
    targets : (n_banks, n_experiments, n_outputs, r) array
    bases : (n_banks, n_poles, most) array
    counts, floors : (n_outputs,) arrays
        Samples, and what is added to a mean square.
    which, first_input, free, nuisance, orders, firsts, group, zeros
        As of `compiled_cost.fit_outputs`.
    """
    n_experiments, n_outputs = which.shape
    tall = n_experiments * targets.shape[3]
    sizes = unknowns(free, nuisance.size, n_experiments, orders, group, zeros)
    found = np.zeros(stack.shape[0])
    for k in range(stack.shape[0]):
        for i in range(n_outputs):
            m = sizes[i]
            matrix, target = np.zeros((tall, m)), np.zeros(tall)
            fill_columns(
                i, stack[k], which, targets[k], first_input, free, nuisance, orders, firsts, group,
                zeros, 1, bases[k], matrix, target,
            )  # fmt: skip
            columns, r = np.empty((m + 1, tall)), np.empty((m + 1, m + 1))
            for t in range(tall):
                for c in range(m):
                    columns[c, t] = matrix[t, c]
                columns[m, t] = target[t]
            triangularise(columns, tall, 0, 0, r)
            rss = r[m, m] * r[m, m]
            found[k] += counts[i] * np.log(rss / counts[i] + floors[i])
    return found
