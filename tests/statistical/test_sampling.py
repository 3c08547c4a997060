"""Jitter and delay over many noise draws: bias, RMSE over the Cramer-Rao bound, coverage.

The bound comes from differences of exact simulations, not from the package's Jacobian.
"""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate
from tridentify.estimation.methods.output_error import OutputError
from tridentify.estimation.methods.three_model import ThreeModel

pytestmark = [pytest.mark.slow, pytest.mark.unjudged(always=True)]
TRUTH = np.array([1.0, 3.0, 0.2, 0.5])
DELAY, N, DRAWS = 0.237, 300, 100


def model(theta):
    return TransferFunction(theta[2:], [1.0, *theta[:2]], delay=DELAY)


def experiment(intersample):
    rng = np.random.default_rng(11)
    t = np.concatenate([[0.0], np.cumsum(0.1 * rng.uniform(0.4, 1.6, N - 1))])
    u = np.repeat(np.sign(rng.standard_normal(N)), 5)[:N]
    return Record(u, u, t=t, intersample=intersample)


def bound(record, sigma):
    """Standard deviations of an efficient estimate, start at rest."""
    steps = 1e-5 * np.eye(4)
    columns = [
        (simulate(model(TRUTH + h), record) - simulate(model(TRUTH - h), record))[:, 0] / 2e-5
        for h in steps
    ]
    j = np.stack(columns, axis=1)
    return sigma * np.sqrt(np.diag(np.linalg.inv(j.T @ j)))


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.parametrize(
    "method", [ThreeModel(noise="white"), OutputError()], ids=["ThreeModel", "OutputError"]
)
def test_jitter_and_delay_at_the_bound(method, intersample):
    record = experiment(intersample)
    clean = simulate(model(TRUTH), record)
    sigma = 0.1 * float(clean.std())
    structure = Structure(2, 1, delay=DELAY, initial_state="rest", offset=False)
    found, std = [], []
    for seed in range(DRAWS):
        noise = sigma * np.random.default_rng(seed).standard_normal(clean.shape)
        noisy = Record(record.u, clean + noise, t=record.t, intersample=intersample)
        estimate = identify(noisy, structure, method)
        found.append(estimate.theta)
        std.append(estimate.std)
    off, std = np.array(found) - TRUTH, np.array(std)
    best = bound(record, sigma)
    rmse = np.sqrt((off**2).mean(axis=0))
    assert np.all(np.abs(off.mean(axis=0)) < 3.5 * rmse / np.sqrt(DRAWS))
    assert np.all(rmse / best < 1.25)
    assert np.all(rmse / best > 0.8)
    coverage = (np.abs(off) < 1.96 * std).mean(axis=0)
    assert np.all(coverage > 0.87)
    assert std.mean(axis=0) == pytest.approx(best, rel=0.05)


def test_a_record_cut_from_flight_has_no_bias():
    """Free state, offset, unknown past, jitter and delay: errors as large as claimed."""
    rng = np.random.default_rng(12)
    t = np.concatenate([[0.0], np.cumsum(0.1 * rng.uniform(0.4, 1.6, N + 59))])
    u = np.repeat(np.sign(rng.standard_normal(N)), 5)[: N + 60] + 0.5
    clean = simulate(model(TRUTH), Record(u, u, t=t))[60:] + 2.0
    t, u = t[60:], u[60:]
    structure = Structure(2, 1, delay=DELAY, initial_state="free", offset=True)
    scaled = []
    for seed in range(DRAWS):
        noise = 0.03 * np.random.default_rng(seed).standard_normal(clean.shape)
        estimate = identify(Record(u, clean + noise, t=t), structure, ThreeModel(noise="white"))
        scaled.append((estimate.theta - TRUTH) / estimate.std)
    scaled = np.array(scaled)
    assert np.all(np.abs(scaled.mean(axis=0)) < 0.35)
    assert np.sqrt((scaled**2).mean(axis=0)) == pytest.approx(1.0, abs=0.2)
