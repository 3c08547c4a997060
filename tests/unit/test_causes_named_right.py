"""Causes that pass for one another: play and friction, pulses and bends, drifts and levels."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter, lsim

from tridentify import Record, Structure, ThreeModel, TransferFunction, identify, simulate
from tridentify.judgement.causes.sensors.pulses import pulses
from tridentify.judgement.causes.system.backlash import play
from tridentify.judgement.cautions.stuck import without_spikes

pytestmark = pytest.mark.judged


def first_of(record, structure=None):
    found = identify(record, structure or Structure(2, 0)).findings
    return next((one for one in found if one.matters), None)


def driven(kind, seed, levels=()):
    """A servo with play behind it, play before it, dry friction, or nothing.

    Its input is at any level, or at some of a few.
    """
    rng = np.random.default_rng(seed)
    n, w, z = 800, rng.uniform(1.0, 8.0), rng.uniform(0.3, 1.2)
    dt = 2.0 * np.pi / w / rng.uniform(20.0, 40.0)
    held = rng.choice(levels, n // 16) if levels else rng.uniform(-1.0, 1.0, n // 16)
    u = np.repeat(held, 16)
    acts = play(u, np.array([0.15]), np.nan)[:, 0] if kind == "before" else u
    friction = 0.2 * w * w if kind == "friction" else 0.0
    y, place, speed, h = np.zeros(n), 0.0, 0.0, dt / 20.0
    for k in range(n):
        y[k] = place
        for _ in range(20):
            slope = w * w * (acts[k] - place) - 2.0 * z * w * speed
            slope -= friction * np.tanh(100.0 * speed / w)
            place, speed = place + h * (speed + 0.5 * h * slope), speed + h * slope
    if kind == "behind":
        y = play(y, np.array([0.06 * np.ptp(y)]), 0.0)[:, 0]
    return Record(u, y + 0.05 * np.std(y) * rng.standard_normal(n), dt=dt)


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("behind", "play of about"),
        ("before", "play or dry friction of"),
        ("friction", "dry friction"),
        ("nothing", ""),
    ],
)
@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(k, marks=pytest.mark.slow) for k in range(2, 6))]
)
@pytest.mark.slow
def test_play_is_told_from_friction(kind, said, seed):
    found = first_of(driven(kind, seed))
    if not said:
        assert found is None
    else:
        assert found.code == "nonlinear"
        assert said in found.message.split("The record hardly tells")[0]


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.slow
def test_play_before_three_levels_is_told(seed):
    right, found = (
        first_of(driven(kind, seed, (-1.0, 0.0, 1.0))) for kind in ("nothing", "before")
    )
    assert right is None
    assert found.code == "nonlinear"
    assert "play or dry friction of" in found.message


def scheduled(share, seed, n=320):
    """A lag of a second whose gain changes with the output, or does not."""
    rng = np.random.default_rng(seed)
    u, dt, h = np.repeat(rng.uniform(-1.0, 1.0, n // 8), 8), 0.15, 0.005
    y, here = np.empty(n), 0.0
    for k in range(n):
        y[k] = here
        for _ in range(round(dt / h)):
            here += h * (u[k] * (1.0 + share * here) - here)
    return Record(u, y + 0.05 * np.std(y) * rng.standard_normal(n), dt=dt)


@pytest.mark.parametrize("seed", range(1, 8))
@pytest.mark.slow
def test_a_gain_that_changes_with_the_output_is_told(seed):
    asked = Structure(1, 0, initial_state="rest", offset=False)
    found = first_of(scheduled(0.5, seed), asked)
    assert found.code == "nonlinear"
    assert "a gain of the input u that changes with the output y" in found.message
    assert first_of(scheduled(0.0, seed), asked) is None


def test_play_moves_only_what_it_touches():
    x = np.array([0.0, 1.0, 2.0, 1.8, 1.5, np.nan, 1.0, 2.5])
    found = play(x, np.array([0.0, 0.5]), 0.0)
    assert found[:, 0].tolist() == [0.0, 1.0, 2.0, 1.8, 1.5, 1.5, 1.0, 2.5]
    assert found[:, 1].tolist() == [0.0, 0.5, 1.5, 1.5, 1.5, 1.5, 1.5, 2.0]


def test_play_is_that_of_one_sample_after_the_other():
    rng = np.random.default_rng(3)
    x = np.cumsum(rng.standard_normal(500))
    x[rng.integers(0, 500, 20)] = np.nan
    widths = np.array([0.3, 2.0, 9.0])
    here, slowly = np.zeros(3), []
    for there in x:
        if np.isfinite(there):
            here = np.minimum(np.maximum(here, there - widths), there + widths)
        slowly.append(here)
    assert np.allclose(play(x, widths, 0.0), slowly)


def struck(seed, size=0.3, blows=5, seconds=3.0):
    """A mass on a spring struck by a hammer, whose force sensor has noise of its own."""
    rng = np.random.default_rng(seed)
    dt, over = 0.001, 10
    t = np.arange(0.0, seconds, dt / over)
    force = np.zeros(t.size)
    for k in range(blows):
        begin = seconds * (14.0 / 15.0) * k / blows + rng.uniform(0.05, 0.25)
        width, height = rng.uniform(0.004, 0.007), rng.uniform(100.0, 400.0)
        on = (t >= begin) & (t < begin + width)
        force[on] = height * np.sin(np.pi * (t[on] - begin) / width)
    y = lsim(([0.5], [1.0, 2.0, 2500.0]), force, t)[1][::over]
    u = force[::over] + size * rng.standard_normal(y.size)
    return Record(u, y + 2e-5 * rng.standard_normal(y.size), dt=dt, intersample="auto")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2, 3))])
def test_blows_of_a_hammer_are_no_bend(seed):
    codes = [one.code for one in identify(struck(seed), Structure(2, 0)).findings if one.matters]
    assert "nonlinear" not in codes
    assert codes[0] in ("input-noise", "intersample")


@pytest.mark.slow
def test_noise_of_an_input_at_rest_is_named():
    found = first_of(struck(1, size=1.0, blows=3, seconds=1.5))
    assert found.code == "input-noise"
    assert "stands still between its pulses" in found.message


@pytest.mark.slow
def test_a_bend_of_blows_is_still_named():
    rng = np.random.default_rng(5)
    u = np.zeros(1500)
    for k, height in enumerate(rng.uniform(1.0, 4.0, 14)):
        u[50 + 100 * k : 58 + 100 * k] = height
    acts = u + 0.3 * u**2
    y = simulate(TransferFunction([9.0], [1.0, 1.2, 9.0]), Record(acts, acts, dt=0.05))[:, 0]
    found = first_of(Record(u, y + 0.01 * np.std(y) * rng.standard_normal(1500), dt=0.05))
    assert found.code == "nonlinear"
    assert "even" in found.message


def test_steps_and_noise_are_no_pulses():
    rng = np.random.default_rng(0)
    assert pulses(np.repeat([0.0, 1.0, 0.0], 50)) == []
    assert pulses(rng.standard_normal(500)) == []


@pytest.mark.slow
def test_ambient_drift_of_an_oven_is_named_before_a_bend():
    """Two steps of the heater and a swing of the air around, slower than the record."""
    rng = np.random.default_rng(8)
    t = np.arange(0.0, 5400.0, 10.0)
    u = np.where(t < 300.0, 0.0, np.where(t < 2700.0, 40.0, 60.0))
    plant = TransferFunction([2.5 / 24000.0], [1.0, 1.0 / 600.0 + 1.0 / 40.0, 1.0 / 24000.0])
    y = simulate(plant, Record(u, u, dt=10.0))[:, 0] + 22.0
    y += 1.2 * np.sin(2.0 * np.pi * t / 14000.0) + 0.15 * rng.standard_normal(t.size)
    record = Record(u, np.round(y, 1), dt=10.0)
    found = identify(record, Structure(2, 0), ThreeModel(noise="ar")).findings[0]
    assert found.code == "drift"
    assert "Estimate a drift along" in found.remedy
    # where nothing is stated it is estimated along, and nothing is left to tell
    along = identify(record, Structure(2, 0))
    assert along.structure.drift_degree
    assert np.all(np.abs(along.theta - [*plant.den[0][0][1:], 2.5 / 24000.0]) < 4.0 * along.std)
    assert not [one for one in along.findings if one.matters]


def clipped(seed, spikes=4):
    """A sensor at its limits, and some samples that the transmission spoilt."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-2.0, 2.0, 30), 20)
    y = simulate(TransferFunction([6.0], [1.0, 1.4, 4.0]), Record(u, u, dt=0.05))[:, 0]
    y = np.clip(y + 1.0 + 0.03 * rng.standard_normal(600), -2.5, 2.5)
    y[rng.integers(0, 600, spikes)] += 9.0
    return Record(u, y, dt=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.parametrize("spikes", [1, 4])
def test_a_spike_makes_no_hung_sensor_of_a_limit(seed, spikes):
    codes = [
        one.code
        for one in identify(clipped(seed, spikes), Structure(2, 0)).findings
        if one.severity == "error"
    ]
    assert codes[0] == "saturation"
    assert "stuck-sensor" not in codes


def test_a_signal_has_no_spikes():
    y = np.sin(0.1 * np.arange(300.0))
    assert without_spikes(y) is y
    y[::7] += 5.0
    assert np.isfinite(without_spikes(y)).all()


def late(seed, joined, noise):
    """An input with a delay, joined by lines or held; taken as held and without a delay."""
    rng = np.random.default_rng(seed)
    n, w, fine = 700, 3.0, 10
    dt = 2.0 * np.pi / w / 20.0
    if joined:
        knots = lfilter([0.7], [1.0, -0.3], rng.standard_normal(n + 1))
        u = np.interp(np.arange(n * fine) / fine, np.arange(n + 1), knots)
    else:
        u = np.repeat(np.repeat(rng.choice([-1.0, 0.0, 1.0], n // 7), 7), fine)
    acts = np.concatenate([np.zeros(34), u])[: u.size]
    plant = TransferFunction([w * w], [1.0, w, w * w])
    y = simulate(plant, Record(acts, acts, dt=dt / fine))[::fine, 0]
    return Record(u[::fine], y + noise * np.std(y) * rng.standard_normal(n), dt=dt)


@pytest.mark.slow
def test_a_delay_and_another_behaviour_are_named_together():
    found = first_of(late(1, True, 0.004))
    assert found.code == "intersample"
    assert "foh) together with a delay" in found.message
    assert "intersample='foh'" in found.remedy
    assert "state the delay" in found.remedy


@pytest.mark.slow
def test_a_delay_alone_is_named_alone():
    found = first_of(late(1, False, 0.004))
    assert found.code == "delay"
    assert "together" not in found.message


@pytest.mark.slow
def test_what_the_record_does_not_tell_is_said():
    found = first_of(late(1, True, 0.1))
    assert found.code == "delay"
    assert "hardly tells it from an input that is" in found.message


@pytest.mark.parametrize(("zeros", "free"), [(0, True), (2, False)])
@pytest.mark.slow
def test_a_delay_is_to_be_estimated_only_where_it_can_be(zeros, free):
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform(-1.0, 1.0, 150), 4)
    plant = TransferFunction([0.8, 0.0, 0.0] if zeros else [4.0], [1.0, 1.2, 4.0])
    late = Record(np.r_[np.zeros(6), u[:-6]], np.zeros(600), dt=0.1, intersample="zoh")
    y = simulate(plant, late)
    record = Record(u, y + 0.02 * rng.standard_normal(y.shape), dt=0.1, intersample="zoh")
    found = first_of(record, Structure(2, zeros))
    assert found.code == "delay"
    assert ("delay='free'" in found.remedy) is free


@pytest.mark.slow
def test_small_moves_of_a_controller_are_no_noise_of_the_input():
    """A position loop whose set point steps now and then: spikes of the input, and feedback."""
    rng = np.random.default_rng(3)
    n, place, before = 600, np.zeros(2), 0.0
    wanted = np.repeat(rng.uniform(-1.0, 1.0, n // 100), 100)
    u, y = np.zeros(n), np.zeros(n)
    for k in range(n):
        y[k] = place[0] + 0.02 * rng.standard_normal()
        error = wanted[k] - y[k]
        u[k] = error + 4.0 * (error - before)
        before = error
        for _ in range(5):
            slope = 3.0 * u[k] - 4.0 * place[1]
            place = place + 0.02 * np.array([place[1], slope])
    record = Record(u, y, dt=0.1)
    codes = [one.code for one in identify(record, Structure(2, 0), throw=False).findings]
    assert "input-noise" not in codes
    assert not [one for one in codes if one == "nonlinear"]


def drive(gap, seed):
    """Motor speed of two masses whose coupling has a gap [rad], moved by steps of the torque."""
    rng = np.random.default_rng(seed)
    n, dt, parts = 1500, 0.002, 6
    stiff, damp, drag = rng.uniform(20.0, 40.0), 0.01, rng.uniform(0.003, 0.006)
    motor, load = 0.002, rng.uniform(0.003, 0.006)
    u = np.repeat(rng.choice([-1.0, -0.4, 0.4, 1.0], n // 50), 50)
    y, twist, one, other, h = np.zeros(n), 0.0, 0.0, 0.0, dt / parts
    for k in range(n):
        y[k] = one
        for _ in range(parts):
            beyond = twist - min(max(twist, -gap / 2), gap / 2)
            torque = stiff * beyond + (damp * (one - other) if beyond else 0.0)
            one += h * (u[k] - torque - drag * one) / motor
            other += h * (torque - drag * other) / load
            twist += h * (one - other)
    return Record(u, y + 0.3 * rng.standard_normal(n), dt=dt)


def bends_of(gap, seed):
    found = identify(drive(gap, seed), Structure(3, 2)).findings
    return [one for one in found if one.code == "nonlinear" and one.matters]


@pytest.mark.slow
def test_play_between_two_masses_shows_in_the_speed_of_one():
    assert not bends_of(0.0, 1)
    (told,) = bends_of(0.01, 1)
    assert "between its parts" in told.message
    assert "larger amplitudes" in told.remedy


@pytest.mark.slow
def test_play_between_two_masses_is_told_and_nearly_always_named():
    assert not any(bends_of(0.0, seed) for seed in range(2, 8))
    told = [bends_of(gap, seed) for gap in (0.005, 0.01) for seed in range(2, 8)]
    assert sum(map(bool, told)) >= 11
    assert sum("between its parts" in one[0].message for one in told if one) >= 10


@pytest.mark.parametrize(
    "seed", [11, *(pytest.param(k, marks=pytest.mark.slow) for k in range(12, 17))]
)
@pytest.mark.slow
def test_friction_of_a_motor_is_named_where_its_speed_is_recorded(seed):
    rng = np.random.default_rng(seed)
    n, dt, parts = 1000, 0.01, 10
    u = np.repeat(rng.uniform(-10.0, 10.0, n // 50), 50)
    rubs = rng.uniform(15.0, 60.0)
    y, speed = np.zeros(n), 0.0
    for k in range(n):
        y[k] = speed
        for _ in range(parts):
            speed += dt / parts * (50.0 * u[k] - 4.0 * speed - rubs * np.tanh(speed / 0.3))
    found = first_of(Record(u, y + 0.3 * rng.standard_normal(n), dt=dt), Structure(1, 0))
    assert found.code == "nonlinear"
    assert "dry friction against y" in found.message
    assert "larger amplitudes" in found.remedy


def battery(noise, seed):
    """Resistance, one time constant and the slope of the voltage at rest; pulses of current."""
    rng = np.random.default_rng(seed)
    n, k = 1500, 60
    current = np.zeros(n)
    while k < n - 200:
        length = int(rng.integers(20, 150))
        current[k : k + length] = rng.choice([10.0, 20.0, 40.0, -20.0])
        k += length + int(rng.integers(30, 150))
    plant = TransferFunction([-0.02, -0.0009, -2e-6 / 40.0], [1.0, 1.0 / 40.0, 0.0])
    y = simulate(plant, Record(current, current, dt=1.0))[:, 0] + 3.9
    seen = current + noise * rng.standard_normal(n)
    return Record(seen, np.round(y + 0.0008 * rng.standard_normal(n), 3), dt=1.0)


@pytest.mark.parametrize("fixed", [{}, {"a0": 0.0}])
@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(k, marks=pytest.mark.slow) for k in range(2, 7))]
)
@pytest.mark.slow
def test_noise_of_a_current_sensor_is_no_controller(seed, fixed):
    estimate = identify(battery(0.05, seed), Structure(2, 2, fixed=fixed), throw=False)
    assert estimate.status.ok
    assert estimate.route == "open-loop"
    codes = [one.code for one in estimate.findings]
    assert "feedback" not in codes
    assert "loop-not-excited" not in codes


def six_samples_late(seed):
    """A second-order system with a zero whose input acts six samples later than it is recorded."""
    rng = np.random.default_rng(seed)
    w, z = rng.uniform(1.0, 8.0), rng.uniform(0.2, 0.6)
    dt = 2.0 * np.pi / w / rng.uniform(25.0, 40.0)
    model = TransferFunction([rng.uniform(0.4, 1.0) * w, w * w], [1.0, 2.0 * z * w, w * w])
    u = np.repeat(rng.choice([-1.0, 1.0], 100), 6)
    clean = simulate(model, Record(np.roll(u, 6) * (np.arange(600) >= 6), 0.0 * u, dt=dt))[:, 0]
    return Record(u, clean + 0.05 * np.std(clean) * rng.standard_normal(600), dt=dt), 6 * dt


@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(k, marks=pytest.mark.slow) for k in range(2, 9))]
)
@pytest.mark.slow
def test_a_delay_is_found_that_a_numerator_makes_up_for(seed):
    record, delay = six_samples_late(seed)
    found = first_of(record, Structure(2, 1))
    assert found.code == "delay"
    (said,) = re.findall(r"delay=([\d.e-]+);", found.remedy)
    assert abs(float(said) - delay) < 0.1 * delay


def with_a_fast_pole(seed):
    """A resonance behind a lag of a third of its period, of which two poles see a delay."""
    rng = np.random.default_rng(seed)
    w, z = rng.uniform(1.0, 8.0), rng.uniform(0.2, 0.6)
    dt = 2.0 * np.pi / w / 40.0
    slow, fast = np.array([1.0, 2.0 * z * w, w * w]), np.array([1.0, 2.0 * w])
    model = TransferFunction([2.0 * w**3], np.polymul(slow, fast))
    u = np.repeat(rng.choice([-1.0, 1.0], 150), 8)
    clean = simulate(model, Record(u, 0.0 * u, dt=dt))[:, 0]
    return Record(u, clean + 0.1 * np.std(clean) * rng.standard_normal(u.size), dt=dt)


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(k, marks=pytest.mark.slow) for k in range(2, 9))]
)
def test_a_missing_pole_is_no_delay(seed):
    assert first_of(with_a_fast_pole(seed)).code == "order-low"


def fed_back(seed):
    """A proportional controller, sampled with the record, whose sensor is noisy."""
    rng = np.random.default_rng(seed)
    w, z = rng.uniform(1.0, 8.0), rng.uniform(0.2, 0.6)
    dt, n = 2.0 * np.pi / w / 30.0, 700
    (a, b), gain = discrete(w, z, dt), rng.uniform(0.8, 1.5)
    reference = np.repeat(rng.choice([-1.0, 1.0], n // 10), 10)
    noise = lfilter([0.7], [1.0, -0.7], 0.3 * rng.standard_normal(n))
    x, u, y = np.zeros(2), np.zeros(n), np.zeros(n)
    for k in range(n):
        y[k] = x[0] + noise[k]
        u[k] = reference[k] - gain * y[k]
        x = a @ x + b * u[k]
    return Record(u, y, dt=dt)


def discrete(w, z, dt):
    """Held, a resonance of gain one: its matrices in position and speed."""
    whole = np.zeros((3, 3))
    whole[:2] = [[0.0, 1.0, 0.0], [-w * w, -2.0 * z * w, w * w]]
    found = expm(whole * dt)
    return found[:2, :2], found[:2, 2]


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(k, marks=pytest.mark.slow) for k in range(2, 9))]
)
def test_a_fit_that_feedback_bends_makes_no_bad_samples(seed):
    estimate = identify(fed_back(seed), Structure(2, 0))
    assert "feedback" in [one.code for one in estimate.findings if one.matters]
    assert "bad-samples" not in [one.code for one in estimate.findings]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 5))
def test_a_spike_inside_a_loop_stays_a_bad_sample(seed):
    record = fed_back(seed)
    y = record.y[:, 0].copy()
    y[[200, 450]] += 3.0
    estimate = identify(Record(record.u, y, dt=record.dt), Structure(2, 0))
    assert "bad-samples" in [one.code for one in estimate.findings]


@pytest.mark.parametrize("seed", [41, *(pytest.param(k, marks=pytest.mark.slow) for k in (42, 44))])
@pytest.mark.slow
def test_one_step_of_three_lags_asked_as_two_poles_is_no_bend(seed):
    rng = np.random.default_rng(seed)
    u = np.where(np.arange(150) >= 20, 30.0, 0.0)
    plant = TransferFunction([2.7e-5], np.poly([-0.03] * 3))
    y = simulate(plant, Record(u, u, dt=5.0))[:, 0]
    found = identify(Record(u, 25.0 + y + 0.05 * rng.standard_normal(150), dt=5.0), (2, 0))
    assert found.findings[0].code == "order-low"


def dried(seed):
    """A hair dryer: two levels, a dead time, air that mixes on its way, and walls that warm up."""
    rng, n, dt, fine = np.random.default_rng([95, seed]), 500, 0.08, 8
    u = np.repeat(rng.choice([3.4, 6.4], n), rng.integers(2, 10, n))[:n]
    late = round(rng.uniform(0.07, 0.11) / dt * fine)
    v = np.concatenate([np.full(late, u[0]), np.repeat(u, fine)])[: n * fine] - u[0]
    air = np.polymul([1.0, 10.3, 27.3], [1.0 / rng.uniform(18.0, 30.0), 1.0])
    acts, y = Record(v, v, dt=dt / fine), 5.0 + 0.025 * rng.standard_normal(n)
    for part in (TransferFunction([24.9], air), TransferFunction([0.03], [1.0, 0.4])):
        y = y + simulate(part, acts)[::fine, 0]
    return Record(u, y, dt=dt)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_a_dead_time_behind_levels_is_no_input_joined_by_lines(seed):
    found = first_of(dried(seed), Structure(2, 1))
    assert found is not None
    assert found.code in ("delay", "order-low")
