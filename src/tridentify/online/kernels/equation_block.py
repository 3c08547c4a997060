"""The equation error of many quiet samples at once, compiled (`online.kernels.blocks`)."""

from __future__ import annotations

from numba import types

from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.compiled import compiled
from tridentify.online.kernels import slots
from tridentify.online.kernels.blocks import SHORTEST, absorb_block, copy, count_block, quiet
from tridentify.online.kernels.filters import direct_terms, line_up, run_filter, run_inputs
from tridentify.online.kernels.signatures import INTS, MANY, SAMPLES, TABLE, VECTOR
from tridentify.online.kernels.workspace import ERRORS


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
        INTS, VECTOR, VECTOR, SAMPLES, types.int64, types.int64, TABLE, types.int64, TABLE, VECTOR
    ),
    wide=True,
)  # fmt: skip
def build_block(
    ints: Indices,
    c: Array,
    x: Array,
    y: Array,
    start: int,
    count: int,
    room: Array,
    columns: int,
    lines: Array,
    zeros: Array,
) -> None:
    """Filters and rows of a block of samples of one output (`advance_inputs`, `build_row`)."""
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
    for r in range(m * q):
        room[q + r, 0] = x[ints[slots.AT_INPUTS] + r]
    run_inputs(ints, c, x, room, q, count, lines, zeros)
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


@compiled(MANY, wide=True, value=True)
def equation_block(
    ints: Indices,
    c: Array,
    x: Array,
    u: Array,
    y: Array,
    start: int,
    most: int,
    innovations: Array,
    flags: Indices,
    room: Array,
    lines: Array,
    zeros: Array,
    kept: Array,
) -> int:
    """As many samples as may be taken together, but ``most``; gives their number."""
    usual = c[slots.FORGETTING] == 1.0 or ints[slots.KIND] == slots.EXPONENTIAL
    weight = c[ints[slots.C_MONIC] + ints[slots.ORDER] + 1]
    if ints[slots.FILTERING] or ints[slots.OUTPUTS] > 1 or not usual or weight != 1.0:
        return 0
    count = quiet(ints, x, u, y, start, most)
    q, m = ints[slots.ORDER], ints[slots.INPUTS]
    columns = q * (m + 1) + 1
    work = columns + ints[slots.COLUMNS] + 1
    own = work + ints[slots.COLUMNS] + 1
    copy(x, kept)
    while count >= SHORTEST:
        line_up(ints, x, u, start, count, lines)
        build_block(ints, c, x, y, start, count, room, columns, lines, zeros)
        first = int(x[slots.FIRST])
        taken = absorb_block(ints, c, x, 0, room, columns, work, own, own, count, first)
        if taken == count:
            for r in range(q):
                x[ints[slots.AT_OUTPUTS] + r] = room[r, count]
            for r in range(m * q):
                x[ints[slots.AT_INPUTS] + r] = room[q + r, count]
            x[ints[slots.AT_BEFORE]] = y[start + count - 1, 0]
            errors = room[own + ERRORS]
            for k in range(count):
                innovations[start + k, 0] = errors[k]
            count_block(ints, c, x, u, y, start, count, lines, flags)
            return count
        copy(kept, x)
        count = taken
    return 0
