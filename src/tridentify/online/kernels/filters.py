"""Filters and rows of a block of samples, compiled: what drives them first, then the states."""

from __future__ import annotations

from numba import types

from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.compiled import compiled
from tridentify.online.kernels import slots
from tridentify.online.kernels.signatures import INTS, SAMPLES, TABLE, VECTOR


@compiled(types.void(INTS, VECTOR, SAMPLES, types.int64, types.int64, TABLE), wide=True)
def line_up(ints: Indices, x: Array, u: Array, start: int, count: int, lines: Array) -> None:
    """The inputs as the delay lines see them, oldest first."""
    past = ints[slots.LINE] - 1
    for j in range(ints[slots.INPUTS]):
        line, at = lines[j], ints[slots.AT_LINE] + j * ints[slots.LINE]
        reference = x[ints[slots.AT_REFERENCE] + j]
        for s in range(past):
            line[past - 1 - s] = x[at + s]
        for i in range(count):
            line[past + i] = u[start + i, j] - reference


@compiled(
    "void(int64[::1], float64[::1], float64[:, ::1], int64, int64, float64[::1], float64[::1])",
    wide=True,
)
def run_filter(
    ints: Indices, c: Array, room: Array, at: int, count: int, later: Array, unused: Array
) -> None:
    """States of a filter; ``room[at + r, 1:]`` holds what drives state ``r`` and is replaced.

    ``room[at + r, 0]`` is the state before, ``later`` what is added after the transition, times
    ``unused[r]``.
    """
    q, f, upper = ints[slots.ORDER], ints[slots.C_STEP], ints[slots.UPPER]
    r = 0
    while r < q:
        pair = upper > 0 and r + 1 < q and c[f + r * q + r + 1] != 0.0
        own = room[at + r]
        weight = unused[r]
        for s in range(r):
            factor, other = c[f + r * q + s], room[at + s]
            for i in range(count):
                own[i + 1] += factor * other[i]
        a = c[f + r * q + r]
        if not pair:
            value = own[0]
            for i in range(count):
                value = own[i + 1] + a * value + weight * later[i]
                own[i + 1] = value
            r += 1
            continue
        second = room[at + r + 1]
        beside = unused[r + 1]
        for s in range(r):
            factor, other = c[f + (r + 1) * q + s], room[at + s]
            for i in range(count):
                second[i + 1] += factor * other[i]
        b = c[f + r * q + r + 1]
        d, e = c[f + (r + 1) * q + r], c[f + (r + 1) * q + r + 1]
        value, following = own[0], second[0]
        for i in range(count):
            new = own[i + 1] + a * value + b * following + weight * later[i]
            following = second[i + 1] + d * value + e * following + beside * later[i]
            value = new
            own[i + 1] = value
            second[i + 1] = following
        r += 2


@compiled(
    "void(int64[::1], float64[::1], float64[::1], float64[:, ::1], int64, int64, float64[:, ::1],"
    " float64[::1])",
    wide=True,
)
def run_inputs(
    ints: Indices, c: Array, x: Array, room: Array, at: int, count: int, lines: Array, zeros: Array
) -> None:
    """States driven by the inputs, from those in column 0 of ``room[at:]``."""
    q, past = ints[slots.ORDER], ints[slots.LINE] - 1
    for j in range(ints[slots.INPUTS]):
        g = ints[slots.C_TAPS] + 3 * j * q
        line, shift = lines[j], past - int(c[ints[slots.C_EXTRA] + j])
        for r in range(q):
            own = room[at + j * q + r]
            first, second, third = c[g + r], c[g + q + r], c[g + 2 * q + r]
            now, before, earlier = line[shift:], line[shift - 1 :], line[shift - 2 :]
            for i in range(count):
                own[i + 1] = first * now[i] + second * before[i] + third * earlier[i]
        run_filter(ints, c, room, at + j * q, count, zeros, zeros)


@compiled(
    "void(int64[::1], float64[::1], float64[:, ::1], int64, int64, int64, float64[:, ::1])",
    wide=True,
)
def direct_terms(
    ints: Indices, c: Array, room: Array, to: int, j: int, count: int, lines: Array
) -> None:
    """Input ``j`` itself as it arrives, into a row of the workspace."""
    line, shift = lines[j], ints[slots.LINE] - 1 - int(c[ints[slots.C_EXTRA] + j])
    h, own = ints[slots.C_DIRECT] + 2 * j, room[to]
    now, before = line[shift:], line[shift - 1 :]
    for i in range(count):
        own[i] = c[h] * now[i] + c[h + 1] * before[i]


@compiled("void(float64[::1], int64, int64, float64[:, ::1], int64, int64, int64)", wide=True)
def combine(c: Array, weights: int, q: int, room: Array, states: int, to: int, count: int) -> None:
    """A combination of the states of a filter, into a row of the workspace."""
    row = room[to]
    for s in range(q):
        weight, own = c[weights + s], room[states + s]
        if s == 0:
            for k in range(count):
                row[k] = weight * own[k + 1]
        else:
            for k in range(count):
                row[k] += weight * own[k + 1]


@compiled(
    types.void(
        INTS, VECTOR, VECTOR, SAMPLES, types.int64, types.int64, TABLE, types.int64, TABLE
    ),
    wide=True,
)  # fmt: skip
def equation_rows(
    ints: Indices, c: Array, x: Array, y: Array, start: int, count: int, room: Array, columns: int,
    lines: Array,
) -> None:  # fmt: skip
    """Rows of a block of samples of one output, and its filter (`equation.build_row`)."""
    m, q, basis = ints[slots.INPUTS], ints[slots.ORDER], ints[slots.C_BASIS]
    newest, told = room[columns - 1], room[columns + ints[slots.COLUMNS]]
    for k in range(count):
        newest[k] = y[start + k, 0]
    g, before = ints[slots.C_OUTPUT], x[ints[slots.AT_BEFORE]]
    for r in range(q):
        own, factor = room[r], c[g + r]
        own[0] = x[ints[slots.AT_OUTPUTS] + r]
        own[1] = factor * before
        for k in range(1, count):
            own[k + 1] = factor * newest[k - 1]
    run_filter(ints, c, room, 0, count, newest, c[g + q : g + 2 * q])
    at = columns + ints[slots.ORDER] * ints[slots.FREE]
    if ints[slots.OFFSET]:
        for k in range(count):
            room[at, k] = 1.0
        at += 1
    poles = int(c[ints[slots.C_ZEROS] + m])
    for d in range(poles):
        combine(c, basis + d * q, q, room, 0, at + d, count)
        for k in range(count):
            room[at + d, k] = -room[at + d, k]
    at += poles
    for j in range(m):
        degree = int(c[ints[slots.C_ZEROS] + j])
        for d in range(min(degree + 1, q)):
            combine(c, basis + d * q, q, room, q + j * q, at + d, count)
        if degree == q:
            direct_terms(ints, c, room, at + q, j, count, lines)
        at += degree + 1
    monic = ints[slots.C_MONIC]
    for k in range(count):
        told[k] = c[monic + q] * newest[k]
    for s in range(q):
        factor, own = c[monic + s], room[s]
        for k in range(count):
            told[k] += factor * own[k + 1]


@compiled(
    "void(int64[::1], float64[::1], float64[::1], int64, float64[:, ::1], int64, float64[:, ::1])",
    wide=True,
)
def parallel_rows(
    ints: Indices, c: Array, x: Array, count: int, room: Array, columns: int, lines: Array
) -> None:
    """Rows of a block of samples, once the response to the impulse has died away."""
    m, q = ints[slots.INPUTS], ints[slots.ORDER]
    first = q * ints[slots.FREE]
    for r in range(m * q):
        states, column = room[r], room[columns + first + r]
        for k in range(count):
            column[k] = states[k + 1]
    at = columns + first + m * q
    for j in range(m):
        direct_terms(ints, c, room, at, j, count, lines)
        at += 1
    if ints[slots.OFFSET]:
        for k in range(count):
            room[at, k] = 1.0
        at += 1
    if ints[slots.DRIFT]:
        for k in range(count):
            room[at, k] = (x[slots.COUNT] + k) * c[slots.INTERVAL] + x[slots.EXTRA] - x[slots.BORN]
