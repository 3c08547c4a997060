"""Many quiet samples at once, compiled: what single steps do, in another order.

Turning sample ``k`` into row ``i`` of a triangle needs that row after sample ``k - 1`` and the
sample after the rows above. So a block of samples may pass row after row instead of sample after
sample: the row stays in registers, the divisions of successive samples overlap, and what does not
depend on the triangle runs over whole columns. Every number goes through the same operations in
the same order as in single steps, hence the result is the same, bit for bit.

A block holds samples that are simply taken in. It ends before one that is missing, out of size or
doubtful (`online.kernels.intake`), before the slow clock, and before a judgement that finds a
change or a rest; these are left to the single step. If that shows only when samples beyond have
been taken, everything is put back and the shorter block is done again.
"""

from __future__ import annotations

import numpy as np
from numba import types
from numpy.typing import NDArray

from tridentify.numerics.arrays import Array
from tridentify.numerics.compiled import compiled
from tridentify.online.kernels.intake import doubt, judge, learn, noise_scale, scatter
from tridentify.online.kernels.signatures import INTS, SAMPLES, TABLE, VECTOR, WHICH
from tridentify.online.kernels.slots import (
    ALARM,
    AT_FACTOR,
    AT_LARGEST,
    AT_LINE,
    AT_SCATTER,
    AT_WATCH,
    BLOCK,
    C_MAPS,
    CHANGED,
    CHUNK,
    COLLECTING,
    COLUMNS,
    COUNT,
    DIRECTIONS,
    DIRECTIONS_STRIDE,
    EVENT,
    EXTRA,
    FACTOR,
    FIRST,
    FITTED,
    FLAGS,
    FORGETTING,
    FREE,
    HELD_BLOCKS,
    IDLE,
    INBOX,
    INNOVATION,
    INPUTS,
    INSIDE,
    INTERVAL,
    LARGE,
    LARGEST,
    LINE,
    MOVED,
    OUTPUTS,
    PACE,
    REFUSED,
    SCALE,
    SCATTER,
    SCORES,
    SEEN,
    SENSELESS,
    SINCE,
    SMALLEST,
    SQUARES,
    TAKEN,
    TICK,
    TIME,
    UNDER_WAY,
    WATCH,
)
from tridentify.online.kernels.turning import turn_in
from tridentify.online.kernels.workspace import ERRORS, FIT, LEVERAGE, LONGEST, SCALED_ERRORS

Ints = NDArray[np.int64]

SHORTEST = 4
"""Samples of the shortest block: fewer are quicker one by one."""


@compiled(types.int64(INTS, VECTOR, SAMPLES, SAMPLES, types.int64, types.int64), wide=True)
def quiet(ints: Ints, x: Array, u: Array, y: Array, start: int, most: int) -> int:
    """How many samples from ``start`` on, but ``most``, may be tried as a block."""
    count = min(most, LONGEST)
    if x[TICK] > x[COUNT]:
        count = min(count, int(x[TICK] - x[COUNT]) - 1)
    if x[COUNT] < x[ALARM]:
        count = min(count, int(x[ALARM] - x[COUNT]))
    if count < SHORTEST or ints[COLLECTING] or ints[CHUNK] > 0 or x[SINCE] == 0.0:
        return 0
    if ints[FREE] and x[FIRST] == 0.0:
        return 0
    n = ints[COLUMNS]
    for i in range(ints[OUTPUTS]):
        w = ints[AT_WATCH] + i * ints[WATCH]
        known = x[w + SCALE] > 0.0 and x[w + TAKEN] > 10.0 * n + 30.0
        if not known or x[w + IDLE] >= HELD_BLOCKS:
            return 0
    m = ints[INPUTS]
    for j in range(m + ints[OUTPUTS]):
        bound = SENSELESS * x[ints[AT_LARGEST] + 2 * j]
        for i in range(count):
            size = abs(u[start + i, j]) if j < m else abs(y[start + i, j - m])
            if not (size <= bound and size < LARGEST) or 0.0 < size < SMALLEST:
                count = i
                break
    return count


@compiled(
    "int64(float64[::1], int64, int64, float64[:, ::1], int64, float64[::1], int64, float64)",
    wide=True,
)
def settle(
    x: Array,
    w: int,
    n: int,
    room: Array,
    own: int,
    targets: Array,
    count: int,
    factor: float,
) -> int:
    """Doubt the samples of a block and learn from them; how many are above doubt."""
    fit, leverages = room[own + FIT], room[own + LEVERAGE]
    errors, scores = room[own + ERRORS], room[own + SCALED_ERRORS]
    flags = x[FLAGS]
    for k in range(count):
        y, leverage = targets[k], leverages[k]
        error = y - fit[k]
        root = np.sqrt(1.0 + leverage)
        scale = noise_scale(x, w)
        v = error / root
        if not leverage < 1.0 or doubt(x, w, y, fit[k], leverage, scale * root, n):
            x[FLAGS] = flags
            return k
        score = v / scale
        scores[k] = min(max(score, -LARGE), LARGE)
        errors[k] = error
        x[w + SQUARES] = factor * x[w + SQUARES] + error * error / (1.0 + leverage / factor)
        learn(x, w, y, v, factor)
    return count


@compiled(
    "int64(int64[::1], float64[::1], float64[::1], int64, int64, float64[:, ::1], int64, int64,"
    " int64, int64)",
    wide=True,
)
def gather(
    ints: Ints,
    c: Array,
    x: Array,
    w: int,
    first: int,
    room: Array,
    columns: int,
    to: int,
    own: int,
    count: int,
) -> int:
    """The scores of a block of samples (`intake.watch`); how many are above judgement."""
    k, n = ints[DIRECTIONS], ints[COLUMNS]
    if k == 0:
        return count
    if ints[DIRECTIONS_STRIDE] == 0:
        to = columns + n - k
    else:
        maps = ints[C_MAPS] + ints[DIRECTIONS_STRIDE] * ((w - ints[AT_WATCH]) // ints[WATCH])
        for i in range(k):
            gathered = room[to + i]
            for j in range(count):
                gathered[j] = 0.0
            for s in range(first, n):
                weight, column = c[maps + i * n + s], room[columns + s]
                for j in range(count):
                    gathered[j] += weight * column[j]
    for i in range(k):
        x[w + SCORES + i] = room[to + i, count - 1]
    scores = w + SCORES + k
    power = ints[AT_SCATTER] + ints[SCATTER] * ((w - ints[AT_WATCH]) // ints[WATCH]) + UNDER_WAY
    v = room[own + SCALED_ERRORS]
    done = 0
    while done < count:
        end = min(count, done + ints[BLOCK] - int(x[w + INSIDE]))
        m = scores + k
        squares = x[power]
        for j in range(done, end):
            squares += v[j] * v[j]
        x[power] = squares
        for i in range(k):
            one = room[to + i]
            total = x[scores + i]
            last = x[m + i]
            for j in range(done, end):
                value = one[j]
                total += value * v[j]
                last += value * value
            x[scores + i], x[m + i] = total, last
            s = 0
            while s + 1 < i:
                two, three = room[to + s], room[to + s + 1]
                a, b = x[m + s], x[m + s + 1]
                for j in range(done, end):
                    value = one[j]
                    a += value * two[j]
                    b += value * three[j]
                x[m + s], x[m + s + 1] = a, b
                s += 2
            if s < i:
                two = room[to + s]
                a = x[m + s]
                for j in range(done, end):
                    a += one[j] * two[j]
                x[m + s] = a
            m += i + 1
        x[w + INSIDE] += float(end - done)
        done = end
        if x[w + INSIDE] >= ints[BLOCK]:
            x[w + INSIDE] = 0.0
            scatter(ints, c, x, w)
            x[power] = 0.0
            scale = 0
            while judge(ints, x, w, scale, True):
                scale += 1
            if x[w + IDLE] >= HELD_BLOCKS or x[w + MOVED] > 0.0:
                return int(done - 1)
    return count


@compiled(
    "int64(int64[::1], float64[::1], float64[::1], int64, float64[:, ::1], int64, int64, int64,"
    " int64, int64, int64)",
    wide=True,
)
def absorb_block(
    ints: Ints,
    c: Array,
    x: Array,
    output: int,
    room: Array,
    columns: int,
    work: int,
    directions: int,
    own: int,
    count: int,
    first: int,
) -> int:
    """A block of rows with their targets into one triangle; how many of them were taken rightly."""
    n = ints[COLUMNS]
    w = ints[AT_WATCH] + output * ints[WATCH]
    at = ints[AT_FACTOR] + output * ints[FACTOR]
    for i in range(first, n):
        if not x[at + i] > 0.0:
            return 0
    factor = c[FORGETTING]
    turn_in(x, at, n, first, room, columns, work, own, count, factor, c[PACE])
    targets = room[columns + n]
    taken = settle(x, w, n, room, own, targets, count, factor)
    if taken < count:
        return taken
    taken = gather(ints, c, x, w, first, room, columns, directions, own, count)
    x[w + REFUSED] = 0.0
    x[w + FITTED] = room[own + FIT, count - 1]
    x[w + INNOVATION] = room[own + ERRORS, count - 1]
    return taken


@compiled(types.void(*WHICH, TABLE, INTS), wide=True)
def count_block(
    ints: Ints,
    c: Array,
    x: Array,
    u: Array,
    y: Array,
    start: int,
    count: int,
    lines: Array,
    flags: Ints,
) -> None:
    """What `take_in` and `count` do to each sample of a block that was taken."""
    m, p = ints[INPUTS], ints[OUTPUTS]
    found = float(CHANGED) if x[COUNT] < x[ALARM] else 0.0
    x[FLAGS] = found
    x[SEEN] = float(int(x[SEEN]) | int(found))
    for k in range(count):
        flags[start + k] = int(found)
    for j in range(m + p):
        most = ints[AT_LARGEST] + 2 * j
        largest = x[most]
        for k in range(count):
            largest = max(largest, abs(u[start + k, j]) if j < m else abs(y[start + k, j - m]))
        x[most], x[most + 1] = largest, 0.0
        x[INBOX + j] = u[start + count - 1, j] if j < m else y[start + count - 1, j - m]
    past = ints[LINE] - 1
    for j in range(m):
        at = ints[AT_LINE] + j * ints[LINE]
        for s in range(past + 1):
            x[at + s] = lines[j, past + count - 1 - s]
    x[EVENT] = 0.0
    x[COUNT] += float(count)
    x[SINCE] += float(count)
    x[TIME] = (x[COUNT] - 1.0) * c[INTERVAL] + x[EXTRA]
