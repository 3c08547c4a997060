"""Samples left out of a fit with a delay are predicted with the inputs that came before."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate
from tridentify.judgement.selection.held_out import HeldEstimate, cross_fit


@pytest.mark.parametrize("seed", [21, 22])
@pytest.mark.parametrize("level", [0.0, 50.0])
@pytest.mark.unjudged
@pytest.mark.fast("50.0-21")
def test_an_input_away_from_zero_is_predicted_as_well_as_one_about_it(seed, level):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-8.0, 8.0], 30), 14)
    plant = TransferFunction([0.6], [15.0, 1.0], delay=9.0)
    y = simulate(plant, Record(u, u, dt=1.0))[:, 0]
    y = 60.0 + y + 0.15 * np.std(y) * rng.standard_normal(u.size)
    # the beginning is not at rest
    record = Record(u[40:] + level, y[40:], dt=1.0)
    structure = Structure(1, 0, delay="free", initial_state="free", offset=True)
    estimate = identify(record, structure)
    held = cross_fit(HeldEstimate(estimate, (record,), (), structure))
    assert held.fit[0] == pytest.approx(estimate.fit[0], abs=3.0)
    first = int(np.isnan(estimate.predict(record)[:, 0]).sum())
    assert np.isnan(held.errors[0][:9]).all()
    assert np.isfinite(held.errors[0][first:]).all()
