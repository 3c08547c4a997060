"""A slow disturbance hides a resonance: white weights end elsewhere, a long noise model stays."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, ThreeModel, TransferFunction, simulate

DT = 8e-4
SLOW, FAST = [1.0, 7.0, 280.0], [1.0, 15.5, 480.6**2]
BENCH = TransferFunction([205.0, 8000.0, 2.37e7], np.polymul(FAST, SLOW))


def disturbed(seed):
    """A multisine on a two-mass bench, and a slow disturbance several times its response."""
    rng = np.random.default_rng(seed)
    t = np.arange(1000) * DT
    lines = np.arange(11, 251)
    phases = rng.uniform(0.0, 2 * np.pi, lines.size)
    u = np.cos(2 * np.pi * np.outer(t, lines) + phases).sum(axis=1) / 15
    y = simulate(BENCH, Record(u, u, dt=DT, intersample="band-limited"))[:, 0]
    size = 3.0 * np.std(y)
    walk = np.cumsum(np.cumsum(rng.standard_normal(t.size)))
    slow = 0.05 * walk / np.std(walk) + np.sin(14.4 * t) + 0.5 * np.exp(-15.0 * t)
    noise = 0.01 * np.std(y) * rng.standard_normal(t.size)
    return Record(u, y + size * slow + noise, dt=DT, intersample="band-limited")


@pytest.mark.slow
def test_the_resonance_is_found_that_a_slow_disturbance_hides():
    estimate = ThreeModel().estimate([disturbed(0)], Structure(4, 2))
    fastest = estimate.model.poles[np.argmax(estimate.model.poles.imag)]
    assert abs(fastest - np.roots(FAST)[0]) < 2.0
    b2 = estimate.parameters["b2"]
    assert abs(b2.value - 205.0) < 4.0 * b2.std
    assert b2.std < 0.02 * 205.0
