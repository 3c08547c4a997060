"""A disturbance that moves slowly over a record, estimated along as a polynomial in time."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from tridentify import Estimate, Record, Structure, identify, online, select_structure
from tridentify.errors import OptionError, UnsupportedError

pytestmark = pytest.mark.unjudged

SLOW, FAST, GAIN = 35.0, 4.0, 2.0


def of_a_tank(seed: int, wander: np.ndarray, noise: float = 1.0) -> Record:
    """Two lags moved in steps, simulated apart from the package, with a disturbance beside them."""
    rng = np.random.default_rng(seed)
    n = wander.size
    u = np.repeat(rng.uniform(-20.0, 20.0, n), rng.integers(30, 90, n))[:n]
    num, den, _ = signal.cont2discrete(([GAIN], np.polymul([SLOW, 1.0], [FAST, 1.0])), 1.0)
    y = signal.lfilter(np.ravel(num), den, u)
    return Record(u, y + wander + noise * rng.standard_normal(n), dt=1.0)


def swing(n: int, phase: float = 0.0) -> np.ndarray:
    return 8.0 * np.sin(2.0 * np.pi * np.arange(n) / (3.0 * n) + phase)


def error_of_gain(estimate: Estimate) -> float:
    gain = estimate.theta[2] / estimate.theta[1]
    slope = np.array([0.0, -gain, 1.0]) / estimate.theta[1]
    return float((gain - GAIN) / np.sqrt(slope @ estimate.cov @ slope))


def test_a_polynomial_that_is_known_comes_back() -> None:
    t = np.arange(200.0)
    record = of_a_tank(3, 1.0 + 0.02 * t - 1e-4 * t**2 + 2e-7 * t**3, noise=0.0)
    estimate = identify(record, Structure(2, 0, drift=3))
    a1, a0 = 1.0 / SLOW + 1.0 / FAST, 1.0 / (SLOW * FAST)
    np.testing.assert_allclose(estimate.theta, [a1, a0, GAIN * a0], rtol=1e-6)
    np.testing.assert_allclose(estimate.predict(record), record.y, atol=1e-6)


def test_a_degree_is_kept_in_files(tmp_path) -> None:
    record = of_a_tank(4, swing(300))
    estimate = identify(record, Structure(2, 0, drift=2))
    again = Estimate.load(estimate.save(tmp_path / "model.json"))
    assert again.structure.drift == 2
    np.testing.assert_array_equal(again.predict(record), estimate.predict(record))


@pytest.mark.parametrize("wrong", [-1, 11, 2.5, "often"])
def test_no_other_degree_is_taken(wrong: object) -> None:
    with pytest.raises(OptionError, match="drift"):
        Structure(2, 0, drift=wrong)  # type: ignore[arg-type]


def test_a_stream_takes_a_slope_at_most() -> None:
    with pytest.raises(UnsupportedError, match="slope at most"):
        online.ThreeModel().init(Structure(2, 0, drift=3), 1.0)


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_slow_swing_is_estimated_along(seed: int) -> None:
    estimate = identify(of_a_tank(seed, swing(600, seed)), Structure(2, 0))
    assert estimate.structure.drift_degree > 1
    assert any("slow disturbance" in one for one in estimate.notes())
    assert abs(error_of_gain(estimate)) < 3.5
    assert 0.9 < np.std(estimate.residual(of_a_tank(seed, swing(600, seed)))) < 1.1


@pytest.mark.slow
def test_gains_hold_beside_slow_swings() -> None:
    errors = [
        error_of_gain(identify(of_a_tank(s, swing(600, s)), Structure(2, 0))) for s in range(20, 40)
    ]
    assert np.sqrt(np.mean(np.square(errors))) < 1.5


@pytest.mark.slow
@pytest.mark.parametrize("memory", [0.0, 0.6, 0.9])
def test_noise_is_no_drift(memory: float) -> None:
    found = []
    for seed in range(10):
        rng = np.random.default_rng(seed + 100)
        noise = signal.lfilter([1.0], [1.0, -memory], 2.0 * rng.standard_normal(900))[300:]
        found.append(identify(of_a_tank(seed, noise), Structure(2, 0)).structure.drift_degree)
    assert found == [0] * 10


@pytest.mark.slow
def test_a_random_walk_is_left_to_the_noise_model() -> None:
    found = []
    for seed in range(10):
        walk = np.cumsum(np.random.default_rng(seed + 50).standard_normal(800))
        found.append(identify(of_a_tank(seed, walk), Structure(2, 0)).structure.drift_degree)
    assert found.count(0) >= 8


@pytest.mark.slow
@pytest.mark.parametrize("seed", [5, 6, 7])
def test_no_pole_is_bought_for_it(seed: int) -> None:
    found = select_structure(of_a_tank(seed, swing(700, seed))).recommended
    assert found is not None
    assert (found.structure.poles, found.structure.zeros) == (2, 0)
