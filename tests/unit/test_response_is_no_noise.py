"""A response that the structure lacks: no model of the noise may swallow it."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, ThreeModel, TransferFunction, simulate

DT = 0.05


def stepped(plant, n_samples, noise, seed):
    """Two levels that change every half second, and noise of one pole (0: white)."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], n_samples // 10), 10)
    y = simulate(plant, Record(u, u, dt=DT))[:, 0]
    size, pole = noise
    v = np.zeros(n_samples)
    for k, e in enumerate(rng.standard_normal(n_samples)):
        v[k] = pole * v[k - 1] + size * np.std(y) * e
    return Record(u, y + v, dt=DT)


def whitened(estimate):
    return any(a.size for a in estimate.noise_model)


@pytest.mark.parametrize("n_samples", [250, 1000])
@pytest.mark.parametrize("poles", [1, 2])
@pytest.mark.fast("1-250", "2-250")
def test_a_missing_zero_is_not_taken_for_noise(poles, n_samples):
    plant = TransferFunction([1.0, 2.0], [1.0, 1.2, 4.0])
    record = stepped(plant, n_samples, (0.03, 0.0), 3)
    found = ThreeModel().estimate([record], Structure(poles, 0))
    white = ThreeModel(noise="white").estimate([record], Structure(poles, 0))
    assert not whitened(found)
    np.testing.assert_allclose(found.theta, white.theta, rtol=1e-9)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.fast("0")
def test_noise_of_a_right_model_is_noise(seed):
    plant = TransferFunction([1.0, 2.0], [1.0, 1.2, 4.0])
    record = stepped(plant, 600, (0.1, 0.9), seed)
    assert whitened(ThreeModel().estimate([record], Structure(2, 1)))


@pytest.mark.slow
def test_a_model_of_the_noise_that_is_asked_for_is_made():
    plant = TransferFunction([1.0, 2.0], [1.0, 1.2, 4.0])
    record = stepped(plant, 250, (0.03, 0.0), 3)
    assert whitened(ThreeModel(noise="ar").estimate([record], Structure(2, 0)))
