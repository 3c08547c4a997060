"""A slow disturbance: a few slow waves that act beside the input, through the same poles.

What moves an output slowly and not because of the input is, for frequencies well below those of the
poles, the same as a slow signal at the input: a constant gain apart. So the waves are further
inputs without zeros, which every estimator takes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from tridentify.judgement.causes.present import Present
from tridentify.judgement.causes.rivals import Rival, one
from tridentify.numerics.arrays import Array

HALVES = 6
"""Half periods of the fastest wave in a record: faster ones are noise, or a response."""


UNEVEN = (
    "Resample the record to even time (record.resample) for a noise model, which takes what "
    "wanders for noise; a straight drift (drift=True) does not stand for it."
)
"""What to do about a slow disturbance where time is uneven, on which no autoregression stands."""


def slow_waves(place: Array) -> Array:
    """(n, k) cosines of one to a few half periods at places from 0 to 1 in a record."""
    return np.asarray(np.cos(np.pi * np.outer(place, np.arange(1, HALVES + 1))))


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
