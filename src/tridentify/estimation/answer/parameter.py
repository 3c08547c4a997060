"""One coefficient with its uncertainty, and what was estimated along with the coefficients."""

from __future__ import annotations

import dataclasses
import math
from statistics import NormalDist

import numpy as np

from tridentify.errors import OptionError
from tridentify.estimation.answer.trace import freeze_arrays
from tridentify.models.columns import drift_columns
from tridentify.numerics.arrays import Array
from tridentify.numerics.quantiles import around
from tridentify.writing.layout import format_value

NOT_DETERMINED = "not determined"
"""What tables show in place of such a number (`Parameter.determined`)."""


def checked_level(level: float) -> float:
    """A probability between zero and one.

    Raises
    ------
    OptionError

    Examples
    --------
    >>> checked_level(0.9)
    0.9
    """
    if isinstance(level, bool) or not isinstance(level, (int, float)) or not 0 < level < 1:
        raise OptionError.found("level=", level, "a probability between 0 and 1", "write 0.95")
    return float(level)


@dataclasses.dataclass(frozen=True, eq=False)
class Parameter:
    """One coefficient with its standard error.

    Examples
    --------
    >>> a0 = Parameter("a0", 3.0, 0.1, "1/s^2")
    >>> [round(end, 3) for end in a0.interval(0.95)]
    [2.804, 3.196]
    """

    name: str
    value: float
    std: float
    unit: str = ""
    draws: Array = dataclasses.field(default_factory=lambda: np.zeros(0), repr=False)

    @property
    def determined(self) -> bool:
        """Whether there is a number to show: a time constant has none where its pole may be zero.

        To first order the interval of the one contains zero where that of the other does; what
        lies between the ends of such an interval is not what the time constant may be.

        Examples
        --------
        >>> Parameter("time constant", 2700.0, 8900.0, "s").determined
        False
        """
        if not self.name.startswith("time constant") or not self.std > 0:
            return True
        low, high = self.interval()
        return not low <= 0.0 <= high

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Interval that holds the probability ``level``.

        Gaussian; where the estimate is a posterior mean, between quantiles of the draws that leave
        out as much on either side of the value as lies there (`numerics.quantiles.around`), so that
        it lies inside. That of a delay begins at zero at the earliest.
        """
        level = checked_level(level)
        if self.draws.size:
            if np.isnan(self.draws).any():
                return math.nan, math.nan
            ends = around(self.draws, np.array(self.value), level)
            return float(ends[0]), float(ends[1])
        half = NormalDist().inv_cdf((1 + level) / 2) * self.std
        low = self.value - half
        return max(low, 0.0) if self.name.startswith("delay") else low, self.value + half

    @property
    def told_to(self) -> float:
        """To which error the value is written: the standard error, or the room in its interval.

        An interval that is not symmetric may end much nearer to the value than a standard error
        away; rounded to that the value would lie outside. Nor is a posterior mean rounded away:
        ratios of coefficients are known better than each of them, and are to follow from those
        that are written.

        Examples
        --------
        >>> Parameter("a0", 4.8, 120.0).told_to
        120.0
        >>> draws = np.geomspace(1.0, 500.0, 1001)
        >>> round(Parameter("a0", 4.8, 120.0, draws=draws).told_to, 1)
        3.7
        >>> Parameter("b0", 4.7, 440.0, draws=np.linspace(-800.0, 800.0, 1001)).told_to
        4.7
        """
        if not (self.draws.size and self.std > 0):
            return self.std
        return min(self._room, abs(self.value) or self._room)

    @property
    def _room(self) -> float:
        """Of a posterior mean: the standard error, or how near an end of the interval is."""
        low, high = self.interval()
        room = [one for one in (self.value - low, high - self.value) if one > 0]
        return min([self.std, *room])

    @property
    def written_ends(self) -> tuple[str, str]:
        """Both ends of the interval of 95 % as tables write them; empty without an error.

        Examples
        --------
        >>> Parameter("a0", 3.0, 0.1).written_ends
        ('2.80', '3.20')
        >>> draws = np.geomspace(0.3, 300.0, 1001)
        >>> Parameter("time constant", 48.0, 78.0, draws=draws).written_ends
        ('0.39', '274')
        """
        if not self.std > 0:
            return "", ""
        told, ends = self._room if self.draws.size else self.std, self.interval()
        # where one end is decades below the other, what it is shows only in its own digits
        digits = [min(told, abs(end) or told) if self.draws.size else told for end in ends]
        low, high = (format_value(end, one) for end, one in zip(ends, digits, strict=True))
        return low, high

    @property
    def relative_std(self) -> float:
        """``std / |value|``; infinite for a value of zero."""
        return self.std / abs(self.value) if self.value else math.inf


@dataclasses.dataclass(frozen=True, eq=False)
class Nuisance:
    """What was estimated along for one experiment.

    Attributes
    ----------
    input_reference : ndarray, shape (n_inputs,)
        Subtracted from the input before the model [input units].
    offset, drift : ndarray, shape (n_outputs,)
        Added to the model response [output units], [output units/s]; drift counts from ``t0`` [s].
    bends : ndarray, shape (n_outputs, degree - 1)
        Weights of the Legendre polynomials of degree two and up, from -1 at ``t0`` to 1 a
        ``duration`` later [output units]; none of a straight drift.
    free_response : ndarray, shape (n_outputs, n) or (n_outputs, n_inputs, n)
        Numerators c(p) of the response c(p)/a(p) delta(t) to the initial state, descending powers;
        of every channel where denominators are separate, zeros in front of the shorter ones.
    offset_std, drift_std : ndarray, shape (n_outputs,)
        Zero where not estimated.
    initial_state : str
        "rest", "equilibrium" or "free".
    t0 : float
        First instant of the record [s].
    duration : float
        Length of the record [s].
    free_after : float
        How long after ``t0`` the free response begins [s]: with delays, when the last of the
        inputs has arrived. What came before is not explained.
    """

    input_reference: Array
    offset: Array
    drift: Array
    free_response: Array
    offset_std: Array
    drift_std: Array
    initial_state: str = "rest"
    t0: float = 0.0
    free_after: float = 0.0
    bends: Array = dataclasses.field(default_factory=lambda: np.zeros(0))
    duration: float = 0.0

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def constants(self, t: Array) -> Array:
        """(n_samples, n_outputs) offset and drift at instants [s]."""
        found = self.offset + np.outer(t - self.t0, self.drift)
        if not self.bends.size:
            return np.asarray(found)
        columns = drift_columns((t - self.t0) / self.duration, self.bends.shape[1] + 1)[1:]
        return np.asarray(found + (self.bends @ columns).T)
