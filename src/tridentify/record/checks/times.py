"""Checks of time: instants, steps and stretches of a record."""

from __future__ import annotations

from datetime import datetime
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from tridentify.errors import (
    EmptyRangeError,
    NotFiniteError,
    OptionError,
    SamplingError,
    ShapeError,
    TimeNotIncreasingError,
)
from tridentify.numerics.arrays import Array
from tridentify.numerics.quantiles import quantiles
from tridentify.record.checks.samples import shared_numbers
from tridentify.record.checks.scales import check_time

STEPS_TO_A_START = 10
"""Typical steps by which time goes back where another run begins, and the fewest rows of one:
samples that were written out of order go back by a few."""

HOUR = 3600.0
"""By which clocks go back [s] at the end of summer time."""

TIME_TOLERANCE = 1e-3
"""Largest departure from a uniform time axis, in steps, that counts as rounding."""


def sample_range(t: Array, start: float | None, stop: float | None) -> tuple[int, int]:
    """Find the samples between two instants, both ends included within rounding.

    Parameters
    ----------
    t : ndarray, shape (n_samples,)
        Increasing sampling instants [s].
    start, stop : float or None
        First and last instant [s]; None for the ends of `t`.

    Returns
    -------
    first, last : int
        The samples ``first:last``.

    Raises
    ------
    EmptyRangeError
        Fewer than two samples lie in between.

    Examples
    --------
    >>> import numpy as np
    >>> sample_range(np.arange(10.0), 2.0, 4.0)
    (2, 5)
    """
    low = float(t[0]) if start is None else instant("start", start)
    high = float(t[-1]) if stop is None else instant("stop", stop)
    slack = time_slack(t)
    first = int(np.searchsorted(t, low - slack, side="left"))
    last = int(np.searchsorted(t, high + slack, side="right"))
    if last - first < 2 or np.isnan(low) or np.isnan(high):
        raise EmptyRangeError(
            f"found {max(last - first, 0)} samples from {low:.6g} s to {high:.6g} s; expected at "
            f"least 2; choose times between {t[0]:.6g} s and {t[-1]:.6g} s"
        )
    return first, last


def instant(label: str, value: object) -> float:
    """Give a time [s], which may be infinite or nan.

    Raises
    ------
    OptionError
        It is no number.

    Examples
    --------
    >>> instant("start", 3)
    3.0
    """
    try:
        if isinstance(value, (str, bytes, bool)):
            raise TypeError
        return float(cast(Any, value))
    except (TypeError, ValueError, OverflowError) as error:
        raise OptionError.found(f"{label}=", value, "a time in seconds", "give a number") from error


def uniform_step(t: Array) -> float | None:
    """Give the sampling interval of a uniform time axis.

    Parameters
    ----------
    t : ndarray, shape (n_samples,)
        Increasing sampling instants [s].

    Returns
    -------
    float or None
        The mean step [s]; None when an instant is off by more than a thousandth of it.

    Examples
    --------
    >>> import numpy as np
    >>> uniform_step(np.array([0.0, 0.5, 1.0])), uniform_step(np.array([0.0, 0.4, 1.0]))
    (0.5, None)
    """
    step = float(t[-1] - t[0]) / (len(t) - 1)
    departure = np.arange(len(t), dtype=np.float64)
    departure *= -step
    departure += t
    departure -= t[0]
    tolerance = TIME_TOLERANCE * step
    return step if -tolerance <= departure.min() and departure.max() <= tolerance else None


def typical_step(t: Array) -> float:
    """One of the shorter sampling intervals: what limits the dynamics that can be seen.

    Parameters
    ----------
    t : ndarray, shape (n_samples,)
        Increasing sampling instants [s].

    Returns
    -------
    float
        A tenth of the intervals are shorter [s].

    Examples
    --------
    >>> import numpy as np
    >>> round(typical_step(np.array([0.0, 0.1, 0.2, 0.3, 86400.0, 86400.1])), 9)
    0.1
    """
    return float(quantiles(np.diff(t), (0.1,))[0])


def time_slack(t: Array) -> float:
    """Rounding allowed at the end of a stretch of time [s]."""
    return TIME_TOLERANCE * float(t[-1] - t[0]) / (len(t) - 1)


def _instants(t: ArrayLike) -> ArrayLike:
    """Give dates as seconds since the first, durations in seconds, anything else as it is."""
    array = np.asarray(t)
    kind = array.dtype.kind
    if kind in "mM" and array.ndim and array.size:
        since = array - array.flat[0] if kind == "M" else array
        nanoseconds = since.astype("timedelta64[ns]").astype(np.int64) * 1e-9
        return cast(ArrayLike, np.where(np.isnat(since), np.nan, nanoseconds))
    first = array.flat[0] if kind == "O" and array.size else None
    if isinstance(first, datetime):  # with a time zone, as pandas and Python give them
        try:
            return np.array([(one - first).total_seconds() for one in array.ravel()])
        except (TypeError, AttributeError):
            return t
    return t


def time_axis(dt: float | None, t: ArrayLike | None, n_samples: int) -> tuple[float | None, Array]:
    """Give the uniform step [s], if there is one, and the sampling instants, read-only."""
    if (dt is None) == (t is None):
        found = "neither dt nor t" if dt is None else "both dt and t"
        raise SamplingError(
            f"found {found}; expected exactly one of them; give dt [s] for a uniform record, else t"
        )
    if t is None:
        return _step_and_time(dt, n_samples)
    time = shared_numbers("t", _instants(t))
    if time.ndim == 2 and time.shape[1] == 1:
        time = time[:, 0]
    if time.ndim != 1:
        raise ShapeError(f"found t of shape {time.shape}; expected (n_samples,); flatten it")
    if not np.isfinite(time).all():
        index = int(np.flatnonzero(~np.isfinite(time))[0])
        raise NotFiniteError(
            f"found t[{index}] = {time[index]}; expected finite times; drop or repair that sample"
        )
    check_increasing(time)
    if len(time) < 2:
        return None, time
    check_time(float(time[0]), float(time[-1]), typical_step(time))
    return uniform_step(time), time


def check_increasing(time: Array) -> None:
    """Refuse runs below each other, and time that is not sorted, each with what helps.

    Parameters
    ----------
    time : (n,) array
        Finite instants [s].

    Raises
    ------
    TimeNotIncreasingError
        An instant is not after the one before.

    Examples
    --------
    >>> import numpy as np
    >>> check_increasing(np.r_[0.0:20.0, 0.0:18.0])
    Traceback (most recent call last):
    ...
    tridentify.errors.TimeNotIncreasingError: found t[20] = 0 s after t[19] = 19 s: 2 runs below
    each other; expected one run; give each as a record of its own
    >>> check_increasing(np.r_[0.0:7200.0:60.0, 3600.0:9000.0:60.0])
    Traceback (most recent call last):
    ...
    tridentify.errors.TimeNotIncreasingError: found t[120] = 3600 s after t[119] = 7140 s, an hour
    back and a step on: a clock set back, as at the end of summer time; expected strictly increasing
    time; add 3600 s to the times from there on, or log in UTC
    """
    step = np.diff(time)
    if np.all(step > 0.0):
        return
    index = int(np.argmin(step > 0.0))
    found = f"found t[{index + 1}] = {time[index + 1]:.9g} s after t[{index}] = {time[index]:.9g} s"
    starts = int(np.sum(step < -STEPS_TO_A_START * np.median(np.abs(step))))
    usual = float(np.median(step))
    back = float(step[index]) + HOUR - usual
    # a second run of an hour begins where the first one did
    if (
        np.sum(step <= 0.0) == 1
        and 2.0 * abs(back) < usual < HOUR
        and time[index + 1] > time[0] + usual
    ):
        raise TimeNotIncreasingError(
            f"{found}, an hour back and a step on: a clock set back, as at the end of summer time; "
            "expected strictly increasing time; add 3600 s to the times from there on, or log in "
            "UTC"
        )
    if 0 < starts <= step.size / STEPS_TO_A_START:
        raise TimeNotIncreasingError(
            f"{found}: {starts + 1} runs below each other; expected one run; give each as a record "
            "of its own"
        )
    raise TimeNotIncreasingError(
        f"{found}; expected strictly increasing time; sort the samples or drop repeated ones"
    )


def _step_and_time(dt: object, n_samples: int) -> tuple[float, Array]:
    try:
        step = float(dt)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        step = np.nan
    if isinstance(dt, (str, bytes, bool)) or not 0.0 < step < np.inf:
        raise SamplingError.found("dt=", dt, "a positive number of seconds", "correct dt")
    if not np.isfinite(step * max(n_samples, 1)):
        raise SamplingError(f"found dt={step:.6g} s; expected a duration within range; correct dt")
    check_time(0.0, step * max(n_samples - 1, 1), step)
    time = np.arange(n_samples, dtype=np.float64)
    time *= step
    return step, time
