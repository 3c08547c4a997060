"""Jumps of the state are told from shocks to the noise and from single bad samples."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify.judgement.causes.sensors.lost import Place, jumps
from tridentify.numerics.realization import cascade

NOISE = np.array([-1.5, 0.63])
STEP, DECAY = 9.0, -0.045
AT = 180


def looked_at(residual) -> list[Place]:
    bank = cascade(np.array([DECAY], dtype=complex))
    return jumps([residual[:, None]], [bank], [NOISE], STEP)


def noise(seed: int, shock: float = 0.0) -> np.ndarray:
    e = np.random.default_rng(seed).standard_normal(300)
    e[AT] += shock
    return lfilter([1.0], np.r_[1.0, NOISE], e)


@pytest.mark.parametrize("seed", range(8))
def test_a_shock_to_coloured_noise_is_no_lost_row(seed):
    assert looked_at(noise(seed, shock=9.0)) == []


@pytest.mark.parametrize("seed", range(8))
def test_a_state_that_jumps_is_found(seed):
    residual = noise(seed)
    residual[AT:] += 25.0 * np.exp(DECAY * STEP * np.arange(300 - AT))
    (found,) = looked_at(residual)
    assert abs(found.sample - AT) <= 1


def test_noise_alone_and_single_samples_are_none():
    assert not any(looked_at(noise(seed)) for seed in range(20))
    residual = noise(3)
    residual[[50, 120]] += 15.0
    assert looked_at(residual) == []
