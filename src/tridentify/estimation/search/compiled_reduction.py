"""From a parallel model on fixed operators to poles in machine code, both ways of `search.starts`.

Step 1, then Step 2 through a filter of its own for each denominator (`models.series_parallel`
derives it), and balanced truncation. The filters' poles are among the bank's, not its first ones,
so the filter's answer to what drives it is solved for on the whole bank.

Arguments are those of `estimation.likelihood.compiled.cost`.
"""

from __future__ import annotations

import numpy as np

from tridentify.models.compiled_columns import add_combined, coefficients, largest, leads_to, summed
from tridentify.models.compiled_steps import parallel_fit
from tridentify.numerics.arrays import Array, Complex, Indices
from tridentify.numerics.compiled import compiled
from tridentify.numerics.kernels.cascades import (
    fill_basis,
    fill_cascade,
    fill_map,
    solve_in_place,
)
from tridentify.numerics.kernels.polynomials import numerator_table
from tridentify.numerics.kernels.small_eigenvalues import eigenvalues
from tridentify.numerics.kernels.small_least_squares import contiguous, solve_small


@compiled("float64[:,::1](float64[:,::1], float64[:,::1])")
def observability(a: Array, square: Array) -> Array:
    """Gramian ``Q`` of ``A' Q + Q A + S = 0``, ``A`` lower triangular but for pairs.

    Block by block from the last, each after those that ``A`` couples it to (Bartels & Stewart
    1972).
    """
    k, count, m = len(a), 0, 0
    firsts, widths, q = np.zeros(k, np.int64), np.zeros(k, np.int64), np.zeros((k, k))
    while m < k:
        firsts[count], widths[count] = m, 2 if m + 1 < k and a[m, m + 1] != 0.0 else 1
        m += widths[count]
        count += 1
    for v in range(count - 1, -1, -1):
        i, rows = firsts[v], widths[v]
        for w in range(count - 1, -1, -1):
            j, columns = firsts[w], widths[w]
            size = rows * columns
            matrix, side = np.zeros((size, size)), np.zeros((size, 1))
            for r in range(rows):
                for c in range(columns):
                    at, total = r * columns + c, -square[i + r, j + c]
                    for d in range(i + rows, k):
                        total -= a[d, i + r] * q[d, j + c]
                    for d in range(j + columns, k):
                        total -= q[i + r, d] * a[d, j + c]
                    side[at, 0] = total
                    for d in range(rows):
                        matrix[at, d * columns + c] += a[i + d, i + r]
                    for d in range(columns):
                        matrix[at, r * columns + d] += a[j + d, j + c]
            solve_in_place(matrix, side)
            for r in range(rows):
                for c in range(columns):
                    q[i + r, j + c] = side[r * columns + c, 0]
    return q


@compiled("complex128[::1](float64[:,:], float64[:,:], int64)", inner=True)
def truncated(a: Array, rows: Array, n: int) -> Complex:
    """Balanced truncation to ``n`` poles of ``rows X``; the other Gramian is the identity."""
    k = len(a)
    square, own, leading = np.zeros((k, k)), np.empty((k, k)), np.zeros((k, n))
    for i in range(k):
        for j in range(k):
            own[i, j] = a[i, j]
            for c in range(len(rows)):
                square[i, j] += rows[c, i] * rows[c, j]
    gramian = observability(own, square)
    for i in range(k):
        for j in range(i + 1):
            gramian[i, j] = 0.5 * (gramian[i, j] + gramian[j, i])
            gramian[j, i] = gramian[i, j]
    _, vectors = np.linalg.eigh(gramian)
    small = np.zeros((n, n))
    for i in range(k):
        for c in range(n):
            for j in range(k):
                leading[i, c] += own[i, j] * vectors[j, k - n + c]
        for r in range(n):
            for c in range(n):
                small[r, c] += vectors[i, k - n + r] * leading[i, c]
    return eigenvalues(small)


@compiled(
    "(int64, boolean, int64[:,::1], complex128[::1], float64[:,::1], float64[::1],"
    " float64[:,:,::1], float64[:,::1], float64[:,:,::1])",
    inner=True,
)
def filter_of(
    g: int, free: bool, group: Indices, poles: Complex, a: Array, b: Array, rows: Array,
    direct: Array, started: Array,
) -> tuple[Array, Array, Array, Array, Array]:  # fmt: skip
    """The filter of one denominator, and its states driven by what the parallel model says.

    Returns
    -------
    inner, drive : (m, m), (m,) arrays
    basis, leading : (m, m), (m,) arrays
        Numerators sorted by degree.
    answers : (1 + n_outputs (n_inputs + n_experiments), m, q) array
        The states driven by the input, by every channel, and by the free responses of every output.
    """
    m, q = poles.size, b.size
    n_experiments, (n_outputs, n_inputs) = len(started), group.shape
    inner, drive, basis, leading = np.zeros((m, m)), np.zeros(m), np.zeros((m, m)), np.zeros(m)
    fill_cascade(poles, 1, inner, drive)
    fill_basis(inner, drive, basis, leading)
    given = np.zeros((1 + n_outputs * (n_inputs + n_experiments), q))
    answers = np.zeros((len(given), m, q))
    for d in range(q):
        given[0, d] = b[d]
        for i in range(n_outputs):
            for j in range(n_inputs):
                if group[i, j] == g:
                    given[1 + i * n_inputs + j, d] = rows[i, j, d] + direct[i, j] * b[d]
            for e in range(n_experiments):
                if free:
                    given[1 + n_outputs * (n_inputs + e) + i, d] = started[e, i, d]
    fill_map(inner, drive, a, given, answers)
    return inner, drive, basis, leading, answers


@compiled(
    "int64(float64[:,:,::1], int64[:,::1], int64, int64, boolean, int64, int64, int64[:,::1],"
    " int64[:,::1], float64[:,::1], float64[::1], float64[:,:,::1], float64[::1],"
    " float64[:,:,::1], float64[:,::1], float64[:,:,::1], float64[:,::1], float64[::1], int64)",
    inner=True,
)
def add_equations(
    stack: Array, which: Indices, height: int, first_input: int, free: bool, g: int, n: int,
    group: Indices, zeros: Indices, basis: Array, leading: Array, answers: Array, weights: Array,
    rows: Array, direct: Array, started: Array, matrix: Array, target: Array, place: int,
) -> int:  # fmt: skip
    """One denominator's share of Step 2, from column ``place`` on; the next free column."""
    n_experiments, (n_outputs, n_inputs) = len(which), group.shape
    m, q = leading.size, answers.shape[2]
    first_direct, states = q * (n_inputs + first_input), np.empty((height, m))
    driven = np.zeros((m, q))
    for c in range(m):
        for d in range(m):
            for k in range(q):
                driven[c, k] += basis[c, d] * answers[0, d, k]
    for e in range(n_experiments):
        at = place + n
        for i in range(n_outputs):
            if not leads_to(group, i, g):
                continue
            s, top, w = stack[which[e, i]], (e * n_outputs + i) * height, weights[i]
            states[:] = 0.0
            for j in range(n_inputs):
                if group[i, j] == g:
                    column, own = q * (j + first_input), min(zeros[i, j] + 1, m)
                    add_combined(s, column, answers[1 + i * n_inputs + j], 1.0, states, 0, 0)
                    add_combined(s, column, driven[:own], -w, matrix, top, at)
                    for r in range(height):
                        if zeros[i, j] == m:
                            matrix[top + r, at + m] = -w * s[r, first_direct + j]
                        if m == n:
                            value = direct[i, j] * s[r, first_direct + j]
                            for k in range(q):
                                value += rows[i, j, k] * s[r, column + k]
                            target[top + r] -= w * value
                    at += zeros[i, j] + 1
            if free:
                local = at + e * n
                add_combined(s, 0, answers[1 + n_outputs * (n_inputs + e) + i], 1.0, states, 0, 0)
                add_combined(s, 0, driven[:n], -w, matrix, top, local)
                for r in range(height):
                    if m == n:
                        for k in range(q):
                            target[top + r] -= w * started[e, i, k] * s[r, k]
                at += n_experiments * n
            for r in range(height):
                for c in range(n):
                    for d in range(m):
                        matrix[top + r, place + c] += w * states[r, d] * basis[c, d]
                if m > n:
                    for d in range(m):
                        target[top + r] -= w * states[r, d] * basis[n, d] / leading[n]
    return at


@compiled("complex128[::1](float64[::1], complex128[::1], float64[::1], int64)", inner=True)
def roots_through(row: Array, poles: Complex, last: Array, n: int) -> Complex:
    """Roots of a polynomial of degree ``n`` given by its row on a filter of more poles."""
    table, m = numerator_table(poles), poles.size
    polynomial, matrix = np.zeros(n + 1), np.zeros((n, n))
    for k in range(n + 1):
        for d in range(m):
            polynomial[k] += (row[d] + last[d]) * table[d, m - n - 1 + k]
    for k in range(n):
        matrix[0, k] = -polynomial[k + 1] / polynomial[0] if polynomial[0] != 0.0 else np.nan
        if k:
            matrix[k, k - 1] = 1.0
    return eigenvalues(matrix)


@compiled(
    "complex128[::1](float64[:,:,::1], int64[:,::1], int64, int64, boolean, int64, int64[:,::1],"
    " int64[:,::1], int64[::1], int64[::1], complex128[::1], float64[:,::1], float64[::1],"
    " float64[::1], float64[:,:,::1], float64[:,::1], float64[:,:,::1])",
    inner=True,
)
def second_step(
    stack: Array, which: Indices, height: int, first_input: int, free: bool, only: int,
    group: Indices, zeros: Indices, orders: Indices, sizes: Indices, filters: Complex, a: Array,
    b: Array, weights: Array, rows: Array, direct: Array, started: Array,
) -> Complex:  # fmt: skip
    """Step 2 for all denominators together, or for one alone (``only``, else negative)."""
    poles, tall = summed(orders), which.size * height
    wide = poles + coefficients(zeros)
    if free:
        wide += which.size * poles
    matrix, target = np.zeros((tall, wide)), np.zeros(tall)
    found, firsts = np.zeros(poles, np.complex128), np.zeros(orders.size, np.int64)
    inners, drives, bases, lasts = [a], [b], [a], [b]
    place, at = 0, 0
    for g in range(orders.size):
        n, m = orders[g], sizes[g]
        if only < 0 or only == g:
            inner, drive, basis, leading, answers = filter_of(
                g, free, group, filters[at : at + m], a, b, rows, direct, started
            )
            firsts[g] = place
            place = add_equations(
                stack, which, height, first_input, free, g, n, group, zeros, basis, leading,
                answers, weights, rows, direct, started, matrix, target, place,
            )  # fmt: skip
            last = basis[n] / leading[n] if m > n else leading
            inners.append(inner)
            drives.append(drive)
            bases.append(basis)
            lasts.append(last)
        at += m
    x, _, _, _, _ = solve_small(contiguous(matrix[:, :place]), target)
    done, count, at = 0, 0, 0
    for g in range(orders.size):
        n, m = orders[g], sizes[g]
        if only < 0 or only == g:
            count += 1
            row = np.zeros(m)
            for c in range(n):
                for d in range(m):
                    row[d] += x[firsts[g] + c] * bases[count][c, d]
            if m > n:
                own = roots_through(row, filters[at : at + m], lasts[count], n)
            else:
                moved = inners[count].copy()
                for c in range(m):
                    for d in range(m):
                        moved[c, d] -= drives[count][c] * row[d]
                own = eigenvalues(moved)
            for c in range(n):
                found[done + c] = own[c]
            done += n
        at += m
    return found[:done].copy()


@compiled("int64(complex128[::1], int64, complex128[::1])", inner=True)
def append(found: Complex, count: int, more: Complex) -> int:
    """Put more poles behind the first ``count`` of an array; how many there are then."""
    for k in range(more.size):
        found[count + k] = more[k]
    return count + more.size


@compiled(
    "(float64[:,:,::1], int64[:,::1], float64[:,:,::1], int64, boolean, int64[::1], int64, boolean,"
    " float64[:,::1], float64[::1], int64[:,::1], int64[:,::1], int64[::1], int64[::1],"
    " complex128[::1], float64, float64[::1])",
    free=True,
)
def reductions(
    stack: Array, which: Indices, targets: Array, first_input: int, free: bool, nuisance: Indices,
    order: int, biproper: bool, a: Array, b: Array, group: Indices, zeros: Indices,
    orders: Indices, sizes: Indices, filters: Complex, samples: float, floors: Array,
) -> tuple[Array, Array, Complex, Complex, Complex]:  # fmt: skip
    """The parallel model on the first operators of a bank, and the poles it is reduced to.

    Parameters
    ----------
    order : int
        Number of operators.
    a, b : arrays
        Of the bank.
    sizes : (n_groups,) int array
        Poles of each denominator's filter.
    filters : complex array
        All of them; empty for no Step 2.
    samples : float
    floors : (n_outputs,) array
        What is added to a mean square.

    Returns
    -------
    rows : (n_outputs, n_inputs, q) array
        The model on the bank.
    costs : (n_outputs,) array
    together, alone, shortened : complex arrays
        By Step 2 for all denominators and for each by itself, and by balanced truncation; empty
        where it was not asked for, there is but one, and there are fewer operators than poles.
    """
    n_outputs, n_groups = len(group), orders.size
    first, width = np.zeros(1, np.int64), np.zeros(1, np.int64)
    width[0] = order
    _, rows, direct, started, costs, _ = parallel_fit(
        stack, which, targets, first_input, free, nuisance, width, first,
        np.zeros(group.shape, np.int64), b.size, biproper,
    )  # fmt: skip
    weights = 1.0 / np.sqrt(costs / samples + floors)
    # the free response is not known denominator by denominator, so it is left out
    own, height = free and n_groups == 1, targets.shape[2]
    together, poles = np.zeros(0, np.complex128), summed(orders)
    alone, shortened = np.zeros(poles, np.complex128), np.zeros(poles, np.complex128)
    own_ones, short_ones = 0, 0
    if filters.size:
        for g in range(-1, n_groups if n_groups > 1 else 0):
            found = second_step(
                stack, which, height, first_input, own, g, group, zeros, orders, sizes, filters, a,
                b, weights, rows, direct, started,
            )  # fmt: skip
            if g < 0:
                together = found
            else:
                own_ones = append(alone, own_ones, found)
    if order >= largest(orders):
        for g in range(n_groups):
            scaled = np.zeros((group.size, order))
            for i in range(n_outputs):
                for j in range(group.shape[1]):
                    if group[i, j] == g:
                        for k in range(order):
                            scaled[i * group.shape[1] + j, k] = weights[i] * rows[i, j, k]
            found = truncated(a[:order, :order], scaled, orders[g])
            short_ones = append(shortened, short_ones, found)
    return rows, costs, together, alone[:own_ones], shortened[:short_ones]
