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

from tridentify.numerics.arrays import Array
from tridentify.numerics.compiled import compiled
from tridentify.online.kernels.absorb import absorb
from tridentify.online.kernels.intake import count, take_in
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
    DRIFT,
    EVENT,
    FACTOR,
    FIRST,
    FLAGS,
    FREE,
    IDLE,
    IDLE_BLOCKS,
    INBOX,
    INNOVATION,
    INPUTS,
    LINE,
    MOVED,
    NOT_EXCITED,
    NOT_READY,
    OFFSET,
    ORDER,
    OUTPUTS,
    SINCE,
    TIME,
    UPPER,
    WATCH,
)

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


@compiled("float64(int64[::1], float64[::1], float64[::1], float64)", value=True)
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
