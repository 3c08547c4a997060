"""What an estimate calls bad samples is what `validate` calls so, of the same record."""

from __future__ import annotations

import numpy as np
import pytest

from oracles import by_modes
from tridentify import Record, Structure, identify, validate

pytestmark = pytest.mark.slow

DT = 0.02


@pytest.mark.parametrize("seed", [0, 1])
def test_estimate_and_validation_list_the_same_samples(seed):
    rng = np.random.default_rng(seed)
    u = 5.0 + np.repeat(rng.uniform(-2.0, 2.0, 30), 30)
    y = by_modes(np.array([860.0]), np.array([1.0, 2.86]), u - u[0], DT) + 300.0 * u[0]
    y += 5.0 * rng.standard_normal(u.size)
    y[rng.choice(u.size, 9, replace=False)] = 0.0  # a sensor of a speed that loses pulses
    y[500:504] = 0.0
    record = Record(u, y, dt=DT)
    estimate = identify(record, Structure(1, 0))
    own, tested = (
        [(one.message, one.times) for one in found if one.code == "bad-samples"]
        for found in (estimate.findings, validate(estimate, record).findings)
    )
    assert len(own) == 1
    assert own == tested
