"""A pole that is too slow for the record, and the row that holds it at zero."""

import numpy as np
import pytest
from numpy.random import default_rng

from oracles import by_exponential
from tridentify import Record, Structure, select_structure


def charged_battery(seed: int) -> Record:
    """Voltage under current pulses: two lags, a resistance, and a charge that is drained."""
    rng = default_rng(seed)
    current = np.repeat(rng.choice([-3.0, 0.0, 2.0, 4.0], 12), 25)
    lags = by_exponential([-0.02, -0.0045, -8e-5], [1.0, 0.14, 0.002], current, 1.0)
    charge = np.concatenate([[0.0], np.cumsum(current)[:-1]]) / 9000.0
    voltage = 3.7 + lags - 0.9 * charge + 0.0005 * rng.standard_normal(current.size)
    return Record(current, voltage, dt=1.0, intersample="zoh")


@pytest.fixture(scope="module")
def battery():
    return select_structure(charged_battery(1))


def test_a_charge_is_an_integrator(battery):
    chosen = battery.recommended
    assert chosen.structure.fixed == {"a0": 0.0}
    assert chosen.label == "3, 3, integrator"
    assert "at zero" in battery.reason


def test_its_lags_are_those_of_the_battery(battery):
    estimate = battery.recommended.estimate
    rates = sorted(estimate.model.poles.real)[:2]
    # roots of s^2 + 0.14 s + 0.002
    assert rates == pytest.approx([-0.12384, -0.01615], rel=0.08)


def test_rows_that_were_asked_for_stay_alone():
    asked = [Structure(2, 2), Structure(3, 3)]
    found = select_structure(charged_battery(2), asked)
    assert [row.structure for row in found.rows] == asked
