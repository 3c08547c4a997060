"""The input between its samples: compared by likelihood, told where it was stated wrongly."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import OutputError, Record, Structure, TransferFunction, identify, simulate
from tridentify.errors import NonUniformTimeError, OptionError
from tridentify.judgement.causes.attempts.intersample import behaviours, is_staircase

PLANT = TransferFunction([-7.0, -6.5], [1.0, 2.4, 6.3])
DT = 0.04


def elevator(rng, n=600, measured=True):
    """A 3-2-1-1 as a surface follows it, fast against the samples, or as it was commanded."""
    fine, rate = 20 * n, 20
    u = np.repeat(np.repeat([0, 1, -1, 1, -1, 0, 1, 0], [25, 75, 50, 25, 25, 100, 50, 250]), rate)
    u = np.resize(u, fine).astype(float)
    step = DT / rate
    if measured:
        pole = np.exp(-step / 0.05)
        u = lfilter([1 - pole], [1, -pole], u) + 0.2 * lfilter(
            [1 - pole], [1, -pole], np.repeat(rng.standard_normal(fine // 200), 200)
        )
    y = simulate(PLANT, Record(u, u, dt=step))[::rate, 0]
    return u[::rate], y


@pytest.mark.parametrize(("measured", "wanted"), [(True, "foh"), (False, "zoh")])
def test_auto_finds_what_the_input_did(measured, wanted):
    rng = np.random.default_rng(1)
    u, y = elevator(rng, measured=measured)
    record = Record(u, y + 0.02 * rng.standard_normal(y.size), dt=DT, intersample="auto")
    estimate = identify(record, Structure(2, 1))
    held = estimate.intersample
    assert held == wanted or (measured and held == "band-limited")
    assert any(line.startswith("input taken as") for line in estimate.trace.decisions)
    assert "intersample" not in [finding.code for finding in estimate.findings]
    error = np.abs(estimate.theta - [2.4, 6.3, -7.0, -6.5]) / estimate.std
    assert error.max() < 4.0


@pytest.mark.unjudged
def test_a_swept_sine_tells_in_its_second_half():
    plant, rate, dt, n = TransferFunction([1e6], [1.0, 3e3, 1e6]), 10, 5e-5, 10_000
    t, low, ratio = np.arange(rate * n) * dt / rate, 5.0, 300.0
    end = n * dt
    fine = np.sin(2.0 * np.pi * low * end / np.log(ratio) * ratio ** (t / end))
    y = simulate(plant, Record(fine, fine, dt=dt / rate))[::rate, 0]
    noise = 0.005 * np.random.default_rng(5).standard_normal(n)
    estimate = identify(Record(fine[::rate], y + noise, dt=dt, intersample="auto"), (2, 0))
    assert estimate.intersample != "zoh"
    assert estimate.theta == pytest.approx([3e3, 1e6, 1e6], rel=0.01)


@pytest.mark.slow
def test_a_measured_input_stated_as_held_is_told():
    rng = np.random.default_rng(2)
    u, y = elevator(rng)
    record = Record(u, y + 0.02 * rng.standard_normal(y.size), dt=DT)
    estimate = identify(record, Structure(2, 1))
    (finding,) = [f for f in estimate.findings if f.code == "intersample"]
    assert finding.matters
    assert "standard errors" in finding.effect
    better = identify(record.between("foh"), Structure(2, 1))
    assert better.fit[0] > estimate.fit[0]


@pytest.mark.slow
@pytest.mark.unjudged
def test_right_records_are_left_alone():
    rng = np.random.default_rng(3)
    for _ in range(10):
        u = np.repeat(rng.choice([-1.0, 1.0], 40), 6)
        y = simulate(PLANT, Record(u, u, dt=DT))[:, 0]
        y = y + 0.3 * rng.standard_normal(y.size)
        record = Record(u, y, dt=DT, intersample="auto")
        assert identify(record, Structure(2, 1), OutputError()).intersample == "zoh"


def test_the_guess_is_what_calculations_take():
    t = np.arange(50) * 0.1
    smooth = Record(np.sin(t), np.sin(t), dt=0.1, intersample="auto")
    staircase = Record(np.repeat([0.0, 1.0], 25), np.sin(t), dt=0.1, intersample="auto")
    noise = np.random.default_rng(0).standard_normal(50)
    assert (smooth.behaviour, staircase.behaviour) == ("foh", "zoh")
    assert Record(noise, noise, dt=0.1, intersample="auto").behaviour == "zoh"
    assert smooth.intersample == "auto"
    np.testing.assert_array_equal(simulate(PLANT, smooth), simulate(PLANT, smooth.between("foh")))
    assert is_staircase([staircase])
    assert not is_staircase([smooth])


def test_impossible_behaviours_are_refused():
    record = Record([0, 1, 1], [0, 1, 2], t=[0.0, 1.0, 3.0])
    with pytest.raises(NonUniformTimeError):
        record.between("band-limited")
    with pytest.raises(OptionError, match="auto"):
        record.between("linear")
    assert record.between("auto").settled("band-limited").intersample == "foh"


@pytest.mark.unjudged
def test_nothing_is_compared_where_nothing_moves():
    u = np.ones(200)
    y = simulate(PLANT, Record(u, u, dt=DT))[:, 0]
    y = y + 0.01 * np.random.default_rng(0).standard_normal(200)
    record = Record(u, y, dt=DT, intersample="auto")
    structure = Structure(2, 1, initial_state="rest", offset=False)
    estimate = identify(record, structure)
    assert behaviours(estimate, [record]) is None
    assert estimate.intersample == "zoh"
