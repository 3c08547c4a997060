"""Step 1 on many quiet samples at once, compiled (`online.kernels.blocks`)."""

from __future__ import annotations

from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.compiled import compiled
from tridentify.online.kernels import slots
from tridentify.online.kernels.blocks import SHORTEST, absorb_block, copy, count_block, quiet
from tridentify.online.kernels.filters import direct_terms, line_up, run_inputs
from tridentify.online.kernels.signatures import MANY
from tridentify.online.kernels.workspace import ERRORS


@compiled(
    "void(int64[::1], float64[::1], float64[::1], int64, float64[:, ::1], int64, float64[:, ::1],"
    " float64[::1])",
    wide=True,
)
def fill_rows(
    ints: Indices,
    c: Array,
    x: Array,
    count: int,
    room: Array,
    columns: int,
    lines: Array,
    zeros: Array,
) -> None:
    """Rows of a block of samples, once the response to the impulse has died away."""
    m, q = ints[slots.INPUTS], ints[slots.ORDER]
    first = q * ints[slots.FREE]
    for r in range(m * q):
        room[r, 0] = x[ints[slots.AT_ROW] + first + r]
    run_inputs(ints, c, x, room, 0, count, lines, zeros)
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


@compiled(MANY, wide=True, value=True)
def parallel_block(
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
    if c[slots.FORGETTING] < 1.0 and ints[slots.KIND] != slots.EXPONENTIAL:
        return 0
    count = quiet(ints, x, u, y, start, most)
    q, m, p, n = ints[slots.ORDER], ints[slots.INPUTS], ints[slots.OUTPUTS], ints[slots.COLUMNS]
    columns = q * m
    work = columns + n + 1
    directions = work + n + 1
    own = directions + ints[slots.DIRECTIONS]
    first = int(x[slots.FIRST])
    copy(x, kept)
    while count >= SHORTEST:
        line_up(ints, x, u, start, count, lines)
        fill_rows(ints, c, x, count, room, columns, lines, zeros)
        taken = count
        for i in range(p):
            targets, errors = room[columns + n], room[own + ERRORS]
            for k in range(count):
                targets[k] = y[start + k, i]
            taken = absorb_block(ints, c, x, i, room, columns, work, directions, own, count, first)
            if taken < count:
                break
            for k in range(count):
                innovations[start + k, i] = errors[k]
        if taken == count:
            for r in range(m * q):
                x[ints[slots.AT_ROW] + q * ints[slots.FREE] + r] = room[r, count]
            count_block(ints, c, x, u, y, start, count, lines, flags)
            return count
        copy(kept, x)
        count = taken
    return 0
