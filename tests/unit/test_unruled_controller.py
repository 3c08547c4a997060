"""Controllers that leave no rule in the samples although they work on them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from tridentify import Record, Structure, ThreeModel
from tridentify.estimation.closed_loop.input_rule import InputRule, input_rule

pytestmark = pytest.mark.unjudged
N, STEP = 600, 0.1


def loop(seed: int, kind: str, a0: float = 4.0) -> Record:
    """``3 / (s^2 + 1.2 s + a0)`` under a sampled controller of a kind."""
    rng = np.random.default_rng(seed)
    whole = expm(np.array([[-1.2, -a0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]) * STEP)
    r = np.repeat(rng.choice([-1.0, 1.0], N // 25), 25)
    shake = np.repeat(rng.choice([-0.5, 0.5], N // 6), 6)
    aim = np.repeat(rng.standard_normal(N // 50), 50)
    x, total, u, y = np.zeros(2), 0.0, np.empty(N), np.empty(N)
    for k in range(N):
        y[k] = 3.0 * x[1] + 0.1 * rng.standard_normal()
        seen = 3.0 * x[1] + 0.1 * rng.standard_normal() if kind == "own sensor" else y[k]
        error = (aim if kind == "set point not recorded" else r)[k] - seen
        bent = np.sign(error) * max(abs(error) - 0.1, 0.0)
        by_error = bent + 0.5 * bent * abs(bent) if kind == "bent" else error
        u[k] = 2.0 * by_error + total + (shake[k] if kind == "set point not recorded" else 0.0)
        total += 0.3 * STEP * error
        x = whole[:2, :2] @ x + whole[:2, 2] * u[k]
    return Record(u, y, dt=STEP, reference=shake if kind == "set point not recorded" else r)


def test_no_rule_is_no_evidence_where_the_controller_is_bent_or_reads_another_sensor() -> None:
    for kind in ("bent", "own sensor"):
        assert input_rule([loop(3, kind)], 2) is InputRule.UNSEEN


def test_a_set_point_that_is_not_recorded_leaves_the_rule() -> None:
    for seed in (3, 4):
        assert input_rule([loop(seed, "set point not recorded")], 2) is InputRule.SAMPLED


def worst(seed: int, kind: str, a0: float = 4.0) -> float:
    one = ThreeModel(noise="white").estimate([loop(seed, kind, a0)], Structure(2, 0))
    return float(np.max(np.abs((one.theta - [1.2, a0, 3.0]) / one.std)))


@pytest.mark.slow
def test_errors_reach_the_truth_under_a_bent_controller() -> None:
    assert worst(3, "bent") < 4.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["bent", "own sensor", "set point not recorded"])
@pytest.mark.parametrize("a0", [4.0, 0.0])
def test_errors_reach_the_truth_whatever_the_controller_reads(kind: str, a0: float) -> None:
    assert max(worst(seed, kind, a0) for seed in range(20, 26)) < 4.5
