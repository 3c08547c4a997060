"""Step 1 sample by sample, compiled: the bank of operators driven by the input, and its triangle.

The row of a sample holds the states of the bank (`numerics.realization`), exact for the stated
intersample behaviour: with ``w_j`` the input ``j`` as it arrives, late by a whole number of
samples and a part of one,

    x_j(k) = F x_j(k-1) + g_0 w_j(k) + g_1 w_j(k-1) + g_2 w_j(k-2),

the response of the same bank to an impulse at the first sample (an unknown initial state), the
inputs themselves, a one and the time. Each output has a triangle of its own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tridentify.numerics.recursive import compiled, forget, innovate, rotate
from tridentify.online.kernels.blocks import SHORTEST, absorb_block, count_block, quiet
from tridentify.online.kernels.filters import direct_terms, line_up, run_inputs
from tridentify.online.kernels.intake import count, doubt, learn, noise_scale, take_in, watch
from tridentify.online.kernels.signatures import MANY
from tridentify.online.kernels.slots import (
    ALARMED,
    AT_FACTOR,
    AT_LINE,
    AT_ROW,
    AT_WATCH,
    AT_WORK,
    BEGIN,
    BORN,
    C_DIRECT,
    C_EXTRA,
    C_START,
    C_STEP,
    C_TAPS,
    COLLECTING,
    COLUMNS,
    COUNT,
    CUT,
    DIRECTIONAL,
    DIRECTIONS,
    DRIFT,
    EVENT,
    EXPONENTIAL,
    EXTRA,
    FACTOR,
    FIRST,
    FITTED,
    FLAGS,
    FORGETTING,
    FREE,
    HELD_BLOCKS,
    IDLE,
    IDLE_BLOCKS,
    INBOX,
    INNOVATION,
    INPUTS,
    INTERVAL,
    KIND,
    LARGE,
    LEARNING,
    LINE,
    MOST_REFUSED,
    MOVED,
    NOT_EXCITED,
    NOT_READY,
    OFFSET,
    ORDER,
    OUTLIER,
    OUTPUTS,
    PACE,
    REFUSED,
    RESETTING,
    SCALE,
    SCALE_PACE,
    SINCE,
    SQUARES,
    TAKEN,
    TIME,
    TOLD,
    UPPER,
    WATCH,
    WEIGHT,
    WEIGHT2,
)
from tridentify.online.kernels.turning import ERRORS

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@compiled("void(int64[::1], float64[::1], float64[::1])", inline=True)
def advance(ints: Ints, c: Array, x: Array) -> None:
    """The states of the bank at the sample whose input was taken in."""
    m, q, upper = ints[INPUTS], ints[ORDER], ints[UPPER]
    f, taps, line = ints[C_STEP], ints[C_TAPS], ints[LINE]
    row, work = ints[AT_ROW], ints[AT_WORK]
    since = x[SINCE]
    first = 0
    if ints[FREE]:
        if since > ints[BEGIN] and x[FIRST] == 0.0:
            largest = 0.0
            for i in range(q):
                total = 0.0
                for s in range(min(i + 1 + upper, q)):
                    total += c[f + i * q + s] * x[row + s]
                x[work + i] = total
                largest = max(largest, abs(total))
            for i in range(q):
                x[row + i] = x[work + i]
            if largest < c[ints[C_START]]:
                x[FIRST] = float(q)
                for i in range(q):
                    x[row + i] = 0.0
        elif since == ints[BEGIN]:
            for i in range(q):
                x[row + i] = c[ints[C_START] + 1 + i]
        first = q
    if since == 0.0:
        return
    for j in range(m):
        own = row + first + j * q
        late = ints[AT_LINE] + j * line + int(c[ints[C_EXTRA] + j])
        g = taps + 3 * j * q
        now, new = x[own : own + q], x[work : work + q]
        arrived, before, earlier = x[late], x[late + 1], x[late + 2]
        for i in range(q):
            total = c[g + i] * arrived + c[g + q + i] * before + c[g + 2 * q + i] * earlier
            transition = c[f + i * q : f + (i + 1) * q]
            for s in range(min(i + 1 + upper, q)):
                total += transition[s] * now[s]
            new[i] = total
        for i in range(q):
            now[i] = new[i]


@compiled("void(int64[::1], float64[::1], float64[::1])", inline=True)
def complete_row(ints: Ints, c: Array, x: Array) -> None:
    """The inputs as they arrive, the constant and the time behind the states."""
    m, q = ints[INPUTS], ints[ORDER]
    at = ints[AT_ROW] + q * (m + ints[FREE])
    for j in range(m):
        late = ints[AT_LINE] + j * ints[LINE] + int(c[ints[C_EXTRA] + j])
        h = ints[C_DIRECT] + 2 * j
        x[at] = c[h] * x[late] + c[h + 1] * x[late + 1]
        at += 1
    if ints[OFFSET]:
        x[at] = 1.0
        at += 1
    if ints[DRIFT]:
        x[at] = x[TIME] - x[BORN]


@compiled("void(int64[::1], float64[::1], float64[::1], int64, int64, float64, boolean)")
def refuse(ints: Ints, c: Array, x: Array, w: int, first: int, error: float, ready: bool) -> None:
    """A doubtful sample: one far off still counts as a hint that the coefficients have moved."""
    if int(x[FLAGS]) & OUTLIER:
        x[w + REFUSED] += 1.0
        # refused samples count for the scale, or one that is too small would stay so
        x[w + SCALE] *= 1.0 + max(4.0 / (x[w + TAKEN] + 8.0), SCALE_PACE)
        watch(ints, c, x, w, first, TOLD if error > 0.0 else -TOLD, ready)
        if x[w + REFUSED] > MOST_REFUSED:
            x[w + MOVED] = 1.0


@compiled(
    "void(float64[::1], int64, int64, int64, int64, int64, float64, float64, float64, float64)"
)
def forget_along(
    x: Array, at: int, n: int, first: int, row: int, work: int, y: float, error: float,
    leverage: float, factor: float,
) -> None:  # fmt: skip
    """Directional forgetting, after the row has been absorbed (`numerics.recursive`)."""
    beta = factor
    if leverage < np.inf:
        beta = factor - (1.0 - factor) / leverage if leverage > 0.0 else 1.0
    if leverage > 1e-12:
        new = y - (error / (1.0 + leverage) if leverage < np.inf else 0.0)
        rotate(x, at, n, first, row, work, new, beta - 1.0)


@compiled("void(float64[::1], int64, int64, int64, float64)")
def reset(x: Array, w: int, at: int, n: int, factor: float) -> None:
    """Most of what was learnt loses its weight, once in a memory."""
    period = np.floor(1.0 / (1.0 - factor) + 0.5)
    if x[SINCE] % period == period - 1.0 and x[w + IDLE] == 0.0:
        for i in range(n):
            x[at + i] *= CUT
        x[w + SQUARES] *= CUT
        x[w + WEIGHT] *= CUT
        x[w + WEIGHT2] *= CUT * CUT


@compiled(
    "float64(int64[::1], float64[::1], float64[::1], int64, int64, int64, int64, float64)",
    inline=True,
)
def absorb(ints: Ints, c: Array, x: Array, w: int, at: int, n: int, first: int, y: float) -> float:
    """One row with its target into one triangle, unless it is doubtful; gives the innovation."""
    row, work = ints[AT_ROW], ints[AT_WORK]
    fitted, leverage = innovate(x, at, n, first, row, work)
    error = y - fitted
    x[w + FITTED] = fitted
    x[w + INNOVATION] = error
    root = np.sqrt(1.0 + leverage)
    known = x[w + SCALE] > 0.0
    ready = x[w + TAKEN] > 10.0 * n + 30.0
    scale = noise_scale(x, w)
    if doubt(x, w, y, fitted, leverage, scale * root, n):
        refuse(ints, c, x, w, first, error, ready)
        return error
    x[w + REFUSED] = 0.0
    v = error / root
    if known and leverage < 1.0:
        z = v / scale
        z = min(max(z, -LARGE), LARGE)
        watch(ints, c, x, w, first, z, ready)
    if ints[LEARNING] > 0 and x[w + IDLE] >= HELD_BLOCKS:
        return error
    factor = c[FORGETTING]
    kind = ints[KIND]
    kept = 1.0
    if factor < 1.0 and kind == EXPONENTIAL:
        kept = factor
        forget(x, at, n, first, work, factor, c[PACE])
    rotate(x, at, n, first, row, work, y, 1.0)
    if factor < 1.0 and kind == DIRECTIONAL:
        kept = factor
        forget_along(x, at, n, first, row, work, y, error, leverage, factor)
    if factor < 1.0 and kind == RESETTING:
        reset(x, w, at, n, factor)
    if leverage < np.inf:
        x[w + SQUARES] = kept * x[w + SQUARES] + error * error / (1.0 + leverage / kept)
    learn(x, w, y, v if leverage < 1.0 else np.nan, kept)
    return error


@compiled("float64(int64[::1], float64[::1], float64[::1], float64)")
def parallel_step(ints: Ints, c: Array, x: Array, interval: float) -> float:
    """One sample, which stands in the inbox; gives the innovation of the first output."""
    take_in(ints, c, x, interval)
    if ints[COLLECTING]:
        x[FLAGS] = float(int(x[FLAGS]) | NOT_READY)
        for i in range(ints[OUTPUTS]):
            x[ints[AT_WATCH] + i * ints[WATCH] + INNOVATION] = np.nan
        count(ints, x)
        return np.nan
    advance(ints, c, x)
    complete_row(ints, c, x)
    n, first = ints[COLUMNS], int(x[FIRST])
    late = ints[FREE] and x[SINCE] < ints[BEGIN]
    for i in range(ints[OUTPUTS]):
        w = ints[AT_WATCH] + i * ints[WATCH]
        if late:
            x[w + INNOVATION] = np.nan
            continue
        absorb(
            ints, c, x, w, ints[AT_FACTOR] + i * ints[FACTOR], n, first,
            x[INBOX + ints[INPUTS] + i],
        )  # fmt: skip
        if x[w + IDLE] >= IDLE_BLOCKS:
            x[FLAGS] = float(int(x[FLAGS]) | NOT_EXCITED)
        if x[w + MOVED] > 0.0:
            x[EVENT] = float(int(x[EVENT]) | ALARMED)
    count(ints, x)
    return float(x[ints[AT_WATCH] + INNOVATION])


@compiled(
    "void(int64[::1], float64[::1], float64[::1], int64, float64[:, ::1], int64, float64[:, ::1],"
    " float64[::1])",
    wide=True,
)
def fill_rows(
    ints: Ints,
    c: Array,
    x: Array,
    count: int,
    room: Array,
    columns: int,
    lines: Array,
    zeros: Array,
) -> None:
    """Rows of a block of samples, once the response to the impulse has died away."""
    m, q = ints[INPUTS], ints[ORDER]
    first = q * ints[FREE]
    for r in range(m * q):
        room[r, 0] = x[ints[AT_ROW] + first + r]
    run_inputs(ints, c, x, room, 0, count, lines, zeros)
    for r in range(m * q):
        states, column = room[r], room[columns + first + r]
        for k in range(count):
            column[k] = states[k + 1]
    at = columns + first + m * q
    for j in range(m):
        direct_terms(ints, c, room, at, j, count, lines)
        at += 1
    if ints[OFFSET]:
        for k in range(count):
            room[at, k] = 1.0
        at += 1
    if ints[DRIFT]:
        for k in range(count):
            room[at, k] = (x[COUNT] + k) * c[INTERVAL] + x[EXTRA] - x[BORN]


@compiled(MANY, wide=True)
def parallel_block(
    ints: Ints,
    c: Array,
    x: Array,
    u: Array,
    y: Array,
    start: int,
    most: int,
    innovations: Array,
    flags: Ints,
    room: Array,
    lines: Array,
    zeros: Array,
    kept: Array,
) -> int:
    """As many samples as may be taken together, but ``most``; gives their number."""
    if c[FORGETTING] < 1.0 and ints[KIND] != EXPONENTIAL:
        return 0
    count = quiet(ints, x, u, y, start, most)
    q, m, p, n = ints[ORDER], ints[INPUTS], ints[OUTPUTS], ints[COLUMNS]
    columns = q * m
    work = columns + n + 1
    directions = work + n + 1
    own = directions + ints[DIRECTIONS]
    first = int(x[FIRST])
    kept[:] = x
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
                x[ints[AT_ROW] + q * ints[FREE] + r] = room[r, count]
            count_block(ints, c, x, u, y, start, count, lines, flags)
            return count
        x[:] = kept
        count = taken
    return 0
