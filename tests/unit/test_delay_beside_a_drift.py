"""A delay that is estimated along, behind a smooth input and beside a slow disturbance."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from tridentify import Record, Structure, identify

pytestmark = pytest.mark.unjudged

STEP, FINE = 0.1, 20
"""[s], and steps of the simulation in one of them."""


def beside_a_swing(seed: int, size: float, periods: float) -> tuple[Record, float, float]:
    """One lag behind dead time, simulated apart from the package: its pole [1/s] and delay [s]."""
    rng = np.random.default_rng([4051, seed])
    pole, late = rng.uniform(0.8, 3.5), int(rng.integers(4, 19))
    n = 300
    t = np.arange(n * FINE) * STEP / FINE
    u = signal.lsim(([1.0], [0.36, 0.84, 1.0]), np.repeat(rng.standard_normal(n), FINE), t)[1]
    moved = np.concatenate([np.zeros(late * FINE // 2), u])[: u.size]
    y = signal.lsim(([pole], [1.0, pole]), moved, t)[1][::FINE]
    swing = np.sin(2.0 * np.pi * periods * np.arange(n) / n + rng.uniform(0.0, 6.3))
    y = y + y.std() * (0.02 * rng.standard_normal(n) + size * swing)
    return Record(u[::FINE], y, dt=STEP, intersample="foh"), pole, late * STEP / 2.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8))
def test_the_drift_is_searched_beside(seed: int) -> None:
    """Without it the response is found where it looks like the swing, and no drift leads back."""
    record, pole, delay = beside_a_swing(seed, (0.5, 2.0)[seed % 2], (0.5, 1.6)[seed // 2 % 2])
    found = identify(record, Structure(1, 0, delay="free"))
    assert found.structure.drift_degree
    assert abs(found.parameters["delay"].value - delay) < 0.03
    assert abs(found.parameters["a0"].value - pole) < 4.0 * found.parameters["a0"].std
