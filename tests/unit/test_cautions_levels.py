"""Where an input moves little beside its level, trim and start decide, and the estimate says so."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import Record, Structure, TransferFunction, identify, simulate
from tridentify.judgement.cautions.levels import _standing

PLANT = TransferFunction([9.0], [1.0, 1.5, 9.0])
THETA = np.array([1.5, 9.0, 9.0])
SAYS = "moves little beside its level"


def at_rest(seed, n=125, dt=0.04):
    """A second of trim after a manoeuvre: the last oscillation fades, the input hardly moves."""
    rng = np.random.default_rng([seed, 7])
    moves = 0.02 * rng.standard_normal(n)
    t = dt * np.arange(n)
    y = simulate(PLANT, Record(moves, moves, dt=dt))[:, 0]
    y = y + 0.2 + 0.2 * np.exp(-0.75 * t) * np.cos(2.9 * t + seed)
    return Record(2.2 + moves, y + 0.05 * rng.standard_normal(n), dt=dt)


def moving(seed, n=400, dt=0.05):
    rng = np.random.default_rng([seed, 8])
    level = rng.uniform(3.0, 10.0)
    u = np.repeat(rng.choice([-1.0, 1.0], n // 8), 8)
    acts = u + (level if seed % 2 else 0.0)
    y = simulate(PLANT, Record(acts, u, dt=dt))[:, 0]
    return Record(u + level, y + 0.1 * rng.standard_normal(n), dt=dt)


def said(record):
    estimate = identify(record, Structure(2, 0), throw=False)
    return estimate, [one for one in estimate.findings if SAYS in one.message]


@pytest.mark.parametrize("seed", [0, 3, *(pytest.param(k, marks=pytest.mark.slow) for k in (5, 6))])
def test_a_record_at_rest_is_told_to_hang_on_its_trim(seed):
    estimate, told = said(at_rest(seed))
    # confident, and wrong: two levels pass for a gain
    assert np.max(np.abs(estimate.theta - THETA) / estimate.std) > 20.0
    (one,) = told
    assert one.matters
    assert "b0 from" in one.effect
    assert one.message.startswith("Input u ")


def test_the_input_that_stands_is_named_and_not_one_that_moves_or_never_does():
    rng = np.random.default_rng(1)
    feed = 10.0 + 1.3 * rng.standard_normal(200)
    steps = np.repeat([1.0, 0.0, 2.0, 0.0], 50)
    u = np.column_stack([steps, feed, np.full(200, 50.0)])
    record = Record(u, steps, dt=1.0, input_names=["base", "acid", "heater"])
    name, ratio = _standing(record)
    assert name == "acid"
    assert ratio == pytest.approx(10.0 / 1.3, rel=0.15)


def soon(seed):
    """One step soon after the start of a test, of two lags about a trim, and its static gain."""
    rng = np.random.default_rng(7000 * 2 + seed)
    n = int(rng.integers(200, 600))
    u = np.zeros(n)
    u[int(rng.integers(3, 25)) :] = 80.0
    slow = rng.uniform(15.0, 80.0)
    quick, gain = slow * rng.uniform(0.2, 0.5), rng.uniform(0.5, 2.0)
    plant = TransferFunction([gain], np.polymul([slow, 1.0], [quick, 1.0]))
    y = simulate(plant, Record(u, u, dt=1.0))[:, 0]
    size = rng.uniform(0.01, 0.05) * y.std()
    noise = lfilter([1.0], [1.0, -0.6], size * rng.standard_normal(n))
    return Record(u, y + noise + 20.0, dt=1.0), gain


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "warned"), [(20, True), (0, False)])
def test_a_step_soon_after_the_start_hangs_on_whether_it_began_at_rest(seed, warned):
    record, gain = soon(seed)
    estimate, told = said(record)
    assert any(one.matters for one in told) is warned
    assert (abs(estimate.model.dc_gain.item() / gain - 1.0) > 0.1) is warned


@pytest.mark.slow
def test_no_step_whose_gain_was_found_is_warned_of():
    wrong = []
    for seed in range(100, 130):
        record, gain = soon(seed)
        estimate, told = said(record)
        if any(one.matters for one in told):
            wrong.append(abs(estimate.model.dc_gain.item() / gain - 1.0))
    assert len(wrong) > 0
    assert min(wrong) > 0.1


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(k, marks=pytest.mark.slow) for k in (2, 3))])
def test_an_input_that_moves_about_its_level_is_not(seed):
    estimate, told = said(moving(seed))
    assert not told
    assert np.all(np.abs(estimate.theta - THETA) < 5.0 * estimate.std)


def test_what_is_stated_is_not_doubted():
    structure = Structure(2, 0, offset=True, initial_state="free")
    found = identify(at_rest(0), structure, throw=False).findings
    assert not [one for one in found if SAYS in one.message]
