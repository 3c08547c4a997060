"""Bad samples that stand beside a jump of the input by chance; slow disturbances and noise."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate

pytestmark = pytest.mark.judged
ROUND = TransferFunction([4.0], [1.0, 1.6, 4.0])
LIGHT = TransferFunction([0.74, 2.36], [1.0, 0.79, 1.53])


def said(u, y, dt, structure):
    found = identify(Record(u, y, dt=dt), structure).findings
    return [one.code for one in found if one.matters]


def driven(plant, rng, n, dt, hold):
    u = np.repeat(rng.choice([-1.0, 1.0], n // hold + 1), hold)[:n]
    return u, simulate(plant, Record(u, np.zeros(n), dt=dt))[:, 0]


@pytest.mark.parametrize(
    "seed", [3, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 5, 20))]
)
def test_spikes_that_follow_a_jump_by_chance_are_bad_samples(seed):
    """One lies where the output is lowest, as if a limit were there."""
    rng = np.random.default_rng([34, seed])
    u, y = driven(LIGHT, rng, 252, 0.248, int(rng.integers(5, 10)))
    size = 0.09 * np.std(y)
    late = np.unique(np.flatnonzero(np.diff(u))[:, None] + np.arange(1, 5))
    near = late[late < 249]
    lowest = rng.choice(near[np.argsort(y[near])[:3]])
    other = rng.choice(near[(near > 9) & (np.abs(y[near]) < 0.6 * np.abs(y).max())])
    y = y + size * rng.standard_normal(252)
    y[lowest] += 18.0 * size
    y[other] -= 12.0 * size
    assert said(u, y, 0.248, Structure(2, 1))[:1] == ["bad-samples"]


@pytest.mark.parametrize(
    "seed", [pytest.param(k, marks=pytest.mark.slow) for k in (4, 10, 12, 22, 26, 27, 28)]
)
def test_a_slow_disturbance_is_no_noise_that_changes_its_size(seed):
    rng = np.random.default_rng([32, seed])
    u, y = driven(ROUND, rng, 1100, 0.16, 16)
    walk = np.cumsum(rng.standard_normal(1100)) / np.sqrt(1100.0)
    y = y + np.std(y) * (0.9 * walk + 0.1 * rng.standard_normal(1100))
    assert "noise-changes" not in said(u, y, 0.16, Structure(2, 0))
