"""A controller that stands at its limits most of the time: its small moves between them tell."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify.judgement.causes.attempts.feedback import Inputs
from tridentify.judgement.causes.past_outputs import told_by_past
from tridentify.record.record import Record

DT = 4.0


def heater(seed, n=1200):
    """Two lags that a proportional and integral controller heats, from 0 to 100; in per cent, K."""
    rng = np.random.default_rng(seed)
    wanted = np.repeat(rng.choice([0.0, 25.0, 60.0], n // 60 + 1), 60)[:n]
    body = sensor = total = 0.0
    u, y = np.zeros(n), np.zeros(n)
    for k in range(n):
        body += 0.03 * (0.6 * u[k - 1] - body) if k else 0.0
        sensor += 0.2 * (body - sensor)
        y[k] = sensor + 0.1 * rng.standard_normal()
        error = wanted[k] - y[k]
        asked = 8.0 * error + total
        total += 0.05 * error if 0.0 < asked < 100.0 else 0.0
        u[k] = np.clip(asked, 0.0, 100.0)
    return Record(u, y, dt=DT)


def test_its_moves_between_them_are_told_by_past_outputs():
    """Of 12 others 7 are told; none was asked where all samples counted."""
    records = [heater(seed) for seed in range(40, 44)]
    for record in records:
        assert np.mean((record.u == 0.0) | (record.u == 100.0)) > 0.4
    assert sum(not Inputs.of([record]).commanded for record in records) >= 3
    assert sum(told_by_past([record])[0] is not None for record in records) >= 1


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_an_input_of_another_record_is_told_by_nothing(seed):
    record = Record(heater(seed).u, heater(seed + 50).y, dt=DT)
    assert told_by_past([record]) == [None]


@pytest.mark.parametrize(
    "u",
    [
        np.repeat([0.0, 1.0, 0.0, 1.0], 100),
        np.repeat([0.0, 1.0, 2.0, 0.0, 2.0], 100),
        np.clip(np.sin(0.05 * np.arange(600)), -0.5, 0.5),
        np.clip(sum(np.sin(0.01 * f * np.arange(900) + f * f) for f in range(1, 12)), -0.7, 0.7),
    ],
    ids=["two levels", "three levels", "a sine at its limits", "sines at their limits"],
)
def test_one_that_was_set_is_not_asked(u):
    y = np.cumsum(u) + np.random.default_rng(0).standard_normal(u.size)
    assert told_by_past([Record(u, y, dt=DT)]) == [None]
