"""Exact propagation over intervals of any lengths: jitter, gaps, delays between the samples.

Between two events (an input sample arriving, an output sample being taken) the input is a straight
line, ``u(s) = v + c s``, so the state at the end of an interval of length ``h`` is

    x(h) = e^{A h} x + p(h) v + r(h) c,
    p(h) = int_0^h e^{A s} B ds,   r(h) = int_0^h e^{A (h - s)} B s ds

and all three are blocks of one exponential, that of ``[[A, B, 0], [0, 0, 1], [0, 0, 0]] h``
(Van Loan 1978, IEEE Trans. Automatic Control 23(3), 395-404).

Few different lengths (missing rows, two rates, a delay on a uniform grid) have one exponential
each. Many (jitter) would cost more than all else; instead a length is written in the positional
system of base 64,

    h = c_0 d_0 + c_1 d_1 + ... + rest,     d_{l+1} = d_l / 64,   0 <= c_l < 64,

and the state is carried over the digits one after the other, and digits that are zero cost
nothing, so that a gap of a day beside steps of a millisecond
needs no special case. The rest is so short that a few terms of the Taylor series, applied to the
vector, reach rounding (Higham, Functions of Matrices, SIAM 2008, section 10.3). The cost is linear
in the number of intervals.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.discretize import weight_of
from tridentify.numerics.exponential import exponential

BASE = 64
"""Entries of a table: three levels of 64 reach 4e-6 of the longest length, where the series is
short."""
MOST_TABULATED = 128
"""Different lengths up to which each has its exponential: as many as two tables hold."""
MOST_LEVELS = 12
"""Digits that are tried: with 12 the rest is 1e-20 of the longest length, below rounding."""
SERIES = 1e-17
"""Relative bound of the terms of the Taylor series that are left out: a twentieth of rounding."""
RESOLUTION = float(np.finfo(np.float64).eps)
SNAP = 1e-9
"""Share of a step within which an event belongs to an instant: rounding of a delay and of text."""


@dataclass(frozen=True, eq=False)
class Plan:
    """What happens to the channels that share a delay, interval by interval.

    Attributes
    ----------
    lengths : (m,) array
        Of the intervals [s].
    value, slope : (n_channels, m) arrays
        The input at the beginning of each interval and its slope there.
    reached : (n_samples,) int array
        How many intervals lie before each sample; -1 where none has begun.
    which : (m,) int array
        The position of each length among ``distinct``; empty where they are too many.
    distinct : (k,) array
        Different lengths; empty where they are too many.
    """

    lengths: Array
    value: Array
    slope: Array
    reached: Indices
    which: Indices
    distinct: Array


def plan(t: Array, u: Array, delay: float, intersample: str) -> Plan:
    """Merge the instants at which the delayed input changes with those of the samples.

    Parameters
    ----------
    t : (n_samples,) array
        Instants of inputs and outputs, from zero [s].
    u : (n_samples, n_channels) array
        Inputs; zero before the first sample.
    delay : float
        [s]
    intersample : {"zoh", "foh"}

    Examples
    --------
    >>> p = plan(np.array([0.0, 1.0, 3.0]), np.array([[1.0], [2.0], [3.0]]), 0.5, "zoh")
    >>> p.lengths.tolist(), p.value.tolist(), p.reached.tolist()
    ([0.5, 0.5, 1.5], [[1.0, 1.0, 2.0]], [-1, 1, 3])
    """
    knots = snapped(t + delay, t)
    events = np.union1d(t, knots[knots <= t[-1]])
    events = events[events >= knots[0]]
    at = np.clip(np.searchsorted(knots, events[:-1], side="right") - 1, 0, t.size - 1)
    value, slope = u[at].T, np.zeros((u.shape[1], at.size))
    if intersample == "foh":
        rates = np.append(np.diff(u, axis=0) / np.diff(t)[:, None], np.zeros((1, u.shape[1])), 0)
        slope = rates[at].T
        value = value + slope * (events[:-1] - knots[at])
    reached = np.where(t >= knots[0], np.searchsorted(events, t), -1).astype(np.int64)
    return _classified(np.diff(events), value, slope, reached)


def free_plan(t: Array, begin: int) -> Plan:
    """The intervals between the samples from sample ``begin`` on, without input."""
    lengths = np.diff(t[begin:])
    reached = np.arange(t.size, dtype=np.int64) - begin
    nothing = np.zeros((1, lengths.size))
    return _classified(lengths, nothing, nothing, np.maximum(reached, -1))


def snapped(knots: Array, t: Array) -> Array:
    """Knots that fall on a sample but for rounding, put onto it."""
    tolerance = SNAP * float(np.median(np.diff(t))) + 4.0 * RESOLUTION * float(abs(t[-1]))
    right = np.clip(np.searchsorted(t, knots), 1, t.size - 1)
    nearest = np.where(t[right] - knots < knots - t[right - 1], right, right - 1)
    return np.where(np.abs(t[nearest] - knots) <= tolerance, t[nearest], knots)


def _classified(lengths: Array, value: Array, slope: Array, reached: Indices) -> Plan:
    which, distinct = np.zeros(0, dtype=np.int64), np.zeros(0)
    # lengths as they are, else as far as the instants can tell them apart
    unit = RESOLUTION * float(lengths.sum())
    for key in (lengths, np.round(lengths / unit) if unit else lengths):
        _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
        if first.size <= MOST_TABULATED:
            which, distinct = inverse.astype(np.int64).ravel(), lengths[first]
            break
    return Plan(
        lengths,
        np.ascontiguousarray(value),
        np.ascontiguousarray(slope),
        reached,
        which,
        distinct,
    )


class Steps(NamedTuple):
    """How the intervals of a plan are crossed by one state equation.

    ``tables`` (levels, entries, q, q + 2) holds ``[e^{A h} | p | r / unit]``; ``units`` (levels,)
    the lengths of one digit; with ``terms`` zero there is one level, whose entries are the
    distinct lengths, and ``units`` are those of its entries.
    """

    tables: Array
    units: Array
    terms: int


def steps(a: Array, b: Array, lengths: Array, distinct: Array) -> Steps:
    """Tables for the intervals of a plan.

    Parameters
    ----------
    a : (q, q) array
    b : (q,) array
    lengths, distinct : arrays
        Of a `Plan`.
    """
    q = b.size
    if distinct.size or not lengths.size:
        longest = float(distinct.max(initial=0.0))
        weight = weight_of(longest * a, longest * b)
        tables = _exponentials(a, b / weight, distinct, np.ones(distinct.size))
        tables = tables[None, :, :q].copy()
        tables[..., q:] *= weight
        return Steps(tables, distinct, 0)
    largest = float(lengths.max())
    size = float(np.abs(a).sum(axis=1).max())
    levels, terms = _levels(size * largest / (BASE - 1))
    units = largest / (BASE - 1) / BASE ** np.arange(levels, dtype=np.float64)
    weight = weight_of(largest * a, largest * b)
    tables = np.ascontiguousarray(_digits(a, b / weight, units)[:, :, :q])
    tables[..., q:] *= weight
    return Steps(tables, units, terms)


def _exponentials(a: Array, b: Array, lengths: Array, slopes: Array) -> Array:
    """(m, q + 2, q + 2): those of ``[[A h, B h, 0], [0, 0, c], [0, 0, 0]]`` (`slopes` ``c``)."""
    if _has_pairs_only(a):
        from tridentify.numerics.kernels.exponentials import crossings

        return np.asarray(crossings(a, np.ascontiguousarray(b), lengths, slopes))
    q = b.size
    matrix = np.zeros((lengths.size, q + 2, q + 2))
    matrix[:, :q, :q] = lengths[:, None, None] * a
    matrix[:, :q, q] = lengths[:, None] * b
    matrix[:, q, q + 1] = slopes
    return exponential(matrix)


def _has_pairs_only(a: Array) -> bool:
    """Whether a matrix is lower triangular but for 2 x 2 blocks on its diagonal."""
    above = np.diagonal(a, 1) != 0.0
    return not (np.any(np.triu(a, 2)) or np.any(above[1:] & above[:-1]))


def _levels(size: float) -> tuple[int, int]:
    """Levels and Taylor terms with the fewest products, for ``size = |A| d_0``."""
    best, found = math.inf, (1, 1)
    for level in range(1, MOST_LEVELS + 1):
        rest = size / BASE ** (level - 1)
        terms, bound = 0, 1.0
        while bound > SERIES and terms < 20:
            terms += 1
            bound *= rest / (terms + 1)
        # the first term left out is relative to the first one kept
        if bound <= SERIES and level + terms < best:
            best, found = level + terms, (level, max(terms, 1))
    return found


def _digits(a: Array, b: Array, units: Array) -> Array:
    """(levels, BASE, ., .): the exponentials of 0 .. BASE - 1 units of each level.

    Each is the product of powers of two exponentials, those of one unit and of eight. A power is
    made of halves, as in scaling and squaring: no error of one is multiplied 64 times.
    """
    root = math.isqrt(BASE)
    counts = np.array([1.0, root])
    # the slope counts in one unit of the level, whatever the digit
    ones = _exponentials(a, b, np.outer(units, counts).ravel(), np.tile(counts, units.size))
    shape = ones.shape[1:]
    powers = np.empty((units.size, 2, root, *shape))
    powers[:, :, 0] = np.eye(shape[0])
    powers[:, :, 1] = ones.reshape(units.size, 2, *shape)
    for k in range(2, root):
        powers[:, :, k] = powers[:, :, k // 2] @ powers[:, :, k - k // 2]
    product = powers[:, 1, :, None] @ powers[:, 0, None, :]
    return np.asarray(product.reshape(units.size, BASE, *shape))


class Crossing:
    """States of one state equation over the samples of a plan, block by block.

    Parameters
    ----------
    chart : Plan
    a : (q, q) array
    b : (q,) array
    state : (n_channels, q) array
        Where the first interval begins (default: zero).
    upper : int, optional
        Non-zero diagonals of ``a`` above the main one (default: all).
    beside : Crossing, optional
        Of the same state equation: its tables serve where the lengths are the same.

    Examples
    --------
    >>> t = np.array([0.0, 0.5, 2.0])
    >>> crossing = Crossing(plan(t, np.ones((3, 1)), 0.0, "zoh"), -np.eye(1), np.ones(1))
    >>> out = np.empty((1, 3))
    >>> crossing.advance(0, 3, out)
    >>> bool(np.allclose(out, 1 - np.exp(-t), rtol=1e-15))
    True
    """

    def __init__(
        self,
        chart: Plan,
        a: Array,
        b: Array,
        state: Array | None = None,
        upper: int | None = None,
        beside: Crossing | None = None,
    ) -> None:
        self.chart = chart
        self._beside = beside
        self._a, self._b = np.ascontiguousarray(a), np.ascontiguousarray(b)
        channels = chart.value.shape[0]
        self.state = np.zeros((channels, b.size)) if state is None else state.copy()
        self._done = np.zeros(channels, dtype=np.int64)
        self._upper = b.size if upper is None else upper
        self._steps: Steps | None = None

    def advance(self, start: int, stop: int, out: Array) -> None:
        """Write the states at samples ``start .. stop - 1``; to be called in their order."""
        from tridentify.numerics.kernels.crossing import cross

        chart = self.chart
        if self._steps is None:
            self._steps = self._shared() or steps(self._a, self._b, chart.lengths, chart.distinct)
        tables, units, terms = self._steps
        cross(
            tables, units, terms, self._a, self._b, self._upper, chart.lengths, chart.which,
            chart.value, chart.slope, chart.reached, self._done, self.state, start, stop, out,
        )  # fmt: skip

    def _shared(self) -> Steps | None:
        """Tables of the other crossing, where they are those that would be made."""
        if self._beside is None:
            return None
        other, own = self._beside.chart, self.chart
        if other.lengths.max(initial=0.0) != own.lengths.max(initial=0.0):
            return None
        return self._beside._steps if np.array_equal(other.distinct, own.distinct) else None
