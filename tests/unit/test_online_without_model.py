"""What is said where the samples so far give no model."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tridentify import Structure, online
from tridentify.online.asked import NotReadyError


def held_plant(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Input and output of ``y' = y + 2 u``, which a controller keeps from running away."""
    rng, dt, x = np.random.default_rng(0), 0.05, 0.0
    wanted = np.repeat(rng.choice([-1.0, 1.0], n // 20), 20)
    u, y = np.zeros((n, 1)), np.zeros((n, 1))
    for k in range(n):
        y[k] = x + 0.02 * rng.standard_normal()
        u[k] = 1.5 * (wanted[k] - y[k])
        x = math.exp(dt) * x + 2.0 * math.expm1(dt) * float(u[k, 0])
    return u, y


def test_what_may_be_in_the_way_is_said_after_many_samples() -> None:
    u, y = held_plant(240)
    method = online.ThreeModel()
    state = method.init(Structure(1, 0), 0.05)
    said = []
    for k in range(240):
        state, _ = method.step(state, u[k], y[k])
        if k in (60, 239):
            with pytest.raises(NotReadyError) as refusal:
                method.estimate(state)
            said.append(str(refusal.value))
    assert "still searched" in said[0]
    assert "no stable model" in said[1]
    assert "reference=" in said[1]
