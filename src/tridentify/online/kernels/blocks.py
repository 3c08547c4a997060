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

A block of samples into a triangle, compiled: row after row instead of sample after sample.
"""

from __future__ import annotations

import numpy as np
from numba import types

from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.compiled import compiled
from tridentify.numerics.recursive import LOST, NEGLIGIBLE, RENEWED, TINY
from tridentify.online.kernels import slots
from tridentify.online.kernels.filters import equation_rows, line_up, parallel_rows, run_inputs
from tridentify.online.kernels.intake import doubt, judge, learn, noise_scale, scatter
from tridentify.online.kernels.signatures import INTS, MANY, SAMPLES, TABLE, VECTOR, WHICH
from tridentify.online.kernels.workspace import (
    COSINES,
    ERRORS,
    FIT,
    LEFT,
    LEVERAGE,
    LONGEST,
    NOW,
    REFERENCE,
    SCALED_ERRORS,
    SINES,
)


@compiled(
    "void(float64[::1], int64, int64, int64, boolean, float64[:, ::1], int64, int64, int64, int64,"
    " float64, float64)",
    wide=True,
)
def turn_pivot(
    x: Array, at: int, n: int, i: int, newest: bool, room: Array, columns: int, work: int,
    own: int, count: int, factor: float, pace: float,
) -> None:  # fmt: skip
    """The pivot of column ``i`` sample by sample, and the rotation that each asks for.

    ``newest``: the pivots are what forgetting is measured by.
    """
    sines, cosines = room[own + SINES], room[own + COSINES]
    left, now = room[own + LEFT], room[own + NOW]
    leverage, reference = room[own + LEVERAGE], room[own + REFERENCE]
    lost = (1.0 - factor) * RENEWED
    forgets = factor < 1.0
    d, largest, arrived = x[at + i], x[at + 2 * n + i], x[at + 3 * n + i]
    source, coordinates = room[columns + i], room[work + i]
    for k in range(count):
        largest = max(largest, abs(source[k]))
        xi = coordinates[k]
        live = abs(xi) > NEGLIGIBLE * largest
        xi = xi if live else 0.0
        if forgets:
            arrived += pace * (xi * xi / (1.0 + leverage[k]) - arrived)
        leverage[k] += xi * xi / d
        if forgets and arrived >= lost * d:
            d *= factor
        if newest:
            reference[k] = d
        w = left[k]
        new = d + w * xi * xi
        share = 1.0 / new
        turned = live and w != 0.0 and new > TINY
        now[k] = xi if turned else 0.0
        sines[k] = w * xi * share if turned else 0.0
        cosines[k] = d * share if turned else 1.0
        left[k] = w * cosines[k]
        d = new if turned else d
    x[at + i], x[at + 2 * n + i], x[at + 3 * n + i] = d, largest, arrived


@compiled(
    "float64(float64[::1], int64, float64, int64, int64, float64[:, ::1], int64, int64, int64)",
    wide=True,
)
def turn_row(
    x: Array, u: int, t: float, i: int, n: int, room: Array, work: int, own: int, count: int
) -> float:
    """Row ``i`` of the triangle, at ``u``, and its target through the rotations; gives the target.

    Two columns at a time, as each is a chain of its own, the last one with the target.
    """
    sines, cosines, now = room[own + SINES], room[own + COSINES], room[own + NOW]
    fit, target = room[own + FIT], room[work + n]
    j = i + 1
    while j + 1 < n:
        one, two = room[work + j], room[work + j + 1]
        a, b = x[u + j - i - 1], x[u + j - i]
        for k in range(count):
            xi, s, cosine = now[k], sines[k], cosines[k]
            old, other = one[k], two[k]
            one[k] = old - xi * a
            two[k] = other - xi * b
            a = cosine * a + s * old
            b = cosine * b + s * other
        x[u + j - i - 1], x[u + j - i] = a, b
        j += 2
    if j < n:
        one = room[work + j]
        a = x[u + j - i - 1]
        for k in range(count):
            xi, s, cosine = now[k], sines[k], cosines[k]
            fit[k] += xi * t
            old, other = one[k], target[k]
            one[k] = old - xi * a
            target[k] = other - xi * t
            a = cosine * a + s * old
            t = cosine * t + s * other
        x[u + j - i - 1] = a
    else:
        for k in range(count):
            xi = now[k]
            fit[k] += xi * t
            other = target[k]
            target[k] = other - xi * t
            t = cosines[k] * t + sines[k] * other
    return t


@compiled(
    "void(float64[::1], int64, int64, int64, float64[:, ::1], int64, int64, int64, int64, float64,"
    " float64)",
    wide=True,
)
def turn_in(
    x: Array, at: int, n: int, first: int, room: Array, columns: int, work: int, own: int,
    count: int, factor: float, pace: float,
) -> None:  # fmt: skip
    """A block of samples into a triangle: what `innovate`, `forget` and `rotate` do to each.

    ``room[columns + i]`` holds column ``i`` of the rows, ``room[columns + n]`` the targets;
    ``work`` is room for as many. Fit and leverage before each sample are left in rows of their own.
    """
    for i in range(first, n + 1):
        source, copy = room[columns + i], room[work + i]
        for k in range(count):
            copy[k] = source[k]
    left, fit = room[own + LEFT], room[own + FIT]
    leverage, reference = room[own + LEVERAGE], room[own + REFERENCE]
    for k in range(count):
        left[k] = 1.0
        fit[k] = 0.0
        leverage[k] = 0.0
    u = at + 4 * n + first * (n - 1) - first * (first - 1) // 2
    for i in range(first, n):
        turn_pivot(x, at, n, i, i == first, room, columns, work, own, count, factor, pace)
        x[at + n + i] = turn_row(x, u, x[at + n + i], i, n, room, work, own, count)
        u += n - 1 - i
    if factor < 1.0:
        for i in range(first):
            d = x[at + i]
            for k in range(count):
                if d > LOST * reference[k]:
                    d *= factor
            x[at + i] = d


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
    x: Array, w: int, n: int, room: Array, own: int, targets: Array, count: int, factor: float,
) -> int:  # fmt: skip
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
    "void(int64[::1], float64[::1], int64, int64, float64[:, ::1], int64, int64, int64)",
    wide=True,
    inner=True,
)
def along_directions(
    ints: Indices, c: Array, output: int, first: int, room: Array, columns: int, to: int, count: int
) -> None:
    """The columns of a block of samples along the directions of the coefficients."""
    n = ints[slots.COLUMNS]
    maps = ints[slots.C_MAPS] + ints[slots.DIRECTIONS_STRIDE] * output
    for i in range(ints[slots.DIRECTIONS]):
        gathered = room[to + i]
        for j in range(count):
            gathered[j] = 0.0
        for s in range(first, n):
            weight, column = c[maps + i * n + s], room[columns + s]
            for j in range(count):
                gathered[j] += weight * column[j]


@compiled(
    "void(float64[::1], int64, int64, float64[::1], float64[:, ::1], int64, int64, int64)",
    wide=True,
    inner=True,
)
def add_scores(
    x: Array, scores: int, k: int, v: Array, room: Array, to: int, done: int, end: int
) -> None:
    """Add samples to the sums of ``k`` scores, and to those of their products."""
    m = scores + k
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


@compiled(
    "int64(int64[::1], float64[::1], float64[::1], int64, int64, float64[:, ::1], int64, int64,"
    " int64, int64)",
    wide=True,
)
def gather(
    ints: Indices, c: Array, x: Array, w: int, first: int, room: Array, columns: int, to: int,
    own: int, count: int,
) -> int:  # fmt: skip
    """The scores of a block of samples (`intake.watch`); how many are above judgement."""
    k, n = ints[slots.DIRECTIONS], ints[slots.COLUMNS]
    if k == 0:
        return count
    output = (w - ints[slots.AT_WATCH]) // ints[slots.WATCH]
    if ints[slots.DIRECTIONS_STRIDE] == 0:
        to = columns + n - k
    else:
        along_directions(ints, c, output, first, room, columns, to, count)
    for i in range(k):
        x[w + slots.SCORES + i] = room[to + i, count - 1]
    scores = w + slots.SCORES + k
    power = ints[slots.AT_SCATTER] + ints[slots.SCATTER] * output + slots.UNDER_WAY
    v = room[own + SCALED_ERRORS]
    done = 0
    while done < count:
        end = min(count, done + ints[slots.BLOCK] - int(x[w + slots.INSIDE]))
        squares = x[power]
        for j in range(done, end):
            squares += v[j] * v[j]
        x[power] = squares
        add_scores(x, scores, k, v, room, to, done, end)
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
    ints: Indices, c: Array, x: Array, output: int, room: Array, columns: int, work: int,
    directions: int, own: int, count: int, first: int,
) -> int:  # fmt: skip
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
    ints: Indices, c: Array, x: Array, u: Array, y: Array, start: int, count: int,
    lines: Array, flags: Indices,
) -> None:  # fmt: skip
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


@compiled(MANY, wide=True, value=True)
def take_block(
    ints: Indices, c: Array, x: Array, u: Array, y: Array, start: int, most: int,
    innovations: Array, flags: Indices, room: Array, lines: Array, zeros: Array, kept: Array,
) -> int:  # fmt: skip
    """As many samples as may be taken together, but ``most``; gives their number."""
    on_equation = int(ints[slots.COEFFICIENTS] > 0)
    q, m, p, n = ints[slots.ORDER], ints[slots.INPUTS], ints[slots.OUTPUTS], ints[slots.COLUMNS]
    if c[slots.FORGETTING] < 1.0 and ints[slots.KIND] != slots.EXPONENTIAL:
        return 0
    if on_equation and (ints[slots.FILTERING] or p > 1 or c[ints[slots.C_MONIC] + q + 1] != 1.0):
        return 0
    # rows of the workspace: filters, of the output first, columns, targets, and copies of these
    inputs = ints[slots.AT_INPUTS] if on_equation else ints[slots.AT_ROW] + q * ints[slots.FREE]
    outputs, columns = q * on_equation, q * (m + on_equation) + on_equation
    work = columns + n + 1
    directions = work + n + 1
    own, first = directions + ints[slots.DIRECTIONS], int(x[slots.FIRST])
    count = quiet(ints, x, u, y, start, most)
    copy(x, kept)
    while count >= SHORTEST:
        line_up(ints, x, u, start, count, lines)
        for r in range(m * q):
            room[outputs + r, 0] = x[inputs + r]
        run_inputs(ints, c, x, room, outputs, count, lines, zeros)
        if on_equation:
            equation_rows(ints, c, x, y, start, count, room, columns, lines)
        else:
            parallel_rows(ints, c, x, count, room, columns, lines)
        taken, targets, errors = count, room[columns + n], room[own + ERRORS]
        for i in range(p):
            if not on_equation:
                for k in range(count):
                    targets[k] = y[start + k, i]
            taken = absorb_block(ints, c, x, i, room, columns, work, directions, own, count, first)
            if taken < count:
                break
            for k in range(count):
                innovations[start + k, i] = errors[k]
        if taken == count:
            for r in range(m * q):
                x[inputs + r] = room[outputs + r, count]
            for r in range(outputs):
                x[ints[slots.AT_OUTPUTS] + r] = room[r, count]
            if on_equation:
                x[ints[slots.AT_BEFORE]] = y[start + count - 1, 0]
            count_block(ints, c, x, u, y, start, count, lines, flags)
            return count
        copy(kept, x)
        count = taken
    return 0
