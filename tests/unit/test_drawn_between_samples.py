"""An input that moves between its samples is none that a controller moves, though taken as held."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate

SEEDS = [2, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (0, 1, 3, 4, 5, 6, 7))]


@pytest.mark.parametrize("seed", SEEDS)
def test_tones_that_are_taken_as_held_are_told_as_such_and_not_as_feedback(seed):
    rng = np.random.default_rng([931, seed])
    n = 160
    tones = np.arange(1, 54, 4)
    u = np.cos(2 * np.pi * np.outer(np.arange(n), tones) / n + rng.uniform(0, 6.28, tones.size))
    record = Record(u.sum(axis=1), np.zeros(n), dt=0.1, intersample="band-limited")
    pole = rng.uniform(0.3, 3.0)
    y = simulate(TransferFunction([pole], [1.0, pole]), record)[:, 0]
    y = y + 0.08 * y.std() * rng.standard_normal(n)
    estimate = identify(Record(record.u, y, dt=0.1), Structure(1, 0))
    assert estimate.route == "open-loop"
    assert estimate.findings[0].code == "intersample"
    assert "feedback" not in [one.code for one in estimate.findings]
