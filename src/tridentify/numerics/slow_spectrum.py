"""Whether a series holds more slow power than its own spectrum foretells.

Noise with a long memory has a spectrum that still rises at the lowest frequencies of a record,
``1 / f`` for instance, which an autoregression fitted to all frequencies misses: its slow waves are
large, and are noise all the same. So the lowest modes are judged by the ones next to them. With
``P_k`` the power in the cosine of ``k`` half periods a record, ``P_k / (c k^-s)`` is a chi-square
for noise of slope ``s``; ``c`` and ``s`` are the likeliest (Whittle) for the modes beside the
lowest, and ``s`` at most one: steeper noise (a random walk) never returns to its level and is a
disturbance. Ramps, warm-ups and steps in level fall off as ``k^-4`` to ``k^-2``, and stand out.

References: P. Whittle, Arkiv foer Matematik 2 (1953) 423-434. P. Robinson, Annals of Statistics 23
(1995) 1630-1661, for the slope from the lowest frequencies alone.
"""

from __future__ import annotations

import numpy as np
from scipy.special import fdtrc

from tridentify.numerics.arrays import Array

LOWEST = 6
"""Half periods of the fastest slow wave in a record: three periods."""
BESIDE = 24
"""The same of the fastest wave that they are judged by."""
STEEPEST = 1.0
"""Slope of the spectrum of noise, at most: that of 1/f noise."""
SLOPES = np.linspace(0.0, STEEPEST, 21)
LEVEL = 0.5
"""Half periods that stand for a constant."""
FEWEST = 4 * BESIDE
"""Samples below which the modes are not told apart."""


def slow_chance(series: Array) -> float:
    """Probability that noise of the spectrum beside it is as slow as a series.

    Parameters
    ----------
    series : (n_samples,) array
        At even times; ``nan`` marks a missing sample.

    Returns
    -------
    float
        Of its slow waves or of its level, whichever is less, twice; zero for too few samples.

    Examples
    --------
    >>> noise = np.random.default_rng(1).standard_normal(400)
    >>> slow_chance(noise) > 0.01, slow_chance(noise + np.linspace(-1.0, 1.0, 400)) < 0.001
    (True, True)
    """
    count = series.size
    if count < FEWEST:
        return 0.0
    half = np.arange(BESIDE + 1.0)
    waves = np.cos(np.pi * np.outer((np.arange(count) + 0.5) / count, half))
    power = (waves.T @ np.nan_to_num(series)) ** 2 / np.sum(waves**2, axis=0)
    half[0] = LEVEL
    beside = slice(LOWEST + 1, None)
    scales = np.array([np.mean(power[beside] * half[beside] ** s) for s in SLOPES])
    if not scales.min() > 0.0:
        return 0.0
    unlikely = np.log(scales) - SLOPES * np.mean(np.log(half[beside]))
    best = int(np.argmin(unlikely))
    foreseen = scales[best] * half ** -SLOPES[best]
    freedom = BESIDE - LOWEST
    low = slice(1, LOWEST + 1)
    waving = fdtrc(LOWEST, freedom, float(np.sum(power[low]) / np.sum(foreseen[low])))
    level = fdtrc(1, freedom, float(power[0] / foreseen[0]))
    return min(1.0, 2.0 * float(min(waving, level)))
