"""What the input does between its samples is asked of a candidate that explains the record."""

import numpy as np
import pytest

from tridentify import Record, TransferFunction, select_structure, simulate

FIRST, ANTI, SECOND = 12.0, 20.0, 34.0


def flexible_arm(seed: int) -> Record:
    """Two resonances with an anti-resonance between them; three poles explain half of it."""
    rng = np.random.default_rng(seed)
    n, dt = 256, 0.02
    den = np.polymul([1.0, 0.1 * FIRST, FIRST**2], [1.0, 0.1 * SECOND, SECOND**2])
    arm = TransferFunction(300.0 * np.array([1.0, 0.08 * ANTI, ANTI**2]), den)
    k = np.arange(1, 41)[:, None]
    phases = rng.uniform(0.0, 2.0 * np.pi, k.shape)
    u = np.sum(np.cos(2.0 * np.pi * k * np.arange(n) / n + phases), axis=0) / 10.0
    record = Record(u, np.zeros(n), dt=dt, intersample="band-limited")
    y = simulate(arm, record)[:, 0]
    y = y + 0.01 * np.std(y) * rng.standard_normal(n)
    return Record(u, y, dt=dt, intersample="auto")


@pytest.mark.slow
def test_the_likeliest_candidate_is_asked_too() -> None:
    found = select_structure(flexible_arm(1), [(3, 1), (4, 2)])
    assert found.recommended is not None
    assert found.recommended.label == "4, 2"
    assert "band-limited for all candidates, as 4, 2 says" in found.notes[0]


def steered(seed: int) -> Record:
    """Yaw rate of a car whose tyres saturate and whose speed falls, by its measured steering."""
    rng = np.random.default_rng(seed)
    n, fine, dt = 1500, 10, 0.02
    steer, k = np.zeros(n * fine), fine * 50
    while k < (n - 200) * fine:
        length = int(rng.integers(60, 150)) * fine
        swing = np.sin(2.0 * np.pi * np.arange(length) / length * rng.choice([1, 2]))
        steer[k : k + length] = rng.uniform(0.5, 1.5) * 0.03 * swing
        k += length + int(rng.integers(20, 80)) * fine
    slip, rate, found = 0.0, 0.0, np.empty(n)
    for k, angle in enumerate(steer):
        if k % fine == 0:
            found[k // fine] = rate
        speed = 25.0 - 3.0 * k / steer.size
        front, rear = angle - (slip + 1.2 * rate) / speed, -(slip - 1.5 * rate) / speed
        forces = [9e4 * one * (1.0 - 40.0 * one * one) for one in (front, rear)]
        slip += dt / fine * (sum(forces) / 1500.0 - speed * rate)
        rate += dt / fine * (1.2 * forces[0] - 1.5 * forces[1]) / 2500.0
    y = found + 0.004 * rng.standard_normal(n)
    return Record(steer[::fine] + 1e-4 * rng.standard_normal(n), y, dt=dt, intersample="auto")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [963, 321, 535])
def test_a_measured_input_is_not_held_since_another_order_would_have_it_so(seed: int) -> None:
    found = select_structure(steered(seed)).recommended
    assert found is not None
    assert found.label == "2, 1"
    assert found.estimate is not None
    assert found.estimate.intersample != "zoh"
