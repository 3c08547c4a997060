"""Plants that integrate, held by a hand against forces that nobody recorded.

Position over force, or tilt: two integrators, or one behind a lag, stated as such. A simulation of
them wanders off with the forces, and a small gain in noise of the loop's own colour explains such a
record nearly as well as the plant does.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from scipy.linalg import expm

from tridentify import Record, Structure, ThreeModel, identify, validate

STEP, PARTS = 0.1, 5


class Hand(NamedTuple):
    """How a hand follows ``y`` and its rate, and how much of it is its own."""

    level: float
    rate: float
    own: float


def held(seed: int, lag: float, hand: Hand) -> tuple[Record, dict[str, float], float]:
    """A record of a plant ``b0 / (s (s + lag))``, what is known of it, and ``b0``."""
    rng = np.random.default_rng([seed, 41])
    n, gain = int(rng.integers(400, 800)), float(rng.uniform(0.5, 5.0) * rng.choice([-1.0, 1.0]))
    block = np.array([[0.0, 1.0, 0.0], [0.0, -lag, gain], [0.0, 0.0, 0.0]])
    moved = expm(block * STEP / PARTS)
    a, b = moved[:2, :2], moved[:2, 2]
    force, colour = float(rng.uniform(0.05, 0.25)), float(rng.choice([0.0, 0.9]))
    x, w, answer, own, left = np.zeros(2), 0.0, 0.0, 0.0, 0
    u, y = np.zeros(n), np.zeros(n)
    for k in range(n):
        y[k] = x[0]
        if left == 0:
            own, left = float(rng.choice([-1.0, 1.0])) * hand.own, int(rng.integers(3, 25))
        left -= 1
        before = y[max(k - 1, 0)]
        wanted = -(hand.level * y[k] + hand.rate * (y[k] - before) / STEP) / gain
        answer += 0.4 * (wanted - answer)
        u[k] = answer + own + 0.02 * rng.standard_normal()
        for _ in range(PARTS):
            w = colour * w + np.sqrt(1.0 - colour**2) * rng.standard_normal()
            x = a @ x + b * (u[k] + force * w * (1.0 if colour else np.sqrt(PARTS)))
    y += 0.05 * np.std(np.diff(y)) * rng.standard_normal(n)
    known = {"a0": 0.0} if lag else {"a1": 0.0, "a0": 0.0}
    return Record(u, y, dt=STEP), known, gain


def misses(seed: int, lag: float, hand: Hand) -> float:
    """Errors by which ``b0`` misses."""
    record, known, gain = held(seed, lag, hand)
    found = identify(record, Structure(2, 0, fixed=known), ThreeModel(route="direct"))
    k = found.names.index("b0")
    return float(abs(found.theta[k] - gain) / found.std[k])


@pytest.mark.parametrize(
    ("lag", "hand"),
    [(0.0, Hand(0.6, 1.1, 0.0)), (2.0, Hand(0.8, 0.2, 0.0)), (0.0, Hand(0.6, 1.1, 0.15))],
    ids=["two integrators", "one behind a lag", "moved"],
)
@pytest.mark.slow
def test_what_a_record_hardly_tells_is_not_said_to_be_known(lag, hand):
    assert sum(misses(seed, lag, hand) > 3.5 for seed in range(3)) == 0


@pytest.mark.slow
def test_forces_that_are_integrated_twice_in_open_loop():
    missed = []
    for seed in range(3):
        record, known, gain = held(seed, 0.0, Hand(0.0, 0.0, 1.0))
        found = identify(record, Structure(2, 0, fixed=known))
        assert found.route == "open-loop"
        missed.append(abs(found.theta[2] - gain) / found.std[2])
        assert validate(found, record).tests
    assert max(missed) < 3.5
