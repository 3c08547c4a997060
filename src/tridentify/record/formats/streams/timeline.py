"""From a column of time to intervals between samples, one pass, in constant memory.

Time stamps of uniform sampling are rounded; taken as they are, no two intervals would be alike. A
stamp within a thousandth of a step of where a raster of the nominal step expects it counts as on
the raster, and the interval is the nominal step. One that is not is taken as it is recorded, and
the raster goes on from there: no time is lost or gained in the long run. (A nominal step that is
known to its last digits only drifts off the raster once in a while; a stamp that is late by then,
after `STEADY` steps or more, but a step behind the one before it, is a new beginning of the raster
and nothing else. The intervals are then wrong by a hundred-thousandth at most.)

A stamp that stands still or goes back is refused. If `SET_BACK` of them in a row go forward among
themselves, the clock was set back (a sender that started again, say): the stream then goes on from
the new time, as if the refused samples had been a nominal step apart.

Where only whole steps will do (``whole``), a stamp within `NEARLY` of one is moved there and others
are refused, up to `SET_BACK` of them in a row: then the raster moves.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tridentify.numerics.arrays import Array
from tridentify.record.checks.times import TIME_TOLERANCE, uniform_step
from tridentify.record.checks.values import check_keys, checked, finite_number, whole_number

NEARLY = 0.05
"""Largest departure from a whole number of steps, in steps, where only these will do."""
OPENING = 32
"""Samples from which the nominal step is taken."""
STEADY = 100
"""Steps on the raster after which a small departure is put down to the nominal step."""
SET_BACK = 10
"""Refused stamps in a row, in order among themselves, after which they are believed."""
ROUNDING = 1e-12
"""Of time stamps that are far from zero, relative to these."""
_WINDOW = 4096
"""Samples that are looked at together for an even step."""
_FEW = 16
"""Samples of a window that were even, from which the next window is worth a look."""


def nominal_step(t: Array) -> float | None:
    """Give the nominal step of the first stamps.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Time [s] as it came; stamps that do not go forward do not count.

    Returns
    -------
    float or None
        The mean step of a uniform axis, else the median step [s]; None without any.

    Examples
    --------
    >>> nominal_step(np.array([0.0, 0.1, 0.1, 0.2, 0.5, 0.6]))
    0.1
    """
    highest = np.maximum.accumulate(t)
    forward = t[np.concatenate([[True], t[1:] > highest[:-1]])]
    if len(forward) < 2:
        return None
    step = uniform_step(forward)
    return float(np.median(np.diff(forward))) if step is None else float(step)


@dataclass
class Timeline:
    """Where the stream is in time; plain numbers, to be saved and resumed.

    Attributes
    ----------
    dt : float
        Nominal step [s].
    first, last : float
        The first stamp, as it would be on the present clock, and the last one [s]; nan before.
    anchor : float
        Stamp from which the raster counts [s].
    count : int
        Steps of the raster since then.
    behind : int
        Refused stamps in a row that are in order among themselves.
    behind_last : float
        The last of them [s].
    whole : bool
        Whether only whole numbers of nominal steps will do.
    between : int
        Stamps in a row that were refused since they are none.
    """

    dt: float
    first: float = math.nan
    last: float = math.nan
    anchor: float = math.nan
    count: int = 0
    behind: int = 0
    behind_last: float = math.nan
    whole: bool = False
    between: int = 0

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> Timeline:
        """Make it of what `to_dict` gave.

        Raises
        ------
        TypeError, ValueError, OverflowError
            It cannot have given that.
        """
        check_keys(document, [one.name for one in dataclasses.fields(cls)])
        values: dict[str, Any] = {
            key: math.nan if document[key] is None else finite_number(document[key])
            for key in ("first", "last", "anchor", "behind_last")
        }
        values |= {key: whole_number(document[key]) for key in ("count", "behind", "between")}
        dt = finite_number(document["dt"], math.ulp(0.0))
        found = cls(dt, whole=checked(document["whole"], bool), **values)
        found._check()
        return found

    def _check(self) -> None:
        """Whether the numbers go together."""
        stamps = (self.first, self.last, self.anchor)
        if all(map(math.isnan, stamps)):
            good = not (self.count or self.behind or self.between)
        else:
            # the last stamp is where the raster is; nan compares as false
            off = abs(self.last - (self.anchor + self.dt * self.count))
            good = off <= NEARLY * self.dt + ROUNDING * abs(self.last)
            good &= 0.0 <= self.elapsed < math.inf
        good &= not (self.behind and math.isnan(self.behind_last))
        if not good or self.behind >= SET_BACK or self.between > SET_BACK:
            raise ValueError("stamps and counts of a timeline that do not go together")

    def to_dict(self) -> dict[str, Any]:
        """Give plain values, None for nan."""
        values = dataclasses.asdict(self)
        return {k: None if v != v else v for k, v in values.items()}

    @property
    def elapsed(self) -> float:
        """Time since the first sample [s]."""
        return self.last - self.first

    def intervals(self, t: Array) -> tuple[Array, Array, dict[int, str]]:
        """Give the steps before samples.

        Parameters
        ----------
        t : ndarray, shape (n,)
            The next stamps [s].

        Returns
        -------
        interval : ndarray, shape (n,)
            Time since the sample before [s]; the nominal step at the first one; nan for a sample
            that is refused.
        elapsed : ndarray, shape (n,)
            Time since the first sample [s].
        remarks : dict of int to str
            What is wrong with samples, or worth saying about them.
        """
        remarks: dict[int, str] = {}
        interval, elapsed = np.full(len(t), self.dt), np.empty(len(t))
        k = 0
        while k < len(t):
            regular = self._regular(t[k : k + _WINDOW])
            elapsed[k : k + regular] = t[k : k + regular] - self.first
            k += regular
            # where little was regular, another look at the whole window is not worth while
            for _ in range(1 if regular > _FEW else _FEW):
                if k == len(t):
                    break
                interval[k], remark = self._step(float(t[k]))
                elapsed[k] = self.elapsed
                if remark:
                    remarks[k] = remark
                k += 1
        return interval, elapsed, remarks

    def _regular(self, t: Array) -> int:
        """Take the first of some stamps, as many as are on the raster; say how many."""
        if self.behind or self.between or math.isnan(self.anchor):
            return 0
        raster = self.anchor + self.dt * np.arange(self.count + 1, self.count + len(t) + 1)
        off = np.abs(t - raster) > TIME_TOLERANCE * self.dt
        regular = int(np.argmax(off)) if off.any() else len(t)
        if regular:
            self.count += regular
            self.last = float(t[regular - 1])
        return regular

    def _step(self, stamp: float) -> tuple[float, str]:
        slack = TIME_TOLERANCE * self.dt
        if math.isnan(self.anchor):
            self.first = self.last = self.anchor = stamp
            return self.dt, ""
        if not stamp - self.last > slack:
            return self._not_forward(stamp)
        if not math.isfinite(stamp - self.last) or not math.isfinite(stamp - self.first):
            return math.nan, f"found time {stamp:g}; expected seconds within the range of a float"
        self.behind = 0
        if self.whole:
            return self._whole_step(stamp)
        if abs(stamp - (self.anchor + self.dt * (self.count + 1))) <= slack:
            self.count += 1
            interval = self.dt
        elif self.count >= STEADY and abs(stamp - self.last - self.dt) <= slack:
            self.anchor, self.count = stamp, 0
            interval = self.dt
        else:
            interval = stamp - (self.anchor + self.dt * self.count)
            self.anchor, self.count = stamp, 0
        self.last = stamp
        return interval, ""

    def _whole_step(self, stamp: float) -> tuple[float, str]:
        since = stamp - (self.anchor + self.dt * self.count)
        steps = max(round(since / self.dt), 1)
        if abs(since - steps * self.dt) > NEARLY * self.dt and self.between < SET_BACK:
            self.between += 1
            return math.nan, (
                f"found time {stamp!r}, {since / self.dt:.6g} steps of {self.dt:g} s after the "
                "sample before; expected whole steps, as there is a delay"
            )
        self.between = 0
        self.last = self.anchor = stamp
        self.count = 0
        return steps * self.dt, ""

    def _not_forward(self, stamp: float) -> tuple[float, str]:
        in_order = self.behind and stamp - self.behind_last > TIME_TOLERANCE * self.dt
        self.behind = self.behind + 1 if in_order else 1
        self.behind_last = stamp
        if self.behind < SET_BACK:
            return math.nan, f"found time {stamp!r} after {self.last!r}; expected a later one"
        interval = self.behind * self.dt
        remark = f"found the clock set back from {self.last!r} to {stamp!r}; going on from there"
        self.first = stamp - (self.elapsed + interval)
        self.last = self.anchor = stamp
        self.count = self.behind = 0
        return interval, remark
