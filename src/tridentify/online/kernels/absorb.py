"""One row with its target into one triangle, compiled: predicted, doubted, forgotten, turned in."""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.compiled import linked as compiled
from tridentify.numerics.recursive import forget, innovate, rotate
from tridentify.online.kernels import slots
from tridentify.online.kernels.intake import doubt, learn, noise_scale, watch


@compiled("void(int64[::1], float64[::1], float64[::1], int64, int64, float64, boolean)")
def refuse(
    ints: Indices, c: Array, x: Array, w: int, first: int, error: float, ready: bool
) -> None:
    """A doubtful sample: one far off still counts as a hint that the coefficients have moved."""
    if int(x[slots.FLAGS]) & slots.OUTLIER:
        x[w + slots.REFUSED] += 1.0
        # refused samples count for the scale, or one that is too small would stay so
        x[w + slots.SCALE] *= 1.0 + max(4.0 / (x[w + slots.TAKEN] + 8.0), slots.SCALE_PACE)
        watch(ints, c, x, w, first, slots.TOLD if error > 0.0 else -slots.TOLD, ready)
        if x[w + slots.REFUSED] > slots.MOST_REFUSED:
            x[w + slots.MOVED] = 1.0


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
    if x[slots.SINCE] % period == period - 1.0 and x[w + slots.IDLE] == 0.0:
        for i in range(n):
            x[at + i] *= slots.CUT
        x[w + slots.SQUARES] *= slots.CUT
        x[w + slots.WEIGHT] *= slots.CUT
        x[w + slots.WEIGHT2] *= slots.CUT * slots.CUT


@compiled(
    "float64(int64[::1], float64[::1], float64[::1], int64, int64, int64, int64, float64)",
    inline=True,
)
def absorb(
    ints: Indices, c: Array, x: Array, w: int, at: int, n: int, first: int, y: float
) -> float:
    """One row with its target into one triangle, unless it is doubtful; gives the innovation."""
    row, work = ints[slots.AT_ROW], ints[slots.AT_WORK]
    fitted, leverage = innovate(x, at, n, first, row, work)
    error = y - fitted
    x[w + slots.FITTED] = fitted
    x[w + slots.INNOVATION] = error
    root = np.sqrt(1.0 + leverage)
    known = x[w + slots.SCALE] > 0.0
    ready = x[w + slots.TAKEN] > 10.0 * n + 30.0
    scale = noise_scale(x, w)
    if doubt(x, w, y, fitted, leverage, scale * root, n):
        refuse(ints, c, x, w, first, error, ready)
        return error
    x[w + slots.REFUSED] = 0.0
    v = error / root
    if known and leverage < 1.0:
        z = v / scale
        z = min(max(z, -slots.LARGE), slots.LARGE)
        watch(ints, c, x, w, first, z, ready)
    if ints[slots.LEARNING] > 0 and x[w + slots.IDLE] >= slots.HELD_BLOCKS:
        return error
    factor = c[slots.FORGETTING]
    kind = ints[slots.KIND]
    kept = 1.0
    if factor < 1.0 and kind == slots.EXPONENTIAL:
        kept = factor
        forget(x, at, n, first, work, factor, c[slots.PACE])
    rotate(x, at, n, first, row, work, y, 1.0)
    if factor < 1.0 and kind == slots.DIRECTIONAL:
        kept = factor
        forget_along(x, at, n, first, row, work, y, error, leverage, factor)
    if factor < 1.0 and kind == slots.RESETTING:
        reset(x, w, at, n, factor)
    if leverage < np.inf:
        x[w + slots.SQUARES] = kept * x[w + slots.SQUARES] + error * error / (1.0 + leverage / kept)
    learn(x, w, y, v if leverage < 1.0 else np.nan, kept)
    return error
