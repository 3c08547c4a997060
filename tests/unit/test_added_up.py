"""What a plant adds up of noise between the samples of a continuous controller."""

from __future__ import annotations

import numpy as np
import pytest

from oracles import moving_noise_loop
from tridentify import Record, Structure, ThreeModel, identify
from tridentify.estimation.closed_loop.added_up import Series, added_up


def instruments(count, periods=3):
    t = np.arange(count)
    slow = np.column_stack([np.sin(2 * np.pi * periods * t / count), np.ones(count)])
    return np.linalg.qr(slow)[0]


def test_slow_noise_that_no_test_of_whiteness_shows_counts_where_the_instruments_are():
    rng, count = np.random.default_rng(1), 400
    shape = np.append(0.0, 0.96 ** np.arange(count - 1))
    noise = rng.standard_normal(count)
    drift = np.convolve(shape, 0.15 * rng.standard_normal(count))[:count]
    z = instruments(count)
    quiet, loud = (
        np.diag(added_up([Series(one - z @ (z.T @ one), z, z, shape, np.zeros(0))]))
        for one in (noise, noise + drift)
    )
    true = np.sum(np.abs(np.fft.rfft(shape, 2 * count)[:2]) ** 2) / 2 * 0.15**2
    assert np.all(quiet < 2.0)
    assert np.all(loud > 2.0 * quiet)
    assert np.all(loud < 3.0 * (1.0 + true))


def stated_of_a_sum(seed, noise, gain):
    """What slow instruments see of noise with a walk, stated, over what there is."""
    rng, count = np.random.default_rng(seed), 600
    shape = np.append(0.0, np.ones(count - 1))
    errors = rng.standard_normal(count)
    errors += gain * np.convolve(shape, rng.standard_normal(count))[:count]
    errors = np.convolve(errors, np.append(1.0, noise))[:count]
    z = instruments(count)
    own = Series(errors - z @ (z.T @ errors), z, z, shape, noise)
    added = np.array([np.convolve(one, shape)[:count] for one in z[::-1].T])
    white = np.array([np.convolve(one, np.append(1.0, noise))[:count] for one in z[::-1].T])
    seen = [np.convolve(one, np.append(1.0, noise))[:count] for one in added]
    there = np.sum(white**2, axis=1) + gain**2 * np.sum(np.square(seen), axis=1)
    return np.diag(added_up([own])) / there


@pytest.mark.parametrize(
    "noise", [pytest.param(np.zeros(0), marks=pytest.mark.slow), np.array([-0.2, -0.2])]
)
def test_a_walk_is_as_large_as_it_is_whatever_a_model_of_the_noise_took_of_it(noise):
    shares = np.array([stated_of_a_sum(seed, noise, 0.3) for seed in range(3)])
    middle = np.median(shares, axis=0)
    assert np.all((middle > 0.5) & (middle < 2.5))


def test_noise_that_is_held_has_no_part_that_is_added_up():
    shares = np.array([stated_of_a_sum(seed, np.zeros(0), 0.0) for seed in range(3)])
    assert np.median(shares[:, 0]) < 2.0


def record(seed, pole, gains=(3.0, 1.0), count=500, dt=0.05):
    """A plant ``1 / (s - pole)`` under a continuous PI controller, noise 20 times a sample."""
    rng = np.random.default_rng(seed)
    r = np.repeat(rng.choice([-1.0, 1.0], count // 20), 20)
    noise = 0.05 * rng.standard_normal((count, 20))
    u, y = moving_noise_loop(pole, gains, r, noise, dt)
    return Record(u, y, dt=dt, reference=r)


def scores(seed, pole):
    estimate = identify(record(seed, pole), Structure(1, 0), ThreeModel(controller="continuous"))
    return (estimate.theta - [-pole, 1.0]) / estimate.std


@pytest.mark.slow
@pytest.mark.parametrize("pole", [0.8, 0.0])
def test_a_plant_that_adds_up_noise_between_the_samples_is_as_far_off_as_is_said(pole):
    found = np.array([scores(seed, pole) for seed in range(12)])
    assert np.all(np.sqrt(np.mean(found**2, axis=0)) < 1.6)
    assert np.abs(found).max() < 4.0  # a stable plant, where a fit led astray, was seven off
