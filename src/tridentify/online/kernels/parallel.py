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

from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.compiled import linked as compiled
from tridentify.online.kernels import slots
from tridentify.online.kernels.absorb import absorb
from tridentify.online.kernels.intake import count, die_away, drive, nothing_told, take_in, tell


@compiled("void(int64[::1], float64[::1], float64[::1])", inline=True)
def advance(ints: Indices, c: Array, x: Array) -> None:
    """The states of the bank at the sample whose input was taken in."""
    q, row = ints[slots.ORDER], ints[slots.AT_ROW]
    if ints[slots.FREE] and die_away(ints, c, x, row):
        x[slots.FIRST] = float(q)
        for i in range(q):
            x[row + i] = 0.0
    if x[slots.SINCE] > 0.0:
        drive(ints, c, x, row + q * ints[slots.FREE])


@compiled("void(int64[::1], float64[::1], float64[::1])", inline=True)
def complete_row(ints: Indices, c: Array, x: Array) -> None:
    """The inputs as they arrive, the constant and the time behind the states."""
    m, q = ints[slots.INPUTS], ints[slots.ORDER]
    at = ints[slots.AT_ROW] + q * (m + ints[slots.FREE])
    for j in range(m):
        late = ints[slots.AT_LINE] + j * ints[slots.LINE] + int(c[ints[slots.C_EXTRA] + j])
        h = ints[slots.C_DIRECT] + 2 * j
        x[at] = c[h] * x[late] + c[h + 1] * x[late + 1]
        at += 1
    if ints[slots.OFFSET]:
        x[at] = 1.0
        at += 1
    if ints[slots.DRIFT]:
        x[at] = x[slots.TIME] - x[slots.BORN]


@compiled("float64(int64[::1], float64[::1], float64[::1], float64)", value=True)
def parallel_step(ints: Indices, c: Array, x: Array, interval: float) -> float:
    """One sample, which stands in the inbox; gives the innovation of the first output."""
    take_in(ints, c, x, interval)
    if ints[slots.COLLECTING]:
        return nothing_told(ints, x)
    advance(ints, c, x)
    complete_row(ints, c, x)
    n, first = ints[slots.COLUMNS], int(x[slots.FIRST])
    late = ints[slots.FREE] and x[slots.SINCE] < ints[slots.BEGIN]
    for i in range(ints[slots.OUTPUTS]):
        w = ints[slots.AT_WATCH] + i * ints[slots.WATCH]
        if late:
            x[w + slots.INNOVATION] = np.nan
            continue
        absorb(
            ints, c, x, w, ints[slots.AT_FACTOR] + i * ints[slots.FACTOR], n, first,
            x[slots.INBOX + ints[slots.INPUTS] + i],
        )  # fmt: skip
        tell(ints, x, w)
    count(ints, x)
    return float(x[ints[slots.AT_WATCH] + slots.INNOVATION])
