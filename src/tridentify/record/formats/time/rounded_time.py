"""Time stamps that were rounded when they were written.

A log at 16 kHz whose time has six digits, or one at 60 Hz whose time counts milliseconds, has
uneven stamps of even samples. Rounding is at most half a unit of the last digit, so the stamps are
those of a raster ``c + k dt`` if one passes within half a unit of every one of them. Time that is
uneven by itself, at all above its last digit, leaves no such line: of ``n`` independent departures
each would have to lie in a band of one unit. A unit may even hold many samples (whole seconds of a
log at 50 Hz, so that stamps repeat): what is uneven within a unit nobody can tell, and over a
hundred units at an even pace the raster is the only reading.
"""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array
from tridentify.record.checks.times import uniform_step

FEWEST = 20
"""Stamps from which a raster through all of them is no chance."""
MOST_DECIMALS = 9
"""Nanoseconds, the finest that files write."""
DIGITS = range(4, 10)
"""Significant digits that a program may have written."""
FINE = 0.5
"""Unit of the last digit, in steps, above which stamps of any kind lie near some raster."""
TICKS = 100
"""Units that a record with coarser stamps has to last."""
SURE = 16.0
"""Of the fitted step, in standard errors of one through independent stamps."""
SLACK = 0.1
"""Half units by which a line that is fitted may miss the band."""
NICE = 3
"""Significant digits of a step that somebody has chosen."""
EXACT = 4.0 * float(np.finfo(np.float64).eps)
"""Relative error of a stamp that a program wrote: its own rounding, and that of a product."""


def raster_behind(time: Array) -> Array | None:
    """Even instants that rounded to these stamps; None where there are none, or nothing to mend.

    Parameters
    ----------
    time : (n,) array
        Rising stamps in the unit in which they were written.

    Returns
    -------
    (n,) array or None

    Examples
    --------
    >>> even = np.arange(60) / 60.0
    >>> found = raster_behind(np.round(even, 3))
    >>> bool(np.allclose(np.diff(found), 1.0 / 60.0, rtol=1e-5))
    True
    >>> raster_behind(np.round(even + 0.003 * np.sin(np.arange(60.0)), 3)) is None
    True
    """
    rises = time.size >= FEWEST and np.all(np.diff(time) >= 0.0) and time[-1] > time[0]
    if not rises or uniform_step(time) is not None:
        return None
    for half in (_of_decimals(time), _of_digits(time)):
        even = None if half is None else _even(time, half)
        if even is not None:
            return even
    return None


def _even(time: Array, half: Array) -> Array | None:
    """A raster within half a unit of every stamp."""
    places, unit = np.arange(time.size, dtype=np.float64), 2.0 * float(half.max())
    for step in _steps(time, unit):
        left = time - places * step
        low, high = float(np.max(left - half)), float(np.min(left + half))
        told = unit <= FINE * step or time[-1] - time[0] >= TICKS * unit
        if told and low - high <= 0.5 * SLACK * unit:
            begin = min(max(float(time[0]), min(low, high)), max(low, high))
            return np.asarray(begin + places * step)
    return None


def _of_decimals(time: Array) -> Array | None:
    """Half a unit of the last decimal; None where stamps have too many."""
    decimals = decimals_of(time)
    return None if decimals is None else np.full(time.size, 0.5 * 10.0**-decimals)


def decimals_of(time: Array) -> int | None:
    """How many decimals stamps were written with; None where they have too many.

    Examples
    --------
    >>> decimals_of(np.array([0.0, 0.25])), decimals_of(np.array([1.0 / 3.0]))
    (2, None)
    """
    for decimals in range(MOST_DECIMALS + 1):
        if np.all(np.abs(np.round(time, decimals) - time) <= EXACT * np.abs(time)):
            return decimals
    return None


def _of_digits(time: Array) -> Array | None:
    """Half a unit of the last significant digit of every stamp; None where they have too many."""
    size = np.where(time == 0.0, 1.0, np.abs(time))
    exponent = np.floor(np.log10(size))
    for digits in DIGITS:
        unit = 10.0 ** (exponent - digits + 1)
        if np.all(np.abs(np.round(time / unit) * unit - time) <= EXACT * size):
            return np.asarray(np.where(time == 0.0, 0.0, 0.5 * unit))
    return None


def _steps(time: Array, unit: float) -> list[float]:
    """Steps to be tried: one that somebody has chosen, a whole rate, and the fitted one.

    Rounding of a fine raster may repeat its pattern and bend the fit by half a unit over the whole
    record; with many samples in a unit it averages out.
    """
    n = time.size
    mean = float(time[-1] - time[0]) / (n - 1)
    places = np.arange(n) - 0.5 * (n - 1)
    fitted = float(places @ (time - time.mean())) / float(places @ places)
    nice = [float(f"{fitted:.{digits}g}") for digits in range(1, NICE + 1)]
    nice.append(1.0 / max(round(1.0 / fitted), 1))
    off = 0.5 * unit / n if unit <= FINE * mean else SURE * unit / n**1.5
    return [*(step for step in nice if abs(step - fitted) <= off), fitted, mean]
