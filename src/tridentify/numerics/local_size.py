"""Samples over the size of the noise around them, where its size changes."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.special import ndtri, stdtr

from tridentify.numerics.arrays import Array
from tridentify.numerics.quantiles import quantiles
from tridentify.numerics.robust import MAD_OF_NORMAL

NEIGHBOURS = 31
"""Samples of which the median magnitude is the size of the noise: ten spikes among them move it
little, and what changes more slowly is followed."""
FEWEST_NEIGHBOURS = 20
"""Below these the size is that of chance."""
EFFICIENCY = 0.37
"""Of the median magnitude against the standard deviation, for normal noise (Hampel 1974): so much
fewer are the degrees of freedom."""
CHANGES = 2.5
"""Size of the noise around the upper tenth of the samples over that around the lower tenth from
which it changes: 1.7 where it is chance."""
MANY = 2000
"""Windows that are looked at: of more every few."""
LEAST = 0.1
"""Of the usual size, what is taken at least: of an output at rest the noise may be none."""


def over_local_size(values: Array) -> Array:
    """Each sample over the median magnitude of its neighbours, as a normal deviate.

    Those before and those after, whichever is larger: where the noise begins to be large at once it
    belongs to what follows. For normal noise the quotient has about Student's distribution, of as
    many degrees of freedom as the median is worth; its quantiles are taken to those of a normal
    variable. So single samples that are far stay far, and a stretch of larger noise does not look
    like many of them.

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
    >>> even = over_local_size(noise)
    >>> int(np.sum(np.abs(noise) > 5.0)), np.flatnonzero(np.abs(even) > 5.0).tolist()
    (70, [500])
    """
    found, seen = values.copy(), np.isfinite(values)
    size = np.abs(values[seen])
    local = _around(size)
    least = LEAST * float(np.median(local)) if local.size else 0.0
    if not least > 0.0:
        return found
    freedom = EFFICIENCY * min(NEIGHBOURS, size.size)
    p_value = stdtr(freedom, -size / np.maximum(local, least))
    deviate = -ndtri(np.maximum(p_value, np.finfo(np.float64).tiny))
    found[seen] = np.sign(values[seen]) * deviate
    return found


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


def _around(size: Array) -> Array:
    """Size of the noise around each of these magnitudes; empty where they are too few."""
    width = min(NEIGHBOURS, size.size)
    if width < FEWEST_NEIGHBOURS:
        return np.zeros(0)
    middles = np.median(sliding_window_view(size, width), axis=1) / MAD_OF_NORMAL
    rest = size.size - middles.size
    after, before = (np.pad(middles, ends, mode="edge") for ends in ((0, rest), (rest, 0)))
    return np.asarray(np.maximum(after, before))
