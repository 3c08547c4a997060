"""Noise that was recorded with an input and did not act; delays that are missing beside gusts."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from tridentify import Record, Structure, TransferFunction, identify, simulate
from tridentify.judgement.causes.sensors.input_floor import filtered, floor_of
from tridentify.judgement.causes.signals.levels_in_noise import (
    chance_of_noise,
    levels_of,
    stretches,
)

pytestmark = pytest.mark.judged

DT = 0.05
PLANT = TransferFunction([2.0, 8.0], [1.0, 1.6, 16.0])


def switched(rng, n, hold=6):
    return np.repeat(rng.choice([-1.0, 1.0], n // hold + 1), hold)[:n]


def response(u, model=PLANT, dt=DT, between="zoh"):
    return simulate(model, Record(u, np.zeros(u.size), dt=dt, intersample=between))[:, 0]


def noisy(y, rng, share=0.02):
    return y + share * np.std(y) * rng.standard_normal(y.size)


def told(record):
    findings = identify(record, Structure(2, 1), throw=False).findings
    return [one for one in findings if one.matters]


@pytest.mark.parametrize("size", [0.02, 0.2])
def test_levels_of_a_switched_input_are_found_in_its_noise(size):
    rng = np.random.default_rng(1)
    u = switched(rng, 600)
    recorded = u + size * rng.standard_normal(600)
    levels = levels_of(recorded)
    assert np.all(np.abs(levels - u) < 0.05)
    record = Record(recorded, noisy(response(u), rng), dt=DT)
    assert chance_of_noise(record, 0, levels) > 1e-3


def test_a_controller_at_levels_is_no_noise():
    rng = np.random.default_rng(2)
    y = rng.standard_normal(600)
    record = Record(switched(rng, 600) - 0.1 * y, y, dt=DT)
    assert chance_of_noise(record, 0, levels_of(record.u[:, 0])) < 1e-6


@pytest.mark.parametrize("kind", ["white", "walk", "sine", "exact"])
def test_other_inputs_stand_at_no_levels(kind):
    rng = np.random.default_rng(3)
    u = {
        "white": rng.standard_normal(500),
        "walk": np.cumsum(rng.standard_normal(500)),
        "sine": np.sin(0.2 * np.arange(500)) + 0.02 * rng.standard_normal(500),
        "exact": switched(rng, 500),
    }[kind]
    record = Record(u, rng.standard_normal(500), dt=DT)
    assert not stretches(u) or chance_of_noise(record, 0, levels_of(u)) < 1e-3


@pytest.mark.parametrize(
    ("seed", "size", "n"),
    [(0, 0.1, 200)]
    + [pytest.param(k, s, 300, marks=pytest.mark.slow) for k in (1, 2) for s in (0.05, 0.2)],
)
def test_noise_of_a_switched_input_is_named_first_and_alone(seed, size, n):
    rng = np.random.default_rng(seed)
    u = switched(rng, n)
    y = noisy(response(u), rng)
    found = told(Record(u + size * rng.standard_normal(n), y, dt=DT))
    assert [one.code for one in found] == ["input-noise"]
    assert 0.8 * size < float(found[0].message.split("noise of ")[1].split()[0]) < 1.2 * size
    assert "fit of y from" in found[0].effect


def smooth(rng, n, over=10):
    fine = lfilter(*butter(3, 1.5 * 2.0 * DT / over), 3.0 * rng.standard_normal(n * over))
    acts = np.append(0.5 * (fine[1:] + fine[:-1]), fine[-1])
    return fine[::over], response(acts, dt=DT / over)[::over]


def test_the_floor_of_a_smooth_input_is_its_noise():
    rng = np.random.default_rng(4)
    u, _ = smooth(rng, 800)
    size = 0.1 * float(np.std(u))
    found = floor_of(u + size * rng.standard_normal(800))
    assert found.size == pytest.approx(size, rel=0.15)
    assert floor_of(u).size < 0.2 * size
    assert floor_of(rng.standard_normal(800)).size == 0.0


def test_a_filter_of_ones_changes_nothing():
    x = np.cumsum(np.random.default_rng(5).standard_normal(101))
    assert np.allclose(filtered(x, np.ones(2)), x)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("acts", [False, True])
def test_noise_of_a_smooth_input_is_told_unless_it_acted(acts, seed):
    rng = np.random.default_rng(seed)
    u, y = smooth(rng, 800)
    noise = 0.25 * np.std(u) * rng.standard_normal(800)
    if acts:
        y = response(u + noise, between="band-limited")
    record = Record(u + noise, noisy(y, rng), dt=DT, intersample="band-limited")
    codes = [one.code for one in identify(record, Structure(2, 1)).findings]
    assert ("input-noise" in codes) is not acts


@pytest.mark.parametrize("seed", [3, pytest.param(4, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_noise_of_a_sweep_is_told_and_no_bend_is_seen_in_it(seed):
    rng = np.random.default_rng(seed)
    t = np.arange(400) * DT
    u = np.sin(2 * np.pi * (0.05 + 0.0375 * t) * t)  # to 1.5 Hz
    y = noisy(response(u, between="foh"), rng)
    noise = 0.15 * rng.standard_normal(t.size)
    assert told(Record(u, y, dt=DT, intersample="foh")) == []
    first = told(Record(u + noise, y, dt=DT, intersample="foh"))[0]
    assert (first.code, first.kind) == ("input-noise", "floor")
    assert "low-pass filter" in first.remedy


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "n"),
    [(1, 200), *((k, 500) for k in range(2, 6))],
)
def test_a_delay_beside_gusts_is_named_and_not_what_follows_them(seed, n):
    rng = np.random.default_rng(seed)
    forget = np.exp(-DT / 0.8)
    u = switched(rng, n)
    gust = lfilter([np.sqrt(1.0 - forget**2)], [1.0, -forget], rng.standard_normal(n + 200))[200:]
    late = TransferFunction(PLANT.num[0][0], PLANT.den[0][0], delay=0.12)
    record = Record(u, noisy(response(u, late) + response(0.3 * gust), rng), dt=DT)
    first = told(record)[0]
    assert first.code == "delay"
    assert first.remedy.startswith("Have it estimated (delay='free'")
    stated = float(first.remedy.split("delay=")[-1].split(";")[0])
    assert stated == pytest.approx(0.12, abs=0.01)
