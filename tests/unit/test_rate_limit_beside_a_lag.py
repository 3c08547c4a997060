"""An actuator at the limit of its rate, where a further pole passes for it."""

import numpy as np
import pytest

from oracles import by_modes
from tridentify import Record, Structure, TransferFunction, identify, simulate, validate
from tridentify.judgement.causes.sensors.saturation import alike, following

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


def heater(seed, sizes=(80.0,)):
    """A heater of two lags and a delay, switched on after a while, and on to other levels."""
    rng = np.random.default_rng(seed)
    slow, fast = rng.uniform(80.0, 140.0), rng.uniform(10.0, 25.0)
    late, gain = int(rng.integers(0, 4)), rng.uniform(0.5, 0.9)
    u = np.concatenate([np.zeros(20), *(np.full(240, size) for size in sizes)])
    den = np.polymul([1.0, 1.0 / slow], [1.0, 1.0 / fast])
    acted = np.concatenate([np.zeros(late), u[: u.size - late]])
    y = by_modes(np.array([gain * den[-1]]), den, acted, 1.0) + coloured(rng, u.size, 0.12)
    return Record(u, 27.4 + 0.049 * np.round(y / 0.049), dt=1.0)


def coloured(rng, n_samples, size):
    noise = size * rng.standard_normal(n_samples)
    for k in range(1, n_samples):
        noise[k] += 0.5 * noise[k - 1]
    return noise


@pytest.mark.parametrize(
    "seed", [3, *(pytest.param(k, marks=pytest.mark.slow) for k in (20, 21, 22))]
)
@pytest.mark.slow
def test_one_step_of_two_lags_that_were_taken_for_a_lag_and_a_delay(seed):
    record = heater(seed)
    estimate = identify(record, Structure(1, 0, delay="free"))
    first = next(one for one in estimate.findings if one.matters)
    assert first.code == "order-low", first.message
    assert "beside a shorter delay" in first.message
    assert "the delay estimated again" in first.remedy
    better = identify(record, Structure(2, 0, delay="free"))
    assert better.parameters["delay"].value < 0.6 * estimate.parameters["delay"].value


def test_moves_of_one_size_and_of_others():
    assert alike(np.repeat([0.0, 80.0, 0.0], 100), 2.0)
    assert alike(np.repeat([0.0, 80.0], 100), 2.0)
    assert not alike(np.repeat([0.0, 80.0, 40.0], 100), 2.0)
    assert not alike(np.repeat([0.0, 80.0, 0.0], 30), 2.0)
