"""Causes that lie in how a record was made: clocks, delays that vary, limits of a rate, units."""

import re

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from tridentify import Record, Structure, identify
from tridentify.estimation.likelihood.setup.nuisance import Nuisances
from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.sensors.breaks import break_rivals

FINE = 10
DT, A1, A0 = 0.1, 1.4, 4.0


def response(fine):
    """Of ``4 / (s^2 + 1.4 s + 4)`` at the samples."""
    b, a, _ = cont2discrete(([A0], [1.0, A1, A0]), DT / FINE, "zoh")
    return lfilter(b[0], a, fine)[::FINE]


def commanded(rng, n=600, hold=12):
    return np.repeat(rng.choice([-1.0, 1.0, 0.4], n // hold + 1), hold)[:n]


def noisy(rng, y):
    return y + 0.03 * np.std(y) * rng.standard_normal(y.size)


def later(fine, samples):
    """The input late by a number of samples that varies."""
    return fine[np.clip(np.arange(fine.size) - np.rint(samples * FINE).astype(int), 0, None)]


def with_delay_that_grows(rng):
    u = commanded(rng)
    fine = np.repeat(u, FINE)
    return u, noisy(rng, response(later(fine, np.linspace(1.0, 6.0, fine.size))))


def with_each_move_late(rng):
    u = commanded(rng, hold=20)
    fine, late = np.repeat(u, FINE), np.repeat(rng.uniform(0.0, 6.0, 30), 20 * FINE)
    return u, noisy(rng, response(later(fine, late)))


def with_rate_limit(rng):
    u = commanded(rng, hold=20)
    fine, place = np.repeat(u, FINE), float(u[0])
    for k, wanted in enumerate(fine):
        place += np.clip(wanted - place, -0.02, 0.02)
        fine[k] = place
    return u, noisy(rng, response(fine))


def with_output_early(rng):
    u = commanded(rng)
    y = response(np.repeat(u, FINE))
    return u, noisy(rng, np.append(y[2:], [y[-1], y[-1]]))


def with_degrees(rng):
    u = commanded(rng)
    y = noisy(rng, response(np.repeat(u, FINE)))
    y[250:] *= 180.0 / np.pi
    return u, y


def with_input_gain(rng):
    u = rng.choice([-1.0, 1.0, 0.4, -0.3], 51).repeat(12)[:600]
    y = noisy(rng, response(np.repeat(u, FINE)))
    u = u.copy()
    u[240:] *= 1.7
    return u, y


def with_output_level(rng):
    u = commanded(rng)
    y = noisy(rng, response(np.repeat(u, FINE)))
    y[250:] += 0.8
    return u, y


def with_input_level(rng):
    u = commanded(rng)
    y = noisy(rng, response(np.repeat(u, FINE)))
    u = u.copy()
    u[250:] += 0.5
    return u, y


def with_a_plug_turned_round(rng):
    u = commanded(rng)
    y = noisy(rng, response(np.repeat(u, FINE)))
    y[330:] *= -1.0
    return u, y


CASES = {
    "delay grows": (with_delay_that_grows, "varying", "delay that varies"),
    "each move late": (with_each_move_late, "varying", "delay is not the same throughout"),
    "rate limit": (with_rate_limit, "saturation", "no faster than at 2"),
    "output early": (with_output_early, "delay", "0.2 s (2 samples) before the input"),
    "degrees": (with_degrees, "channel-changes", "as from radians to degrees"),
    "input gain": (with_input_gain, "channel-changes", "u that changes its scale, to 1.7"),
    "output level": (with_output_level, "channel-changes", "y that changes its level, by 0."),
    "input level": (with_input_level, "channel-changes", "u that changes its level"),
}


@pytest.mark.parametrize("kind", CASES)
@pytest.mark.slow
def test_what_the_recording_did_is_named_first(kind):
    made, code, words = CASES[kind]
    u, y = made(np.random.default_rng(11))
    found = identify(Record(u, y, dt=DT), Structure(2, 0)).findings[0]
    assert found.code == code
    assert words in found.message
    if kind == "output level":
        (size,) = re.findall(r"by ([\d.]+), at", found.message)
        assert float(size) == pytest.approx(0.8, abs=0.02)


@pytest.mark.slow
def test_a_sign_that_changes_is_found_from_a_model_that_shows_nothing():
    u, y = with_a_plug_turned_round(np.random.default_rng(11))
    record = Record(u, y, dt=DT)
    rest, poles = Nuisances("free", offset=False, drift=False), np.array([-0.1 + 0.1j, -0.1 - 0.1j])
    present = Present.of([record], Structure(2, 0), np.zeros((1, 1)), rest, (np.zeros(0),), poles)
    found = break_rivals(present, [np.zeros((u.size, 1))])
    (scaled,) = (one for one in found if one.kind == "scale" and "channel y" in one.what)
    assert "to -0.99" in scaled.what or "to -1" in scaled.what
    assert scaled.times[0] == pytest.approx(33.0, abs=0.3)


def test_a_level_that_changes_is_named_first():
    u, y = (one[:300] for one in with_output_level(np.random.default_rng(11)))
    found = identify(Record(u, y, dt=DT), Structure(2, 0)).findings[0]
    assert found.code == "channel-changes"
    assert "y that changes its level, by 0." in found.message


@pytest.mark.slow
def test_the_instant_of_a_changed_unit_is_told():
    u, y = with_degrees(np.random.default_rng(12))
    found = identify(Record(u, y, dt=DT), Structure(2, 0)).findings[0]
    assert found.times == pytest.approx((25.0,), abs=2 * DT)


@pytest.mark.slow
def test_the_shift_that_is_advised_mends_an_early_output():
    u, y = with_output_early(np.random.default_rng(13))
    found = identify(Record(u, y, dt=DT), Structure(2, 0)).findings[0]
    assert "Record(u[2:], y[:-2], ...)" in found.remedy
    mended = identify(Record(u[2:], y[:-2], dt=DT), Structure(2, 0))
    assert not any(one.matters for one in mended.findings)
    assert np.all(np.abs(mended.theta - [A1, A0, A0]) < 4.0 * mended.std)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(30))
def test_right_records_are_none_of_these(seed):
    rng = np.random.default_rng([seed, 3])
    u = commanded(rng)
    late = int(rng.integers(0, 4))
    y = noisy(rng, response(later(np.repeat(u, FINE), np.full(u.size * FINE, late))))
    estimate = identify(Record(u, y, dt=DT), Structure(2, 0, delay=late * DT))
    assert not any(one.matters for one in estimate.findings)


@pytest.mark.slow
def test_noise_with_memory_in_a_short_record_is_no_slow_disturbance():
    told = 0
    for seed in range(8):
        rng = np.random.default_rng([seed, 4])
        u = commanded(rng, 220)
        noise = lfilter([1.0], [1.0, -0.88], rng.standard_normal(420))[200:]
        y = response(np.repeat(u, FINE))
        record = Record(u, y + 0.1 * np.std(y) * noise / np.std(noise), dt=DT)
        estimate = identify(record, Structure(2, 0))
        told += any(one.code == "drift" and one.matters for one in estimate.findings)
    assert told <= 1
