"""Whether a series holds more slow power than its own spectrum foretells.

Noise with a long memory has a spectrum that still rises at the lowest frequencies of a record,
``1 / f`` for instance, which an autoregression fitted to all frequencies misses: its slow waves are
large, and are noise all the same. So the lowest modes are judged by the ones next to them. With
``P_k`` the power in the cosine of ``k`` half periods a record, ``P_k / (c k^-s)`` is a chi-square
for noise of slope ``s``. The modes beside the lowest tell ``c`` and, badly, ``s``: its chance is
the mean over slopes, weighed by their likelihood (Whittle), up to one, as steeper noise (a random
walk) never returns to its level and is a disturbance. Ramps, warm-ups and steps in level fall off
as ``k^-4`` to ``k^-2``, and stand out. A series whose constant is larger than its waves is left:
what is missing there is an offset.

References: P. Whittle, Arkiv foer Matematik 2 (1953) 423-434. P. Robinson, Annals of Statistics 23
(1995) 1630-1661, for the slope from the lowest frequencies alone.
"""

from __future__ import annotations

import numpy as np
from scipy.special import fdtrc

from tridentify.numerics.arrays import Array

LOWEST = 6
"""Half periods of the fastest slow wave in a record: three periods."""
BESIDE = 36
"""The same of the fastest wave that they are judged by."""
STEEPEST = 1.0
"""Slope of the spectrum of noise, at most: that of 1/f noise."""
SLOPES = np.linspace(0.0, STEEPEST, 21)
BY_NOISE = 0.05
"""Chance from which slow waves pass for noise: below it a drift that a test tells stays told. Of
1/f noise one series in fifteen is below 0.01."""
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
        Zero for too few samples, and for a level that is not zero.

    Examples
    --------
    >>> noise = np.random.default_rng(1).standard_normal(400)
    >>> noise = noise - noise.mean()
    >>> slow_chance(noise) > 0.01, slow_chance(noise + np.linspace(-1.0, 1.0, 400)) < 0.001
    (True, True)
    """
    count = series.size
    if count < FEWEST:
        return 0.0
    half = np.arange(BESIDE + 1.0)
    waves = np.cos(np.pi * np.outer((np.arange(count) + 0.5) / count, half))
    power = (waves.T @ np.nan_to_num(series)) ** 2 / np.sum(waves**2, axis=0)
    half[0] = 1.0  # has no part in what follows
    beside = slice(LOWEST + 1, None)
    scales = np.array([np.mean(power[beside] * half[beside] ** s) for s in SLOPES])
    if not scales.min() > 0.0:
        return 0.0
    freedom = BESIDE - LOWEST
    # minus log likelihood of each slope, the scale being the likeliest
    unlikely = 0.5 * freedom * (np.log(scales) - SLOPES * np.mean(np.log(half[beside])))
    weights = np.exp(unlikely.min() - unlikely)
    low = slice(1, LOWEST + 1)
    if power[0] > np.mean(power[low]):
        return 0.0
    foreseen = scales * np.sum(half[low, None] ** -SLOPES, axis=0)
    chances = fdtrc(LOWEST, freedom, np.sum(power[low]) / foreseen)
    return float(weights @ chances / weights.sum())
