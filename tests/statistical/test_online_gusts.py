"""On-line estimators where noise is coloured, strong at times, slow, coarse or spiky. Slow.

The plant is a short period flown by doublets and 3-2-1-1s with pauses between them.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter

from tridentify import Record, Structure, TransferFunction, online, simulate

DT = 0.04
TRUTH = (3.0, 16.4, -8.0, -12.0)
N = 6000


def flown(u, gust, plants, when):
    """Pitch rate of ``(b1 p + b0) / (p^2 + a1 p + a0)``, whose coefficients step at a sample."""
    steps = []
    for a1, a0, b1, b0 in plants:
        rates = np.zeros((4, 4))
        rates[0], rates[1] = [-a1, 1.0, b1, 0.3 * b1], [-a0, 0.0, b0, b0]
        steps.append(expm(rates * DT))
    y, x = np.empty(u.size), np.zeros(2)
    for k in range(u.size):
        y[k] = x[0]
        x = (steps[k >= when] @ np.array([*x, u[k], gust[k]]))[:2]
    return y


def elevator(rng, n):
    u, k = np.zeros(n), 100
    while k < n - 80:
        size = rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.5)
        widths = (30, 20, 10, 10) if rng.random() < 0.3 else (12, 12)
        for j, width in enumerate(widths):
            u[k : k + width] = size * (-1) ** j
            k += width
        k += int(rng.integers(20, 140))
    return u


def first_order(rng, n, tau):
    keep = np.exp(-DT / tau)
    return lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], rng.standard_normal(n))


def second_order(rng, n, omega, damping):
    step = expm(np.array([[0.0, 1.0], [-(omega**2), -2.0 * damping * omega]]) * DT)
    made = lfilter([1.0, 0.5], np.poly(step), rng.standard_normal(n + 500))[500:]
    return made / made.std()


def strength(n):
    return 0.3 + 2.0 * np.abs(np.sin(2.0 * np.pi * np.arange(n) / 2500.0)) ** 3


GUSTS = {
    "gust at the input": lambda rng: 0.25 * first_order(rng, N, 1.5),
    "swinging gust at the input": lambda rng: 0.25 * second_order(rng, N, 1.2, 0.4),
    "gust that comes and goes": lambda rng: 0.2 * first_order(rng, N, 1.5) * strength(N),
}
DISTURBANCES = {
    "gust at the output": lambda rng: 0.3 * first_order(rng, N, 1.0),
    "swinging at the output": lambda rng: 0.3 * second_order(rng, N, 2.5, 0.2),
    "slow": lambda rng: 0.5 * first_order(rng, N, 30.0),
    "noise that comes and goes": lambda rng: 0.3 * first_order(rng, N, 0.3) * strength(N),
    "spikes": lambda rng: 5.0 * rng.standard_normal(N) * (rng.random(N) < 0.01),
}
KINDS = [*GUSTS, *DISTURBANCES, "coarse"]


def stream(kind, seed, second=TRUTH, when=N):
    rng = np.random.default_rng(seed)
    u, still = elevator(rng, N), np.zeros(N)
    size = flown(u, still, (TRUTH, TRUTH), N).std()
    gust = GUSTS[kind](rng) if kind in GUSTS else still
    y = flown(u, gust, (TRUTH, second), when)
    y = y + size * DISTURBANCES.get(kind, lambda rng: still)(rng)
    y = y + 0.03 * size * rng.standard_normal(N)
    if kind == "coarse":
        y = np.round(y / (0.15 * size)) * 0.15 * size
    return Record(u, y, dt=DT)


OTHERS = {
    "least squares": online.RecursiveLeastSquares(on_change="restart"),
    "kalman": online.Kalman(drift=0.002, on_change="restart"),
    "gradient": online.Gradient(),
}


def ended(record, method=None):
    return online.run(method or online.ThreeModel(), record, Structure(2, 1), every=1e9)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("kind", KINDS)
def test_a_plant_that_stays_is_not_said_to_change(kind):
    """And the standard errors hold, as far as six records of four coefficients can tell."""
    changes, errors = 0, []
    for seed in range(6):
        run = ended(stream(kind, seed))
        assert run.estimate is not None
        changes += len(run.state.changes)
        errors.append((run.estimate.theta - TRUTH) / run.estimate.std)
    print(kind, "changes", changes, "errors", np.sqrt(np.mean(np.square(errors), axis=0)).round(2))
    assert changes <= 1
    assert np.sqrt(np.mean(np.square(errors))) < 1.7
    assert np.max(np.abs(errors)) < 5.0


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("kind", KINDS)
def test_a_step_of_the_stiffness_by_a_third_is_found_all_the_same(kind):
    second = (TRUTH[0], 1.3 * TRUTH[1], *TRUTH[2:])
    found, early = 0, 0
    for seed in range(6):
        run = ended(stream(kind, seed, second, N // 2))
        assert run.estimate is not None
        changes = np.array(run.state.changes)
        # an alarm before the change may be confirmed by the samples after it
        early += int(np.sum(changes < N // 2 - 600))
        found += bool(np.any(changes >= N // 2 - 600))
    print(kind, "found", found, "early", early)
    assert found >= 4
    assert early <= 1


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("key", list(OTHERS))
@pytest.mark.parametrize("kind", KINDS)
def test_no_method_says_that_a_plant_changed_that_stays(kind, key):
    """Where it was noise that came and went, each alarm cost the answer its samples."""
    changes = 0
    for seed in range(3):
        run = ended(stream(kind, seed), OTHERS[key])
        assert run.estimate is not None
        changes += len(run.state.changes)
    assert changes <= 1


def just_begun(seed, n):
    """A lightly damped plant that a gust shakes at its own frequency, from the first sample on."""
    rng, dt = np.random.default_rng(seed), 0.05
    steps = n // 12 + 1
    u = np.repeat(rng.choice([-1.0, 1.0], steps) * rng.uniform(0.5, 1.5, steps), 12)[:n]
    gust = lfilter([1.0], [1.0, -np.exp(-dt / 1.5)], rng.standard_normal(n))
    gust *= 0.5 / gust.std()
    plant = TransferFunction([9.0], [1.0, 1.0, 9.0])
    y = simulate(plant, Record(u + gust, u, dt=dt))[:, 0]
    return Record(u, y + 0.02 * rng.standard_normal(n), dt=dt)


def changes_of(seeds, n):
    method, asked = online.ThreeModel(), Structure(2, 0)
    return [len(online.run(method, just_begun(seed, n), asked).state.changes) for seed in seeds]


def test_a_gust_soon_after_the_start_is_no_change():
    # the errors of so few samples are too small where they are made of blocks of scores
    assert sum(changes_of((21, 25), 600)) == 0


@pytest.mark.slow
def test_gusts_soon_after_the_start_are_seldom_changes():
    # 13 of these 48 before few samples were judged by an autoregression of their own, 4 with it
    told = [
        count > 0
        for count in (*changes_of(range(20, 44), 1000), *changes_of(range(880, 904), 1000))
    ]
    assert sum(told) <= 6
