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

One sample on: a filter driven by the impulse at the beginning, and by the inputs, compiled.
"""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.compiled import linked as compiled
from tridentify.online.kernels import slots


@compiled("void(int64[::1], float64[::1], float64[::1], float64)", inline=True)
def take_in(ints: Indices, c: Array, x: Array, interval: float) -> None:
    """Count, keep the time, put the input into the delay line and the sample into the chunk."""
    m, p = ints[slots.INPUTS], ints[slots.OUTPUTS]
    flags = slots.CHANGED if x[slots.COUNT] < x[slots.ALARM] else 0
    x[slots.EVENT] = 0.0
    line, at = ints[slots.LINE], ints[slots.AT_LINE]
    for k in range(m + p):
        # a value a million times the largest so far is none, but for many in a row
        size = abs(x[slots.INBOX + k])
        most = ints[slots.AT_LARGEST] + 2 * k
        patience = 2.0 if k < m else 30.0
        if size <= slots.SENSELESS * x[most] or x[most] == 0.0 or x[most + 1] >= patience:
            if size < slots.LARGEST:
                x[most] = max(x[most], size)
                x[most + 1] = 0.0
        elif size < slots.LARGEST:
            x[most + 1] += 1.0
            x[slots.INBOX + k] = np.nan
            flags |= slots.OUTLIER
        if size < slots.SMALLEST:
            x[slots.INBOX + k] = 0.0
        if k >= m and not (abs(x[slots.INBOX + k]) < slots.LARGEST):
            x[slots.INBOX + k] = np.nan
            flags |= slots.MISSING_OUTPUT
    for j in range(m):
        u = x[slots.INBOX + j]
        own = at + j * line
        if not (abs(u) < slots.LARGEST):
            flags |= slots.MISSING_INPUT
            u = x[own] + x[ints[slots.AT_REFERENCE] + j] if x[slots.COUNT] > 0.0 else 0.0
            x[slots.INBOX + j] = u
        for s in range(line - 1, 0, -1):
            x[own + s] = x[own + s - 1]
        if x[slots.COUNT] == 0.0:
            x[ints[slots.AT_FIRST_INPUT] + j] = u
            if ints[slots.EQUILIBRIUM]:
                x[ints[slots.AT_REFERENCE] + j] = u
        x[own] = u - x[ints[slots.AT_REFERENCE] + j]
    if x[slots.COUNT] > 0.0:
        if interval != c[slots.INTERVAL]:
            x[slots.EXTRA] += interval - c[slots.INTERVAL]
            if abs(interval - c[slots.INTERVAL]) > 1e-6 * c[slots.INTERVAL]:
                flags |= slots.JITTER
        x[slots.TIME] = x[slots.COUNT] * c[slots.INTERVAL] + x[slots.EXTRA]
    if ints[slots.CHUNK] > 0:
        width = m + p + 1
        here = ints[slots.AT_CHUNK] + int(x[slots.FILLED]) * width
        x[here] = interval
        for s in range(m + p):
            x[here + 1 + s] = x[slots.INBOX + s]
        x[slots.FILLED] += 1.0
        if x[slots.FILLED] >= ints[slots.CHUNK]:
            x[slots.EVENT] += slots.CHUNK_FULL
    x[slots.FLAGS] = float(flags)


@compiled("void(int64[::1], float64[::1])", inline=True)
def count(ints: Indices, x: Array) -> None:
    """The sample is done with."""
    x[slots.COUNT] += 1.0
    x[slots.SINCE] += 1.0
    if x[slots.FLAGS] != 0.0:
        x[slots.SEEN] = float(int(x[slots.SEEN]) | (int(x[slots.FLAGS]) & ~slots.NOT_READY))
    if x[slots.COUNT] == x[slots.TICK]:
        x[slots.EVENT] += slots.TICKED


@compiled("float64(int64[::1], float64[::1])")
def nothing_told(ints: Indices, x: Array) -> float:
    """The sample is done with, and nothing was expected of it."""
    if ints[slots.COLLECTING]:
        x[slots.FLAGS] = float(int(x[slots.FLAGS]) | slots.NOT_READY)
    for i in range(ints[slots.OUTPUTS]):
        x[ints[slots.AT_WATCH] + i * ints[slots.WATCH] + slots.INNOVATION] = np.nan
    count(ints, x)
    return np.nan


@compiled("boolean(int64[::1], float64[::1], int64)")
def tell(ints: Indices, x: Array, w: int) -> bool:
    """Raise what the watch of an output has come to; whether the input rests."""
    idle = x[w + slots.IDLE] >= slots.IDLE_BLOCKS
    if idle:
        x[slots.FLAGS] = float(int(x[slots.FLAGS]) | slots.NOT_EXCITED)
    if x[w + slots.MOVED] > 0.0:
        x[slots.EVENT] = float(int(x[slots.EVENT]) | slots.ALARMED)
    return bool(idle)


@compiled("float64(float64[::1], int64)", inline=True)
def noise_scale(x: Array, w: int) -> float:
    """Standard deviation of the noise, but no less than a trace of the output's."""
    return max(float(x[w + slots.SCALE]), float(x[w + slots.FLOOR]))


@compiled("boolean(float64[::1], int64, float64, float64, float64, float64, int64)", inline=True)
def doubt(x: Array, w: int, y: float, fitted: float, leverage: float, own: float, n: int) -> bool:
    """Whether a sample is to be left out; says why in the flags. ``own``: of the innovation."""
    if not (abs(y) < slots.LARGEST):
        x[slots.FLAGS] = float(int(x[slots.FLAGS]) | slots.MISSING_OUTPUT)
        x[w + slots.REPEATS] = 0.0
        return True
    if y == x[w + slots.LAST] and x[w + slots.REPEATS] > 0.0:
        x[w + slots.REPEATS] += 1.0
        if x[w + slots.REPEATS] == 2.0:
            x[w + slots.DOUBLES] += 1.0
    else:
        x[w + slots.REPEATS] = 1.0
        x[w + slots.AT_FIRST] = fitted
        x[w + slots.STANDS] = 0.0
    x[w + slots.LAST] = y
    limits = int(x[w + slots.LIMITS])
    if y > x[w + slots.HIGHEST]:
        x[w + slots.HIGHEST] = y
        limits &= ~1
    if y < x[w + slots.LOWEST]:
        x[w + slots.LOWEST] = y
        limits &= ~2
    x[w + slots.LIMITS] = float(limits)
    taken = x[w + slots.TAKEN]
    if taken < 2.0 * n + 10.0 or not (leverage < 1.0) or x[w + slots.SCALED] < slots.FIRST_SCALED:
        return False
    error = y - fitted
    if x[w + slots.REPEATS] >= 3.0:
        if y >= x[w + slots.HIGHEST] and error < -3.0 * own:
            limits |= 1
        if y <= x[w + slots.LOWEST] and error > 3.0 * own:
            limits |= 2
        x[w + slots.LIMITS] = float(limits)
    if (limits & 1 and y >= x[w + slots.HIGHEST]) or (limits & 2 and y <= x[w + slots.LOWEST]):
        x[slots.FLAGS] = float(int(x[slots.FLAGS]) | slots.SATURATED)
        return True
    if x[w + slots.REPEATS] >= 5.0 and abs(fitted - x[w + slots.AT_FIRST]) > 4.0 * own:
        x[w + slots.STANDS] = 1.0
    if x[w + slots.REPEATS] >= 3.0 and x[w + slots.DOUBLES] < slots.RARE * x[w + slots.TAKEN]:
        x[w + slots.STANDS] = 1.0
    if x[w + slots.STANDS] > 0.0:
        x[slots.FLAGS] = float(int(x[slots.FLAGS]) | slots.STUCK)
        return True
    far = slots.FAR * own
    if abs(error) > far and abs(error) > (1.0 + slots.UNSURE / np.sqrt(taken)) * far:
        x[slots.FLAGS] = float(int(x[slots.FLAGS]) | slots.OUTLIER)
        return True
    return False


@compiled("void(float64[::1], int64, float64, float64, float64)", inline=True)
def learn(x: Array, w: int, y: float, v: float, factor: float) -> None:
    """Follow scale, mean and spread of an output with a sample that was taken."""
    x[w + slots.TAKEN] += 1.0
    taken = x[w + slots.TAKEN]
    x[w + slots.WEIGHT] = factor * x[w + slots.WEIGHT] + 1.0
    x[w + slots.WEIGHT2] = factor * factor * x[w + slots.WEIGHT2] + 1.0
    step = y - x[w + slots.MEAN]
    x[w + slots.MEAN] += step / x[w + slots.WEIGHT]
    x[w + slots.SPREAD] = factor * x[w + slots.SPREAD] + step * (y - x[w + slots.MEAN])
    if int(taken) % slots.FLOOR_PACE == 1:
        size = np.sqrt(x[w + slots.SPREAD] / x[w + slots.WEIGHT] + x[w + slots.MEAN] ** 2)
        x[w + slots.FLOOR] = slots.TRACE * size
    size = abs(v) * slots.TO_SCALE
    known = x[w + slots.SCALED] == 0.0 and x[w + slots.SCALE] > 0.0
    if not (size >= 0.0):
        return
    if x[w + slots.SCALED] < slots.FIRST_SCALED:
        # a mean of few is better than a median of few; a scale that was given is kept
        x[w + slots.SCALED] = slots.FIRST_SCALED if known else x[w + slots.SCALED] + 1.0
        if not known:
            x[w + slots.SCALE] += (size * slots.MEAN_TO_MEDIAN - x[w + slots.SCALE]) / x[
                w + slots.SCALED
            ]
    else:
        up, down = 1.0 + slots.SCALE_PACE, 1.0 / (1.0 + slots.SCALE_PACE)
        if taken < 4.0 / slots.SCALE_PACE:
            up = 1.0 + max(4.0 / (taken + 8.0), slots.SCALE_PACE)
            down = 1.0 / up
        x[w + slots.SCALE] *= up if size > x[w + slots.SCALE] else down


@compiled("boolean(int64[::1], float64[::1], int64, int64, boolean)")
def judge(ints: Indices, x: Array, w: int, scale: int, ready: bool) -> bool:
    """Judge the block of a scale, add it to that of the next; whether that one is now full."""
    k = ints[slots.DIRECTIONS]
    width = k + k * (k + 1) // 2
    own = w + slots.SCORES + k + scale * (width + slots.SUMS)
    state = own + width
    # while the input rests there is nothing to judge by
    resting = scale == 0 and x[w + slots.IDLE] > 0.0
    if scale + 1 < slots.SCALES and not resting:
        for i in range(width):
            x[own + width + slots.SUMS + i] += x[own + i]
    usual = w + slots.SCORES + k + slots.SCALES * (width + slots.SUMS)
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
        if pivot < slots.IDLE_SHARE * x[usual + i]:
            idle = True
    if scale == 0:
        # a first large block must not make all others look idle for ever
        x[w + slots.BLOCKS] += 1.0
        blocks = min(x[w + slots.BLOCKS], slots.BLOCKS_USUAL)
        if idle and blocks > slots.BLOCKS_FIRST:
            blocks = 10.0 * slots.BLOCKS_USUAL
        for i in range(k):
            x[usual + i] += (x[m + i * (i + 1) // 2 + i] - x[usual + i]) / blocks
        x[w + slots.IDLE] = x[w + slots.IDLE] + 1.0 if idle else 0.0
    for i in range(width):
        x[own + i] = 0.0
    if ready and directions > 0 and not (resting or idle):
        ratio = total / directions
        norm = 1.0 + x[state + 1]
        x[state + 3] += 1.0
        if x[state + 3] <= ints[slots.LEARNING]:
            x[state + 1] += (ratio - norm) / x[state + 3]
        else:
            x[state] = max(0.0, x[state] + directions * (ratio / norm - 2.0))
            if x[state] > ints[slots.ALERT]:
                x[w + slots.MOVED] = 1.0
            x[state + 1] += (min(ratio, 4.0 * norm) - norm) / slots.BLOCKS_USUAL
        x[state + 1] = max(0.0, x[state + 1])
    x[state + 2] += 1.0
    if x[state + 2] < slots.PER_SCALE:
        return False
    x[state + 2] = 0.0
    return scale + 1 < slots.SCALES


@compiled("void(int64[::1], float64[::1], float64[::1], int64)")
def scatter(ints: Indices, c: Array, x: Array, w: int) -> None:
    """Add a block to the covariance of the scores, on every level (`online.scatter`).

    To be called before the block is judged, as that takes its sums apart.
    """
    k = ints[slots.DIRECTIONS]
    width = k * (k + 1) // 2
    scores = w + slots.SCORES + k
    at = ints[slots.AT_SCATTER] + ints[slots.SCATTER] * (
        (w - ints[slots.AT_WATCH]) // ints[slots.WATCH]
    )
    keep = c[slots.FORGETTING] ** ints[slots.BLOCK]
    x[at + slots.POWER] = keep * x[at + slots.POWER] + x[at + slots.UNDER_WAY]
    x[at + slots.NUMBER] = keep * x[at + slots.NUMBER] + ints[slots.BLOCK]
    at += slots.HEADER
    for i in range(width):
        x[at + i] = keep * x[at + i] + x[scores + k + i]
    at += width
    for i in range(k):
        x[at + i] += x[scores + i]
    full = 1.0
    for level in range(slots.LEVELS):
        x[at + k] += 1.0
        if x[at + k] < full:
            return
        full = float(slots.PER_LEVEL)
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
            if level + 1 < slots.LEVELS:
                x[above + i] += x[at + i]
            x[at + i] = 0.0
        keep = keep**slots.PER_LEVEL
        at = above


@compiled(
    "void(int64[::1], float64[::1], float64[::1], int64, int64, float64, boolean)", inline=True
)
def watch(ints: Indices, c: Array, x: Array, w: int, first: int, v: float, ready: bool) -> None:
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
    k, n, row = ints[slots.DIRECTIONS], ints[slots.COLUMNS], ints[slots.AT_ROW]
    if k == 0:
        return
    g = w + slots.SCORES
    scores = g + k
    m = scores + k
    maps, power = ints[slots.C_MAPS], ints[slots.AT_SCATTER] + slots.UNDER_WAY
    if w != ints[slots.AT_WATCH]:
        power += ints[slots.SCATTER] * ((w - ints[slots.AT_WATCH]) // ints[slots.WATCH])
        maps += ints[slots.DIRECTIONS_STRIDE] * ((w - ints[slots.AT_WATCH]) // ints[slots.WATCH])
    # views: an index that cannot be negative is quicker
    z, gathered = x[row + first : row + n], x[g : g + k]
    for i in range(k):
        value = 0.0
        products = x[m : m + i + 1]
        if ints[slots.DIRECTIONS_STRIDE] == 0:
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
    x[w + slots.INSIDE] += 1.0
    if x[w + slots.INSIDE] >= ints[slots.BLOCK]:
        x[w + slots.INSIDE] = 0.0
        if ready:
            scatter(ints, c, x, w)
        x[power] = 0.0
        scale = 0
        while judge(ints, x, w, scale, ready):
            scale += 1


@compiled("void(int64[::1], float64[::1], float64[::1], int64)", inline=True)
def transit(ints: Indices, c: Array, x: Array, own: int) -> None:
    """The states at ``own`` one sample on; what drives them stands in the room for work."""
    q, upper = ints[slots.ORDER], ints[slots.UPPER]
    f, work = ints[slots.C_STEP], ints[slots.AT_WORK]
    now, new = x[own : own + q], x[work : work + q]
    for i in range(q):
        total = new[i]
        transition = c[f + i * q : f + (i + 1) * q]
        for s in range(min(i + 1 + upper, q)):
            total += transition[s] * now[s]
        new[i] = total
    for i in range(q):
        now[i] = new[i]


@compiled("boolean(int64[::1], float64[::1], float64[::1], int64)", inline=True)
def die_away(ints: Indices, c: Array, x: Array, at: int) -> bool:
    """The states at ``at``, after an impulse at the beginning; whether they are nothing from now.

    The impulse acts once all inputs have arrived; the states are left alone once ``FIRST`` says
    that they are nothing.
    """
    q, since = ints[slots.ORDER], x[slots.SINCE]
    if since == ints[slots.BEGIN]:
        for i in range(q):
            x[at + i] = c[ints[slots.C_START] + 1 + i]
    if since <= ints[slots.BEGIN] or x[slots.FIRST] != 0.0:
        return False
    for i in range(q):
        x[ints[slots.AT_WORK] + i] = 0.0
    transit(ints, c, x, at)
    largest = 0.0
    for i in range(q):
        largest = max(largest, abs(x[at + i]))
    return bool(largest < c[ints[slots.C_START]])


@compiled("void(int64[::1], float64[::1], float64[::1], int64)", inline=True)
def drive(ints: Indices, c: Array, x: Array, first: int) -> None:
    """The states at ``first``, input after input, at the sample whose inputs were taken in."""
    q, work = ints[slots.ORDER], ints[slots.AT_WORK]
    for j in range(ints[slots.INPUTS]):
        late = ints[slots.AT_LINE] + j * ints[slots.LINE] + int(c[ints[slots.C_EXTRA] + j])
        g = ints[slots.C_TAPS] + 3 * j * q
        arrived, before, earlier = x[late], x[late + 1], x[late + 2]
        for i in range(q):
            x[work + i] = c[g + i] * arrived + c[g + q + i] * before + c[g + 2 * q + i] * earlier
        transit(ints, c, x, first + j * q)
