"""On-line, an early record whose model with all nuisance terms ends at a pole that is none."""

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, online, simulate
from tridentify.online.steps import distance_of

PLANT = TransferFunction([2.0, 3.0], [1.0, 2.0, 9.0])


@pytest.mark.parametrize("seed", [125, *(pytest.param(k, marks=pytest.mark.slow) for k in (3, 7))])
def test_estimates_stay_near_between_good_ones(seed: int) -> None:
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], 35), 20)
    clean = simulate(PLANT, Record(u, u, dt=0.02))[:, 0]
    y = clean + 0.03 * rng.standard_normal(700)
    method = online.ThreeModel()
    state = method.init(Structure(2, 1), dt=0.02)
    far = []
    for k, (u_k, y_k) in enumerate(zip(u[:231].tolist(), y.tolist(), strict=False)):
        state, _ = method.step(state, u_k, y_k)
        if k > 148 and k % 20 == 9 and not state.stage.searching:
            far.append(float(np.max(np.abs(method.estimate(state).theta / (2.0, 9.0, 2.0, 3.0)))))
    assert far
    assert max(far) < 2.0


def test_distance_is_relative_to_the_decay() -> None:
    bank = np.array([-2.0 + 1.0j, -2.0 - 1.0j])
    assert distance_of(bank - 1.0, bank) == pytest.approx(0.5)
