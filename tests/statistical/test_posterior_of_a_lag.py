"""Intervals of the posterior mean hold what they say where a lag is hardly slower than sampling."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Status, Structure, TransferFunction, identify, simulate

pytestmark = [pytest.mark.slow, pytest.mark.unjudged(always=True)]
DT, N = 0.3, 60


def short_record(seed: int) -> tuple[Record, TransferFunction]:
    """A pair at 1 rad/s and a lag of 1.1 to 3 samples, 12 dB, from rest."""
    rng = np.random.default_rng([seed, 83])
    den = np.polymul([1.0, 2.0 * rng.uniform(0.2, 0.9), 1.0], [1.0, rng.uniform(1.1, 3.0)])
    plant = TransferFunction([den[-1] * rng.uniform(0.5, 2.0)], den)
    u = np.repeat(rng.choice([-1.0, 1.0], N // 4), 4)
    y = simulate(plant, Record(u, u, dt=DT))[:, 0]
    return Record(u, y + 0.25 * y.std() * rng.standard_normal(N) + 0.1, dt=DT), plant


def test_a_lag_of_a_sample_or_so_is_not_denied():
    held, count = [], 0
    for seed in range(100):
        record, plant = short_record(seed)
        found = identify(record, Structure(3, 0), throw=False)
        count += found.status is Status.POSTERIOR_MEAN
        truth = [*plant.den[0][0][1:], *plant.num[0][0]]
        bounds = [p.interval(0.95) for p in found.parameters.values()][: len(truth)]
        held.append([low <= v <= high for v, (low, high) in zip(truth, bounds, strict=True)])
    assert count > 80
    assert np.mean(held) > 0.87
