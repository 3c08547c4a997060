"""Robust losses over many records: intervals that hold, and what they cost on clean ones."""

from __future__ import annotations

import numpy as np
import pytest

from oracles import by_modes
from tridentify import Record, Structure, ThreeModel, identify

pytestmark = pytest.mark.unjudged(always=True)

DEN, NUM = np.array([1.0, 1.0, 3.0]), np.array([0.2, 0.5])
TRUTH = np.concatenate([DEN[1:], NUM])
DT = 0.05
DRAWS = 200
N_SAMPLES = 500


def respond(u):
    return by_modes(NUM, DEN, u, DT)


def noise_of(kind, rng):
    if kind == "student":
        return rng.standard_t(3, N_SAMPLES)
    if kind == "laplace":
        return rng.laplace(size=N_SAMPLES)
    share, one_sided = {"clean": (0.0, 0), "few": (0.05, 0), "many": (0.1, 0), "up": (0.1, 1)}[kind]
    noise = rng.standard_normal(N_SAMPLES)
    bad = rng.random(N_SAMPLES) < share
    sign = 1.0 if one_sided else rng.choice([-1.0, 1.0], bad.sum())
    noise[bad] += sign * rng.uniform(10.0, 50.0, bad.sum())
    return noise


def drawn(kind, method, seed=90):
    """Estimates (DRAWS, 4) and their standard errors; input and seeds are the same for all."""
    u = np.repeat(np.random.default_rng(seed).choice([-1.0, 1.0], N_SAMPLES // 10), 10)
    clean = respond(u)
    # an offset is there to take the mean of one-sided outliers
    structure = Structure(2, 1, offset=True, initial_state="rest")
    theta, std = np.empty((2, DRAWS, 4))
    for k, child in enumerate(np.random.SeedSequence(seed).spawn(DRAWS)):
        noise = 0.2 * clean.std() * noise_of(kind, np.random.default_rng(child))
        found = identify(Record(u, clean + noise, dt=DT), structure, method)
        theta[k], std[k] = found.theta, found.std
    return theta, std


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("loss", ["huber", "student"])
@pytest.mark.parametrize("kind", ["clean", "few", "many", "up", "student", "laplace"])
def test_intervals_hold(loss, kind):
    theta, std = drawn(kind, ThreeModel(loss=loss))
    covered = (np.abs(theta - TRUTH) < 1.96 * std).mean(axis=0)
    # three binomial standard errors of 200 draws for each of four coefficients
    assert np.all(np.abs(covered - 0.95) < 3.2 * np.sqrt(0.95 * 0.05 / DRAWS)), covered
    # and their mean, whose draws are not independent, within half of that
    assert abs(covered.mean() - 0.95) < 0.03, covered
    bias = (theta.mean(axis=0) - TRUTH) / theta.std(axis=0)
    assert np.all(np.abs(bias) < 0.25), bias


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_what_robustness_costs_on_clean_records():
    plain, _ = drawn("clean", ThreeModel(noise="white", finish="likelihood"))
    for loss, least in (("huber", 0.94), ("student", 0.97)):
        theta, _ = drawn("clean", ThreeModel(loss=loss))
        # the same draws: the two errors are nearly the same, their ratio is much sharper
        efficiency = np.var(plain, axis=0) / np.var(theta, axis=0)
        # the ratio's own standard error is about 3.5 %
        assert np.mean(efficiency) > least - 0.04, (loss, efficiency)
