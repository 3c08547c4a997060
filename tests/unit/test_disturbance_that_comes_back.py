"""What disturbs an output every day is no mode of the plant."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import Record, Structure, TransferFunction, identify, simulate
from tridentify.judgement.causes.system.periodic import comes_back

HOUR, DT = 3600.0, 900.0
ROOM = TransferFunction([4e-8, 2e-12], [1.0, 2.3e-4, 1.6e-9])


def room(seed: int) -> Record:
    """A week in a room: heated by night and day, the sun of each day as strong as it likes."""
    rng = np.random.default_rng(seed)
    t = np.arange(7 * 96) * DT
    heat = np.where((t / HOUR) % 24 > 6, 2500.0, 0.0)
    heat = heat + 1500.0 * np.repeat(rng.integers(0, 2, t.size // 6), 6)
    sun = np.clip(np.sin(2 * np.pi * (t / 86400 - 0.25)), 0.0, None)
    sun = sun * np.repeat(rng.uniform(300.0, 1500.0, 7), 96)
    weather = 40.0 * lfilter([1.0], [1.0, -0.99], rng.standard_normal(t.size + 500))[500:]
    both = Record(heat + sun + weather, heat, dt=DT)
    y = 18.0 + simulate(ROOM, both)[:, 0] + 0.05 * rng.standard_normal(t.size)
    return Record(heat, y, dt=DT, input_names=["heat"], output_names=["T"])


@pytest.mark.parametrize(
    ("seed", "said"),
    [(3, 1), *(pytest.param(k, k == 4, marks=pytest.mark.slow) for k in (4, 6, 7, 8, 9))],
)
@pytest.mark.slow
def test_the_day_is_named_and_no_order(seed, said):
    """Where the noise model takes all of it, nothing has to be said."""
    found = identify(room(seed), Structure(2, 1), throw=False).findings
    days = [one for one in found if "comes back every day" in one.message]
    assert [one.code for one in days] == ["drift"] * said
    assert all("as a further input" in one.remedy for one in days)
    assert "order-low" not in [one.code for one in found if one.matters]


@pytest.mark.parametrize("damping", [0.002, pytest.param(0.03, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_a_mode_that_rings_is_an_order(damping):
    rng = np.random.default_rng(5)
    u = np.repeat(rng.choice([-1.0, 0.0, 1.0], 8), 100)
    second = TransferFunction([9.0], [1.0, 12.0 * damping, 36.0])
    y = simulate(TransferFunction([2.25], [1.0, 1.2, 2.25]), Record(u, u, dt=0.05))
    y = (y + simulate(second, Record(u, u, dt=0.05)))[:, 0]
    record = Record(u, y + 0.03 * rng.standard_normal(u.size), dt=0.05)
    found = identify(record, Structure(2, 1), throw=False).findings
    assert next(one.code for one in found if one.matters) == "order-low"


@pytest.mark.parametrize("seed", [2, *(pytest.param(k, marks=pytest.mark.slow) for k in range(9))])
@pytest.mark.slow
def test_what_wanders_does_not_come_back(seed):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], 60), 10)
    lag = TransferFunction([2.0], [1.0, 2.0])
    y = simulate(lag, Record(u, u, dt=0.05))[:, 0] + 0.02 * np.cumsum(rng.standard_normal(600))
    found = identify(Record(u, y, dt=0.05), Structure(1, 0), throw=False).findings
    assert not any("comes back" in one.message for one in found)


def test_white_noise_has_no_period():
    noise = np.random.default_rng(1).standard_normal((40, 600, 1))
    assert not any(comes_back(one, 1.0) for one in noise)
    assert comes_back(np.zeros((20, 1)), 1.0) == []
