"""Columns of a triangle combined in machine code: what every fit of the models is made of."""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.compiled import compiled


@compiled("boolean(int64[:,::1], int64, int64)", inner=True, linked=True)
def leads_to(group: Indices, output: int, g: int) -> bool:
    """Whether any channel of a denominator leads to an output; ``group`` (n_outputs, n_inputs)."""
    found = False
    for j in range(group.shape[1]):
        found = found or group[output, j] == g
    return found


@compiled("int64(int64[::1])", inner=True)
def largest(numbers: Indices) -> int:
    """The largest of some numbers that are not negative."""
    found = 0
    for k in range(numbers.size):
        found = numbers[k] if numbers[k] > found else found
    return found


@compiled("int64(int64[::1])", inner=True)
def summed(numbers: Indices) -> int:
    """The sum."""
    found = 0
    for k in range(numbers.size):
        found += numbers[k]
    return found


@compiled("int64(int64[:,::1])", inner=True)
def coefficients(zeros: Indices) -> int:
    """Coefficients of all numerators, whose degrees are given."""
    found = zeros.size
    for i in range(zeros.shape[0]):
        for j in range(zeros.shape[1]):
            found += zeros[i, j]
    return found


@compiled(
    "void(float64[:,::1], int64, float64[:,:], float64, float64[:,:], int64, int64)",
    inner=True,
    linked=True,
)
def add_combined(
    s: Array, column: int, rows: Array, sign: float, out: Array, top: int, first: int
) -> None:
    """Add combinations of states to columns: ``out[top + r, first + c] += sign s[r] rows[c]``.

    Parameters
    ----------
    s : (r, n_columns) array
        A triangle.
    column : int
        Where the states begin.
    rows : (k, n_states) array
    sign : float
    out : array
    top, first : int
        Where the first row and the first column go.
    """
    count, n = rows.shape
    for r in range(s.shape[0]):
        for c in range(count):
            value = 0.0
            for d in range(n):
                value += s[r, column + d] * rows[c, d]
            out[top + r, first + c] += sign * value


@compiled("void(float64[:], float64[:,:,:], float64[:,:])", inner=True, linked=True)
def through(weights: Array, map_: Array, found: Array) -> None:
    """States of a filter driven by a combination of a bank's states.

    Parameters
    ----------
    weights : (q,) array
    map_ : (q, n, q) array
        `numerics.realization.filter_map`.
    found : (n, q) array
        Receives the coordinates.
    """
    q, n = map_.shape[0], map_.shape[1]
    for c in range(n):
        for d in range(q):
            found[c, d] = 0.0
    for k in range(q):
        if weights[k] != 0.0:
            for c in range(n):
                for d in range(q):
                    found[c, d] += weights[k] * map_[k, c, d]


@compiled(
    "void(float64[:,::1], int64, int64, boolean, int64, int64, int64[::1], int64[::1],"
    " int64[:,::1], int64, float64[::1], float64[::1], float64[:,:,::1], float64[:,::1],"
    " float64[:,:,::1], float64[:,:], int64)",
    inner=True,
)
def add_filtered(
    s: Array,
    experiment: int,
    output: int,
    free: bool,
    first_input: int,
    repeats: int,
    orders: Indices,
    firsts: Indices,
    group: Indices,
    n_inputs: int,
    b: Array,
    maps: Array,
    rows: Array,
    direct: Array,
    started: Array,
    out: Array,
    top: int,
) -> None:
    """Add the states of every denominator's filter, driven by its part of an output.

    Parameters
    ----------
    s : (r, n_columns) array
        A triangle of the output in the experiment.
    experiment, output : int
    free, first_input, repeats, orders, firsts, group, n_inputs
        As in `estimation.likelihood.compiled.cost`.
    b, maps : arrays
        Of the bank (`numerics.kernels.cascades.bank_parts`).
    rows, direct, started : arrays
        The output on the bank (`models.response.Response`).
    out : (rows, >= n_poles) array
    top : int
        Where its first row stands.
    """
    q, place = b.size, 0
    for g in range(orders.size):
        n, own, at = orders[g], orders[g] * repeats, firsts[g] * repeats
        map_ = maps[place : place + own * n * own].reshape((own, n, own))
        place += own * n * own
        filtered, weights = np.empty((n, own)), np.empty(own)
        for j in range(-1, n_inputs):
            if j < 0:
                if not free or not leads_to(group, output, g):
                    continue
                column = at
                for k in range(own):
                    weights[k] = started[experiment, output, at + k]
            elif group[output, j] != g:
                continue
            else:
                column = q * (j + first_input) + at
                for k in range(own):
                    weights[k] = rows[output, j, at + k] + direct[output, j] * b[at + k]
            through(weights, map_, filtered)
            add_combined(s, column, filtered, 1.0, out, top, firsts[g])
