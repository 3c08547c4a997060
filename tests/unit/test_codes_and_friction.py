"""What looks like a sensor that hung, rows that were lost or bad samples, and is something else."""

from __future__ import annotations

import numpy as np
import pytest

from oracles import by_modes
from tridentify import Record, Structure, identify
from tridentify.judgement.cautions.stuck import coded

NUM, DEN = np.array([12.0]), np.array([1.0, 3.0, 12.0])


def steps(rng, n, low, high):
    u, k = np.empty(n), 0
    while k < n:
        m = int(rng.integers(low, high))
        u[k : k + m] = rng.uniform(-1.0, 1.0)
        k += m
    return u


def plant(seed, n=600, dt=0.05):
    rng = np.random.default_rng(seed)
    u = steps(rng, n, 10, 40)
    y = by_modes(NUM, DEN, u, dt)
    return rng, u, y + 0.05 * y.std() * rng.standard_normal(n), dt


def codes(record, structure):
    return [one.code for one in identify(record, structure, throw=False).findings if one.matters]


@pytest.mark.parametrize(("seed", "code"), [(1, -999.0), (2, 9999.0), (3, -1e6)])
@pytest.mark.slow
def test_a_code_for_missing_values_is_told_first(seed, code):
    rng, u, y, dt = plant(seed)
    at = int(rng.integers(50, 450))
    y[at : at + int(rng.integers(4, 40))] = code
    found = identify(Record(u, y, dt=dt), Structure(2, 0), throw=False).findings
    assert "a code for missing values" in found[0].message
    assert found[0].times[0] == pytest.approx(at * dt)


def test_levels_and_steps_are_no_codes():
    assert coded(np.repeat([0.0, 1.0, 0.0, 1.0], 30), "y") is None
    rest = np.concatenate([np.zeros(60), 4.0 + np.sin(0.2 * np.arange(60))])
    assert coded(rest, "y") is None


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, 5, 6])
def test_where_a_sensor_hung_no_rows_were_lost(seed):
    rng, u, y, dt = plant(seed)
    at = int(rng.integers(100, 400))
    y[at : at + 40] = 0.0
    found = codes(Record(u, y, dt=dt), Structure(2, 0))
    assert found[0] == "stuck-sensor"
    assert "lost-rows" not in found


@pytest.mark.parametrize("seed", range(20, 24))
@pytest.mark.fast("21")
def test_a_coarse_slow_sensor_is_told_of_its_steps_alone(seed):
    rng = np.random.default_rng(seed)
    u = np.where(steps(rng, 600, 60, 150) > 0, 1.0, -1.0)
    u[:100] = -u[100]
    y = np.round(20.0 + by_modes(np.array([0.3]), np.array([1.0, 0.025]), u, 1.0))
    found = codes(Record(u, y, dt=1.0), Structure(1, 0))
    assert "quantisation" in found
    assert set(found) <= {"quantisation", "noise-model"}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [11, 13, 15])
def test_a_drive_that_friction_stops_has_no_sensor_that_hung(seed):
    rng = np.random.default_rng(seed)
    u = 6.0 * steps(rng, 500, 20, 60)
    position, speed, y = 0.0, 0.0, np.empty(500)
    for k in range(500):
        y[k] = position
        for _ in range(50):
            force = 1.5 * u[k] - 0.8 * speed
            if abs(speed) < 1e-3 and abs(force) < 1.4:
                speed = 0.0
                continue
            before = speed
            speed += 2e-4 / 0.1 * (force - 1.4 * np.sign(speed if abs(speed) > 1e-3 else force))
            speed = 0.0 if before * speed < 0 else speed
            position += 2e-4 * speed
    q = 2 * np.pi / 500
    found = identify(
        Record(u, q * np.round(y / q), dt=0.01), Structure(2, 0, fixed={"a0": 0.0}), throw=False
    ).findings
    assert "friction" in found[0].message
    assert "hung." not in " ".join(one.message for one in found)


def test_an_input_that_rests_at_nothing_is_not_cut_off():
    rng = np.random.default_rng(31)
    rain = np.where(rng.random(600) < 0.4, rng.exponential(3.0, 600), 0.0)
    y = by_modes(np.array([0.5]), np.array([1.0, 0.25]), rain, 1.0)
    y = y + 0.05 * y.std() * rng.standard_normal(600)
    assert "saturation" not in codes(Record(rain, y, dt=1.0), Structure(1, 0))
    measured = np.clip(rng.standard_normal(600), -0.8, 0.8)
    y = by_modes(np.array([0.5]), np.array([1.0, 0.25]), measured, 1.0)
    y += 0.01 * rng.standard_normal(600)
    assert "saturation" in codes(Record(measured, y, dt=1.0), Structure(1, 0))


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.slow
def test_an_encoder_of_a_drive_that_friction_stops_has_not_hung(seed):
    """It leaves standstill by several of its steps at once, and goes on from where it stood."""
    n, dt, gain, tau, step = 2000, 0.005, 2.0, 0.08, 2.0 * np.pi / 1000.0
    u = np.repeat(np.random.default_rng([seed, 7]).choice([-60.0, -30.0, 0.0, 30.0, 60.0], 80), 25)
    angle, speed, y = 0.0, 0.0, np.empty(n)
    for k in range(n):
        y[k] = step * round(angle / step)
        for _ in range(5):
            speed += dt / 5 * (gain * u[k] - 6.0 * np.tanh(speed / 0.5) - speed) / tau
            angle += dt / 5 * speed
    found = codes(Record(u, y, dt=dt), Structure(2, 0, fixed={"a0": 0.0}))
    assert "stuck-sensor" not in found
    assert found[0] == "nonlinear"
