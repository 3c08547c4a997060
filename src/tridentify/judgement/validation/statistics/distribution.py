"""Distribution of the innovations: Gaussian or not, and which samples stand out.

Gaussian noise is not needed for the estimate, nor for its standard errors; heavy tails make a
robust loss better, and gross outliers spoil what least squares finds. Skewness and kurtosis are
judged together by D'Agostino and Pearson's test, whose approximation holds from 20 samples on. An
outlier is farther from the middle than the largest of ``N`` Gaussian samples would be
(Bonferroni), the scale taken from the middle of the distribution, so that what is looked for does
not hide itself.

A wrong sample leaves the next ones as they are; a door that opens, a gust or a load that comes on
moves them all, as the noise does. In what whitens coloured noise ``(1, a)`` the first is the whole
of ``size (1, a)``, the second ``size`` alone (additive and innovation outliers; Fox 1972).

References: A. Fox, Journal of the Royal Statistical Society B 34 (1972) 350-363. R. D'Agostino &
E. Pearson, Biometrika 60 (1973) 613-622; R. D'Agostino, A. Belanger & R. D'Agostino Jr., The
American Statistician 44 (1990) 316-321.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtrc, ndtri

from tridentify.judgement.validation.result import Normality
from tridentify.numerics.arrays import Array
from tridentify.numerics.local_size import farthest_by_chance
from tridentify.numerics.quantiles import median, quantiles
from tridentify.numerics.robust import median_scale
from tridentify.record.record import Record

BEFORE, AFTER = 1, 2
"""Samples before and after a move of an input that are there."""

FEW_MOVES = 0.1
"""Share of the samples that are there, from which anything is."""

BY_CHANCE = 0.05
"""Probability that so many samples are all there, below which the moves have to do with it."""

SMALL_SAMPLE = 6.0
"""Samples' worth by which the scale of a short record is uncertain: the limit is wider by this over
their number."""
QUANTILE = 0.8
"""Quantile of the absolute values that a second scale is taken from: rounding makes the median too
small, and up to a fifth of spikes does not move this."""


CLEARLY = 4.0
"""Fall of -2 log L from which a far innovation is a shock and no wrong sample: odds of 7 to 1."""
BURST = 3
"""Samples within which what comes back was a burst of wrong ones, and what goes on is one shock."""

NOT_COLOURED = np.zeros(0)


def scale_of(size: Array) -> float:
    """Of Gaussian noise whose absolute values these are."""
    far = float(quantiles(size, (QUANTILE,))[0]) / float(ndtri(0.5 + QUANTILE / 2))
    return max(median_scale(size), far)


def largest_by_chance(rate: float, count: int, least: float = 0.0) -> float:
    """The largest of so many, in standard deviations: passed by chance at a rate."""
    return max(least, -float(ndtri(rate / count / 2))) * (1.0 + SMALL_SAMPLE / count)


def distribution(
    name: str,
    innovations: Sequence[Array],
    times: Sequence[Array],
    rate: float,
    noise: Array = NOT_COLOURED,
    *,
    levelled: bool = False,
) -> Normality:
    """Test one output.

    Innovations that only repeat a spike, as what whitens them makes of it, are no outliers.

    Parameters
    ----------
    name : str
    innovations, times : sequence of (n_samples,) arrays
        ``nan`` marks a missing sample.
    rate : float
        Probability that Gaussian noise has an outlier.
    noise : (p,) array
        Autoregression that made them white.
    levelled : bool
        Whether they are over the size of the noise around them (`over_local_size`).

    Examples
    --------
    >>> e = np.random.default_rng(0).standard_normal(200)
    >>> e[7] = 9.0
    >>> found = distribution("q", [e], [0.1 * np.arange(200)], 0.001)
    >>> found.p_value < 0.001, found.outliers[:, 1].round(3).tolist()
    (True, [0.7])
    """
    joined = np.concatenate(list(innovations))
    seen = joined[np.isfinite(joined)]
    middle = median(seen)
    size = np.abs(seen - middle)
    scale, limit = scale_of(size), largest_by_chance(rate, seen.size)
    if levelled:
        scale, limit = 1.0, farthest_by_chance(rate, seen.size)
    rows, shocks = [], []
    for e, (one, t) in enumerate(zip(innovations, times, strict=True)):
        far = np.nan_to_num((one - middle) / scale) if scale > 0 else np.zeros(one.size)
        begun = -far.size
        for k in _first_hand(far, limit, noise):
            rows.append((float(e), float(t[k]), float(far[k])))
            goes_on = k - begun <= BURST and far[k] * far[begun] > 0
            if goes_on or is_shock(far, k, limit, noise):
                begun = k
                shocks.append(rows[-1])
    skewness, excess = _shape(seen)
    p_value = _gaussian(skewness, excess, float(seen.size))
    outliers, sets_in = (np.array(own).reshape(-1, 3) for own in (rows, shocks))
    return Normality(name, skewness, excess, p_value, outliers, sets_in)


def _first_hand(far: Array, limit: float, noise: Array) -> list[int]:
    """Places beyond a limit but for echoes of one before, ``size noise[j - 1]`` at ``k + j``."""
    left, found = far.copy(), []
    for k in np.flatnonzero(np.abs(far) > limit).tolist():
        if min(abs(left[k]), abs(far[k])) > limit:
            found.append(k)
            if k < noise.size:  # whitened by fewer than all coefficients, on a scale of its own
                continue
            echo = left[k + 1 : k + 1 + noise.size]
            echo -= left[k] * noise[: echo.size]
    return found


def is_shock(far: Array, k: int, limit: float, noise: Array) -> bool:
    """Whether what is far goes on as the noise does, and does not come back at once.

    Parameters
    ----------
    far : (n_samples,) array
        Innovations in standard deviations, 0 where there is none.
    k : int
        Which one is far.
    limit : float
        From where one is.
    noise : (p,) array
        Autoregression that made them white.
    """
    after = far[k + 1 : k + 1 + BURST]
    if not noise.size <= k < far.size - noise.size or np.any(-np.sign(far[k]) * after > limit):
        return False
    whole = np.append(1.0, noise)
    near = far[k - noise.size : k + noise.size + 1]
    spikes = np.correlate(near, whole, "valid") ** 2 / float(whole @ whole)
    if not float(far[k]) ** 2 - spikes.max() > CLEARLY:
        return False
    others = [j for j in np.flatnonzero(np.abs(near) > limit).tolist() if j != noise.size]
    return not others or _beside_spikes(near, others, whole) > CLEARLY


def _beside_spikes(near: Array, others: Sequence[int], whole: Array) -> float:
    """Fall of -2 log L from a wrong sample in the middle to a shock, wrong samples near it."""
    middle = near.size // 2
    spikes = [np.convolve(np.eye(near.size)[j], whole)[: near.size] for j in (middle, *others)]
    shock = np.eye(near.size)[middle]
    left = []
    for first in (spikes[0], shock):
        table = np.column_stack([first, *spikes[1:]])
        left.append(float(np.sum((near - table @ np.linalg.lstsq(table, near)[0]) ** 2)))
    return left[0] - left[1]


def _shape(values: Array) -> tuple[float, float]:
    """Skewness and excess kurtosis; both nan where all values are the same."""
    centred = values - values.mean()
    square = float(np.mean(centred**2))
    if not square > 0:
        return np.nan, np.nan
    third, fourth = float(np.mean(centred**3)), float(np.mean(centred**4))
    return third / square**1.5, fourth / square**2 - 3.0


def _gaussian(skewness: float, excess: float, n: float) -> float:
    """p-value of D'Agostino and Pearson's test.

    As `scipy.stats.normaltest`, whose import alone takes longer than all tests of a record.
    """
    y = skewness * np.sqrt((n + 1.0) * (n + 3.0) / (6.0 * (n - 2.0)))
    spread = 3.0 * (n**2 + 27.0 * n - 70.0) * (n + 1.0) * (n + 3.0)
    spread /= (n - 2.0) * (n + 5.0) * (n + 7.0) * (n + 9.0)
    w2 = np.sqrt(2.0 * (spread - 1.0)) - 1.0
    of_skewness = np.arcsinh(y * np.sqrt(0.5 * (w2 - 1.0))) / np.sqrt(0.5 * np.log(w2))
    variance = 24.0 * n * (n - 2.0) * (n - 3.0) / ((n + 1.0) ** 2 * (n + 3.0) * (n + 5.0))
    x = (excess + 6.0 / (n + 1.0)) / np.sqrt(variance)
    beta = 6.0 * (n**2 - 5.0 * n + 2.0) / ((n + 7.0) * (n + 9.0))
    beta *= np.sqrt(6.0 * (n + 3.0) * (n + 5.0) / (n * (n - 2.0) * (n - 3.0)))
    a = 6.0 + 8.0 / beta * (2.0 / beta + np.sqrt(1.0 + 4.0 / beta**2))
    cube = np.cbrt((1.0 - 2.0 / a) / (1.0 + x * np.sqrt(2.0 / (a - 4.0))))
    of_kurtosis = (1.0 - 2.0 / (9.0 * a) - cube) / np.sqrt(2.0 / (9.0 * a))
    return float(chdtrc(2.0, of_skewness**2 + of_kurtosis**2))


def at_moves(records: Sequence[Record], places: Sequence[tuple[int, int]]) -> bool:
    """Whether samples lie where an input moves, all of them and not by chance.

    What is too fast for the model, or moves whose times are not those of the samples, leaves
    single large residuals there, and no sample is wrong.

    Parameters
    ----------
    records : sequence of Record
    places : sequence of (experiment, sample)

    Examples
    --------
    >>> record = Record(np.repeat([0.0, 1.0, 0.0, 1.0], 100), np.zeros(400), dt=1.0)
    >>> at_moves([record], [(0, 100), (0, 201)]), at_moves([record], [(0, 100), (0, 250)])
    (True, False)
    """
    there = []
    for record in records:
        near = np.zeros(record.n_samples, dtype=bool)
        for k in np.flatnonzero(np.any(np.diff(record.u, axis=0) != 0.0, axis=1)) + 1:
            near[max(k - BEFORE, 0) : k + AFTER + 1] = True
        there.append(near)
    share = float(np.mean(np.concatenate(there)))
    if not places or share > FEW_MOVES or share ** len(places) > BY_CHANCE:
        return False
    return all(there[e][k] for e, k in places)
