"""Plants that are not stable, without a controller, in records that are short enough for it."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import tf2ss

from tridentify import Estimate, Record, Structure, ThreeModel, identify, validate
from tridentify.identify import search

CASES = {
    "one pole": ([1.0, -1.0], 3.0),
    "pendulum": ([1.0, 0.5, -1.5], 4.0),
    "growing oscillation": ([1.0, -0.6, 4.0], 6.0),
}


def released(den, duration, seed=1, noise=0.05, start=0.0, dt=0.02):
    """``2 / den`` driven by held steps, simulated state by state."""
    rng = np.random.default_rng(seed)
    n = round(duration / dt)
    u = np.repeat(rng.choice([-1.0, 1.0], n // 10), 10)
    a, b, c, _ = tf2ss([2.0], den)
    m = len(a)
    whole = expm(np.block([[a, b], [np.zeros((1, m + 1))]]) * dt)
    x, y = np.zeros(m), []
    x[-1] = start
    for push in u:
        y.append(float(c[0] @ x))
        x = whole[:m, :m] @ x + whole[:m, m] * push
    y = np.array(y)
    return Record(u, y + noise * y.std() * rng.standard_normal(u.size), dt=dt)


@pytest.mark.parametrize("key", list(CASES))
@pytest.mark.parametrize("start", [0.0, 0.5])
@pytest.mark.fast("0.5-growing oscillation")
def test_the_pole_is_found_and_said(key, start):
    den, duration = CASES[key]
    estimate = identify(released(den, duration, start=start), Structure(len(den) - 1, 0))
    truth = np.array([*den[1:], 2.0])
    assert estimate.status.ok
    assert estimate.route == "open-loop"
    assert np.all(np.abs(estimate.theta - truth) < 4.0 * estimate.std)
    assert estimate.model.poles.real.max() == pytest.approx(np.roots(den).real.max(), rel=0.1)
    told = {finding.code: finding for finding in estimate.findings}
    assert "grows in the record" in told["unstable"].message
    assert told["unstable"].severity == "note"
    assert estimate.fit[0] == pytest.approx(95.0, abs=1.5)


@pytest.mark.unjudged
@pytest.mark.parametrize("key", list(CASES))
@pytest.mark.slow
def test_without_noise_the_truth_is_found(key):
    den, duration = CASES[key]
    estimate = identify(released(den, duration, noise=0.0), Structure(len(den) - 1, 0))
    assert np.allclose(estimate.theta, [*den[1:], 2.0], rtol=1e-6)


@pytest.mark.unjudged
@pytest.mark.slow
def test_several_experiments_of_one_plant():
    den, duration = CASES["pendulum"]
    records = [released(den, duration, seed=seed) for seed in (1, 2)]
    alone, together = (identify(one, Structure(2, 0)) for one in (records[0], records))
    assert np.all(together.std < alone.std)
    assert np.all(np.abs(together.theta - [0.5, -1.5, 2.0]) < 4.0 * together.std)


@pytest.mark.unjudged
@pytest.mark.slow
def test_what_it_was_is_kept_in_the_file(tmp_path):
    estimate = identify(released(*CASES["one pole"]), Structure(1, 0))
    again = Estimate.load(estimate.save(tmp_path / "model.json"))
    assert again.loop.mirrored
    assert again.loop.sampling == estimate.loop.sampling
    assert again.theta.tolist() == estimate.theta.tolist()
    told = validate(again, released(*CASES["one pole"]))
    assert told.ok
    assert told.fit[0] == pytest.approx(estimate.fit[0], abs=1.0)


@pytest.mark.unjudged
@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 4, 6])
def test_no_polynomial_that_nobody_asked_for_stands_in_for_the_growth(seed):
    """An aircraft that falls away over 9 s: a stable plant beside a drift of degree four or more
    follows it as well, at a higher AICc."""
    den = [1.0, 2.0, -0.6]
    estimate = identify(released(den, 9.0, seed=seed, noise=0.02, dt=0.03), Structure(2, 0))
    assert estimate.structure.drift_degree == 0
    assert np.all(np.abs(estimate.theta - [*den[1:], 2.0]) < 4.0 * estimate.std)


@pytest.mark.unjudged
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.fast("0")
def test_a_slow_stable_plant_in_drifting_noise_stays_stable(seed):
    """An unstable mode with a free start could take up a drift: the record must ask for it."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], 20), 10)
    states = np.zeros(u.size)
    for k in range(1, u.size):
        states[k] = np.exp(-0.005) * states[k - 1] + 0.05 * u[k - 1]
    y = states + 0.02 * np.cumsum(rng.standard_normal(u.size))
    assert identify(Record(u, y, dt=0.05), Structure(1, 0)).model.is_stable


@pytest.mark.unjudged
def test_a_disturbance_that_grows_is_no_plant_that_does():
    """As good as the free response of a pole to the right of zero, but the input has no part."""
    rng = np.random.default_rng(19)
    u = np.repeat(rng.choice([-1.0, 1.0], 15), 10)
    states, at = [], 0.0
    for push in u:
        states.append(at)
        at = np.exp(-0.05) * at + (1.0 - np.exp(-0.05)) * push
    grown = 0.2 * np.exp(2.0 * np.arange(u.size) / u.size)
    y = states + grown + 0.01 * rng.standard_normal(u.size)
    assert identify(Record(u, y, dt=0.05), Structure(1, 0)).model.is_stable


@pytest.mark.slow
@pytest.mark.parametrize("seed", [38, 5])
def test_steps_to_and_fro_come_to_rest(seed):
    """The valleys of these records are so curved that whole steps hardly end.

    In the second one all starts look alike: what tells them apart must not be left out.
    """
    found = search(released(*CASES["pendulum"], seed=seed, noise=0.02), Structure(2, 0)).estimate
    assert found.model.poles.real.max() == pytest.approx(1.0, abs=0.1)
    assert np.all(np.abs(found.theta - [0.5, -1.5, 2.0]) < 3.0 * found.std)


@pytest.mark.slow
@pytest.mark.parametrize("key", list(CASES))
@pytest.mark.timeout(900)
def test_intervals_hold_the_truth(key):
    """On 60 draws: 95 % within three standard deviations of that count, and no bias.

    In one of them the pole may be missed.
    """
    den, duration = CASES[key]
    truth, method = np.array([*den[1:], 2.0]), ThreeModel(noise="white")
    errors = []
    for seed in range(60):
        record = released(den, duration, seed=seed, noise=0.02)
        found = search(record, Structure(len(den) - 1, 0), method).estimate
        if not found.model.is_stable:
            errors.append((found.theta - truth) / found.std)
    assert len(errors) >= 59
    errors = np.array(errors)
    held = np.mean(np.abs(errors) < 1.96, axis=0)
    assert np.all(np.abs(held - 0.95) < 3.0 * np.sqrt(0.95 * 0.05 / 60))
    assert np.all(np.abs(errors.mean(axis=0)) < 3.5 / np.sqrt(60))
