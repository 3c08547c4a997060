"""A plant to start from in the best forecast of a loop, whatever the controller."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record
from tridentify.estimation.closed_loop.long_past import plants_of_forecast
from tridentify.estimation.closed_loop.unstable_answer import open_loops

DT = 0.1


def held_by_a_controller(seed, n, a0=1.0):
    """``2 / (p^2 + p - a0)``, held by proportional and derivative action, a dither on its input."""
    rng = np.random.default_rng(seed)
    y, u, place, speed, before = np.zeros(n), np.zeros(n), 0.0, 0.0, 0.0
    for k in range(n):
        y[k] = place + 0.002 * rng.standard_normal()
        u[k] = -2.0 * y[k] - 1.5 * (y[k] - before) / DT + 0.3 * rng.standard_normal()
        before = y[k]
        for _ in range(20):
            slope = 2.0 * u[k] - speed + a0 * place
            place, speed = place + DT / 20 * speed, speed + DT / 20 * slope
    return Record(u, y, dt=DT)


@pytest.mark.parametrize("seed", range(4))
def test_an_unstable_plant_is_in_the_forecast_of_its_loop(seed):
    realised, slow = plants_of_forecast(open_loops([held_by_a_controller(seed, 1200)]), 2, [0])
    assert realised.theta == pytest.approx([1.0, -1.0, 2.0], abs=0.25)
    assert slow.poles.real == pytest.approx([0.0, 0.0], abs=0.02)
    assert slow.theta[-1] == pytest.approx(2.0, rel=0.5)


def test_a_record_that_is_too_short_for_a_past_has_none():
    assert plants_of_forecast(open_loops([held_by_a_controller(0, 60)]), 2, [0]) == []
