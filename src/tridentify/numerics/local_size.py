"""Samples over the size of the noise around them, or of their record, where its size changes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.special import ndtri

from tridentify.numerics.arrays import Array
from tridentify.numerics.quantiles import median, quantiles
from tridentify.numerics.robust import MAD_OF_NORMAL, median_scale

NEIGHBOURS = 31
"""Samples of which the median magnitude is the size of the noise: ten spikes among them move it
little, and what changes more slowly is followed."""
FEWEST_NEIGHBOURS = 20
"""Below these the size is that of chance."""
FEWEST_OF_ONE = 20
"""Samples of a record from which its noise has a size of its own."""
FARTHER = 1.2
"""How much farther than normal deviates samples may be by chance over a size that is known from so
few."""
CHANGES = 2.5
"""Size of the noise around the upper tenth of the samples over that around the lower tenth from
which it changes: 1.7 where it is chance."""
MOST_HELD = 8
"""Samples over which noise is held at most."""
MANY = 2000
"""Windows that are looked at: of more every few."""
LEAST = 0.1
"""Of the usual size, what is taken at least: of an output at rest the noise may be none."""


def over_local_size(values: Array) -> Array:
    """Each sample over the median magnitude of its neighbours.

    Those before and those after, whichever is larger: where the noise begins to be large at once it
    belongs to what follows. So single samples that are far stay far, and a stretch of larger noise
    does not look like many of them (`farthest_by_chance`).

    Parameters
    ----------
    values : (n_samples,) array
        About zero; ``nan`` marks a missing sample.

    Returns
    -------
    (n_samples,) array
        The values as they are where there are too few.

    References
    ----------
    F. Hampel, J. American Statistical Association 69 (1974) 383-393.

    Examples
    --------
    >>> noise = np.random.default_rng(0).standard_normal(800)
    >>> noise[200:300] *= 9.0
    >>> noise[500] = 12.0
    >>> even, limit = over_local_size(noise), farthest_by_chance(0.001, 800)
    >>> int(np.sum(np.abs(noise) > limit)), np.flatnonzero(np.abs(even) > limit).tolist()
    (62, [500])
    """
    found, seen = values.copy(), np.isfinite(values)
    local = _around(np.abs(values[seen]))
    least = LEAST * float(np.median(local)) if local.size else 0.0
    if least > 0.0:
        found[seen] /= np.maximum(local, least)
    return found


def farthest_by_chance(rate: float, count: int) -> float:
    """Quotient of `over_local_size` that normal noise exceeds in one record with a probability.

    The farthest of 150, 600 and 2000 samples is beyond it in one of 1,000 records.

    Parameters
    ----------
    rate : float
        Probability.
    count : int
        Samples.

    Examples
    --------
    >>> round(farthest_by_chance(0.001, 600), 1)
    5.7
    """
    return -FARTHER * float(ndtri(rate / count / 2))


def changes_size(values: Array) -> bool:
    """Whether the noise is much larger in one part of the samples than in another.

    Parameters
    ----------
    values : (n_samples,) array
        About zero; ``nan`` marks a missing sample.

    Examples
    --------
    >>> noise = np.random.default_rng(0).standard_normal(800)
    >>> changes_size(noise), changes_size(noise * np.where(np.arange(800) < 400, 1.0, 4.0))
    (False, True)
    """
    size = np.abs(values[np.isfinite(values)])
    if size.size < FEWEST_NEIGHBOURS:
        return False
    windows = sliding_window_view(size, min(NEIGHBOURS, size.size))
    low, high = quantiles(
        np.median(windows[:: 1 + len(windows) // MANY], axis=1), (0.1, 0.9)
    ).tolist()
    return bool(high > CHANGES * low)


def over_phases(values: Array) -> Array:
    """Each sample over the size of those as many samples away, where every k-th is large alone.

    What is held over k samples is new at every k-th: the innovations between are small, their
    middle is no size of the others, and a fifth to a half of all would look like far samples.

    Parameters
    ----------
    values : (n_samples,) array
        About zero; ``nan`` marks a missing sample.

    Returns
    -------
    (n_samples,) array
        The values as they are where no phase stands out, or there are too few.

    Examples
    --------
    >>> noise = np.random.default_rng(0).standard_normal(800)
    >>> held = noise * np.where(np.arange(800) % 5, 0.1, 1.0)
    >>> round(float(np.max(np.abs(over_phases(held)))), 1), over_phases(noise) is noise
    (3.6, True)
    """
    best, found = CHANGES, values
    for held in range(2, min(MOST_HELD, values.size // FEWEST_OF_ONE) + 1):
        sizes = np.array(sizes_of([values[phase::held] for phase in range(held)]))
        rest, largest = np.partition(sizes, -2)[-2:].tolist()
        if rest > 0.0 and largest > best * rest:
            best, found = largest / rest, values / np.resize(sizes, values.size)
    return found


def over_own_size(series: Sequence[Array]) -> tuple[Array, ...]:
    """What is left of several experiments, each over the size of its own noise.

    Parameters
    ----------
    series : sequence of (n_samples,) arrays
        ``nan`` marks a missing sample.

    Returns
    -------
    tuple of (n_samples,) arrays
        As they are where there is one, or where one has too few samples.

    Examples
    --------
    >>> noise = np.random.default_rng(0).standard_normal((2, 400))
    >>> [round(float(one.std()), 1) for one in over_own_size([noise[0], 9.0 * noise[1]])]
    [1.0, 1.0]
    """
    if len(series) < 2:
        return tuple(series)
    sizes = sizes_of(series)
    return tuple(one / size if size > 0 else one for one, size in zip(series, sizes, strict=True))


def sizes_of(series: Sequence[Array]) -> list[float]:
    """Standard deviation of each by its median, which single far samples do not move; 0 for none.

    Parameters
    ----------
    series : sequence of (n_samples,) arrays
        ``nan`` marks a missing sample.
    """
    seen = [one[np.isfinite(one)] for one in series]
    return [median_scale(one - median(one)) if one.size >= FEWEST_OF_ONE else 0.0 for one in seen]


def _around(size: Array) -> Array:
    """Size of the noise around each of these magnitudes; empty where they are too few."""
    width = min(NEIGHBOURS, size.size)
    if width < FEWEST_NEIGHBOURS:
        return np.zeros(0)
    middles = np.median(sliding_window_view(size, width), axis=1) / MAD_OF_NORMAL
    rest = size.size - middles.size
    after, before = (np.pad(middles, ends, mode="edge") for ends in ((0, rest), (rest, 0)))
    return np.asarray(np.maximum(after, before))
