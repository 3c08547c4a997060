"""Marks that an analogue-to-digital converter leaves in samples: steps, limits, repeats.

*Quantum.* Values that come from a converter are ``y_0 + q k`` with whole ``k``. The distinct values
are sorted and counted up from one to the next in steps of a trial ``q``, which is the smallest
difference or a whole part of it; a straight line through value against count then gives ``q`` to
far better than a step over the whole range, and the largest departure from it tells whether the
values lie on a grid. Rounding of the values (by a unit conversion, or in a text file) is smaller
than the tolerance of a twentieth of a step. For values that lie on no grid the departure is near
a half, and the chance that all of them pass falls by ten with each further value.

*Runs.* Continuous noise never gives the same value twice in a row. A run of one value is therefore
a plateau without noise, a coarse converter, a limit of the sensor, or a sensor that hangs. Which of
these is decided in `tridentify.judgement.cautions`, with the model at hand.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tridentify.numerics.arrays import Array

Ints = NDArray[np.intp]

OFF_GRID = 0.05
"""Of a step: how far a value may lie from the grid; rounding in a conversion of units is less."""
SAME = 1e-12
"""Relative difference of two values that are one: rounding."""
PARTS = (1, 2, 3, 4)
"""Whole parts of the smallest difference that may be the step."""
FEWEST_VALUES = 6
"""Distinct values from which a grid is told: with four beyond the two that make it, chance does so
once in ten thousand."""
MOST_QUANTA = 1e7
"""Over the range: a converter of 23 bits has fewer."""
FEW_VALUES = 10_000
"""Samples that are looked at first: where they have no step, the others need not be sorted."""
LARGER = 10.0
"""Times the smallest difference of two values beyond which there is no step."""
MOSTLY_ROUNDING = 1.25
"""Of the variance of rounding, a twelfth of the squared step, up to which a residual is little
else: what is beside it is an eighth of a step."""


class Runs(NamedTuple):
    """Stretches of one value: first samples, lengths and values, each (n_runs,)."""

    first: Ints
    length: Ints
    value: Array


def quantum(values: Array, least: float = 0.0) -> float:
    """Step of the grid that all values lie on.

    Parameters
    ----------
    values : (N,) array
        ``nan`` marks a missing sample.
    least : float
        Smaller steps are not asked for.

    Returns
    -------
    float
        0 where they lie on no grid, or are too few different ones to tell: six, or two where
        each is met ten times, or none so large.

    Examples
    --------
    >>> signal = 3.0 + np.sin(np.arange(100.0))
    >>> round(quantum(0.05 * np.round(signal / 0.05)), 6), quantum(signal)
    (0.05, 0.0)
    >>> quantum(0.05 * np.round(signal / 0.05), 1.0)
    0.0
    """
    seen = values[np.isfinite(values)]
    if seen.size < 2 or _too_fine(seen):
        return 0.0
    levels = np.unique(seen)
    span = float(levels[-1] - levels[0])
    size = float(np.abs(levels).max())
    if span <= SAME * size:
        return 0.0
    levels = levels[np.concatenate([[True], np.diff(levels) > SAME * max(size, span)])]
    if levels.size < FEWEST_VALUES and seen.size < 10 * levels.size:
        return 0.0
    steps = np.diff(levels)
    smallest = float(steps.min())
    # the step that a grid is found by grows by half at each of three turns, at most
    if span > MOST_QUANTA * smallest or LARGER * smallest < least:
        return 0.0
    for part in PARTS:
        found = _grid(levels, steps, smallest / part)
        if found:
            return found
    return 0.0


def within_a_step(values: Sequence[Array], residuals: Sequence[Array]) -> bool:
    """Whether all that a response leaves is smaller than a step of the converter.

    Rounding alone leaves half of that, and nothing of single samples can be told from it.

    Parameters
    ----------
    values, residuals : sequence of (N,) arrays
        ``nan`` marks a missing sample.

    Examples
    --------
    >>> signal = 3.0 + np.sin(np.arange(100.0))
    >>> seen = 0.05 * np.round(signal / 0.05)
    >>> within_a_step([seen], [seen - signal]), within_a_step([signal], [seen - signal])
    (True, False)
    """
    return all(
        0.0 < float(np.nanmax(np.abs(left), initial=0.0)) <= quantum(one)
        for one, left in zip(values, residuals, strict=True)
    )


def is_mostly_rounding(values: Sequence[Array], residuals: Sequence[Array]) -> bool:
    """Whether what a response leaves has the size of rounding, and no sample more than a step.

    Rounding leaves a twelfth of the squared step. Where it is nearly all of a residual it depends
    on the signal, and so looks like many causes.

    Parameters
    ----------
    values, residuals : sequence of (N,) arrays
        ``nan`` marks a missing sample.

    Examples
    --------
    >>> signal = 3.0 + np.sin(0.1 * np.arange(100.0))
    >>> seen = 0.2 * np.round(signal / 0.2)
    >>> left = seen - signal
    >>> is_mostly_rounding([seen], [left]), is_mostly_rounding([seen], [1.3 * left])
    (True, False)
    """
    pairs = zip(values, residuals, strict=True)
    return within_a_step(values, residuals) and all(
        float(np.nanmean(left**2)) <= MOSTLY_ROUNDING * quantum(one) ** 2 / 12.0
        for one, left in pairs
    )


def _too_fine(seen: Array) -> bool:
    """Whether a few of many values lie too close already: all of them have no larger step."""
    if seen.size < 2 * FEW_VALUES:
        return False
    few = np.sort(seen[:: seen.size // FEW_VALUES])
    low, high = float(seen.min()), float(seen.max())
    steps = np.diff(few)
    steps = steps[steps > SAME * max(abs(low), abs(high), high - low)]
    return bool(steps.size and high - low > MOST_QUANTA * float(steps.min()))


def _grid(levels: Array, steps: Array, trial: float) -> float:
    """The step near a trial that puts all levels on a grid, or 0."""
    # small steps first: they fix the quantum well enough to count the larger ones
    for most in (4.0, 30.0, np.inf):
        near = steps <= most * trial
        counts = np.round(steps[near] / trial)
        trial = float(steps[near] @ counts / (counts @ counts))
    counts = np.concatenate([[0.0], np.cumsum(np.round(steps / trial))])
    about, centre = counts - counts.mean(), levels - levels.mean()
    q = float(about @ centre / (about @ about))
    off = float(np.abs(centre - q * about).max())
    return q if off < OFF_GRID * q else 0.0


def runs(values: Array) -> Runs:
    """Stretches of two and more equal samples, one after the other.

    Parameters
    ----------
    values : (N,) array
        ``nan`` marks a missing sample, which ends a stretch.

    Examples
    --------
    >>> found = runs(np.array([1.0, 2.0, 2.0, 2.0, 3.0, 1.0, 1.0]))
    >>> found.first.tolist(), found.length.tolist(), found.value.tolist()
    ([1, 5], [3, 2], [2.0, 1.0])
    """
    same = np.concatenate([[False], values[1:] == values[:-1], [False]])
    edges = np.flatnonzero(same[1:] != same[:-1])
    first, last = edges[::2], edges[1::2]
    return Runs(first, last - first + 1, values[first])
