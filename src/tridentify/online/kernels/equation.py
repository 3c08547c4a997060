"""The equation error of the recorded output sample by sample, compiled (`online.equation`).

States of ``1 / c`` driven by each input (exact for its intersample behaviour) and by each output,
whose samples are joined by straight lines. The row of an output is

    [ impulse states, output by output | 1, output by output | - X y_i | X u_j of its own channels ]

and its target ``p^n / c y_i``, both times the weight of the output: one triangle for all outputs,
as they share ``a``.

A sample that is missing or doubtful must not stand in the regressors of those that come after it.
What the model expects in its place does: the error is linear in the newest sample, ``d eps / d
y_k`` is known, and the value that makes it zero is put into the filter.
"""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.compiled import linked as compiled
from tridentify.numerics.recursive import correct, drift, predict, solve_triangle
from tridentify.online.kernels import slots
from tridentify.online.kernels.absorb import absorb, refuse
from tridentify.online.kernels.intake import (
    count,
    die_away,
    doubt,
    drive,
    learn,
    noise_scale,
    nothing_told,
    take_in,
    tell,
    transit,
    watch,
)


@compiled("void(int64[::1], float64[::1], float64[::1])", inline=True)
def advance_inputs(ints: Indices, c: Array, x: Array) -> None:
    """The filter driven by the impulse at the beginning and by the inputs."""
    if ints[slots.FREE] and die_away(ints, c, x, ints[slots.AT_IMPULSE]):
        x[slots.FIRST] = float(ints[slots.ORDER] * ints[slots.OUTPUTS])
    if x[slots.SINCE] > 0.0:
        drive(ints, c, x, ints[slots.AT_INPUTS])


@compiled("void(int64[::1], float64[::1], float64[::1], int64)", inline=True)
def free_motion(ints: Indices, c: Array, x: Array, i: int) -> None:
    """The filter of an output up to the newest sample, which is still to be added."""
    if x[slots.SINCE] == 0.0:
        return
    q, g, before = ints[slots.ORDER], ints[slots.C_OUTPUT], x[ints[slots.AT_BEFORE] + i]
    for r in range(q):
        x[ints[slots.AT_WORK] + r] = c[g + r] * before
    transit(ints, c, x, ints[slots.AT_OUTPUTS] + i * q)


@compiled("void(int64[::1], float64[::1], float64[::1], int64, float64)", inline=True)
def add_newest(ints: Indices, c: Array, x: Array, i: int, y: float) -> None:
    """The share of the newest sample in the filter of an output."""
    if x[slots.SINCE] == 0.0:
        return
    q = ints[slots.ORDER]
    own, g = ints[slots.AT_OUTPUTS] + i * q, ints[slots.C_OUTPUT] + q
    for r in range(q):
        x[own + r] += c[g + r] * y


@compiled("float64(int64[::1], float64[::1], float64[::1], int64, float64)", inline=True)
def build_row(ints: Indices, c: Array, x: Array, i: int, y: float) -> float:
    """Write the row of an output; gives its target."""
    m, p, q, n = ints[slots.INPUTS], ints[slots.OUTPUTS], ints[slots.ORDER], ints[slots.COLUMNS]
    row, basis = ints[slots.AT_ROW], ints[slots.C_BASIS]
    at = row
    if ints[slots.FREE]:
        # also once the free response is over: the Kalman filter reads the whole row
        for s in range(p * q):
            x[at + s] = 0.0
        if x[slots.FIRST] == 0.0:
            for s in range(q):
                x[at + i * q + s] = x[ints[slots.AT_IMPULSE] + s]
        at += p * q
    if ints[slots.OFFSET]:
        for s in range(p):
            x[at + s] = 0.0
        x[at + i] = 1.0
        at += p
    poles = int(c[ints[slots.C_ZEROS] + m * p])
    own = x[ints[slots.AT_OUTPUTS] + i * q : ints[slots.AT_OUTPUTS] + (i + 1) * q]
    for d in range(poles):
        total = 0.0
        function = c[basis + d * q : basis + (d + 1) * q]
        for s in range(q):
            total += function[s] * own[s]
        x[at + d] = -total
    at += poles
    for o in range(p):
        for j in range(m):
            zeros = int(c[ints[slots.C_ZEROS] + o * m + j])
            if o == i:
                states = x[ints[slots.AT_INPUTS] + j * q : ints[slots.AT_INPUTS] + (j + 1) * q]
                for d in range(min(zeros + 1, q)):
                    total = 0.0
                    function = c[basis + d * q : basis + (d + 1) * q]
                    for s in range(q):
                        total += function[s] * states[s]
                    x[at + d] = total
                if zeros == q:
                    late = (
                        ints[slots.AT_LINE] + j * ints[slots.LINE] + int(c[ints[slots.C_EXTRA] + j])
                    )
                    h = ints[slots.C_DIRECT] + 2 * j
                    x[at + q] = c[h] * x[late] + c[h + 1] * x[late + 1]
            else:
                for d in range(zeros + 1):
                    x[at + d] = 0.0
            at += zeros + 1
    target = c[ints[slots.C_MONIC] + q] * y
    for s in range(q):
        target += c[ints[slots.C_MONIC] + s] * own[s]
    weight = c[ints[slots.C_MONIC] + q + 1 + i]
    if weight != 1.0:
        for s in range(n):
            x[row + s] *= weight
        target *= weight
    return float(target)


@compiled("float64(int64[::1], float64[::1], float64[::1], int64)")
def slope(ints: Indices, c: Array, x: Array, theta: int) -> float:
    """``d eps / d y_k`` of the newest sample."""
    m, p, q = ints[slots.INPUTS], ints[slots.OUTPUTS], ints[slots.ORDER]
    g, basis = ints[slots.C_OUTPUT] + q, ints[slots.C_BASIS]
    first = p * (q * ints[slots.FREE] + ints[slots.OFFSET])
    total = c[ints[slots.C_MONIC] + q]
    for s in range(q):
        weight = c[ints[slots.C_MONIC] + s]
        for d in range(int(c[ints[slots.C_ZEROS] + m * p])):
            weight += x[theta + first + d] * c[basis + d * q + s]
        total += weight * c[g + s]
    return float(total)


@compiled("float64(int64[::1], float64[::1], float64[::1], int64, float64)")
def filtered(ints: Indices, c: Array, x: Array, w: int, y: float) -> float:
    """One row into the Kalman filter, unless it is doubtful; gives the innovation."""
    n, row, work = ints[slots.COLUMNS], ints[slots.AT_ROW], ints[slots.AT_WORK]
    theta, at = ints[slots.AT_THETA], ints[slots.AT_COVARIANCE]
    fitted, spread = predict(x, theta, at, n, row, work)
    own = noise_scale(x, w)
    noise = own**2
    leverage = spread / noise if noise > 0.0 else 0.0
    error = y - fitted
    x[w + slots.FITTED] = fitted
    x[w + slots.INNOVATION] = error
    v = error / np.sqrt(1.0 + leverage)
    bounded = min(leverage, 0.9)
    if doubt(x, w, y, fitted, bounded, own * np.sqrt(1.0 + bounded), n):
        refuse(ints, c, x, w, int(x[slots.FIRST]), error, True)
        return float(error)
    x[w + slots.REFUSED] = 0.0
    if own > 0.0:
        z = min(max(v / own, -slots.LARGE), slots.LARGE)
        watch(ints, c, x, w, int(x[slots.FIRST]), z, True)
    if x[w + slots.IDLE] >= slots.HELD_BLOCKS:
        return float(error)
    correct(x, theta, at, n, work, ints[slots.AT_GAIN], error, noise)
    x[w + slots.SQUARES] += error * error / (1.0 + leverage)
    learn(x, w, y, v, 1.0)
    return float(error)


@compiled("float64(int64[::1], float64[::1], float64[::1], float64)", value=True)
def equation_step(ints: Indices, c: Array, x: Array, interval: float) -> float:
    """One sample, which stands in the inbox; gives the innovation of the first output."""
    take_in(ints, c, x, interval)
    m, p = ints[slots.INPUTS], ints[slots.OUTPUTS]
    if ints[slots.COLLECTING]:
        return nothing_told(ints, x)
    advance_inputs(ints, c, x)
    n, theta = ints[slots.COLUMNS], ints[slots.AT_THETA]
    begun = not ints[slots.FREE] or x[slots.SINCE] >= ints[slots.BEGIN]
    resting = False
    for i in range(p):
        w = ints[slots.AT_WATCH] + i * ints[slots.WATCH]
        before = ints[slots.AT_BEFORE] + i
        y = x[slots.INBOX + m + i]
        seen = abs(y) < slots.LARGEST
        used = y if seen else x[before]
        free_motion(ints, c, x, i)
        add_newest(ints, c, x, i, used)
        target = build_row(ints, c, x, i, used)
        if not begun:
            x[w + slots.INNOVATION] = np.nan
            x[before] = used
            continue
        taken = x[w + slots.TAKEN]
        told = target if seen else np.nan
        if ints[slots.FILTERING]:
            filtered(ints, c, x, w, told)
        else:
            first = int(x[slots.FIRST])
            absorb(ints, c, x, w, ints[slots.AT_FACTOR], n, first, told)
        held = x[w + slots.IDLE] >= slots.HELD_BLOCKS
        resting = resting or held
        refused = x[w + slots.TAKEN] == taken
        if held:
            refused = int(x[slots.FLAGS]) & (slots.MISSING_OUTPUT | slots.DOUBTED) > 0
        if refused and x[w + slots.TAKEN] > 2.0 * n:
            # what the model expects takes the place of the sample
            if not ints[slots.FILTERING]:
                solve_triangle(x, ints[slots.AT_FACTOR], n, theta)
            rate = slope(ints, c, x, theta) * c[ints[slots.C_MONIC] + ints[slots.ORDER] + 1 + i]
            if abs(rate) > 1e-12:
                expected = used - (target - x[w + slots.FITTED]) / rate
                if abs(expected) < slots.LARGEST:
                    add_newest(ints, c, x, i, expected - used)
                    used = expected
        x[before] = used
        x[w + slots.INNOVATION] /= c[ints[slots.C_MONIC] + ints[slots.ORDER] + 1 + i]
        tell(ints, x, w)
    if ints[slots.FILTERING] and not resting:
        drift(
            x, ints[slots.AT_COVARIANCE], n, c, ints[slots.C_WALK], ints[slots.C_WIDTHS],
            ints[slots.WALKERS], interval, ints[slots.AT_GAIN] + n,
        )  # fmt: skip
    count(ints, x)
    return float(x[ints[slots.AT_WATCH] + slots.INNOVATION])
