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

from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.compiled import compiled
from tridentify.online.kernels import slots
from tridentify.online.kernels.intake import doubt, judge, learn, noise_scale, scatter
from tridentify.online.kernels.signatures import INTS, SAMPLES, TABLE, VECTOR, WHICH
from tridentify.online.kernels.turning import turn_in
from tridentify.online.kernels.workspace import ERRORS, FIT, LEVERAGE, LONGEST, SCALED_ERRORS

SHORTEST = 4
"""Samples of the shortest block: fewer are quicker one by one."""


@compiled(types.void(VECTOR, VECTOR), inner=True)
def copy(source: Array, goal: Array) -> None:
    """The numbers of one vector into another: put by, or put back."""
    for k in range(source.size):
        goal[k] = source[k]


@compiled(types.int64(INTS, VECTOR, SAMPLES, SAMPLES, types.int64, types.int64), wide=True)
def quiet(ints: Indices, x: Array, u: Array, y: Array, start: int, most: int) -> int:
    """How many samples from ``start`` on, but ``most``, may be tried as a block."""
    count = min(most, LONGEST)
    if x[slots.TICK] > x[slots.COUNT]:
        count = min(count, int(x[slots.TICK] - x[slots.COUNT]) - 1)
    if x[slots.COUNT] < x[slots.ALARM]:
        count = min(count, int(x[slots.ALARM] - x[slots.COUNT]))
    if count < SHORTEST or ints[slots.COLLECTING] or ints[slots.CHUNK] > 0 or x[slots.SINCE] == 0.0:
        return 0
    if ints[slots.FREE] and x[slots.FIRST] == 0.0:
        return 0
    n = ints[slots.COLUMNS]
    for i in range(ints[slots.OUTPUTS]):
        w = ints[slots.AT_WATCH] + i * ints[slots.WATCH]
        known = x[w + slots.SCALE] > 0.0 and x[w + slots.TAKEN] > 10.0 * n + 30.0
        if not known or x[w + slots.IDLE] >= slots.HELD_BLOCKS:
            return 0
    m = ints[slots.INPUTS]
    for j in range(m + ints[slots.OUTPUTS]):
        bound = slots.SENSELESS * x[ints[slots.AT_LARGEST] + 2 * j]
        for i in range(count):
            size = abs(u[start + i, j]) if j < m else abs(y[start + i, j - m])
            if not (size <= bound and size < slots.LARGEST) or 0.0 < size < slots.SMALLEST:
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
    flags = x[slots.FLAGS]
    for k in range(count):
        y, leverage = targets[k], leverages[k]
        error = y - fit[k]
        root = np.sqrt(1.0 + leverage)
        scale = noise_scale(x, w)
        v = error / root
        if not leverage < 1.0 or doubt(x, w, y, fit[k], leverage, scale * root, n):
            x[slots.FLAGS] = flags
            return k
        score = v / scale
        scores[k] = min(max(score, -slots.LARGE), slots.LARGE)
        errors[k] = error
        x[w + slots.SQUARES] = factor * x[w + slots.SQUARES] + error * error / (
            1.0 + leverage / factor
        )
        learn(x, w, y, v, factor)
    return count


@compiled(
    "int64(int64[::1], float64[::1], float64[::1], int64, int64, float64[:, ::1], int64, int64,"
    " int64, int64)",
    wide=True,
)
def gather(
    ints: Indices,
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
    k, n = ints[slots.DIRECTIONS], ints[slots.COLUMNS]
    if k == 0:
        return count
    output = (w - ints[slots.AT_WATCH]) // ints[slots.WATCH]
    if ints[slots.DIRECTIONS_STRIDE] == 0:
        to = columns + n - k
    else:
        maps = ints[slots.C_MAPS] + ints[slots.DIRECTIONS_STRIDE] * output
        for i in range(k):
            gathered = room[to + i]
            for j in range(count):
                gathered[j] = 0.0
            for s in range(first, n):
                weight, column = c[maps + i * n + s], room[columns + s]
                for j in range(count):
                    gathered[j] += weight * column[j]
    for i in range(k):
        x[w + slots.SCORES + i] = room[to + i, count - 1]
    scores = w + slots.SCORES + k
    power = ints[slots.AT_SCATTER] + ints[slots.SCATTER] * output + slots.UNDER_WAY
    v = room[own + SCALED_ERRORS]
    done = 0
    while done < count:
        end = min(count, done + ints[slots.BLOCK] - int(x[w + slots.INSIDE]))
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
        x[w + slots.INSIDE] += float(end - done)
        done = end
        if x[w + slots.INSIDE] >= ints[slots.BLOCK]:
            x[w + slots.INSIDE] = 0.0
            scatter(ints, c, x, w)
            x[power] = 0.0
            scale = 0
            while judge(ints, x, w, scale, True):
                scale += 1
            if x[w + slots.IDLE] >= slots.HELD_BLOCKS or x[w + slots.MOVED] > 0.0:
                return int(done - 1)
    return count


@compiled(
    "int64(int64[::1], float64[::1], float64[::1], int64, float64[:, ::1], int64, int64, int64,"
    " int64, int64, int64)",
    wide=True,
)
def absorb_block(
    ints: Indices,
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
    n = ints[slots.COLUMNS]
    w = ints[slots.AT_WATCH] + output * ints[slots.WATCH]
    at = ints[slots.AT_FACTOR] + output * ints[slots.FACTOR]
    for i in range(first, n):
        if not x[at + i] > 0.0:
            return 0
    factor = c[slots.FORGETTING]
    turn_in(x, at, n, first, room, columns, work, own, count, factor, c[slots.PACE])
    targets = room[columns + n]
    taken = settle(x, w, n, room, own, targets, count, factor)
    if taken < count:
        return taken
    taken = gather(ints, c, x, w, first, room, columns, directions, own, count)
    x[w + slots.REFUSED] = 0.0
    x[w + slots.FITTED] = room[own + FIT, count - 1]
    x[w + slots.INNOVATION] = room[own + ERRORS, count - 1]
    return taken


@compiled(types.void(*WHICH, TABLE, INTS), wide=True)
def count_block(
    ints: Indices,
    c: Array,
    x: Array,
    u: Array,
    y: Array,
    start: int,
    count: int,
    lines: Array,
    flags: Indices,
) -> None:
    """What `take_in` and `count` do to each sample of a block that was taken."""
    m, p = ints[slots.INPUTS], ints[slots.OUTPUTS]
    found = float(slots.CHANGED) if x[slots.COUNT] < x[slots.ALARM] else 0.0
    x[slots.FLAGS] = found
    x[slots.SEEN] = float(int(x[slots.SEEN]) | int(found))
    for k in range(count):
        flags[start + k] = int(found)
    for j in range(m + p):
        most = ints[slots.AT_LARGEST] + 2 * j
        largest = x[most]
        for k in range(count):
            largest = max(largest, abs(u[start + k, j]) if j < m else abs(y[start + k, j - m]))
        x[most], x[most + 1] = largest, 0.0
        x[slots.INBOX + j] = u[start + count - 1, j] if j < m else y[start + count - 1, j - m]
    past = ints[slots.LINE] - 1
    for j in range(m):
        at = ints[slots.AT_LINE] + j * ints[slots.LINE]
        for s in range(past + 1):
            x[at + s] = lines[j, past + count - 1 - s]
    x[slots.EVENT] = 0.0
    x[slots.COUNT] += float(count)
    x[slots.SINCE] += float(count)
    x[slots.TIME] = (x[slots.COUNT] - 1.0) * c[slots.INTERVAL] + x[slots.EXTRA]
