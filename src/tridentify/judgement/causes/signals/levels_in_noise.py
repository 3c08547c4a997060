"""An input that stands at levels, and whether what is recorded on these is noise of its sensor.

*Where it stands.* Steps that stand out far from the noise part long stretches. Where the noise is
larger, or the levels change every few samples, the pieces are those of least squares with a price
for each, found exactly by dynamic programming with pruning (Killick et al. 2012). Pieces of few
levels, which they repeat, share their means.

*Whether that is noise.* The mean of a piece is part of each of its samples, and makes them depend
on one another. So each is compared with the mean of those before it, scaled (Brown, Durbin & Evans
1975): of white noise these recursive residuals are white, however short the pieces are. All that
may tell them is turned alike.

References: R. Killick, P. Fearnhead & I. Eckley, J. American Statistical Association 107 (2012)
1590-1598. R. Brown, J. Durbin & J. Evans, J. Royal Statistical Society B 37 (1975) 149-192.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.special import fdtrc

from tridentify.numerics.arrays import Array
from tridentify.numerics.recent import recent
from tridentify.numerics.robust import median_scale
from tridentify.record.record import Record

AT_REST = 0.8
"""Share of the samples at which an input of pulses stands at one level, one of steps at levels."""

STANDS_OUT = 8.0
"""Usual deviations of the input at rest from which it is a pulse or a step."""

LEAST_STRETCH = 8
"""Samples at one level that tell it to a third of what its noise is."""

SHORTEST = 3
"""The same of an input whose levels change often: many of them together tell its noise."""

FEWEST_PIECES = 3
"""Pieces of such an input, at least."""

UNEVEN = 1.4
"""Root mean square of the moves over their usual size, from which an input may be one of levels:
1 for Gaussian noise, filtered or not, 1.1 for a sine, 1.8 and more for levels of four samples or
more with noise of a fifth of their spread."""

PRICE = 3.0
"""Of a piece in units of the noise's variance, times the logarithm of the number of samples: one
in a thousand pieces of white noise would be parted."""

STEPS_OVER = 2.5
"""Spread of the levels over their noise, at least: else it is noise that commanded."""

APART = 6.0
"""Standard errors of a piece's mean that lie between two levels which pieces repeat."""

REPEATED = 3
"""Pieces a level, at least, where levels are repeated."""

PAST = 3
"""Samples of inputs and outputs that may tell what an input does at rest."""

PER_COLUMN = 10
"""Samples at rest for each of them, at least."""

BY_ITSELF = 1e-3
"""p-value from which what an input does at rest is noise: in random loops the largest of 1,000 was
4e-13, and of noisy inputs one in a thousand is still asked whether it reacts."""

KEPT = 8
"""Inputs whose pieces are kept: several causes ask."""


def stretches(u: Array) -> list[tuple[int, int]]:
    """First sample and the one after the last of each level of an input of levels in noise.

    Empty for an input of another kind, and for levels that are exact.

    Examples
    --------
    >>> noise = 0.01 * np.random.default_rng(0).standard_normal(60)
    >>> stretches(np.repeat([0.0, 1.0, 3.0], 20) + noise)
    [(0, 20), (20, 40), (40, 60)]
    """
    steps = np.abs(np.diff(u))
    usual = median_scale(steps)
    if not usual > 0.0:
        return []
    edges = [0, *(np.flatnonzero(steps > STANDS_OUT * usual) + 1).tolist(), u.size]
    found = [(a, b) for a, b in pairwise(edges) if b - a >= LEAST_STRETCH]
    finer = list(_pieces(np.ascontiguousarray(u)))
    return finer or (found if len(edges) > 2 and _covered(found) >= AT_REST * u.size else [])


def _covered(own: Sequence[tuple[int, int]]) -> int:
    """Samples of some pieces."""
    return sum(b - a for a, b in own)


def levels_of(u: Array) -> Array:
    """(n_samples,) level at which an input of levels in noise stands; ``nan`` where at none.

    All ``nan`` for an input of another kind.

    Examples
    --------
    >>> noise = 0.1 * np.random.default_rng(0).standard_normal(60)
    >>> found = levels_of(np.tile(np.repeat([0.0, 1.0], 5), 6) + noise)
    >>> np.unique(found.round(1)).tolist()
    [0.0, 1.0]
    """
    own = stretches(u)
    levels = np.full(u.size, np.nan)
    if not own:
        return levels
    means = _shared(
        np.array([u[a:b].mean() for a, b in own]), np.array([b - a for a, b in own]), _noise(u, own)
    )
    for (first, last), level in zip(own, means, strict=True):
        levels[first:last] = level
    return levels


def are_repeated(levels: Array) -> bool:
    """Whether levels, as of `levels_of`, are few that it comes back to."""
    return bool(np.unique(levels[np.isfinite(levels)]).size * REPEATED <= len(_runs(levels)))


def _noise(u: Array, own: Sequence[tuple[int, int]]) -> float:
    """Standard deviation about the means of pieces."""
    energy = sum(float(np.sum((u[a:b] - u[a:b].mean()) ** 2)) for a, b in own)
    return float(np.sqrt(energy / max(sum(b - a - 1 for a, b in own), 1)))


def _shared(means: Array, sizes: Array, noise: float) -> Array:
    """Means of pieces, those of levels that are repeated pooled."""
    order = np.argsort(means)
    error = noise / np.sqrt(np.minimum(sizes[order][1:], sizes[order][:-1]))
    parts = np.split(order, np.flatnonzero(np.diff(means[order]) > APART * error) + 1)
    if means.size < REPEATED * len(parts):
        return means
    pooled = np.array(means)
    for part in parts:
        pooled[part] = np.average(means[part], weights=sizes[part])
    freedom = means.size - len(parts)
    left = float(np.sum(sizes * (means - pooled) ** 2)) / max(noise**2 * freedom, 1e-300)
    # the spread of a mean square of so many: more is levels of their own
    return pooled if left < 1.0 + 4.0 * np.sqrt(2.0 / freedom) else means


@recent(KEPT)
def _pieces(u: Array) -> tuple[tuple[int, int], ...]:
    """First sample and the one after the last of each piece of an input that moves by steps."""
    moves = np.diff(u)
    if u.size < FEWEST_PIECES * SHORTEST or not np.std(moves) > UNEVEN * median_scale(moves):
        return ()
    edges = _parted(u, median_scale(moves) / np.sqrt(2.0))
    found = [(a, b) for a, b in pairwise(edges) if b - a >= SHORTEST]
    if len(found) < FEWEST_PIECES or _covered(found) < AT_REST * u.size:
        return ()
    levels = np.concatenate([np.full(b - a, u[a:b].mean()) for a, b in found])
    return tuple(found) if np.std(levels) > STEPS_OVER * _noise(u, found) else ()


def _parted(u: Array, noise: float) -> list[int]:
    """Edges of the pieces of least squares, with a price for each."""
    price = PRICE * noise**2 * float(np.log(u.size))
    since = u - u.mean()
    sums = np.concatenate([[0.0], np.cumsum(since)])
    squares = np.concatenate([[0.0], np.cumsum(since**2)])
    best, last = np.full(u.size + 1, np.inf), np.zeros(u.size + 1, dtype=int)
    best[0] = -price
    starts = np.zeros(1, dtype=int)
    for k in range(1, u.size + 1):
        lengths = k - starts
        cost = squares[k] - squares[starts] - (sums[k] - sums[starts]) ** 2 / lengths
        total = best[starts] + cost
        at = int(np.argmin(total))
        best[k], last[k] = total[at] + price, starts[at]
        starts = np.append(starts[total <= best[k]], k)
    edges = [u.size]
    while edges[-1] > 0:
        edges.append(int(last[edges[-1]]))
    return edges[::-1]


def is_noise_of_its_sensor(record: Record, j: int, levels: Array, past: int = PAST) -> bool:
    """Whether what an input does at rest may be white and follows no output.

    A controller that answers to an output moves its input at rest, too, and that acts.

    Parameters
    ----------
    record : Record
    j : int
        Of the input.
    levels : (n_samples,) array
        Where it is at rest, and at what; ``nan`` elsewhere.
    past : int
        Samples of inputs and outputs that may tell what it does.
    """
    return chance_of_noise(record, j, levels, past) > BY_ITSELF


def chance_of_noise(record: Record, j: int, levels: Array, past: int = PAST) -> float:
    """p-value of that, as `is_noise_of_its_sensor` asks it."""
    pieces = _runs(levels)
    wanted = _recursive(record.u[:, j], pieces)
    beside = [_recursive(_before(y, lag), pieces) for y in record.y.T for lag in range(past + 1)]
    before = [np.nan_to_num(_before(wanted, lag)) for lag in range(1, past + 1)]
    columns = np.column_stack([np.ones(wanted.size), *before, *beside])
    there = np.isfinite(columns).all(axis=1) & np.isfinite(wanted)
    there[:past] = False
    columns, wanted = columns[there], wanted[there]
    if wanted.size < PER_COLUMN * columns.shape[1]:
        return 0.0
    scale = np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
    left = wanted - columns / scale @ np.linalg.lstsq(columns / scale, wanted, rcond=1e-10)[0]
    k, n = columns.shape[1] - 1, wanted.size
    spread = float(np.sum((wanted - wanted.mean()) ** 2))
    told = max(spread - float(left @ left), 0.0)
    return float(fdtrc(k, n - k - 1, told / k / (float(left @ left) / (n - k - 1))))


def _runs(levels: Array) -> list[tuple[int, int]]:
    """First sample and the one after the last of each run at one level."""
    changes = np.flatnonzero((levels[1:] != levels[:-1]) & np.isfinite(levels[1:])) + 1
    ends = np.flatnonzero(np.isnan(levels[1:]) & np.isfinite(levels[:-1])) + 1
    edges = sorted({0, *changes.tolist(), *ends.tolist(), levels.size})
    return [(a, b) for a, b in pairwise(edges) if np.isfinite(levels[a])]


def _before(x: Array, lag: int) -> Array:
    """A signal so many samples ago, ``nan`` before its start."""
    return np.concatenate([np.full(lag, np.nan), x[: x.size - lag]])


def _recursive(x: Array, pieces: Sequence[tuple[int, int]]) -> Array:
    """Every sample of a piece less the mean of those before it, scaled; ``nan`` elsewhere."""
    found = np.full(x.size, np.nan)
    for first, last in pieces:
        own = x[first:last]
        count = np.arange(1, own.size)
        means = np.cumsum(own)[:-1] / count
        found[first + 1 : last] = (own[1:] - means) * np.sqrt(count / (count + 1.0))
    return found
