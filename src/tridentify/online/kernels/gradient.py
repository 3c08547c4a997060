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

from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.compiled import linked as compiled
from tridentify.numerics.recursive import along, descend
from tridentify.online.kernels import gradient_slots as places
from tridentify.online.kernels import slots
from tridentify.online.kernels.absorb import refuse
from tridentify.online.kernels.intake import (
    count,
    doubt,
    learn,
    noise_scale,
    nothing_told,
    take_in,
    tell,
    watch,
)
from tridentify.online.kernels.parallel import advance, complete_row

stride_of = compiled("int64(int64[::1])")(places.fits_stride)


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
    c: Array, x: Array, at: int, k: int, phi: int, gains: int, taken: float, step: float,
    weight: float, error: float,
) -> None:  # fmt: skip
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
    known = c[places.KNOWN] > 0.0
    follow(x, at + k, known, taken, step, size)
    gain = gain_of(known, step, float(k), x[at + k])
    descend(x, at, k, phi + k, size, gain, error, weight)


@compiled("float64(int64[::1], float64[::1], float64[::1], int64, int64, int64, float64)")
def adapt(ints: Indices, c: Array, x: Array, output: int, n: int, first: int, step: float) -> float:
    """Steps 1 and 3 for one output, unless its sample is doubtful; gives the innovation."""
    k1, k3, row = ints[places.PARALLEL_UNKNOWNS], ints[places.SERIES_UNKNOWNS], ints[slots.AT_ROW]
    w = ints[slots.AT_WATCH] + output * ints[slots.WATCH]
    y = x[slots.INBOX + ints[slots.INPUTS] + output]
    t1 = ints[places.C_FITS] + output * stride_of(ints)
    t0 = t1 + k1 * (n + k1)
    t3 = t0 + n
    theta1 = ints[places.X_FITS] + output * (k1 + k3 + 2)
    theta3 = theta1 + k1 + 1
    phi1 = ints[places.X_ROOM]
    phi3 = phi1 + 2 * k1
    regressors(c, x, t1, k1, n, first, row, phi1)
    parallel = inner(x, theta1, phi1, k1)
    fitted, k = parallel, k1
    if ints[places.SERIES]:
        regressors(c, x, t3, k3, n, first, row, phi3)
        fitted, k = inner(x, theta3, phi3, k3), k3
        for s in range(first, n):
            fitted += c[t0 + s] * x[row + s]
    error = y - fitted
    x[w + slots.FITTED] = fitted
    x[w + slots.INNOVATION] = error
    leverage = min(0.5 * step * k, 0.9)
    taken = x[w + slots.TAKEN]
    ready = c[places.READY] > places.DOUBTS and taken > 10.0 * n + 30.0 and leverage < places.WHITE
    known = x[w + slots.SCALE] > 0.0
    scale = noise_scale(x, w)
    # weights that follow every sample have no expectation that a sample could be far from
    doubts = c[places.READY] > 0.0 and leverage < places.WHITE
    own = scale * np.sqrt(1.0 + leverage) if doubts else np.inf
    if doubt(x, w, y, fitted, leverage, own, n):
        refuse(ints, c, x, w, first, error, ready)
        return float(error)
    x[w + slots.REFUSED] = 0.0
    v = error / np.sqrt(1.0 + leverage)
    if known:
        z = v / scale
        watch(ints, c, x, w, first, min(max(z, -slots.LARGE), slots.LARGE), ready)
    move(c, x, theta1, k1, phi1, t1 + k1 * n, taken, step, 1.0, y - parallel)
    if ints[places.SERIES]:
        move(c, x, theta3, k3, phi3, t3 + k3 * n, taken, step, 1.0, error)
    kept = 1.0 - min(step / places.MEMORY, 0.5)
    x[w + slots.SQUARES] = kept * x[w + slots.SQUARES] + error * error
    learn(x, w, y, v, kept)
    return float(error)


@compiled("void(int64[::1], float64[::1], float64[::1], int64)")
def answers(ints: Indices, c: Array, x: Array, at: int) -> None:
    """How the filter answers to each of the states that a model's output may hold."""
    q, d, kept, row = ints[slots.ORDER], ints[places.ANSWERS], ints[places.KEPT], ints[slots.AT_ROW]
    for channel in range(ints[slots.INPUTS] + ints[slots.FREE]):
        own = row + channel * q
        for k in range(kept):
            for a in range(d):
                value = 0.0
                table = ints[places.C_SECOND] + (k * d + a) * q
                for s in range(q):
                    value += c[table + s] * x[own + s]
                x[at + (channel * kept + k) * d + a] = value


@compiled("void(int64[::1], float64[::1], float64[::1], int64, int64, int64, float64, int64)")
def second(
    ints: Indices, c: Array, x: Array, output: int, n: int, first: int, step: float, answer: int
) -> None:
    """Step 2 on the output of the series model, or of the parallel one before there is another."""
    k1, k3, row = ints[places.PARALLEL_UNKNOWNS], ints[places.SERIES_UNKNOWNS], ints[slots.AT_ROW]
    m, q, d, kept, poles = (
        ints[slots.INPUTS],
        ints[slots.ORDER],
        ints[places.ANSWERS],
        ints[places.KEPT],
        ints[places.POLES],
    )
    base = ints[places.C_FITS] + output * stride_of(ints)
    t0 = base + k1 * (n + k1)
    t3 = t0 + n
    t2 = t3 + k3 * (n + k3)
    theta = ints[places.X_FITS] + output * (k1 + k3 + 2)
    r = answer + (m + ints[slots.FREE]) * kept * d
    width = q * (m + ints[slots.FREE]) + m
    table, k = base, k1
    if ints[places.SERIES]:
        table, k, theta = t3, k3, theta + k1 + 1
    for s in range(width):
        x[r + s] = c[t0 + s] if ints[places.SERIES] else 0.0
    for i in range(k):
        value = x[theta + i]
        at = table + i * n
        for s in range(first, width):
            x[r + s] += value * c[at + s]
    monic = 0.0
    for s in range(first, width):
        monic += x[r + s] * x[row + s]
    unknowns = poles + ints[slots.OUTPUTS] * ints[places.OWN]
    psi = r + n
    for i in range(unknowns):
        x[psi + i] = 0.0
    drive = ints[places.C_SECOND] + kept * d * q
    for a in range(d):
        value = 0.0
        for channel in range(first // q, m + ints[slots.FREE]):
            for i in range(kept):
                value += x[r + channel * q + i] * x[answer + (channel * kept + i) * d + a]
        for j in range(m):
            through = x[r + q * (m + ints[slots.FREE]) + j]
            if through != 0.0:
                own = row + (j + ints[slots.FREE]) * q
                for s in range(q):
                    value += through * c[drive + a * q + s] * x[own + s]
        if a < poles:
            x[psi + a] = -value
        else:
            monic = value
    regressors(c, x, t2, ints[places.OWN], n, first, row, psi + poles + output * ints[places.OWN])
    error = monic - inner(x, ints[places.X_SECOND], psi, unknowns)
    weight = c[t2 + ints[places.OWN] * n]
    gains = drive + d * q
    move(c, x, ints[places.X_SECOND], unknowns, psi, gains, x[places.MOMENTS], step, weight, error)


@compiled("void(int64[::1], float64[::1], int64)")
def gather(ints: Indices, x: Array, n: int) -> None:
    """Sum of the unknowns of Step 2."""
    unknowns = ints[places.POLES] + ints[slots.OUTPUTS] * ints[places.OWN]
    at = ints[places.X_SECOND]
    for i in range(unknowns):
        x[at + unknowns + 1 + i] += x[at + i]
    x[places.SUMMED] += 1.0


@compiled("void(int64[::1], float64[::1], float64[::1], int64)")
def moments(ints: Indices, c: Array, x: Array, n: int) -> None:
    """Running mean of ``z z'``, its lower triangle."""
    row, at = ints[slots.AT_ROW], ints[places.X_MOMENTS]
    x[places.MOMENTS] += 1.0
    pace = max(1.0 / x[places.MOMENTS], c[places.GRADIENT_PACE])
    for i in range(n):
        zi = x[row + i]
        if abs(zi) < 1e100:
            for s in range(i + 1):
                x[at + s] += pace * (zi * x[row + s] - x[at + s])
        at += i + 1


@compiled("float64(int64[::1], float64[::1], float64[::1], float64)", value=True)
def gradient_step(ints: Indices, c: Array, x: Array, interval: float) -> float:
    """One sample, which stands in the inbox; gives the innovation of the first output."""
    take_in(ints, c, x, interval)
    if ints[slots.COLLECTING]:
        return nothing_told(ints, x)
    advance(ints, c, x)
    complete_row(ints, c, x)
    n, first = ints[slots.COLUMNS], int(x[slots.FIRST])
    if ints[slots.FREE] and x[slots.SINCE] < ints[slots.BEGIN]:
        return nothing_told(ints, x)
    step = interval * c[places.RATE]
    idle = False
    for i in range(ints[slots.OUTPUTS]):
        adapt(ints, c, x, i, n, first, step)
        idle |= tell(ints, x, ints[slots.AT_WATCH] + i * ints[slots.WATCH])
    answer = ints[places.X_ROOM]
    answers(ints, c, x, answer)
    for i in range(ints[slots.OUTPUTS]):
        second(ints, c, x, i, n, first, step, answer)
    if not idle:
        moments(ints, c, x, n)
        if x[slots.COUNT] >= x[places.FROM]:
            gather(ints, x, n)
    count(ints, x)
    return float(x[ints[slots.AT_WATCH] + slots.INNOVATION])
