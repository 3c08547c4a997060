"""Steps 1 and 2 on adapted operators in machine code.

`models.parallel` and `models.series_parallel` derive the two; here they follow one another on the
triangles of one bank, whose operators have the poles of ``a_hat`` twice and whose filter is ``1 /
a_hat`` (`estimation.search.passes`). The bank begins with the states of the filter, so that
``p^k x / a_hat`` is a combination of its first states, and ``p^n / a_hat`` of the output is the
output itself up to lower powers.

Arguments are those of `estimation.likelihood.compiled.cost`.
"""

from __future__ import annotations

import numpy as np

from tridentify.models.compiled_columns import (
    add_combined,
    add_filtered,
    coefficients,
    leads_to,
)
from tridentify.numerics.arrays import Array, Complex, Indices
from tridentify.numerics.compiled import compiled
from tridentify.numerics.kernels.polynomials import expanded, numerator_table
from tridentify.numerics.kernels.small_least_squares import solve_small


@compiled(
    "(float64[:,:,::1], int64[:,::1], float64[:,:,::1], int64, int64, boolean, int64[::1],"
    " int64[::1], int64[::1], int64[:,::1], int64, boolean)",
    inner=True,
)
def parallel_columns(
    stack: Array,
    which: Indices,
    targets: Array,
    i: int,
    first_input: int,
    free: bool,
    nuisance: Indices,
    widths: Indices,
    tops: Indices,
    group: Indices,
    q: int,
    biproper: bool,
) -> tuple[Array, Array, int, int]:
    """Columns and target of an output; how many unknowns all experiments share, and each has."""
    n_experiments, height = which.shape[0], targets.shape[2]
    n_inputs, n_groups = group.shape[1], widths.size
    first_direct, extra = q * (n_inputs + first_input), 1 if biproper else 0
    shared, local = 0, nuisance.size
    for j in range(n_inputs):
        shared += widths[group[i, j]] + extra
    for g in range(n_groups):
        if free and leads_to(group, i, g):
            local += widths[g]
    matrix = np.zeros((n_experiments * height, shared + n_experiments * local))
    target = np.empty(n_experiments * height)
    for e in range(n_experiments):
        s, top, at = stack[which[e, i]], e * height, shared + e * local
        place = 0
        for r in range(height):
            target[top + r] = targets[e, i, r]
        for j in range(n_inputs):
            g = group[i, j]
            column, width = q * (j + first_input) + tops[g], widths[g]
            for r in range(height):
                for k in range(width):
                    matrix[top + r, place + k] = s[r, column + k]
                if biproper:
                    matrix[top + r, place + width] = s[r, first_direct + j]
            place += width + extra
        for g in range(n_groups):
            if free and leads_to(group, i, g):
                for k in range(widths[g]):
                    for r in range(height):
                        matrix[top + r, at] = s[r, tops[g] + k]
                    at += 1
        for k in range(nuisance.size):
            for r in range(height):
                matrix[top + r, at + k] = s[r, nuisance[k]]
    return matrix, target, shared, local


@compiled(
    "(float64[:,:,::1], int64[:,::1], float64[:,:,::1], int64, boolean, int64[::1], int64[::1],"
    " int64[::1], int64[:,::1], int64, boolean)",
    inner=True,
)
def parallel_fit(
    stack: Array,
    which: Indices,
    targets: Array,
    first_input: int,
    free: bool,
    nuisance: Indices,
    widths: Indices,
    tops: Indices,
    group: Indices,
    q: int,
    biproper: bool,
) -> tuple[Array, Array, Array, Array, Array, float]:
    """Step 1: every channel on the operators of its denominator, or all on the same ones.

    ``widths``, ``tops`` (n_groups,): of the operators of each, how many there are and the first of
    the bank's states that they are.

    Returns
    -------
    beta : (n_outputs, n_inputs, n_operators) array
    rows, direct, started : arrays
        The output on the bank.
    costs : (n_outputs,) array
    condition : float
    """
    n_experiments, n_outputs = which.shape
    n_inputs, n_groups, extra = group.shape[1], widths.size, 1 if biproper else 0
    places, wide = np.zeros(n_groups, np.int64), 0
    for g in range(n_groups):
        places[g] = wide
        wide += widths[g]
    beta = np.zeros((n_outputs, n_inputs, wide + extra))
    rows, direct = np.zeros((n_outputs, n_inputs, q)), np.zeros((n_outputs, n_inputs))
    started = np.zeros((n_experiments, n_outputs, q))
    costs, condition = np.zeros(n_outputs), 1.0
    for i in range(n_outputs):
        matrix, target, shared, local = parallel_columns(
            stack, which, targets, i, first_input, free, nuisance, widths, tops, group, q, biproper
        )
        x, cost, own, _, _ = solve_small(matrix, target)
        costs[i], condition = cost, max(condition, own)
        place = 0
        for j in range(n_inputs):
            g = group[i, j]
            for k in range(widths[g]):
                beta[i, j, places[g] + k] = x[place + k]
                rows[i, j, tops[g] + k] = x[place + k]
            place += widths[g]
            if biproper:
                beta[i, j, -1], direct[i, j] = x[place], x[place]
                place += 1
        for e in range(n_experiments):
            at = shared + e * local
            for g in range(n_groups):
                if free and leads_to(group, i, g):
                    for k in range(widths[g]):
                        started[e, i, tops[g] + k] = x[at]
                        at += 1
    return beta, rows, direct, started, costs, condition


@compiled(
    "float64[::1](float64[::1], int64[::1], int64[::1], int64[:,::1], int64[:,::1],"
    " complex128[::1], float64[:,::1], int64)",
    inner=True,
)
def expanded_numerators(
    x: Array,
    orders: Indices,
    firsts: Indices,
    group: Indices,
    zeros: Indices,
    poles: Complex,
    basis: Array,
    count: int,
) -> Array:
    """(count,) coefficients of all ``b``, descending powers, from the unknowns of Step 2."""
    found, place, n_poles = np.zeros(count), 0, firsts[-1] + orders[-1]
    for i in range(group.shape[0]):
        for j in range(group.shape[1]):
            n, pole, m = orders[group[i, j]], firsts[group[i, j]], zeros[i, j]
            table, whole = numerator_table(poles[pole : pole + n]), expanded(poles[pole : pole + n])
            full = np.zeros(n + 1)
            for c in range(min(m + 1, n)):
                for d in range(n):
                    share = x[n_poles + place + c] * basis[pole + c, d]
                    for k in range(n):
                        full[k + 1] += share * table[d, k]
            for k in range(m + 1):
                found[place + k] = full[n - m + k]
                if m == n:
                    found[place + k] += x[n_poles + place + n] * whole[k]
            place += m + 1
    return found


@compiled(
    "void(float64[:,::1], int64, boolean, float64[:,::1], float64[::1], float64[::1], float64,"
    " float64[::1], int64)",
    inner=True,
    linked=True,
)
def put_output(
    s: Array,
    first_input: int,
    free: bool,
    rows: Array,
    direct: Array,
    started: Array,
    sign: float,
    target: Array,
    top: int,
) -> None:
    """An output of Step 1 on a triangle, times a number, in its place of the target."""
    n_inputs, q = rows.shape
    first_direct = q * (n_inputs + first_input)
    for r in range(s.shape[0]):
        value = 0.0
        for j in range(n_inputs):
            value += direct[j] * s[r, first_direct + j]
            for k in range(q):
                value += rows[j, k] * s[r, q * (j + first_input) + k]
        if free:
            for k in range(q):
                value += started[k] * s[r, k]
        target[top + r] = sign * value


@compiled(
    "(float64[:,:,::1], int64[:,::1], int64, int64, boolean, int64[::1], int64[::1],"
    " int64[:,::1], int64[:,::1], int64, float64[::1], float64[:,::1], float64[::1],"
    " float64[::1], float64[:,:,::1], float64[:,::1], float64[:,:,::1])",
    inner=True,
)
def series_parallel_columns(
    stack: Array,
    which: Indices,
    height: int,
    first_input: int,
    free: bool,
    orders: Indices,
    firsts: Indices,
    group: Indices,
    zeros: Indices,
    repeats: int,
    b: Array,
    basis: Array,
    maps: Array,
    weights: Array,
    rows: Array,
    direct: Array,
    started: Array,
) -> tuple[Array, Array]:
    """Columns and target of Step 2: of ``a``, of every ``b``, and of every free response."""
    n_experiments, n_outputs = which.shape
    n_inputs, n_groups, q = group.shape[1], orders.size, b.size
    n_poles, first_direct = firsts[-1] + orders[-1], q * (n_inputs + first_input)
    n_b, n_free = 0, 0
    for i in range(n_outputs):
        for j in range(n_inputs):
            n_b += zeros[i, j] + 1
        for g in range(n_groups):
            if free and leads_to(group, i, g):
                n_free += orders[g]
    tall = n_experiments * n_outputs * height
    matrix = np.zeros((tall, n_poles + n_b + n_experiments * n_free))
    target, states = np.zeros(tall), np.zeros((height, n_poles))
    at = n_poles + n_b
    for e in range(n_experiments):
        place = n_poles
        for i in range(n_outputs):
            s, top = stack[which[e, i]], (e * n_outputs + i) * height
            for r in range(height):
                for c in range(n_poles):
                    states[r, c] = 0.0
            add_filtered(
                s, e, i, free, first_input, repeats, orders, firsts, group, n_inputs, b, maps,
                rows, direct, started, states, 0,
            )  # fmt: skip
            for g in range(n_groups):
                n, pole = orders[g], firsts[g]
                for c in range(n):
                    for r in range(height):
                        value = 0.0
                        for d in range(n):
                            value += states[r, pole + d] * basis[pole + c, d]
                        matrix[top + r, pole + c] = weights[i] * value
                if free and leads_to(group, i, g):
                    own = basis[pole : pole + n, :n]
                    add_combined(s, pole * repeats, own, -weights[i], matrix, top, at)
                    at += n
            for j in range(n_inputs):
                n, pole = orders[group[i, j]], firsts[group[i, j]]
                column, count = q * (j + first_input) + pole * repeats, min(zeros[i, j] + 1, n)
                own = basis[pole : pole + count, :n]
                add_combined(s, column, own, -weights[i], matrix, top, place)
                if zeros[i, j] == n:
                    for r in range(height):
                        matrix[top + r, place + n] = -weights[i] * s[r, first_direct + j]
                place += zeros[i, j] + 1
            put_output(
                s, first_input, free, rows[i], direct[i], started[e, i], -weights[i], target, top
            )
    return matrix, target


@compiled(
    "(float64[:,:,::1], int64[:,::1], float64[:,:,::1], int64, boolean, int64[::1], int64[::1],"
    " int64[::1], int64[:,::1], int64[:,::1], int64, complex128[::1], float64[::1],"
    " float64[:,::1], float64[::1], float64[::1], boolean)",
    free=True,
)
def adapted_steps(
    stack: Array,
    which: Indices,
    targets: Array,
    first_input: int,
    free: bool,
    nuisance: Indices,
    orders: Indices,
    firsts: Indices,
    group: Indices,
    zeros: Indices,
    repeats: int,
    poles: Complex,
    b: Array,
    basis: Array,
    maps: Array,
    weights: Array,
    biproper: bool,
) -> tuple[Array, Array, float, Array, Array, float, float]:
    """Step 1 on the poles twice each, and Step 2 through the filter that has them once.

    Returns
    -------
    beta, costs, condition
        Of Step 1 (`parallel_fit`).
    row : (n_poles,) array
        Of each denominator, the new one being ``a_hat (1 + row X)``.
    numerators : (n_coefficients of all b,) array
        Descending powers, channel by channel.
    cost, condition : float
        Of Step 2.
    """
    n_groups, n_poles, n_b = orders.size, firsts[-1] + orders[-1], coefficients(zeros)
    beta, rows, direct, started, costs, condition = parallel_fit(
        stack, which, targets, first_input, free, nuisance, 2 * orders, firsts * repeats, group,
        b.size, biproper,
    )  # fmt: skip
    matrix, target = series_parallel_columns(
        stack, which, targets.shape[2], first_input, free, orders, firsts, group, zeros, repeats,
        b, basis, maps, weights, rows, direct, started,
    )  # fmt: skip
    x, cost, own_condition, _, _ = solve_small(matrix, target)
    row = np.zeros(n_poles)
    for g in range(n_groups):
        for c in range(orders[g]):
            for d in range(orders[g]):
                row[firsts[g] + d] += x[firsts[g] + c] * basis[firsts[g] + c, d]
    numerators = expanded_numerators(x, orders, firsts, group, zeros, poles, basis, n_b)
    return beta, costs, condition, row, numerators, cost, own_condition


@compiled(
    "float64[::1](complex128[::1], float64[:,:,::1], float64[:,::1], int64[::1], int64[::1],"
    " int64[:,::1], int64[:,::1], int64)"
)
def coefficients_of(
    poles: Complex,
    rows: Array,
    direct: Array,
    orders: Indices,
    firsts: Indices,
    group: Indices,
    zeros: Indices,
    repeats: int,
) -> Array:
    """Coefficients of all denominators and numerators, in the order of `Structure.names`.

    Parameters
    ----------
    poles : (n_poles,) complex array
    rows, direct : (n_outputs, n_inputs, q), (n_outputs, n_inputs) arrays
        Outputs on the first states of every denominator's part of the bank.
    """
    place, size = 0, firsts[-1] + orders[-1] + coefficients(zeros)
    found, told = np.zeros(size), np.zeros(orders.size, dtype=np.int64)
    for i in range(group.shape[0]):
        for j in range(group.shape[1]):
            g = group[i, j]
            n, pole, m = orders[g], firsts[g], zeros[i, j]
            own = poles[pole : pole + n]
            whole, table = expanded(own), numerator_table(own)
            if not told[g]:
                told[g] = 1
                for k in range(n):
                    found[place + k] = whole[k + 1]
                place += n
            for k in range(n - m, n + 1):
                value = direct[i, j] * whole[k]
                if k > 0:
                    for d in range(n):
                        value += rows[i, j, pole * repeats + d] * table[d, k - 1]
                found[place] = value
                place += 1
    return found
