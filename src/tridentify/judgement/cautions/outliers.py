"""Samples too far off for Gaussian noise, where squares were minimised.

The scale of the residual is taken from its middle, so that what is looked for does not hide itself:
the larger of the median absolute value and the 80 % quantile, both consistent for Gaussian noise.
The limit is that of the largest of ``N`` Gaussian samples (Bonferroni), widened for the error of
the scale in short records. A response that the model misses has large residuals too, but in bursts;
outliers stand alone, so most of those found must be more than twice as far off as their neighbours.
What goes on as coloured noise does set in there, and no sample is wrong (`distribution`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.judgement.causes.attempts.first_samples import Predictions, beginning
from tridentify.judgement.validation.phrases import AT_MOVES, LOOK_THERE
from tridentify.judgement.validation.statistics.distribution import (
    at_moves,
    is_shock,
    largest_by_chance,
    scale_of,
)
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import whiten
from tridentify.numerics.converter import within_a_step
from tridentify.numerics.local_size import (
    FEWEST_OF_ONE,
    changes_size,
    farthest_by_chance,
    over_local_size,
    over_phases,
)
from tridentify.numerics.quantiles import median, root_mean_square
from tridentify.record.record import Record
from tridentify.writing.layout import first_of

FALSE_ALARMS = 1e-3
"""Probability that a record of Gaussian noise is told to have a spike."""
LEAST = 5.0
"""Standard deviations that a spike has at least: in short records the tail of other distributions
is no spike."""
SHARE = 0.5
"""Share of a spike's size below which both its neighbours stay: spikes stand alone, a disturbance
does not."""
ROUNDING = 1e-9
"""Noise over output below which it is rounding, and has no spikes."""
FEWEST = 12
"""Samples below which a median is no scale."""
LONGEST = 100_000
"""Samples of a record that are looked at: spikes show in any part of it."""
FEW = 10_000
"""Samples by whose scale a long residual is looked at first: a median of so many is good to 1 %."""
CLEARLY = 0.9
"""Share of the limit below which that first look is believed; nine standard errors of the scale
away from it."""
OTHER = 1.5
"""Size of one experiment's noise over that of another from which its samples are compared with its
own: of 20 samples the size is uncertain by a quarter."""
MOST_SPIKES = 50
"""Samples taken out of one experiment's noise, one by one."""
BESIDE = 3
"""Samples within which two that are far off are one burst."""
MOST_NAMED = 5
"""Times that are written out."""


def outlier_findings(
    estimate: Estimate, records: Sequence[Record], known: Predictions | None = None
) -> list[Finding]:
    """Advice to fit with a robust loss, where the residual has gross outliers.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
        Those that were identified; the first 100,000 samples of each are looked at.
    known : Predictions, optional
        What was computed before.

    Notes
    -----
    Gaussian noise is taken for outliers in fewer than one of 1,000 records.
    """
    if estimate.loss != "squared" or not estimate.status.ok:
        return []
    records = [beginning(record, LONGEST) for record in records]
    known = known or Predictions(estimate)
    residuals = [known.residual(record, e) for e, record in enumerate(records)]
    found = []
    for i, name in enumerate(estimate.output_names):
        series = [one[:, i] for one in residuals]
        a = estimate.noise_model[i]
        places, farthest = _far_samples(series, a)
        count = len(places)
        if not count or within_a_step([record.y[:, i] for record in records], series):
            continue
        size = root_mean_square(np.concatenate([r.y[:, i] for r in records]))
        if math.sqrt(float(estimate.noise_variance[i])) > ROUNDING * size:
            many = f"{count} samples of {name} lie" if count > 1 else f"A sample of {name} lies"
            times = [float(records[e].t[k]) for e, k in places]
            moves = at_moves(records, places)
            found.append(
                Finding(
                    "bad-samples",
                    "note" if moves else "warning",
                    f"{many} farther from the model than Gaussian noise explains (up to "
                    f"{farthest:.0f} standard deviations of the others; "
                    f"{_at(places, times, len(records))}"
                    + (f"), {AT_MOVES}." if moves else "). Least squares follows such outliers."),
                    LOOK_THERE
                    if moves
                    else "Fit with a robust loss (--loss huber or student, in Python "
                    "ThreeModel(loss='huber')), or mark them as missing (nan).",
                    (name,),
                    places[0][0] if len({e for e, _ in places}) == 1 < len(records) else None,
                    tuple(times),
                )
            )
    return found


def _at(places: Sequence[tuple[int, int]], times: Sequence[float], n_experiments: int) -> str:
    """When, in words."""
    several = n_experiments > 1
    said = [
        f"{t:.4g} s" + (f" of experiment {e + 1}" if several else "")
        for (e, _), t in zip(places, times, strict=True)
    ]
    return f"at {first_of(said, MOST_NAMED)}"


def _far_samples(series: Sequence[Array], a: Array) -> tuple[list[tuple[int, int]], float]:
    """Their (experiment, sample), and the distance of the farthest in standard deviations."""
    joined = np.concatenate(series)
    seen = joined[np.isfinite(joined)]
    if seen.size < FEWEST or (not a.size and _clearly_none(seen)):
        return [], 0.0
    middle = median(seen)
    size = np.abs(seen - middle)
    scale = scale_of(size)
    if scale == 0 or not (a.size or size.max() / scale > _limit(seen.size)):
        return [], 0.0
    # an experiment too short for a size of its own is judged by that of all
    series = _of_one_size(series, a)
    left = [_from_neighbours((one - middle) / scale, _taps(a)) for one in series]
    new = [whiten(np.ascontiguousarray(one - middle), a)[0] for one in series]
    if any(over_phases(one) is not one for one in new):
        # held noise is new at every k-th sample alone, and the middle is no size of that
        return [], 0.0
    if not any(changes_size(one) for one in left):
        places, farthest = _outliers(series, middle, scale)
        return (places, farthest) if places or not a.size else spikes(series, a)
    limit = farthest_by_chance(FALSE_ALARMS, seen.size)
    even = [np.nan_to_num(over_local_size(one)) for one in left]
    places = [(e, int(k)) for e, one in enumerate(even) for k in np.flatnonzero(abs(one) > limit)]
    if 2 * _apart(places) < len(places):
        return [], 0.0
    return places, max((abs(float(even[e][k])) for e, k in places), default=0.0)


def _of_one_size(series: Sequence[Array], a: Array) -> Sequence[Array]:
    """Experiments whose noise is of another size, as if it were of that of all."""
    if len(series) < 2:
        return series
    parts = [_from_neighbours(one, _taps(a)) for one in series]
    there = [one[np.isfinite(one)] for one in parts]
    sizes = np.array(
        [scale_of(np.abs(one - median(one))) if one.size >= FEWEST_OF_ONE else 0.0 for one in there]
    )
    known = sizes > 0
    if np.sum(known) < 2 or sizes[known].max() < OTHER * sizes[known].min():
        return series
    seen = np.concatenate(there)
    scale = scale_of(np.abs(seen - median(seen)))
    factors = np.where(known, scale / np.where(known, sizes, 1.0), 1.0)
    return [factor * one for factor, one in zip(factors.tolist(), series, strict=True)]


def _outliers(
    series: Sequence[Array], middle: float, scale: float
) -> tuple[list[tuple[int, int]], float]:
    """Those that stand alone, where the noise is of one size."""
    limit = _limit(sum(int(np.isfinite(one).sum()) for one in series))
    places, alone, farthest = [], 0, 0.0
    for e, one in enumerate(series):
        far = np.nan_to_num(np.abs(one - middle) / scale)
        padded = np.concatenate([[0.0], far, [0.0]])
        beside = np.maximum(padded[:-2], padded[2:])
        places += [(e, int(k)) for k in np.flatnonzero(far > limit)]
        alone += int(np.sum((far > limit) & (beside < SHARE * far)))
        farthest = max(farthest, float(far.max(initial=0.0)))
    return ([], 0.0) if 2 * alone < max(len(places), 1) else (places, farthest)


def spikes(series: Sequence[Array], a: Array) -> tuple[list[tuple[int, int]], float]:
    """Single samples that stand out of coloured noise, though not from its size.

    Each sample is told from its neighbours on both sides, by ``sum_j c_j v(k + j) / c_0`` with
    ``c`` the autocorrelation of ``(1, a)``: what is left has the variance ``s^2 / c_0``. The
    farthest is taken out, and all is looked at again, so that what it does to its neighbours does
    not count.

    Parameters
    ----------
    series : sequence of (n_samples,) arrays
        Residuals, not whitened; ``nan`` marks a missing sample.
    a : (p,) array
        What whitens them.

    Returns
    -------
    places : list of (experiment, sample)
        None where those that are far off stand together, as those of a missed response do.
    farthest : float
        In standard deviations of what is left of the others.
    """
    taps = _taps(a)
    parts = [_from_neighbours(one, taps) for one in series]
    seen = np.concatenate([one[np.isfinite(one)] for one in parts])
    if seen.size < FEWEST:
        return [], 0.0
    scale = scale_of(np.abs(seen - median(seen)))
    limit = _limit(seen.size) * scale
    places, farthest = [], 0.0
    for e, one in enumerate(parts):
        left = one.copy()
        for _ in range(MOST_SPIKES):
            size = np.nan_to_num(np.abs(left))
            k = int(np.argmax(size))
            if not size[k] > limit:
                break
            places.append((e, k))
            farthest = max(farthest, float(size[k]) / scale)
            first, last = max(k - a.size, 0), min(k + a.size + 1, left.size)
            left[first:last] -= left[k] * taps[first - k + a.size : last - k + a.size]
    places = [(e, k) for e, k in places if not _sets_in(series[e], k, a)]
    return (sorted(places), farthest) if 2 * _apart(places) >= len(places) > 0 else ([], 0.0)


def _apart(places: Sequence[tuple[int, int]]) -> int:
    """How many samples (experiment, sample) have no other one beside them."""
    near = [a[0] == b[0] and b[1] - a[1] <= BESIDE for a, b in pairwise(sorted(places))]
    return sum(not (a or b) for a, b in zip([False, *near], [*near, False], strict=True))


def _taps(a: Array) -> Array:
    """What takes from a sample all that its neighbours on both sides tell of it."""
    whole = np.concatenate([[1.0], a])
    return np.asarray(np.correlate(whole, whole, "full") / float(whole @ whole))


def _sets_in(series: Array, k: int, a: Array) -> bool:
    """Whether a disturbance sets in at a sample, or at the next one: no sample is wrong then."""
    innovations = whiten(np.ascontiguousarray(series), a)[0]
    seen = innovations[np.isfinite(innovations)]
    scale = scale_of(np.abs(seen - median(seen)))
    far = np.nan_to_num(innovations / scale) if scale > 0 else np.zeros(series.size)
    return any(is_shock(far, at, _limit(seen.size), a) for at in (k, k + 1) if at < far.size)


def _from_neighbours(series: Array, taps: Array) -> Array:
    """What is left of each sample that has all its neighbours."""
    found = np.full(series.size, np.nan)
    if series.size >= taps.size:
        half = taps.size // 2
        found[half : series.size - half] = np.convolve(series, taps, "valid")
    return found


def _limit(count: int) -> float:
    """The largest of so many, in standard deviations."""
    return largest_by_chance(FALSE_ALARMS, count, LEAST)


def _clearly_none(seen: Array) -> bool:
    """Whether no sample of many comes near the limit, by the scale of every few of them."""
    if seen.size < 2 * FEW:
        return False
    few = seen[:: seen.size // FEW]
    middle = median(few)
    farthest = max(float(seen.max()) - middle, middle - float(seen.min()))
    return farthest < CLEARLY * _limit(seen.size) * scale_of(np.abs(few - middle))
