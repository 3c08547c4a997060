"""Whether the advice calls an input that moves between its samples one that reacts."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from tridentify import Record, advise

pytestmark = pytest.mark.slow

A, B, GUST = np.array([[-1.3, 1.0], [-9.0, -1.6]]), np.array([-0.1, -11.0]), np.array([-1.3, -9.0])
DT, FINER, COUNT = 0.03, 5, 600


def flown(rng, stick, react=0.0):
    """Pitch rate in gusts, the stick joined by lines; or held, with a gain from the rate to it."""
    both = np.zeros((4, 4))
    both[:2] = np.column_stack([A, B, GUST]) * DT / FINER
    step = expm(both)[:2]
    x, gust, u, y = np.zeros(2), 0.0, np.array(stick), np.zeros(COUNT)
    for k in range(COUNT):
        y[k] = x[1] + 0.08 * rng.standard_normal()
        u[k] += react * y[k]
        following = u[k] if react or k + 1 == COUNT else u[k + 1]
        for part in np.arange(FINER) + 0.5:
            gust = 0.99 * gust + 0.06 * rng.standard_normal()
            moved = u[k] + (following - u[k]) * part / FINER
            x = step @ np.array([*x, moved, gust])
    return Record(u, y, dt=DT)


@pytest.mark.parametrize("seed", range(3))
def test_a_stick_that_moves_at_every_sample_is_not_told_to_react(seed):
    rng = np.random.default_rng(60 + seed)
    stick = np.zeros(COUNT)
    for k in range(1, COUNT):
        stick[k] = 0.93 * stick[k - 1] + 0.7 * rng.standard_normal()
    record = flown(rng, np.round(stick, 2))
    assert "feedback" not in [one.code for one in advise(record).findings]


def test_a_controller_is_still_told():
    rng = np.random.default_rng(70)
    record = flown(rng, -0.15 * np.repeat(rng.uniform(-3.0, 3.0, COUNT // 40), 40), react=0.15)
    assert "feedback" in [one.code for one in advise(record).findings]
