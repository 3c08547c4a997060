"""A search begun in machine code: from the samples to the end of a start.

Parallel models on several banks, ranked (`ranked`); the best of them reduced to poles, the
reduction that explains most, and the adapted passes from there (`begun`). Each is that of the
pieces that `search.starts`, `search.passes` use one at a time.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tridentify.estimation.likelihood.compiled.fit import (
    CHARTS,
    SHAPE,
    fit_there,
    shift_inputs,
    weigh_outputs,
)
from tridentify.estimation.likelihood.compiled.roots import admit, sorted_poles
from tridentify.estimation.search.compiled_passes import adapted
from tridentify.estimation.search.compiled_reduction import reductions
from tridentify.estimation.search.compiled_starts import orders_of, triangles_on
from tridentify.models.compiled_regression import cascades
from tridentify.numerics.arrays import Array, Complex, Indices
from tridentify.numerics.compiled import compiled

CHOICES = "Tuple((boolean[::1], int64[:,::1], float64[:,:,::1]))"
"""Of several choices of nuisance terms: whether each has a free initial state; which of constant
and ramp it keeps, and -1 for none; constants put back on the inputs of every experiment."""


@compiled("boolean(float64[:,::1])", inner=True)
def any_is_set(constants: Array) -> bool:
    """Whether any constant is not zero."""
    found = False
    for e in range(constants.shape[0]):
        for j in range(constants.shape[1]):
            found = found or constants[e, j] != 0.0
    return found


@compiled(
    "float64[:,:,:,::1](int64[:,::1], float64[:,:,:,::1], float64[:,:,::1], float64[:,::1],"
    " float64[:,::1], int64)",
    inner=True,
)
def shifted(
    table: Indices, stack: Array, a: Array, b: Array, constants: Array, inputs: int
) -> Array:
    """The triangles of several banks with constants put back on the inputs of every experiment."""
    found = stack.copy()
    for c in range(table.shape[0]):
        own = table[c, 0]
        if any_is_set(constants[own : own + 1]):
            for k in range(len(b)):
                shift_inputs(found[k, c], a[k], b[k], constants[own], b.shape[1] * inputs)
    return found


@compiled(
    f"({CHARTS}, {SHAPE}, {CHOICES}, complex128[:,::1], boolean, int64, int64, float64[:,::1],"
    " float64[:,::1])",
    free=True,
)
def ranked(
    charts: Any, shape: Any, choices: Any, poles: Complex, biproper: bool, most: int, fewest: int,
    scales: Array, prices: Array,
) -> tuple[Array, Array, Array, Array, Indices, Array]:  # fmt: skip
    """Parallel models on several banks, with every choice of nuisance terms.

    Parameters
    ----------
    charts, shape : tuples
        As of `compiled_fit`, with every nuisance term.
    choices : tuple
        As `CHOICES` says.
    poles : (n_banks, q) complex array
        Pairs side by side, real parts negative.
    biproper : bool
    most, fewest : int
        Numbers of functions: of the states of a bank, the first so many.
    scales : (2, n_outputs) array
        Samples, and what is added to a mean square.
    prices : (n_choices, most) array
        Of the unknowns.

    Returns
    -------
    a, b : arrays
        Of the banks.
    stack, targets : arrays
        As of `compiled_starts.triangles_on`.
    orders, criteria : (n_banks, n_choices) arrays
        As of `compiled_starts.orders_of`.
    """
    a, b = cascades(poles)
    stack, targets = triangles_on(charts, shape, a, b)
    frees, kept, constants = choices
    which, n_inputs, leading = shape[0], shape[4].shape[1], shape[6]
    size, q = (len(b), frees.size), b.shape[1]
    orders, criteria = np.zeros(size, np.int64), np.zeros(size)
    first = q * (n_inputs + leading) + n_inputs
    for v in range(frees.size):
        seen = stack
        if any_is_set(constants[v]):
            seen = shifted(charts[0], stack, a, b, constants[v], n_inputs + leading)
        columns = np.zeros((1, kept.shape[1]), np.int64)
        for c in range(kept.shape[1]):
            columns[0, c] = first + kept[v, c] if kept[v, c] >= 0 else -1
        some, of_each = orders_of(
            seen, which, targets, frees[v : v + 1], columns, biproper, n_inputs, q, most, fewest,
            leading, scales[0], scales[1], prices[v : v + 1],
        )  # fmt: skip
        for k in range(len(b)):
            orders[k, v], criteria[k, v] = some[k, 0], of_each[k, 0]
    return a, b, stack, targets, orders, criteria


@compiled(
    f"({CHARTS}, {SHAPE}, {CHOICES}, complex128[:,::1], boolean, int64, int64, float64[:,::1],"
    " float64[:,::1], float64, float64[::1], float64, int64)",
    free=True,
)
def begun(
    charts: Any, shape: Any, choices: Any, poles: Complex, biproper: bool, most: int, fewest: int,
    scales: Array, prices: Array, samples: float, limits: Array, least_gain: float, passes: int,
) -> tuple[Any, ...]:  # fmt: skip
    """Where the best of several parallel models leads, with one denominator.

    Parameters
    ----------
    charts, shape, choices, poles, biproper, most, fewest, prices
        As of `ranked`; the poles behind the first ``most`` are the filter of Step 2.
    scales : (4, n_outputs) array
        Samples; what is added to a mean square of a parallel model, and of the model; sums of
        squares that are rounding.
    samples : float
        Of all experiments.
    limits, least_gain
        As of `compiled_passes.adapted`.
    passes : int
        Most adapted passes.

    Returns
    -------
    models : tuple
        As of `ranked`.
    best : (2,) int array
        Bank and choice of the best.
    reduction : tuple
        As of `compiled_reduction.reductions`.
    first : (n_poles,) complex array
        Where the passes begin.
    told : tuple
        As of `compiled_passes.adapted`.
    poles : (n_poles,) complex array
        The best place of the passes.
    fit : tuple
        As of `compiled_fit.fit_there`, the poles twice in the bank.
    """
    models = ranked(charts, shape, choices, poles, biproper, most, fewest, scales[:2], prices)
    a, b, stack, targets, orders, criteria = models
    best = np.zeros(2, np.int64)
    for k in range(criteria.shape[0]):
        for v in range(criteria.shape[1]):
            if criteria[k, v] < criteria[best[0], best[1]]:
                best[0], best[1] = k, v
    k, v = int(best[0]), int(best[1])
    frees, kept, constants = choices
    which, place, numbers, firsts, group, zeros, leading = shape[:7]
    is_shifted = any_is_set(constants[v])
    nuisance = kept[v][kept[v] >= 0]
    added = constants[v].copy() if is_shifted else np.zeros((0, 0))
    own = which, place, numbers, firsts, group, zeros, leading, frees[v], nuisance, added
    seen = stack[k : k + 1]
    if is_shifted:
        seen = shifted(charts[0], seen, a[k : k + 1], b[k : k + 1], added, group.shape[1] + leading)
    q, width = b.shape[1], np.zeros(1, np.int64)
    width[0] = q - most
    reduction = reductions(
        seen[0], which, targets[k], leading, frees[v],
        nuisance + (q * (group.shape[1] + leading) + group.shape[1]), orders[k, v], biproper, a[k],
        b[k], group, zeros, numbers, width, poles[k, most:].copy(), samples,
        scales[1],
    )  # fmt: skip
    counts, floors, weights = scales[0], scales[2], np.empty(scales.shape[1])
    first, lowest = poles[0, :0].copy(), np.inf
    for found in (reduction[2], reduction[4]):
        if found.size:
            moved = found.copy()
            admit(moved, limits)
            moved = sorted_poles(moved)
            cost = weigh_outputs(fit_there(charts, own, moved, 2)[4][3], counts, floors, weights)
            if first.size == 0 or cost < lowest:
                first, lowest = moved, cost
    state, passed = np.zeros(2), np.empty((3, counts.size))
    state[0] = np.inf
    for i in range(counts.size):
        passed[0, i], passed[1, i], passed[2, i] = counts[i], floors[i], scales[3, i]
    told = adapted(charts, own, biproper, first, passed, limits, least_gain, state, passes)
    at, lowest = first, np.inf
    for m in range(told[1]):
        if told[4][m] < lowest:
            at, lowest = told[2][m], told[4][m]
    fit = fit_there(charts, own, at, 2)
    return models, best, reduction, first, told, at, fit
