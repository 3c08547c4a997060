"""Whether evenly spaced samples lie on straight lines between every k-th of them.

Second differences of such samples are zero, but for rounding, everywhere except at the samples that
the lines join. Noise leaves none of them near zero, and what a held input makes of a system without
noise bends where the input moves: what the moves of the inputs explain does not count.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tridentify.numerics.arrays import Array

LONGEST = 64
"""Samples from one that is joined to the next, at most."""

FEWEST = 16
"""Samples that are joined, at least: fewer may lie so by chance."""

LOW, HIGH = 0.3, 0.95
"""Quantiles of the bends: lines end in seven of ten that are joined, at least, and the largest
bends are theirs."""

LEADING = FEWEST - 1 - int(LOW * (FEWEST - 1))
"""So many of the largest bends, at least, are then at ends of lines: those of `FEWEST` samples that
are above their quantile `LOW`."""

OVER = 3.0
"""Bends where lines end, over all others: rounding of what was interpolated leaves up to two
digits, and a converter without noise bends by few of its steps."""

ROUNDING = 16.0 * np.finfo(np.float64).eps
"""Of the largest value, below which a second difference is zero."""

MOST_MOVES, SAMPLES_A_MOVE = 8, 4
"""Moves of each input that may explain a bend, and samples for each: a fast system follows them
some samples later."""

QUIET = 1e-5
"""Share of an output's spread that its bends must reach: below, there is no noise that would tell
lines from a response."""

NEARLY = 1e-3
"""Share of an input's range that rounding may move it off a line."""


class Joined(NamedTuple):
    """Every how manyth sample is joined to the next by a line, and which is the first."""

    every: int
    first: int

    def between(self, n_samples: int) -> NDArray[np.bool_]:
        """(n_samples,) which samples lie on the lines alone.

        Parameters
        ----------
        n_samples : int
        """
        return np.asarray((np.arange(n_samples) - self.first) % self.every != 0)


def joined_by_lines(y: Array, u: Array) -> Joined | None:
    """Find out whether samples lie on straight lines between every k-th of them.

    Parameters
    ----------
    y : (n_samples,) array
        Evenly spaced; ``nan`` where one is missing.
    u : (n_samples, n_inputs) array
        What may have bent them.

    Returns
    -------
    Joined or None

    Examples
    --------
    >>> noise = np.random.default_rng(0).standard_normal(60)
    >>> y = np.interp(np.arange(178) / 3.0, np.arange(60), noise)
    >>> joined_by_lines(y, np.zeros((178, 1)))
    Joined(every=3, first=0)
    >>> joined_by_lines(noise, np.zeros((60, 1))) is None
    True
    """
    bends = np.abs(y[:-2] - 2.0 * y[1:-1] + y[2:])
    seen = np.isfinite(bends)
    if int(seen.sum()) < 2 * FEWEST:
        return None
    most = min(LONGEST, y.size // FEWEST)
    spacing = _spacing(np.where(seen, bends, -1.0))
    possible = [every for every in range(2, most + 1) if spacing % every == 0]
    if not possible:
        return None
    zero = ROUNDING * float(np.nanmax(np.abs(y)))
    low, high = np.nanquantile(bends, (0.9 / 2.0, HIGH))
    if not high > OVER * max(float(low), zero):
        return None
    for every in possible:
        largest = np.array([np.nanmax(bends[k::every], initial=0.0) for k in range(every)])
        place = int(np.argmax(largest))
        others = max(float(np.delete(largest, place).max()), zero)
        ends = np.arange(place, bends.size, every)
        ends = ends[np.isfinite(bends[ends])]
        if ends.size < FEWEST or not np.quantile(bends[ends], LOW) > OVER * others:
            continue
        left = _unexplained(y, u, ends + 1)
        if np.quantile(left, LOW) > max(OVER * others, QUIET * float(np.nanstd(y))):
            return Joined(every, (place + 1) % every)
    return None


def _spacing(bends: Array) -> int:
    """What divides all distances between the largest bends: ends of lines are a multiple apart."""
    largest = np.argpartition(bends, -LEADING)[-LEADING:]
    return int(np.gcd.reduce(largest - largest[0]))


def _unexplained(y: Array, u: Array, ends: NDArray[np.intp]) -> Array:
    """Bends at some samples without what moves of the inputs there, or just before, explain."""
    bend = y[ends - 1] - 2.0 * y[ends] + y[ends + 1]
    most = ends.size // (SAMPLES_A_MOVE * u.shape[1])
    moves = np.vstack([np.zeros((MOST_MOVES, u.shape[1])), np.diff(u, axis=0)])
    columns = [moves[ends + MOST_MOVES - back] for back in range(min(MOST_MOVES, most))]
    if not columns:
        return np.abs(bend)
    matrix = np.hstack(columns)
    return np.asarray(np.abs(bend - matrix @ np.linalg.lstsq(matrix, bend)[0]))


def between_follows(u: Array, joined: Joined) -> bool:
    """Whether inputs between the samples that are kept follow from these: held, or on lines.

    Parameters
    ----------
    u : (n_samples, n_inputs) array
    joined : Joined
        Which samples are kept.
    """
    return all(_held(own, joined) or on_lines(own, joined) for own in u.T)


def _held(u: Array, joined: Joined) -> bool:
    """Whether values change where samples are kept alone."""
    moved = np.flatnonzero(np.diff(u)) + 1
    return not np.any((moved - joined.first) % joined.every)


def on_lines(u: Array, joined: Joined) -> bool:
    """Whether values between those that are kept lie on lines, but for rounding.

    Parameters
    ----------
    u : (n_samples,) array
    joined : Joined
    """
    kept = np.arange(joined.first, u.size, joined.every)
    inside = slice(kept[0], kept[-1] + 1)
    place = np.arange(u.size)[inside]
    off = u[inside] - np.interp(place, kept, u[kept])
    return bool(np.abs(off).max() <= NEARLY * np.ptp(u))
