"""The best fit at one denominator in machine code, from the samples on, in one call.

That is bank, exact discretisation, filtering, triangles and the linear fit. The experiments are one
flat array of numbers and a table of where what stands (`models.flat_charts`), so that there is one
code for any number of experiments, outputs, inputs, denominators, and for coloured noise: that of
`likelihood.cost`, of adapted passes (`compiled_passes`) and of steps (`compiled_descent`).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tridentify.estimation.likelihood.compiled.cost import fit_outputs
from tridentify.models.compiled_columns import largest
from tridentify.models.compiled_regression import triangles_of
from tridentify.models.compiled_whitening import whitened_triangles
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.compiled import compiled
from tridentify.numerics.kernels.cascades import bank_parts, solve_in_place

CHARTS = "Tuple((int64[:,::1], float64[::1], int64[:,::1], float64[:,::1], float64[::1]))"
"""`models.flat_charts.FlatCharts`, but for its places."""
SHAPE = (
    "Tuple((int64[:,::1], int64[:,::1], int64[::1], int64[::1], int64[:,::1], int64[:,::1],"
    " int64, boolean, int64[::1], float64[:,::1]))"
)
"""As `charted.Given` says."""
LEAST_VARIANCE = 1e-300
"""As in `likelihood.cost`."""


@compiled("void(float64[:,::1], float64[:,::1], float64[::1], float64[::1], int64)", inner=True)
def shift_inputs(s: Array, a: Array, b: Array, constants: Array, states: int) -> None:
    """Constants put back on the inputs, as `models.regression.restricted` does."""
    q, one = b.size, states + constants.size
    sides = np.empty((q, s.shape[0]))
    for r in range(s.shape[0]):
        for k in range(q):
            sides[k, r] = s[r, k] - s[r, one] * b[k]
    solve_in_place(a.copy(), sides)
    for j in range(constants.size):
        for r in range(s.shape[0]):
            for k in range(q):
                s[r, q * (j + 1) + k] += constants[j] * sides[k, r]
            s[r, states + j] += constants[j] * s[r, one]


@compiled(f"({CHARTS}, {SHAPE}, float64[:,::1], float64[::1])", inner=True)
def triangles_there(charts: Any, shape: Any, a: Array, b: Array) -> tuple[Array, Array]:
    """The triangles of all experiments on a bank, and the targets, as `fit_outputs` wants them."""
    table, numbers, delayed, parts, clocks = charts
    which, place, group, leading, constants = shape[0], shape[1], shape[4], shape[6], shape[9]
    q, n_inputs = b.size, group.shape[1]
    signals = q * (n_inputs + leading) + table[0, 2]
    height = signals + largest(table[:, 3].copy())
    stack = np.zeros((table.shape[0], height, signals))
    targets = np.zeros((*which.shape, height))
    for c in range(table.shape[0]):
        own = table[c]
        n, wide, at = own[1], max(own[5], 1) + 1, own[10:]
        w = numbers[at[0] : at[0] + n_inputs * wide * n].reshape((n_inputs, wide, n))
        begun = numbers[at[1] : at[1] + n_inputs * wide].reshape((n_inputs, wide))
        known = numbers[at[2] : at[2] + own[2] * n].reshape((own[2], n))
        y = numbers[at[3] : at[3] + own[3] * n].reshape((own[3], n))
        weight = numbers[at[4] : at[4] + own[4]]
        one = a.reshape((1, q, q)), b.reshape((1, q))
        given = clocks[c], own[5], w, delayed[c], parts[c], begun, known
        if own[7] == 0:
            r = triangles_of(*one, *given, y, weight, leading != 0, own[6])[0]
        else:
            columns = triangles_of(*one, *given, y[:0], weight[:0], leading != 0, own[6])
            noise = numbers[at[5] : at[5] + own[7]]
            seen = numbers[at[6] : at[6] + n] != 0.0
            gain = numbers[at[7] : at[7] + own[8] * own[7]].reshape((own[8], own[7]))
            scale = numbers[at[8] : at[8] + own[9]]
            r = whitened_triangles(columns, y, noise, seen, gain, scale)[0]
        for k in range(r.shape[0]):
            for m in range(signals):
                stack[c, k, m] = r[k, m]
            for i in range(which.shape[1]):
                if which[own[0], i] == c:
                    targets[own[0], i, k] = r[k, signals + place[own[0], i]]
        is_shifted = False
        for j in range(constants.shape[1]):
            is_shifted = is_shifted or constants[own[0], j] != 0.0
        if is_shifted:
            shift_inputs(stack[c], a, b, constants[own[0]], signals - table[0, 2])
    return stack, targets


@compiled(f"({CHARTS}, {SHAPE}, complex128[::1], int64)", free=True)
def fit_there(charts: Any, shape: Any, poles: Complex, repeats: int) -> tuple[Any, ...]:
    """The best fit at some poles.

    Parameters
    ----------
    charts, shape : tuples
        As `CHARTS` and `SHAPE` say.
    poles : (n_poles,) complex array
        Admissible, group by group.
    repeats : int
        How often each stands in the bank.

    Returns
    -------
    bank : tuple
        As of `numerics.kernels.cascades.bank_parts`.
    stack, targets : arrays
    columns : (k,) int array
        Those of constant and ramp that are kept.
    linear : tuple
        As of `compiled_cost.fit_outputs`, which takes these.

    Raises
    ------
    ValueError
        If a pole is not in the open left half plane or a pair is torn apart.
    """
    which, _, orders, firsts, group, zeros, leading, free, nuisance, _ = shape
    bank = bank_parts(poles, orders, repeats, largest(orders))
    stack, targets = triangles_there(charts, shape, bank[0], bank[1])
    columns = nuisance + (bank[1].size * (group.shape[1] + leading) + group.shape[1])
    linear = fit_outputs(
        stack, which, targets, leading, free, columns, orders, firsts, group, zeros, repeats,
        bank[2],
    )  # fmt: skip
    return bank, stack, targets, columns, linear


@compiled("float64(float64[::1], float64[::1], float64[::1], float64[::1])", inner=True)
def weigh_outputs(costs: Array, counts: Array, floors: Array, weights: Array) -> float:
    """Minus two log likelihood, and the weights of the outputs."""
    objective = 0.0
    for i in range(counts.size):
        variance = max(costs[i] / counts[i] + floors[i], LEAST_VARIANCE)
        weights[i] = 1.0 / np.sqrt(variance)
        objective += counts[i] * np.log(variance)
    return objective
