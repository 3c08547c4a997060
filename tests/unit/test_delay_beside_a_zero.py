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
