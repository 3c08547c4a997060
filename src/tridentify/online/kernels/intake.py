"""What every on-line estimator does with a sample, compiled: take it in, doubt it, watch it.

A whole estimator is one vector ``x`` of numbers. It begins with the slots named here, then come the
inbox for one sample, the delay line of the inputs, a watch for each output, and what the estimator
itself needs (`online.layout`). ``ints`` says where things stand and ``c`` holds the matrices;
both are fixed between two events.

*Doubt.* An innovation divided by its own standard deviation, ``v / sigma``, is of variance one
whatever has been learnt so far (`numerics.recursive`). Beyond six it is no noise (more, as long
as the scale is not well known); the sample is left out. The scale of the noise is followed by its
median, which a few far samples do not move. An output that repeats its value while the fit moves
away by four standard deviations is stuck. One that stays at the largest or smallest value it ever
had while the fit lies three beyond is saturated.

*Watch.* Let ``g = G' z`` be the sensitivities of the output to the coefficients, combinations of
the row ``z``. As long as the coefficients stay, the scores ``S = sum g v`` over a block have the
covariance ``sigma^2 M, M = sum g g'``, and ``T = S' M^{-1} S / sigma^2`` is for white noise a
chi-square with as many degrees of freedom ``k`` as there are directions in the block. Where the
noise is coloured ``T`` is larger at all times; it is divided by its own long mean. A change of
the coefficients moves the scores: with the cumulated sum ``c <- max(0, c + T - 2 k)`` (Page 1954;
the local approach, Basseville & Nikiforov 1993, section 8.2) an alarm is given at ``c > 40``: for
a chi-square ``exp(0.398 (T - 2 k))`` has the mean one, so a false one comes about once in
``exp(0.398 40)``, some eight million blocks. An estimator that looks into its alarms before it
believes them takes ``c > 20``, some three thousand blocks.

A small change adds to ``T`` in proportion to the length of the block. So blocks are judged on
three scales, each sixteen times as long as the one before, each with a sum of its own. A sample
that is left out as too far off counts as one of two standard deviations: a few of them are no
change, many in a row are.

The pivots of ``M``, in the order of the coefficients, say how much the block tells of a coefficient
beyond those before it. Below a hundredth of their mean the input does not excite it.

References
----------
E. S. Page, Biometrika 41 (1954), 100-115.
M. Basseville, I. Nikiforov, Detection of Abrupt Changes, Prentice Hall 1993.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tridentify.numerics.arrays import Array
from tridentify.numerics.compiled import compiled
from tridentify.online.kernels.slots import (
    ALARM,
    ALERT,
    AT_CHUNK,
    AT_FIRST,
    AT_FIRST_INPUT,
    AT_LARGEST,
    AT_LINE,
    AT_REFERENCE,
    AT_ROW,
    AT_SCATTER,
    AT_WATCH,
    BLOCK,
    BLOCKS,
    BLOCKS_FIRST,
    BLOCKS_USUAL,
    C_MAPS,
    CHANGED,
    CHUNK,
    CHUNK_FULL,
    COLUMNS,
    COUNT,
    DIRECTIONS,
    DIRECTIONS_STRIDE,
    DOUBLES,
    EQUILIBRIUM,
    EVENT,
    EXTRA,
    FAR,
    FILLED,
    FIRST_SCALED,
    FLAGS,
    FLOOR,
    FLOOR_PACE,
    FORGETTING,
    HEADER,
    HIGHEST,
    IDLE,
    IDLE_SHARE,
    INBOX,
    INPUTS,
    INSIDE,
    INTERVAL,
    JITTER,
    LARGEST,
    LAST,
    LEARNING,
    LEVELS,
    LIMITS,
    LINE,
    LOWEST,
    MEAN,
    MEAN_TO_MEDIAN,
    MISSING_INPUT,
    MISSING_OUTPUT,
    MOVED,
    NOT_READY,
    NUMBER,
    OUTLIER,
    OUTPUTS,
    PER_LEVEL,
    PER_SCALE,
    POWER,
    RARE,
    REPEATS,
    SATURATED,
    SCALE,
    SCALE_PACE,
    SCALED,
    SCALES,
    SCATTER,
    SCORES,
    SEEN,
    SENSELESS,
    SINCE,
    SMALLEST,
    SPREAD,
    STANDS,
    STUCK,
    SUMS,
    TAKEN,
    TICK,
    TICKED,
    TIME,
    TO_SCALE,
    TRACE,
    UNDER_WAY,
    UNSURE,
    WATCH,
    WEIGHT,
    WEIGHT2,
)

Ints = NDArray[np.int64]


@compiled("void(int64[::1], float64[::1], float64[::1], float64)", inline=True)
def take_in(ints: Ints, c: Array, x: Array, interval: float) -> None:
    """Count, keep the time, put the input into the delay line and the sample into the chunk."""
    m, p = ints[INPUTS], ints[OUTPUTS]
    flags = CHANGED if x[COUNT] < x[ALARM] else 0
    x[EVENT] = 0.0
    line, at = ints[LINE], ints[AT_LINE]
    for k in range(m + p):
        # a value a million times the largest so far is none, but for many in a row
        size = abs(x[INBOX + k])
        most = ints[AT_LARGEST] + 2 * k
        patience = 2.0 if k < m else 30.0
        if size <= SENSELESS * x[most] or x[most] == 0.0 or x[most + 1] >= patience:
            if size < LARGEST:
                x[most] = max(x[most], size)
                x[most + 1] = 0.0
        elif size < LARGEST:
            x[most + 1] += 1.0
            x[INBOX + k] = np.nan
            flags |= OUTLIER
        if size < SMALLEST:
            x[INBOX + k] = 0.0
        if k >= m and not (abs(x[INBOX + k]) < LARGEST):
            x[INBOX + k] = np.nan
            flags |= MISSING_OUTPUT
    for j in range(m):
        u = x[INBOX + j]
        own = at + j * line
        if not (abs(u) < LARGEST):
            flags |= MISSING_INPUT
            u = x[own] + x[ints[AT_REFERENCE] + j] if x[COUNT] > 0.0 else 0.0
            x[INBOX + j] = u
        for s in range(line - 1, 0, -1):
            x[own + s] = x[own + s - 1]
        if x[COUNT] == 0.0:
            x[ints[AT_FIRST_INPUT] + j] = u
            if ints[EQUILIBRIUM]:
                x[ints[AT_REFERENCE] + j] = u
        x[own] = u - x[ints[AT_REFERENCE] + j]
    if x[COUNT] > 0.0:
        if interval != c[INTERVAL]:
            x[EXTRA] += interval - c[INTERVAL]
            if abs(interval - c[INTERVAL]) > 1e-6 * c[INTERVAL]:
                flags |= JITTER
        x[TIME] = x[COUNT] * c[INTERVAL] + x[EXTRA]
    if ints[CHUNK] > 0:
        width = m + p + 1
        here = ints[AT_CHUNK] + int(x[FILLED]) * width
        x[here] = interval
        for s in range(m + p):
            x[here + 1 + s] = x[INBOX + s]
        x[FILLED] += 1.0
        if x[FILLED] >= ints[CHUNK]:
            x[EVENT] += CHUNK_FULL
    x[FLAGS] = float(flags)


@compiled("void(int64[::1], float64[::1])", inline=True)
def count(ints: Ints, x: Array) -> None:
    """The sample is done with."""
    x[COUNT] += 1.0
    x[SINCE] += 1.0
    if x[FLAGS] != 0.0:
        x[SEEN] = float(int(x[SEEN]) | (int(x[FLAGS]) & ~NOT_READY))
    if x[COUNT] == x[TICK]:
        x[EVENT] += TICKED


@compiled("float64(float64[::1], int64)", inline=True)
def noise_scale(x: Array, w: int) -> float:
    """Standard deviation of the noise, but no less than a trace of the output's."""
    return max(float(x[w + SCALE]), float(x[w + FLOOR]))


@compiled("boolean(float64[::1], int64, float64, float64, float64, float64, int64)", inline=True)
def doubt(x: Array, w: int, y: float, fitted: float, leverage: float, own: float, n: int) -> bool:
    """Whether a sample is to be left out; says why in the flags. ``own``: of the innovation."""
    if not (abs(y) < LARGEST):
        x[FLAGS] = float(int(x[FLAGS]) | MISSING_OUTPUT)
        x[w + REPEATS] = 0.0
        return True
    if y == x[w + LAST] and x[w + REPEATS] > 0.0:
        x[w + REPEATS] += 1.0
        if x[w + REPEATS] == 2.0:
            x[w + DOUBLES] += 1.0
    else:
        x[w + REPEATS] = 1.0
        x[w + AT_FIRST] = fitted
        x[w + STANDS] = 0.0
    x[w + LAST] = y
    limits = int(x[w + LIMITS])
    if y > x[w + HIGHEST]:
        x[w + HIGHEST] = y
        limits &= ~1
    if y < x[w + LOWEST]:
        x[w + LOWEST] = y
        limits &= ~2
    x[w + LIMITS] = float(limits)
    taken = x[w + TAKEN]
    if taken < 2.0 * n + 10.0 or not (leverage < 1.0) or x[w + SCALED] < FIRST_SCALED:
        return False
    error = y - fitted
    if x[w + REPEATS] >= 3.0:
        if y >= x[w + HIGHEST] and error < -3.0 * own:
            limits |= 1
        if y <= x[w + LOWEST] and error > 3.0 * own:
            limits |= 2
        x[w + LIMITS] = float(limits)
    if (limits & 1 and y >= x[w + HIGHEST]) or (limits & 2 and y <= x[w + LOWEST]):
        x[FLAGS] = float(int(x[FLAGS]) | SATURATED)
        return True
    if x[w + REPEATS] >= 5.0 and abs(fitted - x[w + AT_FIRST]) > 4.0 * own:
        x[w + STANDS] = 1.0
    if x[w + REPEATS] >= 2.0 and x[w + DOUBLES] < RARE * x[w + TAKEN]:
        x[w + STANDS] = 1.0
    if x[w + STANDS] > 0.0:
        x[FLAGS] = float(int(x[FLAGS]) | STUCK)
        return True
    far = FAR * own
    if abs(error) > far and abs(error) > (1.0 + UNSURE / np.sqrt(taken)) * far:
        x[FLAGS] = float(int(x[FLAGS]) | OUTLIER)
        return True
    return False


@compiled("void(float64[::1], int64, float64, float64, float64)", inline=True)
def learn(x: Array, w: int, y: float, v: float, factor: float) -> None:
    """Follow scale, mean and spread of an output with a sample that was taken."""
    x[w + TAKEN] += 1.0
    taken = x[w + TAKEN]
    x[w + WEIGHT] = factor * x[w + WEIGHT] + 1.0
    x[w + WEIGHT2] = factor * factor * x[w + WEIGHT2] + 1.0
    step = y - x[w + MEAN]
    x[w + MEAN] += step / x[w + WEIGHT]
    x[w + SPREAD] = factor * x[w + SPREAD] + step * (y - x[w + MEAN])
    if int(taken) % FLOOR_PACE == 1:
        size = np.sqrt(x[w + SPREAD] / x[w + WEIGHT] + x[w + MEAN] ** 2)
        x[w + FLOOR] = TRACE * size
    size = abs(v) * TO_SCALE
    known = x[w + SCALED] == 0.0 and x[w + SCALE] > 0.0
    if not (size >= 0.0):
        return
    if x[w + SCALED] < FIRST_SCALED:
        # a mean of few is better than a median of few; a scale that was given is kept
        x[w + SCALED] = FIRST_SCALED if known else x[w + SCALED] + 1.0
        if not known:
            x[w + SCALE] += (size * MEAN_TO_MEDIAN - x[w + SCALE]) / x[w + SCALED]
    else:
        up, down = 1.0 + SCALE_PACE, 1.0 / (1.0 + SCALE_PACE)
        if taken < 4.0 / SCALE_PACE:
            up = 1.0 + max(4.0 / (taken + 8.0), SCALE_PACE)
            down = 1.0 / up
        x[w + SCALE] *= up if size > x[w + SCALE] else down


@compiled("boolean(int64[::1], float64[::1], int64, int64, boolean)")
def judge(ints: Ints, x: Array, w: int, scale: int, ready: bool) -> bool:
    """Judge the block of a scale, add it to that of the next; whether that one is now full."""
    k = ints[DIRECTIONS]
    width = k + k * (k + 1) // 2
    own = w + SCORES + k + scale * (width + SUMS)
    state = own + width
    # while the input rests there is nothing to judge by
    resting = scale == 0 and x[w + IDLE] > 0.0
    if scale + 1 < SCALES and not resting:
        for i in range(width):
            x[own + width + SUMS + i] += x[own + i]
    usual = w + SCORES + k + SCALES * (width + SUMS)
    scores, m = own, own + k
    total = 0.0
    directions = 0
    idle = False
    for i in range(k):
        row_i = m + i * (i + 1) // 2
        size = x[row_i + i]
        pivot = size
        for s in range(i):
            row_l = m + s * (s + 1) // 2
            value = x[row_i + s]
            for r in range(s):
                d = x[m + r * (r + 1) // 2 + r]
                if d > 0.0:
                    value -= x[row_i + r] * x[row_l + r] / d
            x[row_i + s] = value
            d = x[row_l + s]
            if d > 0.0:
                pivot -= value * value / d
                x[scores + i] -= value / d * x[scores + s]
        live = pivot > 1e-9 * size and pivot > 0.0
        x[row_i + i] = pivot if live else 0.0
        if live:
            total += x[scores + i] ** 2 / pivot
            directions += 1
        if pivot < IDLE_SHARE * x[usual + i]:
            idle = True
    if scale == 0:
        # a first large block must not make all others look idle for ever
        x[w + BLOCKS] += 1.0
        blocks = min(x[w + BLOCKS], BLOCKS_USUAL)
        if idle and blocks > BLOCKS_FIRST:
            blocks = 10.0 * BLOCKS_USUAL
        for i in range(k):
            x[usual + i] += (x[m + i * (i + 1) // 2 + i] - x[usual + i]) / blocks
        x[w + IDLE] = x[w + IDLE] + 1.0 if idle else 0.0
    for i in range(width):
        x[own + i] = 0.0
    if ready and directions > 0 and not (resting or idle):
        ratio = total / directions
        norm = 1.0 + x[state + 1]
        x[state + 3] += 1.0
        if x[state + 3] <= ints[LEARNING]:
            x[state + 1] += (ratio - norm) / x[state + 3]
        else:
            x[state] = max(0.0, x[state] + directions * (ratio / norm - 2.0))
            if x[state] > ints[ALERT]:
                x[w + MOVED] = 1.0
            x[state + 1] += (min(ratio, 4.0 * norm) - norm) / BLOCKS_USUAL
        x[state + 1] = max(0.0, x[state + 1])
    x[state + 2] += 1.0
    if x[state + 2] < PER_SCALE:
        return False
    x[state + 2] = 0.0
    return scale + 1 < SCALES


@compiled("void(int64[::1], float64[::1], float64[::1], int64)")
def scatter(ints: Ints, c: Array, x: Array, w: int) -> None:
    """Add a block to the covariance of the scores, on every level (`online.scatter`).

    To be called before the block is judged, as that takes its sums apart.
    """
    k = ints[DIRECTIONS]
    width = k * (k + 1) // 2
    scores = w + SCORES + k
    at = ints[AT_SCATTER] + ints[SCATTER] * ((w - ints[AT_WATCH]) // ints[WATCH])
    keep = c[FORGETTING] ** ints[BLOCK]
    x[at + POWER] = keep * x[at + POWER] + x[at + UNDER_WAY]
    x[at + NUMBER] = keep * x[at + NUMBER] + ints[BLOCK]
    at += HEADER
    for i in range(width):
        x[at + i] = keep * x[at + i] + x[scores + k + i]
    at += width
    for i in range(k):
        x[at + i] += x[scores + i]
    full = 1.0
    for level in range(LEVELS):
        x[at + k] += 1.0
        if x[at + k] < full:
            return
        full = float(PER_LEVEL)
        products = at + k + 2
        x[at + k] = 0.0
        x[at + k + 1] = keep * x[at + k + 1] + 1.0
        above = at + k + 2 + width
        s = 0
        for i in range(k):
            for j in range(i + 1):
                x[products + s] = keep * x[products + s] + x[at + i] * x[at + j]
                s += 1
        for i in range(k):
            if level + 1 < LEVELS:
                x[above + i] += x[at + i]
            x[at + i] = 0.0
        keep = keep**PER_LEVEL
        at = above


@compiled(
    "void(int64[::1], float64[::1], float64[::1], int64, int64, float64, boolean)", inline=True
)
def watch(ints: Ints, c: Array, x: Array, w: int, first: int, v: float, ready: bool) -> None:
    """Gather the scores of a block; at its end, judge change and excitation.

    Parameters
    ----------
    w : int
        The watch of the output; its scores stand behind it.
    first : int
        First column of the row that is not zero.
    v : float
        Innovation over its standard deviation.
    ready : bool
        Whether enough has been learnt for a judgement.
    """
    k, n, row = ints[DIRECTIONS], ints[COLUMNS], ints[AT_ROW]
    if k == 0:
        return
    g = w + SCORES
    scores = g + k
    m = scores + k
    maps, power = ints[C_MAPS], ints[AT_SCATTER] + UNDER_WAY
    if w != ints[AT_WATCH]:
        power += ints[SCATTER] * ((w - ints[AT_WATCH]) // ints[WATCH])
        maps += ints[DIRECTIONS_STRIDE] * ((w - ints[AT_WATCH]) // ints[WATCH])
    # views: an index that cannot be negative is quicker
    z, gathered = x[row + first : row + n], x[g : g + k]
    for i in range(k):
        value = 0.0
        products = x[m : m + i + 1]
        if ints[DIRECTIONS_STRIDE] == 0:
            value = x[row + n - k + i]
        else:
            one = c[maps + i * n + first : maps + i * n + n]
            for s in range(n - first):
                value += one[s] * z[s]
        gathered[i] = value
        x[scores + i] += value * v
        for s in range(i + 1):
            products[s] += value * gathered[s]
        m += i + 1
    x[power] += v * v
    x[w + INSIDE] += 1.0
    if x[w + INSIDE] >= ints[BLOCK]:
        x[w + INSIDE] = 0.0
        if ready:
            scatter(ints, c, x, w)
        x[power] = 0.0
        scale = 0
        while judge(ints, x, w, scale, ready):
            scale += 1
