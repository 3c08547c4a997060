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


@pytest.mark.slow
def test_missing_samples_do_not_lead_the_bank_astray() -> None:
    rng = np.random.default_rng(42)
    u = np.repeat(rng.choice([-1.0, 1.0], 120), 20)[:700]
    y = simulate(PLANT, Record(u, u, dt=0.02))[:, 0] + 0.03 * rng.standard_normal(2400)[:700]
    y[300:310] = np.nan
    method = online.ThreeModel()
    state = method.init(Structure(2, 1), dt=0.02)
    for u_k, y_k in zip(u.tolist(), y.tolist(), strict=True):
        state, _ = method.step(state, u_k, y_k)
    estimate = method.estimate(state)
    assert np.all(np.abs(estimate.theta - (2.0, 9.0, 2.0, 3.0)) < 5.0 * estimate.std)
    assert np.max(estimate.std) < 0.5
