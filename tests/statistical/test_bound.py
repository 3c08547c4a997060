"""Many noise draws against the Cramer-Rao bound: bias, spread, coverage, failures.

The bound comes from finite differences of a simulation of its own. Slow; run by `make test-all`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.optimize import least_squares

from oracles import by_modes, register
from tridentify import IdentifiabilityError, Record, Structure, ThreeModel, identify

pytestmark = pytest.mark.unjudged(always=True)

DRAWS = 240


def respond(theta, n, u, dt):
    return by_modes(theta[n:], np.append(1.0, theta[:n]), u, dt)


def scores(theta, n, u, dt):
    columns = []
    for k in range(theta.size):
        step = np.zeros(theta.size)
        step[k] = 1e-5 * abs(theta[k])
        difference = respond(theta + step, n, u, dt) - respond(theta - step, n, u, dt)
        columns.append(difference / (2.0 * step[k]))
    return np.stack(columns, axis=1)


@dataclass(frozen=True)
class Benchmark:
    theta: tuple[float, ...]
    n: int
    u: np.ndarray
    dt: float
    snr: float
    options: tuple[tuple[str, object], ...]


AT_REST = (("offset", False), ("initial_state", "rest"))
BENCHMARKS = {
    "aircraft": Benchmark((1.0, 3.0, 0.5), 2, register(9, (9, 5), 1000, 8), 0.05, 10.0, AT_REST),
    "aircraft, decided by itself": Benchmark(
        (1.0, 3.0, 0.5), 2, register(9, (9, 5), 1000, 8), 0.05, 10.0, ()
    ),
    "rao-garnier": Benchmark(
        (5.0, 408.0, 416.0, 1600.0, -6400.0, 1600.0),
        4,
        register(10, (10, 7), 1000, 7),
        0.01,
        10.0,
        AT_REST,
    ),
}


@pytest.fixture(scope="module", params=list(BENCHMARKS))
def draws(request):
    """(benchmark, bound, estimates, standard errors); a draw that fails fails the test."""
    case = BENCHMARKS[request.param]
    theta = np.array(case.theta)
    clean = respond(theta, case.n, case.u, case.dt)
    sigma = np.std(clean) * 10 ** (-case.snr / 20)
    columns = scores(theta, case.n, case.u, case.dt)
    bound = sigma * np.sqrt(np.diag(np.linalg.inv(columns.T @ columns)))
    structure = Structure(case.n, theta.size - case.n - 1, **dict(case.options))
    values, errors = np.empty((2, DRAWS, theta.size))
    for k, seed in enumerate(np.random.SeedSequence(20).spawn(DRAWS)):
        y = clean + sigma * np.random.default_rng(seed).standard_normal(clean.size)
        estimate = identify(Record(case.u, y, dt=case.dt), structure)
        assert estimate.status.ok, f"draw {k}: {estimate.status}"
        values[k], errors[k] = estimate.theta, estimate.std
    return case, bound, values, errors


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_no_bias(draws):
    case, bound, values, _ = draws
    bias = values.mean(axis=0) - np.array(case.theta)
    # Beyond the sampling error: the second-order bias, of the order of relative variance.
    allowed = 3.0 * bound / np.sqrt(DRAWS)
    assert np.all(np.abs(bias) < allowed), bias / allowed


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_spread_reaches_the_bound(draws):
    case, bound, values, _ = draws
    rmse = np.sqrt(np.mean((values - np.array(case.theta)) ** 2, axis=0))
    sampling = 3.0 / np.sqrt(2.0 * DRAWS)
    assert np.all(rmse / bound < 1.1 + sampling), rmse / bound
    assert np.all(rmse / bound > 0.9 - sampling), rmse / bound


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_standard_errors_are_the_bound(draws):
    _, bound, _, errors = draws
    assert np.allclose(np.median(errors, axis=0), bound, rtol=0.1)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_intervals_cover(draws):
    case, _, values, errors = draws
    inside = np.abs(values - np.array(case.theta)) < 1.959963985 * errors
    # 92 to 98 percent, widened by what 240 draws of a coefficient can show by chance.
    assert 0.92 <= inside.mean() <= 0.98
    assert np.all(inside.mean(axis=0) >= 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / DRAWS))


# ------------------------------------------------------------------------------ random systems
def random_plant(rng, n, least_damping):
    """(theta, dt, n_samples) of a stable system sampled for its fastest and slowest mode."""
    poles = []
    while len(poles) < n - 1:
        omega = np.exp(rng.uniform(0.0, 2.5))
        damping = np.exp(rng.uniform(np.log(least_damping), -0.05))
        pole = omega * complex(-damping, np.sqrt(1.0 - damping**2))
        poles += [pole, pole.conjugate()]
    if len(poles) < n:
        poles.append(-np.exp(rng.uniform(-0.5, 2.0)))
    poles = np.array(poles)
    m = int(rng.integers(0, n))
    zeros = -np.exp(rng.uniform(0.0, 2.0, m)) * rng.choice([1.0, 1.0, -1.0], m)
    gain = np.prod(np.abs(poles)) / np.prod(np.abs(zeros))
    num = gain * np.poly(zeros) if m else np.array([gain])
    theta = np.concatenate([np.real(np.poly(poles))[1:], num])
    dt = 0.6 / np.max(np.abs(poles))
    n_samples = int(np.clip(8.0 / np.min(np.abs(poles.real)) / dt, 1000, 8000))
    return theta, dt, n_samples


def random_input(rng, n_samples):
    hold = int(rng.choice([2, 4, 8, 25]))
    values = rng.standard_normal(-(-n_samples // hold))
    values = np.sign(values) if rng.random() < 0.5 else values
    return np.repeat(values, hold)[:n_samples]


def relative_bound(theta, n, u, dt, sigma):
    columns = scores(theta, n, u, dt)
    lengths = np.linalg.norm(columns, axis=0)
    inverse = np.linalg.inv((columns / lengths).T @ (columns / lengths))
    return sigma * np.sqrt(np.diag(inverse)) / lengths / np.abs(theta)


@pytest.mark.slow
def test_random_systems_without_noise_come_back():
    """Orders 1 to 6, damping from 0.01, where rounding alone leaves ten digits."""
    failed, tried = [], 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(1, 7))
        theta, dt, n_samples = random_plant(rng, n, 0.01)
        u = random_input(rng, n_samples)
        y = respond(theta, n, u, dt)
        if not np.max(relative_bound(theta, n, u, dt, 1e-15 * np.std(y))) < 1e-10:
            continue
        tried += 1
        try:
            structure = Structure(n, theta.size - n - 1)
            estimate = identify(Record(u, y, dt=dt), structure, throw=False)
        except IdentifiabilityError as refusal:
            failed.append((seed, n, str(refusal)))
            continue
        error = np.max(np.abs(estimate.theta / theta - 1.0))
        if not (error < 1e-8 and estimate.status.ok):
            failed.append((seed, n, f"{error:.1e} {estimate.status.name}"))
    assert tried > 150
    assert not failed, f"{len(failed)} of {tried}: {failed}"


@pytest.mark.slow
def test_random_systems_with_noise_reach_the_lowest_cost():
    """20 and 5 dB; records whose bound is above half of a coefficient are not counted."""
    failed, tried = [], 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(2, 5))
        theta, dt, n_samples = random_plant(rng, n, 0.1)
        u = random_input(rng, n_samples)
        clean = respond(theta, n, u, dt)
        sigma = np.std(clean) * 10 ** (-rng.choice([20.0, 5.0]) / 20)
        if not np.all(relative_bound(theta, n, u, dt, sigma) < 0.5):
            continue
        tried += 1
        y = clean + sigma * rng.standard_normal(n_samples)
        structure = Structure(n, theta.size - n - 1, offset=False, initial_state="rest")
        # the lowest cost of white noise is asked for, not the posterior mean
        method = ThreeModel(noise="white", finish="likelihood")
        estimate = identify(Record(u, y, dt=dt), structure, method, throw=False)
        rival = least_squares(
            lambda x, y=y, n=n, u=u, dt=dt, theta=theta: y - respond(x * theta, n, u, dt),
            np.ones(theta.size),
        )
        error = y - respond(estimate.theta, n, u, dt)
        excess = error @ error / (2.0 * rival.cost) - 1.0
        if not (excess < 1e-6 and estimate.status.ok):
            failed.append((seed, n, f"{excess:.1e} {estimate.status.name}"))
    assert tried > 120
    # One in a hundred may end in another valley: the last iteration has no proof of being global.
    assert len(failed) <= tried // 100, f"{len(failed)} of {tried}: {failed}"
