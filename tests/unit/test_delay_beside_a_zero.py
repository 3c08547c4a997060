"""A zero that is not there, asked for beside a free delay: the two stand for each other."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Status, Structure, TransferFunction, identify, simulate

pytestmark = pytest.mark.unjudged

DT, DELAY = 0.08, 0.155


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_a_zero_that_is_not_there_is_no_reason_to_give_up(seed):
    """Like a hair dryer: two lags and a dead time; half of the records have the zero at infinity"""
    rng, n = np.random.default_rng(seed), 300
    u = np.repeat(rng.choice([-1.0, 1.0], n // 3), 3)
    model = TransferFunction([27.0], [1.0, 10.4, 27.4], delay=DELAY)
    y = simulate(model, Record(u, u, dt=DT))[:, 0]
    record = Record(u, y + 0.05 * y.std() * rng.standard_normal(n), dt=DT)
    estimate = identify(record, Structure(2, 1, delay="free"))
    assert estimate.status in (Status.CONVERGED, Status.WEAKLY_IDENTIFIABLE)
    for name, true in (("delay", DELAY), ("b1", 0.0), ("b0", 27.0), ("a0", 27.4)):
        parameter = estimate.parameters[name]
        assert abs(parameter.value - true) < 4.0 * parameter.std, name


def zigzag(seed: int, n: int = 240, dt: float = 0.5, fine: int = 10) -> Record:
    """A boat whose rudder goes to the other side whenever its heading passes a limit."""
    rng, h = np.random.default_rng([seed, 5]), dt / fine
    gain, lag, limit = rng.uniform(0.12, 0.25), rng.uniform(2, 5), rng.uniform(15, 30)
    drag, heading, rate, rudder, side, gust = 3.0 * rng.uniform(0.0, 0.1), 0.0, 0.0, 30.0, 1.0, 0.0
    u, y = np.zeros(n), np.zeros(n)
    for k in range(n * fine):
        side = -side if side * heading > limit else side
        if k % fine == 0:
            u[k // fine], y[k // fine] = rudder, heading + 8 * np.cos(np.radians(4 * heading))
        rudder += np.clip(30 * side - rudder, -20 * h, 20 * h)
        gust += h * (-gust / 3) + 0.25 * np.sqrt(h) * rng.standard_normal()
        rate += h * ((gain * rudder + gust - rate - drag * rate * abs(rate)) / lag)
        heading += h * rate
    noise = rng.standard_normal((2, n))
    return Record(u + 0.3 * noise[0], y + 0.5 * noise[1], dt=dt, intersample="foh")


@pytest.mark.slow
def test_a_delay_beside_a_zero_that_would_come_before_its_input_is_left_where_it_is():
    estimate = identify(zigzag(9), Structure(2, 1, delay="free"))
    assert estimate.status.ok
    assert estimate.parameters["delay"].value >= 0.0
