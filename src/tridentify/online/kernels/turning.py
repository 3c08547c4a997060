"""A block of samples into a triangle, compiled: row after row instead of sample after sample."""

from __future__ import annotations

from tridentify.numerics.arrays import Array
from tridentify.numerics.compiled import compiled
from tridentify.numerics.recursive import LOST, NEGLIGIBLE, RENEWED, TINY
from tridentify.online.kernels.workspace import COSINES, FIT, LEFT, LEVERAGE, NOW, REFERENCE, SINES


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
    x: Array,
    at: int,
    n: int,
    first: int,
    room: Array,
    columns: int,
    work: int,
    own: int,
    count: int,
    factor: float,
    pace: float,
) -> None:
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
