"""A tone beside the response is named, and nothing that is random or driven passes for one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from oracles import by_modes
from tridentify import Record, Structure, advise, identify, validate
from tridentify.judgement.cautions.tones import mains, tone

NUM, DEN = np.array([30.0]), np.array([1.0, 6.0, 30.0])


def steps(rng, n):
    u, k = np.empty(n), 0
    while k < n:
        m = int(rng.integers(8, 50))
        u[k : k + m] = rng.uniform(-1.0, 1.0)
        k += m
    return u


def humming(seed, rate, size, colour=0.0):
    """A second-order plant under steps, with 50 Hz hum beside it."""
    rng = np.random.default_rng(seed)
    t = np.arange(600) / rate
    u = steps(rng, t.size)
    y = by_modes(NUM, DEN, u, 1.0 / rate)
    noise = lfilter([1.0], [1.0, -colour], rng.standard_normal(t.size))
    y = y + 0.03 * y.std() * noise / noise.std()
    return Record(u, y + size * y.std() * np.sin(2 * np.pi * 50.0 * t + seed), dt=1.0 / rate)


@pytest.mark.parametrize(
    ("seed", "rate", "seen"), [(1, 110.0, "50"), (2, 48.0, "2"), (3, 170.0, "50"), (4, 60.0, "10")]
)
@pytest.mark.fast("3-170.0-50")
def test_hum_is_named_with_the_frequency_at_which_it_appears(seed, rate, seen):
    estimate = identify(humming(seed, rate, 0.2), Structure(2, 0))
    (found,) = [one for one in estimate.findings if one.code == "tone"]
    assert found.severity == "note"  # a noise model takes it up
    assert float(found.message.split()[4]) == pytest.approx(float(seen), abs=0.1)
    assert "50 Hz mains" in found.message
    for name, value in (("a1", 6.0), ("a0", 30.0)):
        own = estimate.parameters[name]
        assert abs(own.value - value) < 4.0 * own.std


@pytest.mark.slow
def test_hum_is_told_by_validation_and_before_a_model_as_well():
    record = humming(5, 48.0, 0.3)
    checked = validate(identify(record, Structure(2, 0)), record)
    assert "tone" in [one.code for one in checked.findings]
    assert "tone" in [one.code for one in advise(record).findings]


@pytest.mark.parametrize("seed", [10, 11, 12])
@pytest.mark.parametrize("colour", [0.0, 0.9])
@pytest.mark.fast("*-10")
def test_a_right_model_is_told_of_no_tone(colour, seed):
    found = identify(humming(seed, 60.0, 0.0, colour), Structure(2, 0)).findings
    assert "tone" not in [one.code for one in found]


def test_random_series_have_no_tone():
    rng = np.random.default_rng(7)
    false = 0
    for _ in range(200):
        n = int(rng.integers(150, 1200))
        pole = rng.choice([0.0, 0.5, 0.95]) * np.exp(1j * rng.uniform(0.2, 2.8))
        noise = lfilter(
            [1.0], [1.0, -2.0 * pole.real, abs(pole) ** 2], rng.standard_normal(n + 500)
        )
        false += tone(noise[500:], steps(rng, n)[:, None], 0.01) is not None
    assert false == 0


def test_tones_are_found_through_noise_of_their_size_and_gaps():
    rng = np.random.default_rng(8)
    for _ in range(50):
        n, f = int(rng.integers(200, 1000)), rng.uniform(0.06, 0.48)
        left = rng.standard_normal(n) + 1.4 * np.sin(
            2 * np.pi * f * np.arange(n) + rng.uniform(0, 6)
        )
        left[rng.integers(0, n, n // 20)] = np.nan
        found = tone(left, steps(rng, n)[:, None], 1.0)
        assert found is not None
        assert found.frequency == pytest.approx(f, abs=0.5 / n)


def test_overtones_of_a_periodic_input_are_no_tone_from_outside():
    t = np.arange(800)
    u = np.sin(2 * np.pi * t / 40.0)
    left = 0.2 * u**3 + 0.02 * np.random.default_rng(9).standard_normal(800)
    assert tone(left, u[:, None], 0.01) is None


def test_slow_sampling_tells_nothing_of_mains():
    assert mains(0.2, 500, 1.0) == 0.0
    assert mains(10.0, 500, 1.0 / 70.0) == 60.0


def test_a_line_of_an_input_of_many_lines_is_no_tone():
    """What dry friction leaves of a drive that goes to and fro four times, among other lines."""
    for seed in range(6):
        rng = np.random.default_rng(300 + seed)
        n = 2400
        swings = 2.0 * np.pi * np.arange(n) / n
        u = sum(np.sin(line * swings + rng.uniform(0.0, 6.0)) for line in range(12, 56, 8))
        left = np.sin(12 * swings) + 0.3 * rng.standard_normal(n)
        assert tone(left, (u + 0.05 * rng.standard_normal(n))[:, None], 0.01) is None
