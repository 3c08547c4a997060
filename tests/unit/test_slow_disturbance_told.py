"""A slow disturbance that the noise model takes for noise is told with the estimate."""

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import Record, Structure, TransferFunction, identify, simulate

MODEL = TransferFunction([4.0], [1.0, 1.2, 4.0])
N, DT = 700, 0.1


def record(seed: int, slow: float) -> Record:
    """Autoregressive noise of 0.05, and a random walk that ends as far as `slow`."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], N // 10), 10)
    clean = simulate(MODEL, Record(u, u, dt=DT))[:, 0]
    noise = 0.05 * lfilter([np.sqrt(1 - 0.49)], [1.0, -0.7], rng.standard_normal(N))
    walk = np.cumsum(rng.standard_normal(N)) / np.sqrt(N)
    return Record(u, clean + noise + slow * walk, dt=DT)


@pytest.mark.parametrize("seed", [3, pytest.param(4, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_a_random_walk_is_told(seed: int) -> None:
    estimate = identify(record(seed, 0.6), Structure(2, 0))
    assert "drift" in [one.code for one in estimate.findings if one.matters]
    # and it is no reason to distrust what does not hang on it
    assert np.all(np.abs(estimate.theta - [1.2, 4.0, 4.0]) < 4.0 * estimate.std)


def test_autoregressive_noise_is_none() -> None:
    estimate = identify(record(3, 0.0), Structure(2, 0))
    assert estimate.noise_model[0].size
    assert not [one for one in estimate.findings if one.matters]
