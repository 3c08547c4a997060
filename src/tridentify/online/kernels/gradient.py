"""The three models adapted by the gradient rule, sample by sample, compiled.

The row ``z`` of a sample is that of Step 1 (`online.kernels.parallel`). Everything that the models
need is a combination of it:

* the parallel model ``theta_1' T_1 z``, with fixed ``T_1``;
* the series model ``t_0' z + theta_3' T_3 z``: ``t_0`` is the output of the model that stood at the
  last tick, ``theta_3`` what the series operators add to it;
* with ``r`` the row of the one of them that Step 2 works on, the filter driven by it. The states of
  the filter driven by state ``k`` of the bank are a fixed map of the bank's states, so one answer
  of the filter for each ``k`` is formed once a sample and weighted by ``r_k``.

Each moves along ``P phi`` (`numerics.recursive.descend`), with ``P`` fixed between two ticks. Until
the first tick nothing is known of the mean squares of the regressors: then ``P`` is the identity
over their running mean square. Later a mean of ``phi' P phi`` above the number of unknowns, an
input that has become larger, divides the step; a smaller one does not multiply it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tridentify.numerics.arrays import Array
from tridentify.numerics.compiled import compiled
from tridentify.numerics.recursive import along, descend
from tridentify.online.kernels.absorb import refuse
from tridentify.online.kernels.gradient_slots import (
    ANSWERS,
    C_FITS,
    C_SECOND,
    DOUBTS,
    FROM,
    GRADIENT_PACE,
    KEPT,
    KNOWN,
    MEMORY,
    MOMENTS,
    OWN,
    PARALLEL_UNKNOWNS,
    POLES,
    RATE,
    READY,
    SERIES,
    SERIES_UNKNOWNS,
    SUMMED,
    WHITE,
    X_FITS,
    X_MOMENTS,
    X_ROOM,
    X_SECOND,
    fits_stride,
)
from tridentify.online.kernels.intake import count, doubt, learn, noise_scale, take_in, watch
from tridentify.online.kernels.parallel import advance, complete_row
from tridentify.online.kernels.slots import (
    ALARMED,
    AT_ROW,
    AT_WATCH,
    BEGIN,
    COLLECTING,
    COLUMNS,
    COUNT,
    EVENT,
    FIRST,
    FITTED,
    FLAGS,
    FREE,
    IDLE,
    IDLE_BLOCKS,
    INBOX,
    INNOVATION,
    INPUTS,
    LARGE,
    MOVED,
    NOT_EXCITED,
    NOT_READY,
    ORDER,
    OUTPUTS,
    REFUSED,
    SCALE,
    SINCE,
    SQUARES,
    TAKEN,
    WATCH,
)

Ints = NDArray[np.int64]


stride_of = compiled("int64(int64[::1])")(fits_stride)


@compiled("void(float64[::1], float64[::1], int64, int64, int64, int64, int64, int64)")
def regressors(
    c: Array, x: Array, table: int, k: int, n: int, first: int, row: int, out: int
) -> None:
    """``T z`` for a table ``T`` (k, n) in ``c``."""
    for i in range(k):
        value = 0.0
        at = table + i * n
        for s in range(first, n):
            value += c[at + s] * x[row + s]
        x[out + i] = value


@compiled("float64(float64[::1], int64, int64, int64)")
def inner(x: Array, one: int, two: int, k: int) -> float:
    """Inner product of two places."""
    total = 0.0
    for i in range(k):
        total += x[one + i] * x[two + i]
    return total


@compiled("float64(boolean, float64, float64, float64)")
def gain_of(known: bool, step: float, k: float, mean: float) -> float:
    """Rate times interval over what ``phi' P phi`` is on average, as the module says."""
    if known:
        return step * k / max(k, mean)
    return step * k / mean if mean > 0.0 else 0.0


@compiled("void(float64[::1], int64, boolean, float64, float64, float64)")
def follow(x: Array, at: int, known: bool, taken: float, step: float, size: float) -> None:
    """The running mean of ``phi' P phi``."""
    pace = min(1.0, max(1.0 / (taken + 1.0), 0.25 * step if known else 0.0))
    if size < 1e200:
        x[at] += pace * (size - x[at])


@compiled(
    "void(float64[::1], float64[::1], int64, int64, int64, int64, float64, float64, float64,"
    " float64)"
)
def move(
    c: Array,
    x: Array,
    at: int,
    k: int,
    phi: int,
    gains: int,
    taken: float,
    step: float,
    weight: float,
    error: float,
) -> None:
    """One fit by one sample.

    Parameters
    ----------
    at, k : int
        Where its unknowns stand, with the mean of ``phi' P phi`` behind them, and their number.
    phi : int
        Where its regressors stand, with room for as many numbers behind them.
    gains : int
        Where ``P`` stands in ``c``.
    taken : float
        Samples that the mean holds.
    step : float
        Rate times interval.
    weight : float
        Of the squared error.
    error : float
    """
    size = along(x, phi, k, c, gains, phi + k) * weight
    known = c[KNOWN] > 0.0
    follow(x, at + k, known, taken, step, size)
    gain = gain_of(known, step, float(k), x[at + k])
    descend(x, at, k, phi + k, size, gain, error, weight)


@compiled("float64(int64[::1], float64[::1], float64[::1], int64, int64, int64, float64)")
def adapt(ints: Ints, c: Array, x: Array, output: int, n: int, first: int, step: float) -> float:
    """Steps 1 and 3 for one output, unless its sample is doubtful; gives the innovation."""
    k1, k3, row = ints[PARALLEL_UNKNOWNS], ints[SERIES_UNKNOWNS], ints[AT_ROW]
    w = ints[AT_WATCH] + output * ints[WATCH]
    y = x[INBOX + ints[INPUTS] + output]
    t1 = ints[C_FITS] + output * stride_of(ints)
    t0 = t1 + k1 * (n + k1)
    t3 = t0 + n
    theta1 = ints[X_FITS] + output * (k1 + k3 + 2)
    theta3 = theta1 + k1 + 1
    phi1 = ints[X_ROOM]
    phi3 = phi1 + 2 * k1
    regressors(c, x, t1, k1, n, first, row, phi1)
    parallel = inner(x, theta1, phi1, k1)
    fitted, k = parallel, k1
    if ints[SERIES]:
        regressors(c, x, t3, k3, n, first, row, phi3)
        fitted, k = inner(x, theta3, phi3, k3), k3
        for s in range(first, n):
            fitted += c[t0 + s] * x[row + s]
    error = y - fitted
    x[w + FITTED] = fitted
    x[w + INNOVATION] = error
    leverage = min(0.5 * step * k, 0.9)
    taken = x[w + TAKEN]
    ready = c[READY] > DOUBTS and taken > 10.0 * n + 30.0 and leverage < WHITE
    known = x[w + SCALE] > 0.0
    scale = noise_scale(x, w)
    # weights that follow every sample have no expectation that a sample could be far from
    doubts = c[READY] > 0.0 and leverage < WHITE
    own = scale * np.sqrt(1.0 + leverage) if doubts else np.inf
    if doubt(x, w, y, fitted, leverage, own, n):
        refuse(ints, c, x, w, first, error, ready)
        return float(error)
    x[w + REFUSED] = 0.0
    v = error / np.sqrt(1.0 + leverage)
    if known:
        z = v / scale
        watch(ints, c, x, w, first, min(max(z, -LARGE), LARGE), ready)
    move(c, x, theta1, k1, phi1, t1 + k1 * n, taken, step, 1.0, y - parallel)
    if ints[SERIES]:
        move(c, x, theta3, k3, phi3, t3 + k3 * n, taken, step, 1.0, error)
    kept = 1.0 - min(step / MEMORY, 0.5)
    x[w + SQUARES] = kept * x[w + SQUARES] + error * error
    learn(x, w, y, v, kept)
    return float(error)


@compiled("void(int64[::1], float64[::1], float64[::1], int64)")
def answers(ints: Ints, c: Array, x: Array, at: int) -> None:
    """How the filter answers to each of the states that a model's output may hold."""
    q, d, kept, row = ints[ORDER], ints[ANSWERS], ints[KEPT], ints[AT_ROW]
    for channel in range(ints[INPUTS] + ints[FREE]):
        own = row + channel * q
        for k in range(kept):
            for a in range(d):
                value = 0.0
                table = ints[C_SECOND] + (k * d + a) * q
                for s in range(q):
                    value += c[table + s] * x[own + s]
                x[at + (channel * kept + k) * d + a] = value


@compiled("void(int64[::1], float64[::1], float64[::1], int64, int64, int64, float64, int64)")
def second(
    ints: Ints, c: Array, x: Array, output: int, n: int, first: int, step: float, answer: int
) -> None:
    """Step 2 on the output of the series model, or of the parallel one before there is another."""
    k1, k3, row = ints[PARALLEL_UNKNOWNS], ints[SERIES_UNKNOWNS], ints[AT_ROW]
    m, q, d, kept, poles = ints[INPUTS], ints[ORDER], ints[ANSWERS], ints[KEPT], ints[POLES]
    base = ints[C_FITS] + output * stride_of(ints)
    t0 = base + k1 * (n + k1)
    t3 = t0 + n
    t2 = t3 + k3 * (n + k3)
    theta = ints[X_FITS] + output * (k1 + k3 + 2)
    r = answer + (m + ints[FREE]) * kept * d
    width = q * (m + ints[FREE]) + m
    table, k = base, k1
    if ints[SERIES]:
        table, k, theta = t3, k3, theta + k1 + 1
    for s in range(width):
        x[r + s] = c[t0 + s] if ints[SERIES] else 0.0
    for i in range(k):
        value = x[theta + i]
        at = table + i * n
        for s in range(first, width):
            x[r + s] += value * c[at + s]
    monic = 0.0
    for s in range(first, width):
        monic += x[r + s] * x[row + s]
    unknowns = poles + ints[OUTPUTS] * ints[OWN]
    psi = r + n
    for i in range(unknowns):
        x[psi + i] = 0.0
    drive = ints[C_SECOND] + kept * d * q
    for a in range(d):
        value = 0.0
        for channel in range(first // q, m + ints[FREE]):
            for i in range(kept):
                value += x[r + channel * q + i] * x[answer + (channel * kept + i) * d + a]
        for j in range(m):
            through = x[r + q * (m + ints[FREE]) + j]
            if through != 0.0:
                own = row + (j + ints[FREE]) * q
                for s in range(q):
                    value += through * c[drive + a * q + s] * x[own + s]
        if a < poles:
            x[psi + a] = -value
        else:
            monic = value
    regressors(c, x, t2, ints[OWN], n, first, row, psi + poles + output * ints[OWN])
    error = monic - inner(x, ints[X_SECOND], psi, unknowns)
    weight = c[t2 + ints[OWN] * n]
    gains = drive + d * q
    move(c, x, ints[X_SECOND], unknowns, psi, gains, x[MOMENTS], step, weight, error)


@compiled("void(int64[::1], float64[::1], int64)")
def gather(ints: Ints, x: Array, n: int) -> None:
    """Sum of the unknowns of Step 2."""
    unknowns = ints[POLES] + ints[OUTPUTS] * ints[OWN]
    at = ints[X_SECOND]
    for i in range(unknowns):
        x[at + unknowns + 1 + i] += x[at + i]
    x[SUMMED] += 1.0


@compiled("void(int64[::1], float64[::1], float64[::1], int64)")
def moments(ints: Ints, c: Array, x: Array, n: int) -> None:
    """Running mean of ``z z'``, its lower triangle."""
    row, at = ints[AT_ROW], ints[X_MOMENTS]
    x[MOMENTS] += 1.0
    pace = max(1.0 / x[MOMENTS], c[GRADIENT_PACE])
    for i in range(n):
        zi = x[row + i]
        if abs(zi) < 1e100:
            for s in range(i + 1):
                x[at + s] += pace * (zi * x[row + s] - x[at + s])
        at += i + 1


@compiled("float64(int64[::1], float64[::1], float64[::1], float64)", value=True)
def gradient_step(ints: Ints, c: Array, x: Array, interval: float) -> float:
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
    if ints[FREE] and x[SINCE] < ints[BEGIN]:
        for i in range(ints[OUTPUTS]):
            x[ints[AT_WATCH] + i * ints[WATCH] + INNOVATION] = np.nan
        count(ints, x)
        return np.nan
    step = interval * c[RATE]
    idle = False
    for i in range(ints[OUTPUTS]):
        w = ints[AT_WATCH] + i * ints[WATCH]
        adapt(ints, c, x, i, n, first, step)
        if x[w + IDLE] >= IDLE_BLOCKS:
            x[FLAGS] = float(int(x[FLAGS]) | NOT_EXCITED)
            idle = True
        if x[w + MOVED] > 0.0:
            x[EVENT] = float(int(x[EVENT]) | ALARMED)
    answer = ints[X_ROOM]
    answers(ints, c, x, answer)
    for i in range(ints[OUTPUTS]):
        second(ints, c, x, i, n, first, step, answer)
    if not idle:
        moments(ints, c, x, n)
        if x[COUNT] >= x[FROM]:
            gather(ints, x, n)
    count(ints, x)
    return float(x[ints[AT_WATCH] + INNOVATION])
