"""Inputs of levels that move between the samples, each time at a time of its own."""

from __future__ import annotations

import numpy as np
import pytest

from oracles import by_modes
from tridentify import Record, Structure, identify, validate
from tridentify.estimation.answer.decision import DecisionKind

pytestmark = pytest.mark.judged
FINE, DT, N = 20, 0.1, 200
LEVELS = np.array([0.0, 1.0, -1.0, 1.0, -1.0, 0.0])


def manoeuvre(seed, snr=25.0, *, own=True, intersample="auto"):
    """A 3-2-1-1 of a plant drawn at random, begun at times of its own or at the samples."""
    rng = np.random.default_rng([41, seed])
    frequency, damping = rng.uniform(2.0, 3.5), rng.uniform(0.3, 0.9)
    den = np.array([1.0, 2.0 * damping * frequency, frequency**2])
    num = np.array([rng.uniform(0.3, 2.0) * frequency, rng.uniform(1.0, 2.0) * frequency**2])
    apart = np.cumsum([20.0, *(np.array([36.0, 24.0, 12.0, 12.0]) / frequency)])  # [samples]
    moves = np.round((apart + rng.uniform(0.0, 1.0, 5)) * FINE) if own else np.ceil(apart) * FINE
    u = LEVELS[np.searchsorted(moves, np.arange(N * FINE), side="right")]
    y = by_modes(num, den, u, DT / FINE)[::FINE]
    y = y + 10.0 ** (-snr / 20.0) * np.std(y) * rng.standard_normal(N)
    early = np.ceil(moves / FINE) - moves / FINE
    truth = np.concatenate([den[1:], num])
    return Record(u[::FINE], y, dt=DT, intersample=intersample), truth, early


def is_timed(estimate):
    return bool(estimate.trace.about(DecisionKind.MOVES_TIMED))


def said_between(estimate):
    return [one for one in estimate.findings if one.code == "intersample" and one.matters]


@pytest.mark.slow
def test_with_little_noise_the_coefficients_are_those_of_the_plant():
    record, truth, _ = manoeuvre(1, snr=60.0)
    found = identify(record, Structure(2, 1))
    assert is_timed(found)
    np.testing.assert_allclose(found.theta, truth, rtol=5e-3)
    held = identify(record.between("zoh"), Structure(2, 1))
    assert np.abs(held.theta / truth - 1.0).max() > 0.03


def test_an_input_that_was_stated_as_held_is_told():
    estimate = identify(manoeuvre(2, intersample="zoh")[0], Structure(2, 1))
    (first, *_) = estimate.findings
    assert first.code == "intersample"
    assert first.matters
    assert "auto" in first.remedy


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3, 9))
def test_the_model_of_such_a_record_is_sound_on_it(seed):
    record, _, _ = manoeuvre(seed)
    estimate = identify(record, Structure(2, 1))
    assert is_timed(estimate)
    assert not said_between(estimate)
    verdict = validate(estimate, record)
    assert verdict.ok
    assert verdict.findings == () or not any(one.code == "intersample" for one in verdict.findings)


@pytest.mark.slow
def test_errors_beside_the_times_are_true():
    scores, timed = [], 0
    for seed in range(100, 140):
        record, truth, _ = manoeuvre(seed)
        estimate = identify(record, Structure(2, 1))
        timed += is_timed(estimate)
        scores.append((estimate.theta - truth) / estimate.std)
    scores = np.array(scores)
    assert timed >= 34
    assert np.mean(np.abs(scores) < 1.96) > 0.88
    assert np.sqrt(np.mean(scores**2)) < 1.5


@pytest.mark.slow
@pytest.mark.parametrize("intersample", ["auto", "zoh"])
def test_moves_at_the_samples_are_taken_for_such(intersample):
    timed, told = 0, 0
    for seed in range(200, 240):
        record = manoeuvre(seed, own=False, intersample=intersample)[0]
        estimate = identify(record, Structure(2, 1))
        timed += is_timed(estimate)
        told += bool(said_between(estimate))
    assert timed == 0
    assert told <= (4 if intersample == "auto" else 1)


def at_both_nodes(seed, n=300, dt=1e-3, fine=50):
    """A switched source behind two loaded low-pass filters, recorded at the node of each."""
    rng = np.random.default_rng([92, seed])
    source = np.repeat(rng.choice([-0.5, 0.5], n), int(rng.integers(8, 25)) * fine)[: n * fine]
    first, load = rng.uniform(700.0, 4000.0), rng.uniform(0.25, 2.0)
    second = 415.0 * rng.uniform(0.5, 1.5)
    u, y, h = np.empty(source.size), np.empty(source.size), dt / fine
    node = last = source[0]
    for k, pushed in enumerate(source):
        u[k], y[k] = node, last
        into = first * (pushed - node + load * (last - node))
        node, last = node + h * into, last + h * second * (node - last)
    seen = (0.002 * np.round(one[::fine] / 0.002 + 0.5 * rng.standard_normal(n)) for one in (u, y))
    return Record(*seen, dt=dt, intersample="zoh")


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.slow
def test_a_node_that_is_taken_as_held_is_no_clock_that_is_early(seed):
    found = identify(at_both_nodes(seed), Structure(1, 0), throw=False).findings
    assert found[0].code == "intersample"
    assert all(one.code != "delay" for one in found if one.matters)
