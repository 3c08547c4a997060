"""What an excitation refuses: times, levels and frequencies that make no signal."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from tridentify.errors import OptionError, shown
from tridentify.numerics.arrays import Array

WHOLE = 1e-6
"""Relative error of a duration over a step that passes for a whole number: what decimal text
leaves."""
MOST_SAMPLES = 20_000_000
"""160 MB a channel; more is a duration in milliseconds, or a step in microseconds."""


def positive(label: str, value: object) -> float:
    """A positive finite number.

    Raises
    ------
    OptionError
        It is none.

    Examples
    --------
    >>> positive("dt", 0.02)
    0.02
    """
    if isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool):
        number = float(value)
        if math.isfinite(number) and number > 0:
            return number
    raise OptionError.found(f"{label}=", value, "a positive finite number", f"correct {label}")


def not_negative(label: str, value: object) -> float:
    """Zero or a positive finite number."""
    return 0.0 if value == 0 and not isinstance(value, bool) else positive(label, value)


def count(label: str, value: object, least: int = 1, most: int = MOST_SAMPLES) -> int:
    """A whole number in a range.

    Raises
    ------
    OptionError
        It is none.

    Examples
    --------
    >>> count("periods", 2)
    2
    """
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if not whole or not least <= int(value) <= most:  # type: ignore[call-overload]
        raise OptionError.found(
            f"{label}=", value, f"a whole number from {least} to {most}", f"correct {label}"
        )
    return int(value)  # type: ignore[call-overload, no-any-return]


def samples_of(label: str, time: float, dt: float, *, exact: bool = False) -> int:
    """The number of sampling intervals in a time, at least one.

    Parameters
    ----------
    label : str
    time, dt : float
        Positive [s].
    exact : bool
        Refuse a time that is no whole number of intervals.

    Raises
    ------
    OptionError
        The time is shorter than half an interval, too long, or not whole where it must be.

    Examples
    --------
    >>> samples_of("width", 0.5, 0.02)
    25
    """
    steps = time / dt
    whole = round(steps) if steps < 2 * MOST_SAMPLES else 2 * MOST_SAMPLES
    if whole > MOST_SAMPLES:
        raise OptionError(
            f"found {label}={time:.6g} s of {steps:.3g} samples; expected at most "
            f"{MOST_SAMPLES:,}; sample more slowly or shorten it"
        )
    if whole < 1:
        raise OptionError(
            f"found {label}={time:.6g} s, shorter than the sampling interval of {dt:.6g} s; "
            "expected at least one sample; sample faster"
        )
    if exact and abs(steps - whole) > WHOLE * whole:
        raise OptionError(
            f"found {label}={time:.6g} s and dt={dt:.6g} s; expected a whole number of sampling "
            f"intervals; take {whole * dt:.6g} s"
        )
    return whole


def _two(given: object) -> tuple[float, float]:
    """Two numbers; nan for what is none."""
    try:
        low, high = (float(one) for one in given)  # type: ignore[attr-defined]
    except (TypeError, ValueError):
        return math.nan, math.nan
    return low, high


def levels_of(levels: object) -> tuple[float, float]:
    """Two different finite levels, lower first.

    Raises
    ------
    OptionError
        They are not.
    """
    low, high = _two(levels)
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise OptionError(
            f"found levels={shown(levels)}; expected two finite numbers, the lower one first; "
            "write for example levels=(-1.0, 1.0)"
        )
    return low, high


def band_of(band: object, highest: float = math.inf) -> tuple[float, float]:
    """Lowest and highest angular frequency, below a limit [rad/s].

    Raises
    ------
    OptionError
        They are no band.
    """
    low, high = _two(band)
    if not 0.0 <= low < high < math.inf:
        raise OptionError(
            f"found band={shown(band)}; expected two frequencies in rad/s, the lower one first; "
            "write for example band=(0.5, 20.0)"
        )
    if high > highest * (1.0 + WHOLE):
        raise OptionError(
            f"found a band up to {high:.6g} rad/s; expected less than {highest:.6g} rad/s, half "
            "the sampling rate; sample faster or lower the band"
        )
    return low, high


def vector(label: str, value: ArrayLike, *, least: float | None = None) -> Array:
    """A finite vector, optionally with nothing below a limit.

    Raises
    ------
    OptionError
        It is none.
    """
    try:
        found = np.atleast_1d(np.asarray(value, dtype=np.float64))
    except (TypeError, ValueError):
        found = np.full(1, np.nan)
    sound = found.ndim == 1 and found.size and bool(np.all(np.isfinite(found)))
    if not sound or (least is not None and np.any(found < least)):
        what = "finite numbers" if least is None else f"finite numbers from {least:g} on"
        raise OptionError.found(f"{label}=", value, f"{what} in one dimension", f"correct {label}")
    return found
