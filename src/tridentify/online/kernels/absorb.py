"""One row with its target into one triangle, compiled: predicted, doubted, forgotten, turned in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tridentify.numerics.arrays import Array
from tridentify.numerics.compiled import compiled
from tridentify.numerics.recursive import forget, innovate, rotate
from tridentify.online.kernels.intake import doubt, learn, noise_scale, watch
from tridentify.online.kernels.slots import (
    AT_ROW,
    AT_WORK,
    CUT,
    DIRECTIONAL,
    EXPONENTIAL,
    FITTED,
    FLAGS,
    FORGETTING,
    HELD_BLOCKS,
    IDLE,
    INNOVATION,
    KIND,
    LARGE,
    LEARNING,
    MOST_REFUSED,
    MOVED,
    OUTLIER,
    PACE,
    REFUSED,
    RESETTING,
    SCALE,
    SCALE_PACE,
    SINCE,
    SQUARES,
    TAKEN,
    TOLD,
    WEIGHT,
    WEIGHT2,
)

Ints = NDArray[np.int64]


@compiled("void(int64[::1], float64[::1], float64[::1], int64, int64, float64, boolean)")
def refuse(ints: Ints, c: Array, x: Array, w: int, first: int, error: float, ready: bool) -> None:
    """A doubtful sample: one far off still counts as a hint that the coefficients have moved."""
    if int(x[FLAGS]) & OUTLIER:
        x[w + REFUSED] += 1.0
        # refused samples count for the scale, or one that is too small would stay so
        x[w + SCALE] *= 1.0 + max(4.0 / (x[w + TAKEN] + 8.0), SCALE_PACE)
        watch(ints, c, x, w, first, TOLD if error > 0.0 else -TOLD, ready)
        if x[w + REFUSED] > MOST_REFUSED:
            x[w + MOVED] = 1.0


@compiled(
    "void(float64[::1], int64, int64, int64, int64, int64, float64, float64, float64, float64)"
)
def forget_along(
    x: Array, at: int, n: int, first: int, row: int, work: int, y: float, error: float,
    leverage: float, factor: float,
) -> None:  # fmt: skip
    """Directional forgetting, after the row has been absorbed (`numerics.recursive`)."""
    beta = factor
    if leverage < np.inf:
        beta = factor - (1.0 - factor) / leverage if leverage > 0.0 else 1.0
    if leverage > 1e-12:
        new = y - (error / (1.0 + leverage) if leverage < np.inf else 0.0)
        rotate(x, at, n, first, row, work, new, beta - 1.0)


@compiled("void(float64[::1], int64, int64, int64, float64)")
def reset(x: Array, w: int, at: int, n: int, factor: float) -> None:
    """Most of what was learnt loses its weight, once in a memory."""
    period = np.floor(1.0 / (1.0 - factor) + 0.5)
    if x[SINCE] % period == period - 1.0 and x[w + IDLE] == 0.0:
        for i in range(n):
            x[at + i] *= CUT
        x[w + SQUARES] *= CUT
        x[w + WEIGHT] *= CUT
        x[w + WEIGHT2] *= CUT * CUT


@compiled(
    "float64(int64[::1], float64[::1], float64[::1], int64, int64, int64, int64, float64)",
    inline=True,
)
def absorb(ints: Ints, c: Array, x: Array, w: int, at: int, n: int, first: int, y: float) -> float:
    """One row with its target into one triangle, unless it is doubtful; gives the innovation."""
    row, work = ints[AT_ROW], ints[AT_WORK]
    fitted, leverage = innovate(x, at, n, first, row, work)
    error = y - fitted
    x[w + FITTED] = fitted
    x[w + INNOVATION] = error
    root = np.sqrt(1.0 + leverage)
    known = x[w + SCALE] > 0.0
    ready = x[w + TAKEN] > 10.0 * n + 30.0
    scale = noise_scale(x, w)
    if doubt(x, w, y, fitted, leverage, scale * root, n):
        refuse(ints, c, x, w, first, error, ready)
        return error
    x[w + REFUSED] = 0.0
    v = error / root
    if known and leverage < 1.0:
        z = v / scale
        z = min(max(z, -LARGE), LARGE)
        watch(ints, c, x, w, first, z, ready)
    if ints[LEARNING] > 0 and x[w + IDLE] >= HELD_BLOCKS:
        return error
    factor = c[FORGETTING]
    kind = ints[KIND]
    kept = 1.0
    if factor < 1.0 and kind == EXPONENTIAL:
        kept = factor
        forget(x, at, n, first, work, factor, c[PACE])
    rotate(x, at, n, first, row, work, y, 1.0)
    if factor < 1.0 and kind == DIRECTIONAL:
        kept = factor
        forget_along(x, at, n, first, row, work, y, error, leverage, factor)
    if factor < 1.0 and kind == RESETTING:
        reset(x, w, at, n, factor)
    if leverage < np.inf:
        x[w + SQUARES] = kept * x[w + SQUARES] + error * error / (1.0 + leverage / kept)
    learn(x, w, y, v if leverage < 1.0 else np.nan, kept)
    return error
