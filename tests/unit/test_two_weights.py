"""White weights and a model of the noise that lead to different coefficients."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import Record, Structure, ThreeModel
from tridentify.estimation.likelihood.noise.two_weights import IN_WORDS

pytestmark = pytest.mark.unjudged

DT, N = 2.0, 400


def heated(seed, third):
    """Two real poles, a third one of the stated gain, and surroundings that wander."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(2.0, 9.0, N // 20), 20)
    y = np.zeros(N)
    for rate, gain in ((0.02, 10.0), (0.002, 15.0), (0.12, third)):
        a = np.exp(-rate * DT)
        y += gain * lfilter([0.0, 1.0 - a], [1.0, -a], u - u[0])
    walk = np.cumsum(rng.standard_normal(N))
    y = y + 0.02 * y.std() * walk / walk.std()
    return Record(u, y + 0.005 * y.std() * rng.standard_normal(N), dt=DT)


def said(estimate):
    return [told for told in estimate.trace.decisions if IN_WORDS in told]


@pytest.mark.slow
def test_a_pole_that_is_missing_widens_the_errors():
    record = heated(0, 3.0)
    estimate = ThreeModel().estimate([record], Structure(2, 1))
    white = ThreeModel(noise="white").estimate([record], Structure(2, 1))
    assert len(said(estimate)) == 1
    assert estimate.errors == "scores"
    assert np.all(np.abs(white.theta - estimate.theta) < 2.001 * estimate.std)


@pytest.mark.slow
def test_the_draws_of_a_posterior_are_widened_as_well():
    estimate = ThreeModel().estimate([heated(3, 3.0)], Structure(2, 1))
    assert said(estimate)
    assert estimate.draws.std(axis=0) == pytest.approx(estimate.std, rel=0.5)


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
@pytest.mark.fast("0")
def test_a_right_structure_in_wandering_noise_keeps_its_errors(seed):
    estimate = ThreeModel().estimate([heated(seed, 0.0)], Structure(2, 1))
    assert estimate.noise_model[0].size
    assert not said(estimate)
