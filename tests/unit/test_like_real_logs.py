"""Simulations like logs of real plants: what is said of them is what is true of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import (
    Record,
    Structure,
    TransferFunction,
    advise,
    identify,
    simulate,
    validate,
)

FINE = 10
"""Steps of the simulation a sample."""


def held(rng, low, high, n, hold):
    return np.repeat(rng.uniform(low, high, n // hold + 1), hold)[:n]


def chamber(seed):
    """Heater to temperature in steps of 0.1 K, while the day goes by outside."""
    rng, dt, n = np.random.default_rng(seed), 10.0, 720
    u = np.repeat(rng.choice([10.0, 30.0, 50.0, 70.0], n // 40 + 1), 40)[:n]
    slow = fast = 0.5 * u[0]
    y = np.empty(n)
    for k in range(n):
        y[k] = fast
        for _ in range(FINE):
            slow += dt / FINE * (0.5 * u[k] - slow) / 600.0
            fast += dt / FINE * (slow - fast) / 60.0
    day = 1.5 * np.sin(2.0 * np.pi * np.arange(n) * dt / 14_000.0 + rng.uniform(0.0, 6.0))
    y = y + 21.0 + day + 0.03 * rng.standard_normal(n)
    return Record(u, np.round(y / 0.1) * 0.1, dt=dt, intersample="auto")


def drive(seed):
    """Voltage to the angle of an encoder, with dry friction."""
    rng, dt, n = np.random.default_rng(seed), 0.005, 600
    u = held(rng, -6.0, 6.0, n, 30)
    angle = speed = 0.0
    y = np.empty(n)
    for k in range(n):
        y[k] = angle
        for _ in range(FINE):
            speed += dt / FINE * (12.0 * (u[k] - 0.5 * np.tanh(speed / 0.2)) - speed) / 0.08
            angle += dt / FINE * speed
    step = 2.0 * np.pi / 2000.0
    return Record(u, np.round(y / step) * step, dt=dt, intersample="auto")


def tank(seed):
    """Pump to level; the sensor ends below the highest fifth."""
    rng, n = np.random.default_rng(seed), 600
    u = held(rng, 1.0, 5.0, n, 25)
    level, y = 3.0, np.empty(n)
    for k in range(n):
        y[k] = level
        for _ in range(FINE):
            level += 0.5 * 1.2 * (u[k] - np.sqrt(max(level, 0.0))) / 50.0
    y = np.minimum(y, np.quantile(y, 0.8)) + 0.02 * rng.standard_normal(n)
    return Record(u, y, dt=5.0, intersample="auto")


def serious(findings):
    return [one.code for one in findings if one.matters]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_coarse_thermometer_in_a_wandering_room_is_not_saturated(seed):
    found = identify(chamber(seed), Structure(2, 0), throw=False).findings
    assert "saturation" not in serious(found)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_drive_that_sticks_is_no_sensor_that_hangs(seed):
    record = drive(seed)
    found = serious(identify(record, Structure(2, 0, fixed={"a0": 0.0}), throw=False).findings)
    assert found[0] == "nonlinear"
    assert "stuck-sensor" not in found + serious(advise(record).findings)


@pytest.mark.slow
def test_an_encoder_that_hangs_is_still_told():
    record = drive(1)
    y = record.y.copy()
    y[300:340] = y[299]
    found = identify(
        record.with_outputs(y), Structure(2, 0, fixed={"a0": 0.0}), throw=False
    ).findings
    assert "stuck-sensor" in serious(found)
    (stuck,) = (one for one in found if one.code == "stuck-sensor")
    np.testing.assert_array_equal(stuck.times, record.t[299:340])


@pytest.mark.parametrize("seed", [4, 5, 6])
@pytest.mark.slow
def test_of_a_level_that_is_cut_off_the_limit_is_told_and_no_outliers(seed):
    found = serious(identify(tank(seed), Structure(1, 0), throw=False).findings)
    assert found[0] == "saturation"
    assert "bad-samples" not in found


def vehicle(seed):
    """Measured steering to yaw rate, whose sensor is 45 ms late."""
    rng, dt, n, fine = np.random.default_rng(seed), 0.02, 500, 10
    pole = np.exp(-2.0 * np.pi * dt / fine)
    u = lfilter([1.0 - pole], [1.0, -pole], rng.standard_normal(n * fine + 2000))
    u = lfilter([1.0 - pole], [1.0, -pole], u)[2000:]
    u *= 0.04 / u.std()
    grid = Record(u, u, dt=dt / fine, intersample="foh")
    y = simulate(TransferFunction([36.75, 245.0], [1.0, 8.4, 49.0], delay=0.045), grid)
    y, u = y[::fine, 0], u[::fine]
    y = y + 0.03 * y.std() * rng.standard_normal(n)
    return Record(u, y, dt=dt, intersample="auto")


@pytest.mark.slow
@pytest.mark.unjudged
def test_a_late_heater_is_no_further_pole_where_the_order_is_open():
    rng = np.random.default_rng(0)
    u = np.repeat(rng.choice([-1.0, 1.0], 30), 8)
    asked = Record(u, u, dt=0.1)
    y = simulate(TransferFunction([2.0], [1.0, 1.0], delay=0.5), asked)[:, 0]
    record = Record(u, y + 0.01 * rng.standard_normal(u.size), dt=0.1)
    found = identify(record, Structure.auto(max_poles=2), throw=False)
    assert (found.structure.poles, found.structure.zeros) == (1, 0)
    assert found.parameters["delay"].value == pytest.approx(0.5, abs=0.02)


@pytest.mark.slow
def test_a_late_sensor_is_no_further_pole_where_the_order_is_open():
    found = identify(vehicle(2), Structure.auto(max_poles=3), throw=False)
    assert (found.structure.poles, found.structure.zeros) == (2, 1)
    # what a smooth input does between its samples is worth half of one, 10 ms
    assert found.parameters["delay"].value == pytest.approx(0.045, abs=0.012)
    assert found.theta[:4] == pytest.approx([8.4, 49.0, 36.75, 245.0], rel=0.05)


def moved_by(levels, seed, n=800):
    """An input that is held for 8 to 34 samples."""
    rng = np.random.default_rng(seed)
    u = [np.repeat(rng.choice(levels), rng.integers(8, 35)) for _ in range(n // 8)]
    return np.concatenate(u)[:n], rng


def answered(acted, recorded, rng, name="y"):
    """What a damped mode answers to what acted, beside what was recorded."""
    plant = TransferFunction([15.0], [1.0, 3.0, 10.0])
    y = simulate(plant, Record(acted, np.zeros(acted.size), dt=0.05))[:, 0]
    y = y + 0.03 * y.std() * rng.standard_normal(y.size)
    return Record(recorded, y, dt=0.05, intersample="auto", output_names=[name])


@pytest.mark.parametrize("seed", [41, 42])
@pytest.mark.slow
def test_a_gain_that_moves_with_the_speed_is_no_sensor_that_changed(seed):
    u, rng = moved_by(np.linspace(-1.0, 1.0, 9), seed)
    turns, begins = rng.uniform(0.7, 1.2), rng.uniform(0.0, 6.0)
    gain = 1.0 + 0.25 * np.sin(2.0 * np.pi * turns * np.linspace(0.0, 1.0, u.size) + begins)
    (first, *_) = identify(answered(gain * u, u, rng), Structure(2, 0), throw=False).findings
    assert first.code == "varying"
    assert "a gain that moves over the record" in first.message


@pytest.mark.parametrize("seed", [51, 52])
@pytest.mark.slow
def test_a_limit_between_two_levels_of_a_command_is_told(seed):
    u, rng = moved_by(np.array([-12.0, -6.0, 0.0, 6.0, 12.0, 30.0]), seed)
    record = answered(np.minimum(u, 24.0), u, rng)
    (first, *_) = identify(record, Structure(2, 0), throw=False).findings
    assert first.code == "saturation"
    level = float(first.message.split("to a limit at ")[1].split()[0])
    assert level == pytest.approx(24.0, abs=1.0)


@pytest.mark.parametrize("name", ["level", "friction"])
@pytest.mark.slow
def test_what_a_channel_is_called_changes_nothing_that_is_found(name):
    u, rng = moved_by(np.linspace(0.0, 2.0, 9), 61)
    record = answered(u * np.abs(u), u, rng, name)
    estimate = identify(record, Structure(2, 0), throw=False)
    assert serious(estimate.findings)[0] == "nonlinear"
    assert serious(validate(estimate, record).findings)[0] == "nonlinear"


@pytest.mark.slow
@pytest.mark.parametrize("seed", [71, 72])
def test_commands_that_pass_a_network_each_later_or_earlier_are_no_bad_samples(seed):
    rng = np.random.default_rng(seed)
    fine, n = 20, 1200
    u = moved_by(np.array([-1.0, 0.0, 1.0, 2.0]), seed, n)[0]
    moves = np.concatenate([[0], np.flatnonzero(np.diff(u)) + 1])
    acted = np.empty(n * fine)
    for at, late in zip(moves, rng.integers(4, 24, moves.size), strict=True):
        acted[at * fine + late * (at > 0) :] = u[at]
    plant = TransferFunction([32.0], [1.0, 3.2, 16.0])
    y = simulate(plant, Record(acted, acted, dt=0.05 / fine))[::fine, 0]
    record = Record(u, y + 0.01 * rng.standard_normal(n), dt=0.05, intersample="auto")
    found = identify(record, Structure(2, 0, delay="free"), throw=False).findings
    assert found[0].code == "varying"
    assert "a delay of each move of the input of its own" in found[0].message


def test_a_heater_that_is_switched_beside_the_weather_is_held():
    rng = np.random.default_rng(81)
    n, fine = 400, 10
    heater = np.repeat(rng.choice([0.0, 6.0], n // 4), 4)
    weather = 5.0 * np.sin(2.0 * np.pi * np.arange(n) / 288.0)
    acted = np.stack([np.repeat(heater, fine), np.repeat(weather, fine)], axis=1)
    room = TransferFunction([[[0.4], [0.1]]], [[[1.0, 0.1], [1.0, 0.1]]])
    y = simulate(room, Record(acted, acted[:, 0], dt=1.0 / fine))[::fine, 0]
    y = y + 0.02 * rng.standard_normal(n)
    record = Record(np.stack([heater, weather], axis=1), y, dt=1.0, intersample="auto")
    assert record.behaviour == "zoh"
    estimate = identify(record, Structure(1, 0), throw=False)
    assert estimate.intersample == "zoh"
    assert estimate.parameters["a0"].value == pytest.approx(0.1, rel=0.05)
