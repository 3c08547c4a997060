"""A loop that is on the move when its record begins: the start is no noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from tridentify import Record, Structure, ThreeModel, TridentifyError

pytestmark = pytest.mark.unjudged
THETA = np.array([1.2, 4.0, 3.0])
N, STEP = 200, 0.1


def moving_loop(seed: int, start: tuple[float, float]) -> Record:
    """``3 / (s^2 + 1.2 s + 4)`` under a sampled PI controller, from a state of its own."""
    rng = np.random.default_rng(seed)
    whole = expm(np.array([[-1.2, -4.0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]) * STEP)
    r = np.repeat(rng.choice([-1.0, 1.0], N // 25), 25)
    x, total, u, y = np.array(start), 0.0, np.empty(N), np.empty(N)
    for k in range(N):
        y[k] = 3.0 * x[1] + 0.1 * rng.standard_normal()
        u[k] = 2.0 * (r[k] - y[k]) + total
        total += 2.0 * STEP * (r[k] - y[k])
        x = whole[:2, :2] @ x + whole[:2, 2] * u[k]
    return Record(u, y, dt=STEP, reference=r)


def errors(seeds: range) -> np.ndarray:
    found = []
    for seed in seeds:
        record = moving_loop(seed, (3.0, 2.0))
        try:
            one = ThreeModel(noise="white").estimate([record], Structure(2, 0))
        except TridentifyError:  # pragma: no cover - what it was about
            found.append(np.full(3, np.inf))
            continue
        assert one.status.ok, one.status
        found.append((one.theta - THETA) / one.std)
    return np.array(found)


@pytest.mark.slow
def test_a_start_that_moves_the_loop_is_no_noise() -> None:
    assert np.max(np.abs(errors(range(72, 73)))) < 4.0


@pytest.mark.slow
def test_errors_hold_where_the_start_moves_the_loop() -> None:
    z = errors(range(200, 240))
    assert np.max(np.abs(z)) < 5.0
    assert np.mean(np.abs(z) < 1.96) > 0.88
