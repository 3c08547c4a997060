"""Behind an integrator a constant error of the input is a ramp of the output."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate

pytestmark = pytest.mark.unjudged


def driven(bias):
    rng = np.random.default_rng(4)
    u = np.repeat(rng.choice([-1.0, 1.0], 80), 5)
    rest = Record(u + bias, u, dt=0.05)
    y = simulate(TransferFunction([3.0], [1.0, 2.0, 0.0]), rest)[:, 0]
    return Record(u, y + 0.01 * rng.standard_normal(u.size), dt=0.05)


def test_the_drift_is_considered_by_itself():
    structure = Structure(2, 0, fixed={"a0": 0.0})
    assert structure.drift == "auto"
    estimate = identify(driven(0.3), structure)
    assert estimate.structure.drift is True
    assert estimate.parameters["a1"].value == pytest.approx(2.0, abs=5 * estimate.std[0] + 0.02)
    assert estimate.fit[0] > 95


def test_what_is_stated_stays():
    assert Structure(2, 0, fixed={"a0": 0.0}, drift=False).drift is False
    assert Structure(2, 0, fixed={"a1": 0.0}).drift is False
    assert Structure(2, 0).drift is False
    # behind two integrators a ramp is no error of the input but a rate at the beginning
    assert Structure(2, 0, fixed={"a0": 0.0, "a1": 0.0}).drift is False
    assert Structure(3, 0, fixed={"a0": 0.0, "a2": 0.0}).drift == "auto"
    again = Structure.from_dict(Structure(2, 0, fixed={"a0": 0.0}).to_dict())
    assert again == Structure(2, 0, fixed={"a0": 0.0}, drift="auto")
