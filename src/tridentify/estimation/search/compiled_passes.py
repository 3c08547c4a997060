"""Adapted passes in machine code: what `search.passes` does, many passes a call."""

from __future__ import annotations

from typing import Any

import numpy as np

from tridentify.estimation.likelihood.compiled.fit import CHARTS, SHAPE, fit_there, weigh_outputs
from tridentify.estimation.likelihood.compiled.roots import led_to
from tridentify.models.compiled_steps import adapted_steps
from tridentify.numerics.arrays import Array, Complex, Indices
from tridentify.numerics.compiled import compiled

REPEATS = 3
"""Step 2 filters once more what the model and its derivatives are made of."""


@compiled(
    f"({CHARTS}, {SHAPE}, boolean, complex128[::1], float64[:,::1], float64[::1], float64,"
    " float64[::1], int64)",
    free=True,
)
def adapted(
    charts: Any, shape: Any, biproper: bool, poles: Complex, scales: Array, limits: Array,
    least_gain: float, state: Array, most: int,
) -> tuple[bool, int, Complex, Indices, Array, Complex]:  # fmt: skip
    """Steps 1 and 2 with filter and basis re-adapted, until the cost stops falling.

    Parameters
    ----------
    charts, shape : tuples
        As `compiled_fit` says.
    biproper : bool
        Whether any channel has as many zeros as poles.
    poles : (n_poles,) complex array
        Where the passes begin; admissible.
    scales : (3, n_outputs) array
        Samples, floors of the variances, and sums of squares that are rounding.
    limits : (4,) array
        As of `compiled_roots.admit`.
    least_gain : float
        Fall of the objective from which the next pass is worth while.
    state : (2,) array
        Lowest objective so far, and passes in turn that were not worth while; is carried on.
    most : int
        Passes to be made.

    Returns
    -------
    is_over : bool
        Whether there is nothing to be gained by another pass.
    count : int
        Passes made.
    visited : (most, n_poles) complex array
        Where each of them was.
    notes : (most,) int array
        What was done to the poles to get to the next place, as of `compiled_roots`.
    objectives : (most,) array
    next : (n_poles,) complex array
        The place after the last.
    """
    _, _, orders, firsts, group, zeros, leading, free, _, _ = shape
    counts, floors, exact = scales[0], scales[1], scales[2]
    visited = np.empty((most, poles.size), dtype=np.complex128)
    notes, objectives = np.zeros(most, dtype=np.int64), np.zeros(most)
    weights = np.empty(counts.size)
    for k in range(most):
        bank, stack, targets, columns, linear = fit_there(charts, shape, poles, REPEATS)
        a, b, basis, _, maps = bank
        for i in range(poles.size):
            visited[k, i] = poles[i]
        objectives[k] = weigh_outputs(linear[3], counts, floors, weights)
        gain, is_exact = state[0] - objectives[k], True
        for i in range(counts.size):
            is_exact = is_exact and linear[3][i] < exact[i]
        state[0] = min(state[0], objectives[k])
        state[1] = state[1] + 1.0 if gain < least_gain else 0.0
        if state[1] >= 1.0 + (gain < 0.0) or is_exact:
            return True, k + 1, visited, notes, objectives, poles
        row = adapted_steps(
            stack, shape[0], targets, leading, free, columns, orders, firsts, group, zeros, REPEATS,
            poles, b, basis, maps, weights, biproper,
        )[3]  # fmt: skip
        poles, notes[k] = led_to(a, b, row, orders, firsts, REPEATS, limits)
    return False, most, visited, notes, objectives, poles
