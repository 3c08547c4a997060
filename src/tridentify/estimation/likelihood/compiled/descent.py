"""Levenberg-Marquardt steps in machine code: what `levenberg_marquardt` does, many steps a call.

A step is all of it: bank, filtering, triangles, linear fits, scores, their decomposition, the roots
of the denominator that the step leads to, and the verdict on them. The experiments are one flat
array of numbers and a table of where what stands (`models.flat_charts`), so that there is one code
for any number of experiments, outputs, inputs, denominators, and for coloured noise.

What is rare is left to Python: the descent stops before it, and who called goes on from there. That
is a pole at a slow limit, a residual of mere rounding, and numbers that are not finite.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tridentify.estimation.likelihood.compiled.cost import scores_at
from tridentify.estimation.likelihood.compiled.fit import (
    CHARTS,
    SHAPE,
    fit_there,
    weigh_outputs,
)
from tridentify.estimation.likelihood.compiled.proposal import (
    bend_of,
    bent_by,
    combined,
    damped,
    dot,
    fall,
    promised,
    slope_left,
)
from tridentify.estimation.likelihood.compiled.roots import inner_cascades, sorted_poles
from tridentify.models.compiled_columns import coefficients
from tridentify.models.compiled_steps import coefficients_of
from tridentify.numerics.arrays import Array, Complex, Indices
from tridentify.numerics.compiled import compiled
from tridentify.numerics.kernels.cascades import solve_in_place
from tridentify.numerics.kernels.small_eigenvalues import eigenvalues

SEEN = (
    "Tuple((float64[::1], float64[:,::1], float64[::1], float64[::1], float64[:,::1],"
    " float64[::1], float64[::1], float64))"
)
"""Residual sums of squares, then what `compiled_cost.scores_at` gives."""


@compiled("boolean(complex128[::1], float64[::1])", inner=True, linked=True)
def is_slow(poles: Complex, limits: Array) -> bool:
    """Whether a pole is near a slow limit, as `Point._decomposition` asks."""
    near = False
    for z in poles:
        near = near or -z.real <= 1.001 * max(limits[1], limits[3] * abs(z))
    return near


@compiled(
    "(complex128[::1], float64[::1], int64[::1], int64[::1], float64[::1], boolean)", inner=True
)
def proposed(
    poles: Complex, change: Array, orders: Indices, firsts: Indices, limits: Array, far: bool
) -> tuple[bool, Complex, int]:
    """Where a step leads: whether it can be gone, admissible poles, and what was done to them.

    ``limits``: the fastest and the slowest pole, the largest imaginary part, the least damping.
    """
    a, b = inner_cascades(poles, orders, firsts)
    found, note = np.empty(poles.size, dtype=np.complex128), 0
    for g in range(orders.size):
        n, at = orders[g], firsts[g]
        matrix = np.empty((n, n))
        for i in range(n):
            for j in range(n):
                matrix[i, j] = a[at + i, at + j] - b[at + i] * change[at + j]
        roots = sorted_poles(eigenvalues(matrix))
        for k in range(n):
            z = roots[k]
            size = abs(z)
            if not np.isfinite(size) or (z.imag == 0.0 and z.real > 0.0 and not far):
                return False, poles, 0
            if z.real > 0.0:
                note = max(note, 1)
            factor = limits[0] / max(size, limits[0])
            real, imag = -abs(z.real) * factor, z.imag * factor
            if factor < 1.0 or abs(imag) > limits[2]:
                note = 2
            imag = min(max(imag, -limits[2]), limits[2])
            if -real < max(limits[1], limits[3] * abs(imag)):
                return False, poles, 0
            roots[k] = complex(real, imag)
        roots = sorted_poles(roots)
        for k in range(n):
            found[at + k] = roots[k]
    return not is_slow(found, limits), found, note


@compiled(
    "boolean(complex128[::1], complex128[::1], int64[::1], int64[::1], float64, float64[::1])",
    inner=True,
)
def step_back(
    old: Complex, new: Complex, orders: Indices, firsts: Indices, apart: float, row: Array
) -> bool:
    """The step from new poles to the old ones, ``a_old / a_new = 1 + row X``; whether there is one.

    At the old poles ``row X = -1``, ``X`` the states of the new ones.
    """
    a, b = inner_cascades(new, orders, firsts)
    total = 0.0
    for g in range(orders.size):
        n, at = orders[g], firsts[g]
        matrix, sides = np.zeros((n, n)), np.zeros((n, 1))
        for i in range(n):
            z = new[at + i]
            for j in range(n):
                if j != i and abs(z - new[at + j]) < apart * abs(z):
                    return False
            p = old[at + i]
            if p.imag < 0.0:
                continue
            x, m, largest = np.zeros(n, dtype=np.complex128), 0, 0.0
            while m < n:
                width = 2 if m + 1 < n and new[at + m].imag > 0.0 else 1
                sums = np.zeros(2, dtype=np.complex128)
                for w in range(width):
                    sums[w] = b[at + m + w]
                    for j in range(m):
                        sums[w] += a[at + m + w, at + j] * x[j]
                first = p - a[at + m, at + m]
                if width == 1:
                    if first == 0.0:
                        return False
                    x[m] = sums[0] / first
                else:
                    over, under = a[at + m, at + m + 1], a[at + m + 1, at + m]
                    second = p - a[at + m + 1, at + m + 1]
                    det = first * second - over * under
                    if det == 0.0:
                        return False
                    x[m] = (sums[0] * second + over * sums[1]) / det
                    x[m + 1] = (first * sums[1] + under * sums[0]) / det
                m += width
            for k in range(n):
                largest = max(largest, abs(x[k]))
            if not 0.0 < largest < np.inf:
                return False
            sides[i, 0] = -1.0 / largest
            for k in range(n):
                matrix[i, k] = x[k].real / largest
                if p.imag > 0.0:
                    matrix[i + 1, k] = x[k].imag / largest
        solve_in_place(matrix, sides)
        for k in range(n):
            row[at + k] = sides[k, 0]
            total += sides[k, 0]
    return bool(np.isfinite(total))


@compiled(f"({CHARTS}, {SHAPE}, complex128[::1], float64[::1], float64[::1])", inner=True)
def cost_there(
    charts: Any, shape: Any, poles: Complex, counts: Array, floors: Array
) -> tuple[Any, float, float, Array]:
    """The best fit at some poles.

    Returns
    -------
    seen : tuple
        As `SEEN` says.
    objective, condition : float
    theta : array
        Coefficients.
    """
    _, _, orders, firsts, group, zeros, leading, free, _, _ = shape
    bank, stack, _, _, linear = fit_there(charts, shape, poles, 2)
    a, b, _, _, maps = bank
    rows, direct, started, costs, conditions, _, _, _, bases, ranks, residuals = linear
    weights, condition = np.empty(counts.size), 0.0
    for i in range(counts.size):
        condition = max(condition, conditions[i])
    objective = weigh_outputs(costs, counts, floors, weights)
    found = scores_at(
        stack, shape[0], leading, free, orders, firsts, group, 2, a, b, maps, rows, direct, started,
        bases, ranks, residuals, weights, 0,
    )  # fmt: skip
    theta = coefficients_of(poles, rows, direct, orders, firsts, group, zeros, 2)
    return (costs, *found), objective, condition, theta


@compiled(
    f"({CHARTS}, {SHAPE}, float64[:,::1], float64[::1], float64[::1],"
    f" complex128[::1], {SEEN}, float64[::1], float64[::1], int64, int64)",
    free=True,
)
def descend(
    charts: Any, shape: Any, scales: Array, limits: Array, rules: Array,
    poles: Complex, seen: Any, state: Array, direction: Array, idle: int, most: int,
) -> tuple[Any, ...]:  # fmt: skip
    """Steps on the cost, as `levenberg_marquardt.finishing` takes them.

    Parameters
    ----------
    charts, shape : tuples
        As `CHARTS` and `SHAPE` say.
    scales : (3, n_outputs) array
        Samples, floors of the variances, and sums of squares that are rounding.
    limits : (4,) array
        As of `proposed`.
    rules : (7,) array
        Fall of the objective below which a step is settled, idle, and not far; bounds of the bend;
        how far apart poles have to be; and the damping beyond which steps are over.
    poles : (n_poles,) complex array
    seen : tuple
        As `SEEN` says, at these poles.
    state : (3,) array
        Damping, its growth, and the bend, ``nan`` without; is carried on.
    direction : (n_poles,) array
        Of the bend; is carried on.
    idle : int
        Steps in turn that gained next to nothing.
    most : int
        Steps to be tried.

    Returns
    -------
    goes_on : bool
        Whether the steps tried are what ended it.
    tried, taken, idle, note : int
        ``note``: what was done to the poles last, 1 for mirrored and 2 for held as too fast.
    poles, seen
        Where it ended.
    thetas, costs : (most, n_theta), (most, n_outputs) arrays
        Of every step that was taken.
    told : (most, 4) array
        Condition, gradient, damping and note of every step taken.
    """
    counts, floors, exact = scales[0], scales[1], scales[2]
    settled, least_gain, far_away, least_bend, most_bend, apart, most_damped = rules
    orders, firsts = shape[2], shape[3]
    samples, size = 0.0, poles.size + coefficients(shape[5])
    for i in range(counts.size):
        samples += counts[i]
    taken, tried, note, goes_on = 0, 0, 0, True
    thetas, costs, told = np.zeros((most, size)), np.zeros((most, counts.size)), np.zeros((most, 4))
    objective = weigh_outputs(seen[0], counts, floors, np.empty(counts.size))
    for i in range(counts.size):
        goes_on = goes_on and seen[0][i] >= exact[i]
    goes_on = goes_on and not is_slow(poles, limits)
    while goes_on and tried < most:
        _, scores, residual, s, vt, scale, projection, total = seen
        left = promised(s, projection, total, 0.0, samples)
        if left < settled:
            goes_on = False
            break
        change = damped(s, vt, scale, projection, state[0])
        predicted = promised(s, projection, total, state[0], samples)
        if not np.isnan(state[2]):
            promise = bent_by(change, scores, residual, direction, state[2])
            predicted = fall(promise, total, samples)
        can, new, done = proposed(poles, change, orders, firsts, limits, left > far_away)
        if not can or not np.isfinite(predicted) or predicted == 0.0:
            goes_on = False
            break
        trial, reached, condition, theta = cost_there(charts, shape, new, counts, floors)
        for i in range(counts.size):
            goes_on = goes_on and trial[0][i] >= exact[i]
        if not goes_on or not np.isfinite(reached):
            goes_on = False
            break
        tried += 1
        gain = objective - reached
        if gain <= 0.0:
            state[2] = np.nan
            state[0] = max(state[0] * state[1], 1e-3)
            state[1] *= 2.0
            goes_on = state[0] <= most_damped
            continue
        for k in range(size):
            thetas[taken, k] = theta[k]
        for i in range(counts.size):
            costs[taken, i] = trial[0][i]
        told[taken, 0], told[taken, 1] = condition, slope_left(trial[3], trial[6], trial[7])
        told[taken, 2], told[taken, 3] = state[0], done
        taken += 1
        ratio = gain / predicted
        state[0] *= max(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3)
        state[0] = 0.0 if state[0] < 1e-6 else state[0]
        state[1], state[2] = 2.0, np.nan
        is_far = promised(trial[3], trial[6], trial[7], 0.0, samples) > far_away
        if done == 0 and not is_far and step_back(poles, new, orders, firsts, apart, direction):
            before = 2.0 * dot(residual, combined(scores, change))
            bend = bend_of(direction, trial[1], trial[2], before)
            state[2] = min(max(bend, least_bend), most_bend) if np.isfinite(bend) else np.nan
        poles, seen, objective, note = new, trial, reached, done
        idle = idle + 1 if gain < least_gain else 0
        goes_on = idle <= 2
    return goes_on, tried, taken, idle, note, poles, seen, thetas, costs, told
