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
