"""Time as workbooks and MATLAB count it: days since 1899 or since the year 0, with decimals.

46000.25 is a morning of 2025, and may be seconds after midnight as well. What tells them apart is
the step: somebody chose it, in the unit that is the right one. 0.05 s is a number of one digit in
seconds and 5.787e-7 in days.
"""

from __future__ import annotations

import numpy as np

from tridentify.errors import shown
from tridentify.numerics.arrays import Array
from tridentify.record.formats.channels import SECONDS, Channel
from tridentify.record.formats.time.rounded_time import NICE, decimals_of
from tridentify.record.formats.time_names import epoch_unit, unit_in_name

SERIALS = ((20_000.0, 80_000.0), (700_000.0, 800_000.0))
"""Days of 1954 to 2119, in workbooks and as MATLAB's datenum."""

DAY = 86400.0

STEPS = (1e-10, 5e-2)
"""Mean steps [d] of a record: 10 us to an hour."""

SUSPECT = 1e-4
"""Mean step below which such numbers are not taken for seconds without a word. Above it, which as
seconds are records of up to 10 kHz, only steps that divide an hour are taken for days."""

COARSE = 1e-3
"""Share of a step by which even days are uneven at most, beside their rounding."""

EXACT = 1e-5
"""Relative error of a mean step that is taken for a number that somebody has chosen."""


def serial_unit(time: Array) -> str:
    """Give "d" where numbers without a unit are days, by their size and their mean step.

    Parameters
    ----------
    time : (n,) array

    Returns
    -------
    str
        Empty where they are none for certain.

    Examples
    --------
    >>> t = 0.05 * np.arange(200)
    >>> serial_unit(46000.0 + t / 86400.0), serial_unit(46000.0 + 0.001 * np.arange(200))
    ('d', '')
    """
    step = _step(time)
    if step is None or step >= STEPS[1]:
        return ""
    span = float(time[-1] - time[0])
    unit = 2.0 * _resolution(time)
    tolerance = max(EXACT, unit / span)
    uneven = float(np.max(np.abs(np.diff(time) - step)))
    if tolerance > COARSE or uneven > 2.0 * unit + COARSE * step:
        return ""
    seconds = not _is_chosen(step, tolerance) and not _is_rate(1.0 / step, tolerance)
    return "d" if seconds and _is_chosen_in_days(step, tolerance) else ""


def about_days(time: Array, unit: str, header: str, file: str) -> str:
    """Tell that numbers are taken for days, or that they may be some; empty where neither is so.

    Parameters
    ----------
    time : (n,) array
    unit : str
        What `serial_unit` gave.
    header, file : str

    Examples
    --------
    >>> t = 46000.0 + 0.05 * np.arange(200) / 86400.0
    >>> about_days(t, "d", "Time", "run.csv")[:77]
    "found 46000 to 46000.0001152 in column 'Time' of 'run.csv'; taken for days as"
    """
    step = _step(time)
    if step is None:
        return ""
    where = f"found {time[0]:.12g} to {time[-1]:.12g} in column {shown(header)} of {shown(file)}"
    if unit:
        return (
            f"{where}; taken for days as workbooks count them, with steps of {step * DAY:.6g} s "
            f"(state the unit s of {shown(header)} if they are seconds)"
        )
    if _is_chosen(step, EXACT):
        return ""
    if step >= SUSPECT and not _is_chosen_in_days(step, EXACT):
        return ""
    return (
        f"{where}, with steps of {step:.3g} on the mean; taken for seconds, and days as workbooks "
        f"count them look so too: state the unit d of {shown(header)} if they are"
    )


def clock_seconds(channel: Channel, values: Array) -> Array | None:
    """Give a column of time in seconds; None where its unit is none of time.

    Parameters
    ----------
    channel : Channel
    values : (n,) array
        As they stand in the file.
    """
    if channel.unit not in SECONDS:
        return None
    if SECONDS[channel.unit] == DAY or (not channel.unit and serial_unit(values)):
        return np.asarray((values - values[:1]) * DAY)
    unit = channel.unit or unit_in_name(channel.name) or epoch_unit(values)
    return np.asarray(values * SECONDS[unit])


def _step(time: Array) -> float | None:
    """The mean step of numbers that may be days by their size; None where they are not."""
    if len(time) < 3 or not np.isfinite(time[[0, -1]]).all():
        return None
    within = any(low < time[0] <= time[-1] < high for low, high in SERIALS)
    step = float(time[-1] - time[0]) / (len(time) - 1)
    return step if within and STEPS[0] < step < STEPS[1] else None


def _resolution(time: Array) -> float:
    """Half a unit of the last decimal, or what a float resolves."""
    decimals = decimals_of(time)
    fine = 4.0 * float(np.spacing(time[-1]))
    return fine if decimals is None else max(0.5 * 10.0**-decimals, fine)


def _is_chosen(step: float, tolerance: float) -> bool:
    """Whether a step is a number of few digits."""
    return abs(float(f"{step:.{NICE}g}") - step) <= tolerance * step


def _is_chosen_in_days(step: float, tolerance: float) -> bool:
    """Whether somebody may have chosen a step [d] in seconds, or by its rate."""
    seconds = step * DAY
    if step >= SUSPECT:
        in_an_hour = 3600.0 / seconds
        return abs(round(in_an_hour) - in_an_hour) <= tolerance * in_an_hour
    return _is_chosen(seconds, tolerance) or _is_chosen(1.0 / seconds, tolerance)


def _is_rate(rate: float, tolerance: float) -> bool:
    """Whether a rate is a number of two digits or a power of two."""
    near = (float(f"{rate:.2g}"), 2.0 ** round(np.log2(rate)))
    return any(abs(one - rate) <= tolerance * rate for one in near)
