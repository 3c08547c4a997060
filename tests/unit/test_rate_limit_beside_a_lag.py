"""An actuator at the limit of its rate, where a further pole passes for it."""

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate, validate
from tridentify.judgement.causes.sensors.saturation import following

DT = 0.02


def servo(seed: int, rate: float, n_samples: int = 800) -> Record:
    """A second-order plant behind an actuator of limited rate, whose demand is recorded."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1.5, 1.5, n_samples // 25), 25)
    fine = following(np.repeat(u, 10), 0.1 * rate * DT, held=False)
    plant = TransferFunction([36.0], [1.0, 8.4, 36.0])
    y = simulate(plant, Record(fine, fine, dt=0.1 * DT, intersample="zoh"))[::10, 0]
    return Record(u, y + 0.01 * rng.standard_normal(n_samples), dt=DT)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.slow
def test_it_is_named_beside_a_pole_that_passes_for_it(seed):
    record = servo(seed, np.random.default_rng(seed).uniform(3.0, 6.0))
    estimate = identify(record, Structure(3, 0), throw=False)
    for found in (estimate, validate(estimate, record)):
        first = next(one for one in found.findings if one.matters)
        assert first.code == "saturation"
        assert "rate" in first.message


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.fast("1")
def test_a_real_lag_is_none(seed):
    record = servo(seed, 1e6)
    assert not [one for one in identify(record, Structure(2, 0)).findings if one.matters]
