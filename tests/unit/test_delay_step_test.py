"""A step test with a dead time: what the step excites is not left out."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate
from tridentify.estimation.likelihood.setup.held_past import at_rest, held_before

pytestmark = pytest.mark.unjudged

GAIN, LAG = 0.7, 60.0


def step_test(seed, rows, second=0.0, noise=0.12, count=400):
    """A first-order lag, perhaps a second one that is not in the model, behind a dead time."""
    rng = np.random.default_rng(seed)
    u = np.where(np.arange(count) < rows, 0.0, 50.0)
    delay = int(rng.integers(3, 15))
    den = np.polymul([LAG, 1.0], [second, 1.0]) if second else np.array([LAG, 1.0])
    y = simulate(TransferFunction([GAIN], den, delay=float(delay)), Record(u, u, dt=1.0))[:, 0]
    y = y + 27.5 + noise * rng.standard_normal(count)
    return Record(u, np.round(y, 3), dt=1.0), delay


def gain(estimate):
    return float(estimate.model.dc_gain[0, 0])


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "rows", "noise"), [(41, 5, 0.12), (42, 20, 0.12), (43, 5, 0.6)])
def test_gain_and_dead_time_of_a_plain_step_test(seed, rows, noise):
    record, delay = step_test(seed, rows, noise=noise)
    estimate = identify(record, Structure(1, 0, delay="free"))
    assert gain(estimate) == pytest.approx(GAIN, rel=0.03)
    assert estimate.parameters["delay"].value == pytest.approx(delay, abs=1.5)
    assert np.isfinite(estimate.predict(record)).all()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(50, 56))
@pytest.mark.parametrize("rows", [10, 20, 40])
def test_a_lag_that_is_not_in_the_model_does_not_hide_the_step(seed, rows):
    record, delay = step_test(seed, rows, second=15.0)
    estimate = identify(record, Structure(1, 0, delay="free"))
    assert gain(estimate) == pytest.approx(GAIN, rel=0.05)
    assert delay < estimate.parameters["delay"].value < delay + 22.0


@pytest.mark.parametrize(
    ("rests", "expected"),
    [
        ([20, 80], 60.0),
        ([30, 5, 5, 60], 30.0),
        ([60, 10, 30], 60.0),
        ([25, 25, 25, 25], 0.0),
        ([1, 2, 1, 3, 1, 1], 0.0),
    ],
    ids=["step", "doublet", "long rest", "square wave", "random"],
)
def test_how_long_an_input_was_held_before(rests, expected):
    u = np.repeat(np.arange(len(rests)) % 2 * 1.0, rests)[:, None]
    since = np.arange(u.size) * 1.0
    assert held_before(u, since) == expected
    assert held_before(u + 1.0, since) == 0.0
    assert held_before(np.hstack([u, np.ones_like(u)]), since) == 0.0
    assert held_before(np.hstack([u, np.zeros_like(u)]), since) == expected


@pytest.mark.slow
@pytest.mark.parametrize("rows", [10, 20])
def test_a_step_between_two_settings_is_seen_as_well(rows):
    record, delay = step_test(60 + rows, rows, second=15.0)
    moved = Record(record.u + 30.0, record.y, dt=1.0)
    estimate = identify(moved, Structure(1, 0, delay="free"))
    assert gain(estimate) == pytest.approx(GAIN, rel=0.05)
    assert delay < estimate.parameters["delay"].value < delay + 22.0
    assert estimate.structure.initial_state == "equilibrium"


def test_an_output_that_moves_at_first_is_not_at_rest():
    record, _ = step_test(70, 30)
    since = record.t - record.t[0]
    moved = Record(record.u + 30.0, record.y, dt=1.0)
    assert at_rest(moved, since, 40.0)
    assert at_rest(record, since, 40.0)
    falling = Record(moved.u, moved.y[:, 0] + 10.0 * np.exp(-since / LAG), dt=1.0)
    assert not at_rest(falling, since, 40.0)
    assert not at_rest(Record(np.roll(moved.u, -26), moved.y, dt=1.0), since, 40.0)
