"""Samples at other instants: two rates in one record, interpolation, filtering."""

from __future__ import annotations

import numpy as np

from tridentify.errors import LengthMismatchError, NonUniformTimeError
from tridentify.numerics.arrays import Array

SAME = 1e-6
"""Share of a step within which two instants are one: rounding of text and of clocks."""
APART = 3.0
"""Steps of a channel between two of its samples that are a gap: nothing is joined across it."""


def merge_rates(
    own: Array, u: Array, other: Array, y: Array, intersample: str
) -> tuple[Array, Array, Array]:
    """Inputs and outputs on the instants of both.

    Parameters
    ----------
    own, other : (n_u,), (n_y,) arrays
        Instants of the inputs and of the outputs [s].
    u, y : (n_u, n_inputs), (n_y, n_outputs) arrays
    intersample : str

    Returns
    -------
    t, u, y : arrays
        ``y`` is nan where only the input was sampled.

    Raises
    ------
    LengthMismatchError, NonUniformTimeError

    Examples
    --------
    >>> t = np.arange(3.0)
    >>> merged = merge_rates(t, t[:, None], np.array([0.5, 1.0]), np.ones((2, 1)), "foh")
    >>> merged[0].tolist(), merged[1].ravel().tolist(), merged[2].ravel().tolist()
    ([0.0, 0.5, 1.0, 2.0], [0.0, 0.5, 1.0, 2.0], [nan, 1.0, 1.0, nan])
    """
    step = (own[-1] - own[0]) / max(own.size - 1, 1)
    near = np.clip(np.searchsorted(own, other - 0.5 * step), 0, own.size - 1)
    slack = SAME * min(step, (other[-1] - other[0]) / max(other.size - 1, 1) or step)
    same = np.abs(own[near] - other) <= slack
    end = own[-1] + (step if intersample == "zoh" else 0.0)
    if other[0] < own[0] - slack or other[-1] > end + slack:
        raise LengthMismatchError(
            f"found outputs from {other[0]:.6g} to {other[-1]:.6g} s and inputs from {own[0]:.6g} "
            f"to {end:.6g} s; expected inputs wherever there are outputs; cut the outputs, or "
            "correct the intervals"
        )
    if intersample == "band-limited" and not same.all():
        raise NonUniformTimeError(
            f"found outputs between the samples of a band-limited input ({step:.6g} s); expected "
            "their interval to be a whole multiple of it; resample the input, or state another "
            "intersample"
        )
    t = np.union1d(own, other[~same])
    if intersample == "foh":
        inputs = np.column_stack([np.interp(t, own, column) for column in u.T])
    else:
        inputs = u[np.searchsorted(own, t, side="right") - 1]
    outputs = np.full((t.size, y.shape[1]), np.nan)
    outputs[np.searchsorted(t, np.where(same, own[near], other))] = y
    return t, inputs, outputs


def interpolate(t: Array, u: Array, y: Array, grid: Array, intersample: str) -> tuple[Array, Array]:
    """Inputs as they are between their samples, outputs on straight lines; nan across gaps."""
    after = np.clip(np.searchsorted(t, grid), 1, t.size - 1)
    before = after - 1
    span = t[after] - t[before]
    share = ((grid - t[before]) / span)[:, None]
    lines = y[before] + share * (y[after] - y[before])
    # at a sample itself its neighbour does not count
    lines = np.where(share == 0.0, y[before], np.where(share == 1.0, y[after], lines))
    wide = (span > APART * np.median(np.diff(t)))[:, None] & (share > 0.0) & (share < 1.0)
    return evaluated(t, u, grid, intersample), np.where(wide, np.nan, lines)


def evaluated(t: Array, u: Array, grid: Array, intersample: str) -> Array:
    """(n_grid, n_channels) samples at other instants within the record: held, or on lines.

    Examples
    --------
    >>> t = np.arange(3.0)
    >>> evaluated(t, t[:, None], np.array([0.5, 2.0]), "foh").ravel().tolist()
    [0.5, 2.0]
    """
    if intersample != "foh":
        return u[np.searchsorted(t, grid, side="right") - 1]
    after = np.clip(np.searchsorted(t, grid), 1, t.size - 1)
    before = after - 1
    share = ((grid - t[before]) / (t[after] - t[before]))[:, None]
    return u[before] + share * (u[after] - u[before])


def filtered(x: Array, weights: Array, *, extend: bool) -> Array:
    """Weighted sums around every sample; beyond the ends reflected, or nan.

    Examples
    --------
    >>> filtered(np.arange(4.0)[:, None], np.ones(3) / 3, extend=False).ravel().round(12).tolist()
    [nan, 1.0, 2.0, nan]
    """
    from scipy.signal import oaconvolve  # slow to import, seldom needed

    half = weights.size // 2
    padded = np.pad(x, ((half, half), (0, 0)), mode="reflect", reflect_type="odd")
    missing = np.isnan(padded)
    turned = weights[::-1, None]
    found = np.asarray(oaconvolve(np.where(missing, 0.0, padded), turned, mode="valid", axes=0))
    if extend:
        return found
    found[:half] = found[x.shape[0] - half :] = np.nan
    if missing.any():
        count = np.cumsum(np.pad(missing, ((1, 0), (0, 0))), axis=0)
        found[count[weights.size :] - count[: -weights.size] > 0] = np.nan
    return found
