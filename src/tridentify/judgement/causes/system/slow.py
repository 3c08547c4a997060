"""A slow disturbance: a few slow waves that act beside the input, through the same poles.

What moves an output slowly and not because of the input is, for frequencies well below those of the
poles, the same as a slow signal at the input: a constant gain apart. So the waves are further
inputs without zeros, which every estimator takes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.attempts.rivals import Rival, one
from tridentify.numerics.arrays import Array

HALVES = 6
"""Half periods of the fastest wave in a record: faster ones are noise, or a response."""

MOSTLY_SLOW = 0.5
"""Share of a residual that a few slow waves explain from which it is a slow disturbance. Of right
records with white or autoregressive (0.7) noise, nine in ten are below 0.1, and the most is 0.2,
or 0.37 of one of two short experiments; of 26 in 30 with a slow disturbance, 0.5 to 0.99."""

PER_WAVE = 25
"""Samples a wave below which their share says nothing: so many of autoregressive noise (0.7) leave
0.2 of it."""

UNEVEN = (
    "Resample the record to even time (record.resample) for a noise model, which takes what "
    "wanders for noise; a straight drift (drift=True) does not stand for it."
)
"""What to do about a slow disturbance where time is uneven, on which no autoregression stands."""


def slow_waves(place: Array) -> Array:
    """(n, k) cosines of one to a few half periods at places from 0 to 1 in a record."""
    return np.asarray(np.cos(np.pi * np.outer(place, np.arange(1, HALVES + 1))))


def slow_share(residual: Array) -> float:
    """Share of a residual, about its mean, that is slower than a few periods a record.

    Parameters
    ----------
    residual : (n_samples,) array
        At even times; ``nan`` marks a missing sample.

    Examples
    --------
    >>> t, noise = np.linspace(0.0, 1.0, 300), np.random.default_rng(0).standard_normal(300)
    >>> round(slow_share(noise), 1), round(slow_share(0.1 * noise + np.sin(6.0 * t)), 1)
    (0.0, 1.0)
    """
    seen = np.isfinite(residual)
    if int(seen.sum()) < PER_WAVE * (HALVES + 1):
        return 0.0
    one = residual[seen] - residual[seen].mean()
    columns = slow_waves(np.linspace(0.0, 1.0, residual.size))[seen]
    basis = np.linalg.qr(columns - columns.mean(axis=0))[0]
    whole = float(one @ one)
    return float(np.sum((basis.T @ one) ** 2)) / whole if whole > 0 else 0.0


def slow_rivals(present: Present) -> Iterator[Rival]:
    """Cosines of one to a few half periods in each record."""
    if not isinstance(present.order, int) or len(present.records) > 1:
        return
    (record,) = present.records
    other = present
    for k, wave in enumerate(slow_waves((record.t - record.t[0]) / record.duration).T, start=1):
        other = other.with_inputs([wave], f"wave {k}", 0)
    freed = replace(other, nuisances=replace(present.nuisances, offset=True, drift=True))
    yield one(
        "drift",
        freed,
        "a slow disturbance of the output",
        UNEVEN if any(record.dt is None for record in present.records) else "",
        refits=False,
    )
