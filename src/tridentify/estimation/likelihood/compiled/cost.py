"""The cost at one denominator in machine code: linear fits, scores and their decomposition.

What `likelihood.cost` derives, on the triangles of all experiments at once and without Python. Any
structure is a few index arrays: which group of channels (denominator) a channel belongs to, the
degree of its numerator, where the poles and states of each group begin. The triangles of output
``i`` in experiment ``e`` are ``stack[which[e, i]]``, with rows of zeros where one is shorter: such
rows change no least-squares problem.

Columns of a triangle: impulse states (where ``first_input`` is one), states of every input, the
inputs themselves, and the constant and the ramp, of which ``nuisance`` names those that are kept.

Unknowns of an output's fit: the numerators, then per experiment the free response and the nuisance
terms.
"""

from __future__ import annotations

import numpy as np

from tridentify.models.compiled_columns import (
    add_combined,
    add_filtered,
    largest,
    leads_to,
    summed,
)
from tridentify.numerics.arrays import Array, Complex, Indices
from tridentify.numerics.compiled import compiled
from tridentify.numerics.kernels.polynomials import numerator_table
from tridentify.numerics.kernels.small_least_squares import contiguous, singular, solve_small

Linear = tuple[Array, Array, Array, Array, Array, Array, Indices, Array, Array, Indices, Array]
"""What `fit_outputs` gives."""


@compiled(
    "void(int64, float64[:,:,::1], int64[:,::1], float64[:,:,::1], int64, boolean, int64[::1],"
    " int64[::1], int64[::1], int64[:,::1], int64[:,::1], int64, float64[:,::1], float64[:,::1],"
    " float64[::1])",
    inner=True,
)
def fill_columns(
    output: int,
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
    basis: Array,
    matrix: Array,
    target: Array,
) -> None:
    """Columns of one output's linear fit, and what they are to meet, into arrays of zeros.

    Arguments are those of `fit_outputs`.
    """
    n_experiments, height, n_inputs = targets.shape[0], targets.shape[2], group.shape[1]
    q = repeats * (firsts[-1] + orders[-1])
    at = 0
    for j in range(n_inputs):
        at += zeros[output, j] + 1
    for e in range(n_experiments):
        s, top = stack[which[e, output]], e * height
        for r in range(height):
            target[top + r] = targets[e, output, r]
        place = 0
        for j in range(n_inputs):
            n, pole = orders[group[output, j]], firsts[group[output, j]]
            own = basis[pole : pole + min(zeros[output, j] + 1, n), :n]
            state = q * (j + first_input) + pole * repeats
            add_combined(s, state, own, 1.0, matrix, top, place)
            if zeros[output, j] == n:
                for r in range(height):
                    matrix[top + r, place + n] = s[r, q * (n_inputs + first_input) + j]
            place += zeros[output, j] + 1
        for g in range(orders.size):
            if free and leads_to(group, output, g):
                for k in range(orders[g]):
                    for r in range(height):
                        matrix[top + r, at] = s[r, firsts[g] * repeats + k]
                    at += 1
        for k in range(nuisance.size):
            for r in range(height):
                matrix[top + r, at] = s[r, nuisance[k]]
            at += 1


@compiled(
    "void(int64, float64[::1], boolean, int64, int64[::1], int64[::1], int64[:,::1],"
    " int64[:,::1], int64, float64[:,::1], float64[:,:,::1], float64[:,::1], float64[:,:,::1])",
    inner=True,
)
def put_in_place(
    output: int,
    x: Array,
    free: bool,
    n_nuisance: int,
    orders: Indices,
    firsts: Indices,
    group: Indices,
    zeros: Indices,
    repeats: int,
    basis: Array,
    rows: Array,
    direct: Array,
    started: Array,
) -> None:
    """The unknowns of one output as its response on the bank, into arrays of zeros."""
    place = 0
    for j in range(group.shape[1]):
        n, pole = orders[group[output, j]], firsts[group[output, j]]
        for d in range(min(zeros[output, j] + 1, n)):
            for k in range(n):
                rows[output, j, pole * repeats + k] += x[place + d] * basis[pole + d, k]
        if zeros[output, j] == n:
            direct[output, j] = x[place + n]
        place += zeros[output, j] + 1
    if free:
        for e in range(started.shape[0]):
            for g in range(orders.size):
                if leads_to(group, output, g):
                    for k in range(orders[g]):
                        started[e, output, firsts[g] * repeats + k] = x[place]
                        place += 1
            place += n_nuisance


@compiled("int64[::1](boolean, int64, int64, int64[::1], int64[:,::1], int64[:,::1])", inner=True)
def unknowns(
    free: bool, n_nuisance: int, n_experiments: int, orders: Indices, group: Indices, zeros: Indices
) -> Indices:
    """(n_outputs,) how many unknowns each output has."""
    sizes = np.zeros(group.shape[0], dtype=np.int64)
    for i in range(group.shape[0]):
        local = n_nuisance
        for g in range(orders.size):
            if free and leads_to(group, i, g):
                local += orders[g]
        sizes[i] = n_experiments * local
        for j in range(group.shape[1]):
            sizes[i] += zeros[i, j] + 1
    return sizes


@compiled(
    "(float64[:,:,::1], int64[:,::1], float64[:,:,::1], int64, boolean, int64[::1], int64[::1],"
    " int64[::1], int64[:,::1], int64[:,::1], int64, float64[:,::1])",
    free=True,
)
def fit_outputs(
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
    basis: Array,
) -> Linear:
    """Fit all that is linear, output by output.

    Parameters
    ----------
    stack : (n_triangles, r, n_columns) array
    which : (n_experiments, n_outputs) int array
        The triangle of each.
    targets : (n_experiments, n_outputs, r) array
    first_input : int
        One where the first states of a triangle are those of an impulse, else zero.
    free : bool
        Whether a free initial state is fitted.
    nuisance : (k,) int array
        Columns of constant and ramp that are kept.
    orders, firsts : (n_groups,) int arrays
        Number of poles of each denominator, and the first of them among all.
    group, zeros : (n_outputs, n_inputs) int arrays
        The denominator of each channel, and the degree of its numerator.
    repeats : int
        How often each pole stands in the bank.
    basis : (n_poles, most) array
        Degree bases (`numerics.kernels.cascades.bank_parts`).

    Returns
    -------
    rows : (n_outputs, n_inputs, q) array
    direct : (n_outputs, n_inputs) array
    started : (n_experiments, n_outputs, q) array
    costs, conditions : (n_outputs,) arrays
    matrices : (n_outputs, n_experiments r, most unknowns) array
    sizes : (n_outputs,) int array
        Unknowns of each output.
    solutions : (n_outputs, most unknowns) array
    bases : as ``matrices``
        Orthonormal columns that span each.
    ranks : (n_outputs,) int array
    residuals : (n_outputs, n_experiments r) array
    """
    n_experiments, n_outputs = which.shape
    n_inputs, tall = group.shape[1], n_experiments * targets.shape[2]
    q = repeats * (firsts[-1] + orders[-1])
    sizes = unknowns(free, nuisance.size, n_experiments, orders, group, zeros)
    most = largest(sizes)
    rows, direct = np.zeros((n_outputs, n_inputs, q)), np.zeros((n_outputs, n_inputs))
    started = np.zeros((n_experiments, n_outputs, q))
    costs, conditions = np.zeros(n_outputs), np.zeros(n_outputs)
    matrices, bases = np.zeros((n_outputs, tall, most)), np.zeros((n_outputs, tall, most))
    solutions, ranks = np.zeros((n_outputs, most)), np.zeros(n_outputs, dtype=np.int64)
    residuals = np.zeros((n_outputs, tall))
    for i in range(n_outputs):
        matrix, target = np.zeros((tall, sizes[i])), np.empty(tall)
        fill_columns(
            i, stack, which, targets, first_input, free, nuisance, orders, firsts, group, zeros,
            repeats, basis, matrix, target,
        )  # fmt: skip
        x, cost, condition, span, residual = solve_small(matrix, target)
        costs[i], conditions[i], ranks[i] = cost, condition, span.shape[1]
        for r in range(tall):
            residuals[i, r] = residual[r]
            for k in range(sizes[i]):
                matrices[i, r, k] = matrix[r, k]
            for k in range(ranks[i]):
                bases[i, r, k] = span[r, k]
        for k in range(sizes[i]):
            solutions[i, k] = x[k]
        put_in_place(
            i, x, free, nuisance.size, orders, firsts, group, zeros, repeats, basis, rows, direct,
            started,
        )  # fmt: skip
    return (
        rows, direct, started, costs, conditions, matrices, sizes, solutions, bases, ranks,
        residuals,
    )  # fmt: skip


@compiled("(float64[:,::1], float64[::1])")
def decomposed(scores: Array, residual: Array) -> tuple[Array, Array, Array, Array, float]:
    """Singular values of scores with columns of length one, and the residual in their terms.

    Parameters
    ----------
    scores : (rows, n) array
    residual : (rows,) array

    Returns
    -------
    s, vt, scale, projection, total
        As of `scores_at`.
    """
    tall, n = scores.shape
    scale = np.zeros(n)
    for r in range(tall):
        for c in range(n):
            scale[c] += scores[r, c] * scores[r, c]
    for c in range(n):
        scale[c] = np.sqrt(scale[c]) if scale[c] > 0.0 else 1.0
    own = np.empty((tall, n))
    total = 0.0
    for r in range(tall):
        total += residual[r] * residual[r]
        for c in range(n):
            own[r, c] = scores[r, c] / scale[c]
    u, s, vt = singular(own)
    projection = np.zeros(s.size)
    for r in range(tall):
        for k in range(s.size):
            projection[k] += u[r, k] * residual[r]
    return s, contiguous(vt), scale, projection, np.sqrt(total)


@compiled(
    "(float64[:,:,::1], int64[:,::1], int64, boolean, int64[::1], int64[::1], int64[:,::1], int64,"
    " float64[:,::1], float64[::1], float64[::1], float64[:,:,::1], float64[:,::1],"
    " float64[:,:,::1], float64[:,:,::1], int64[::1], float64[:,::1], float64[::1], int64)",
    free=True,
)
def scores_at(
    stack: Array,
    which: Indices,
    first_input: int,
    free: bool,
    orders: Indices,
    firsts: Indices,
    group: Indices,
    repeats: int,
    a: Array,
    b: Array,
    maps: Array,
    rows: Array,
    direct: Array,
    started: Array,
    bases: Array,
    ranks: Indices,
    residuals: Array,
    weights: Array,
    n_delays: int,
) -> tuple[Array, Array, Array, Array, Array, Array, float]:
    """Scores projected off the linear columns, and their singular values.

    Parameters
    ----------
    stack, which, first_input, free, orders, firsts, group, repeats
        As of `fit_outputs`.
    a, b, maps : arrays
        The bank and how its filters answer (`numerics.kernels.cascades.bank_parts`).
    rows, direct, started, bases, ranks, residuals
        From `fit_outputs`.
    weights : (n_outputs,) array
        One over the residual standard deviations.
    n_delays : int
        Inputs whose delays have scores, too.

    Returns
    -------
    scores : (rows, n_poles + n_delays) array
        Minus the derivatives of the outputs, weighted.
    residual : (rows,) array
        Weighted.
    s : (k,) array
        Singular values of the scores with columns of length one.
    vt : (k, n_poles + n_delays) array
    scale : (n_poles + n_delays,) array
        Lengths of the scores.
    projection : (k,) array
        The residual on the left singular vectors.
    total : float
        Length of the residual.
    """
    n_experiments, n_outputs = which.shape
    height, n_inputs = stack.shape[1], group.shape[1]
    n_poles, q = firsts[-1] + orders[-1], b.size
    first_direct = q * (n_inputs + first_input)
    n, tall = n_poles + n_delays, n_experiments * height
    scores, residual = np.zeros((n_outputs * tall, n)), np.empty(n_outputs * tall)
    for i in range(n_outputs):
        for e in range(n_experiments):
            s, top = stack[which[e, i]], i * tall + e * height
            add_filtered(
                s, e, i, free, first_input, repeats, orders, firsts, group, n_inputs, b, maps,
                rows, direct, started, scores, top,
            )  # fmt: skip
            for j in range(n_delays):
                slope, jump = np.zeros(q), 0.0
                for k in range(q):
                    weight = rows[i, j, k]
                    if weight != 0.0:
                        jump += weight * b[k]
                        for d in range(q):
                            slope[d] += weight * a[k, d]
                column = q * (j + first_input)
                for r in range(height):
                    value = jump * s[r, first_direct + j]
                    for d in range(q):
                        value += s[r, column + d] * slope[d]
                    scores[top + r, n_poles + j] = value
        basis, top = bases[i], i * tall
        for c in range(n):
            for k in range(ranks[i]):
                share = 0.0
                for r in range(tall):
                    share += basis[r, k] * scores[top + r, c]
                for r in range(tall):
                    scores[top + r, c] -= share * basis[r, k]
            for r in range(tall):
                scores[top + r, c] *= weights[i]
        for r in range(tall):
            residual[top + r] = weights[i] * residuals[i, r]
    s, vt, scale, projection, total = decomposed(scores, residual)
    return scores, residual, s, vt, scale, projection, total


@compiled(
    "(int64, int64, boolean, int64[::1], int64[::1], int64[::1], int64[:,::1], int64[:,::1], int64,"
    " float64[:,::1], float64[:,::1], float64[::1], float64[::1], float64[:,:,::1],"
    " float64[:,::1], float64[:,:,::1], float64[:,::1], int64)",
    free=True,
)
def moves_at(
    n_signals: int, first_input: int, free: bool, nuisance: Indices, orders: Indices,
    firsts: Indices, group: Indices, zeros: Indices, repeats: int, basis: Array, a: Array,
    b: Array, maps: Array, rows: Array, direct: Array, started: Array, solutions: Array,
    n_delays: int,
) -> tuple[Array, Array]:  # fmt: skip
    """How outputs, and their changes with every unknown, are made of the columns of a triangle.

    Parameters
    ----------
    n_signals : int
        Columns of a triangle.
    first_input, free, nuisance, orders, firsts, group, zeros, repeats, basis
        As of `fit_outputs`.
    a, b, maps : arrays
        As of `scores_at`.
    rows, direct, started, solutions
        From `fit_outputs`.
    n_delays : int
        Inputs whose delays are unknowns, too.

    Returns
    -------
    moves : (n_experiments, n_outputs, n_signals, n_unknowns) array
        Unknowns are those of all poles, the delays, then output by output those of its fit.
    made : (n_experiments, n_outputs, n_signals) array
        The outputs that were fitted.
    """
    n_experiments, (n_outputs, n_inputs) = len(started), group.shape
    q, n = b.size, firsts[-1] + orders[-1] + n_delays
    sizes = unknowns(free, nuisance.size, n_experiments, orders, group, zeros)
    moves = np.zeros((n_experiments, n_outputs, n_signals, n + summed(sizes)))
    made = np.zeros((n_experiments, n_outputs, n_signals))
    unit, first_direct = np.eye(n_signals), q * (n_inputs + first_input)
    for e in range(n_experiments):
        first = n
        for i in range(n_outputs):
            out, own = moves[e, i], made[e, i]
            add_filtered(
                unit, e, i, free, first_input, repeats, orders, firsts, group, n_inputs, b, maps,
                rows, direct, started, out, 0,
            )  # fmt: skip
            for j in range(n_delays):
                column = q * (j + first_input)
                for k in range(q):
                    weight = rows[i, j, k]
                    out[first_direct + j, n - n_delays + j] += weight * b[k]
                    for d in range(q):
                        out[column + d, n - n_delays + j] += weight * a[k, d]
            # scores are minus the derivatives
            for r in range(n_signals):
                for c in range(n):
                    out[r, c] = -out[r, c]
            at = first
            for j in range(n_inputs):
                column, m = q * (j + first_input), orders[group[i, j]]
                pole = firsts[group[i, j]]
                for d in range(min(zeros[i, j] + 1, m)):
                    for k in range(m):
                        out[column + pole * repeats + k, at + d] = basis[pole + d, k]
                if zeros[i, j] == m:
                    out[first_direct + j, at + m] = 1.0
                for k in range(q):
                    own[column + k] = rows[i, j, k]
                own[first_direct + j] = direct[i, j]
                at += zeros[i, j] + 1
            at += e * ((first + sizes[i] - at) // n_experiments)
            if free:
                for k in range(q):
                    own[k] = started[e, i, k]
                for g in range(orders.size):
                    if leads_to(group, i, g):
                        for k in range(orders[g]):
                            out[firsts[g] * repeats + k, at] = 1.0
                            at += 1
            for k in range(nuisance.size):
                out[nuisance[k], at] = 1.0
                own[nuisance[k]] = solutions[i, at - first]
                at += 1
            first += sizes[i]
    return moves, made


@compiled("float64(complex128[::1], int64[::1], int64[::1], float64[:,::1])")
def loosest(poles: Complex, orders: Indices, firsts: Indices, root: Array) -> float:
    """The largest standard error of a pole over its own decay rate (`cost.Point.looseness`).

    Parameters
    ----------
    poles : (n_poles,) complex array
    orders, firsts : (n_groups,) int arrays
    root : (n_poles, k) array
        ``root root'`` is the covariance of ``alpha``.
    """
    worst = 0.0
    for g in range(orders.size):
        own = poles[firsts[g] : firsts[g] + orders[g]]
        table = numerator_table(own)
        for k in range(own.size):
            slope, square = 1.0, 0.0
            for other in range(own.size):
                if other != k:
                    slope *= abs(own[k] - own[other])
            if slope == 0.0:
                return np.inf
            for c in range(root.shape[1]):
                moved = 0.0j
                for p in range(own.size):
                    part = 0.0
                    for d in range(own.size):
                        part += table[d, p] * root[firsts[g] + d, c]
                    moved = moved * own[k] + part
                square += moved.real**2 + moved.imag**2
            worst = max(worst, np.sqrt(square) / (slope * -own[k].real))
    return worst
