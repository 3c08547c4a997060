"""Checks of the coefficients of a transfer function, each with its own exception."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tridentify.errors import (
    ChannelCountError,
    CoefficientError,
    ImproperModelError,
    OptionError,
    shown,
)
from tridentify.numerics.arrays import Array


def is_flat(value: Any) -> bool:
    """Tell a one-dimensional polynomial from nested ones."""
    if isinstance(value, np.ndarray):
        return value.ndim <= 1
    if not isinstance(value, (list, tuple)):
        return True
    return not any(isinstance(item, (list, tuple)) or np.ndim(item) > 0 for item in value)


def nested_coefficients(label: str, value: Any) -> list[list[Array]]:
    """Give float arrays ``[output][input]``; a one-dimensional value is one channel."""
    if is_flat(value):
        return [[one_polynomial(label, value)]]
    rows = [list(row) if isinstance(row, (list, tuple, np.ndarray)) else [] for row in value]
    if not rows[0] or any(len(row) != len(rows[0]) for row in rows) or is_flat(value[0]):
        raise ChannelCountError(
            f"found {label}={shown(value)}; expected one-dimensional coefficients or equally long "
            f"rows {label}[output][input]; nest it as [[[b1, b0], [c1, c0]]] for two inputs"
        )
    return [[one_polynomial(label, item) for item in row] for row in rows]


def one_polynomial(label: str, value: Any) -> Array:
    """Copy one polynomial into a finite float array."""
    try:
        raw = np.atleast_1d(np.asarray(value))
    except ValueError:
        raw = np.empty((0, 0))
    if raw.ndim != 1 or raw.size == 0 or raw.dtype.kind not in "fiu":
        raise CoefficientError.found(
            f"{label}=", value, "real coefficients in descending powers", "give at least one number"
        )
    array = raw.astype(np.float64)
    if not np.isfinite(array).all():
        raise CoefficientError(
            f"found {label}={shown(array.tolist())}; expected finite coefficients; correct them"
        )
    return array


def stripped(coefficients: Array) -> Array:
    """Drop leading coefficients that are zero; of nothing but zeros the last one stays."""
    leading = np.flatnonzero(coefficients)
    return coefficients[leading[0] :] if leading.size else coefficients[-1:]


def monic(num: Array, den: Array) -> tuple[Array, Array]:
    """Divide by the leading coefficient of the denominator; read-only."""
    den = stripped(den)
    if den[0] == 0.0:
        raise CoefficientError(
            "found a denominator of zeros; expected at least one coefficient that is not zero; "
            "correct den"
        )
    if len(num) > len(den):
        num = stripped(num)
    if len(num) > len(den):
        raise ImproperModelError(
            f"found a numerator of degree {len(num) - 1} over a denominator of degree "
            f"{len(den) - 1}; expected no higher a degree; lower num or raise den"
        )
    with np.errstate(over="ignore"):
        scaled_num, scaled_den = num / den[0], den / den[0]
    if not (np.isfinite(scaled_num).all() and np.isfinite(scaled_den).all()):
        raise CoefficientError(
            f"found the leading coefficient {den[0]:.3g} in a denominator; expected one that the "
            "others can be divided by; rescale time or drop the leading power"
        )
    scaled_num.flags.writeable = False
    scaled_den.flags.writeable = False
    return scaled_num, scaled_den


def channel_delays(delay: float | ArrayLike, shape: tuple[int, int]) -> Array:
    """Give delays [s] of shape (n_outputs, n_inputs), read-only."""
    try:
        given = np.asarray(delay, dtype=np.float64)
    except (TypeError, ValueError):
        given = np.array(np.nan)
    if given.ndim and given.shape != shape:
        raise ChannelCountError(
            f"found delay of shape {given.shape}; expected a number or shape {shape} (outputs, "
            "inputs); nest it as delay[output][input]"
        )
    if not (np.isfinite(given).all() and np.all(given >= 0.0)):
        raise OptionError.found("delay=", delay, "seconds, zero or more", "correct delay")
    array = np.array(np.broadcast_to(given, shape))
    array.flags.writeable = False
    return array
