"""An output that goes to and fro by itself: poles on the axis follow it, and no input is needed."""

from __future__ import annotations

import numpy as np
import pytest

from oracles import by_modes
from tridentify import Record, Structure, identify

pytestmark = pytest.mark.slow

DT, COUNT = 0.01, 1500


def codes(u, y):
    found = identify(Record(u, y, dt=DT), Structure(2, 1), throw=False).findings
    return [one.code for one in found]


@pytest.mark.parametrize("seed", [300, 302])
def test_heartbeats_do_not_answer_a_breath(seed):
    rng = np.random.default_rng(seed)
    t = DT * np.arange(COUNT)
    rate = 1.0 / (rng.uniform(0.7, 1.0) + 0.05 * np.sin(t) + 0.01 * rng.standard_normal(COUNT))
    phase = (DT * np.cumsum(rate)) % 1.0
    y = np.exp(-(((phase - 0.4) / 0.015) ** 2)) + 0.3 * np.exp(-(((phase - 0.7) / 0.05) ** 2))
    breath = np.sin(1.6 * t + rng.uniform(0.0, 6.0))
    found = codes(breath, y + 0.02 * rng.standard_normal(COUNT))
    assert "no-response" in found
    assert "intersample" not in found


@pytest.mark.parametrize("seed", [0, 1])
def test_a_weak_response_beside_a_swing_that_dies_away_is_one(seed):
    rng = np.random.default_rng(seed)
    t = DT * np.arange(COUNT)
    u = np.repeat(rng.choice([-1.0, 1.0], COUNT // 30), 30)
    y = by_modes(np.array([9.0]), np.array([1.0, 1.0, 9.0]), u, DT)
    y = 0.2 * y / np.std(y) + np.exp(-0.5 * t) * np.sin(2.96 * t)
    assert "no-response" not in codes(u, y + 0.2 * rng.standard_normal(COUNT))
