"""Poles of a loop, found from operators and put in their place."""

import numpy as np
import pytest

from oracles import continuous_loop
from tridentify import Record, Structure, ThreeModel, identify
from tridentify.estimation.closed_loop.driven import driven
from tridentify.estimation.closed_loop.own_poles import own_poles

PLANT = ([3.0], [1.0, 1.4, 4.0])
PI = (np.zeros((1, 1)), np.array([1.0]), np.array([1.0]), 1.5)
LOOP = np.roots([1.0, 1.4, 4.0 + 4.5, 3.0])  # s (s^2 + 1.4 s + 4) + 3 (1.5 s + 1)
DT = 0.05


def swinging(seed, n=400, noise=0.02):
    """A record of the loop, and its signals without noise."""
    rng = np.random.default_rng(seed)
    r = np.repeat(rng.choice([-1.0, 1.0], n // 15 + 1), 15)[:n]
    v = noise * rng.standard_normal(n)
    u, y = continuous_loop(PLANT, PI, r, v, DT)
    return Record(u, y, dt=DT, reference=r), continuous_loop(PLANT, PI, r, np.zeros(n), DT)


def test_a_loop_that_swings_is_described_by_its_own_poles():
    record, (u, _) = swinging(0)
    laguerre, own = driven(record), driven(record, between=True)
    wrong = [np.std(one.inputs[:, 0] - u) for one in (laguerre, own)]
    assert wrong[1] < 0.4 * wrong[0]
    assert own.order < laguerre.order


def test_the_poles_of_a_loop_without_noise_are_found():
    record, _ = swinging(1, noise=1e-6)
    part = driven(record, between=True)
    weights = part.weights[2:]
    found = own_poles(part.poles, weights / 1e-6, 3, record.duration, DT)
    np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(LOOP), rtol=0.02)


def test_operators_repeat_and_no_pair_is_torn():
    part = driven(swinging(0)[0], between=True)
    for order in range(1, 2 * part.order):
        poles = part.repeated(order)
        assert order <= poles.size <= order + 1
        assert abs(np.sum(poles.imag)) < 1e-12


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.slow
def test_a_swinging_loop_is_not_taken_for_a_sampled_one(seed):
    """Sixteen Laguerre functions leave a response that spoke against the right kind."""
    found = identify(swinging(seed)[0], Structure(2, 0), ThreeModel())
    away = np.abs(found.theta - [1.4, 4.0, 3.0]) / found.std
    assert away.max() < 4.0 or any(one.code == "intersample" for one in found.findings)


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 8))]
)
def test_nothing_follows_the_reference_in_a_swinging_loop(seed):
    record, _ = swinging(seed)
    stated = identify(record, Structure(2, 0), ThreeModel(controller="continuous"))
    assert not [one for one in stated.findings if one.matters]
    assert np.max(np.abs(stated.theta - [1.4, 4.0, 3.0]) / stated.std) < 4.0
