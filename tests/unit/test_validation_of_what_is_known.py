"""A validation of the identified record does not forget what its estimate knows of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate, validate
from tridentify.estimation.answer.finding import Finding

pytestmark = pytest.mark.judged

N, DT = 400, 0.04
PLANT = TransferFunction([-6.0, -5.5], [1.0, 2.1, 7.5])


@pytest.mark.slow
def test_four_poles_from_one_sine_are_not_called_right() -> None:
    """Their residual is white; their coefficients are known to several hundred percent."""
    rng = np.random.default_rng(0)
    u = np.sin(2.2 * DT * np.arange(N))
    y = simulate(PLANT, Record(u, u, dt=DT))[:, 0] + 0.02 * rng.standard_normal(N)
    record = Record(u, y, dt=DT)
    found = validate(identify(record, Structure(4, 3), throw=False), record)
    assert not found.ok
    assert found.findings[0].code == "order-high"
    assert "Nothing speaks against" not in found.verdict


@pytest.mark.slow
def test_an_input_of_another_record_is_not_called_right() -> None:
    rng = np.random.default_rng(4)
    u, other = (np.repeat(rng.standard_normal(N // 20), 20) for _ in range(2))
    y = simulate(PLANT, Record(other, other, dt=DT))[:, 0] + 0.02 * rng.standard_normal(N)
    record = Record(u, y, dt=DT)
    found = validate(identify(record, Structure(2, 1), throw=False), record)
    assert not found.ok
    assert found.findings[0].code == "no-response"
    assert found.verdict.startswith(found.findings[0].message[:-1])


@pytest.mark.slow
def test_a_sensor_that_hung_comes_before_what_it_makes_of_the_residual() -> None:
    rng = np.random.default_rng(2)
    u = np.repeat(rng.choice([-1.0, 1.0], N // 20), 20)
    y = simulate(PLANT, Record(u, u, dt=DT))[:, 0] + 0.02 * rng.standard_normal(N)
    y[150:250] = y[150]
    record = Record(u, y, dt=DT)
    assert validate(identify(record, Structure(2, 1), throw=False), record).findings[0].code == (
        "stuck-sensor"
    )


def test_a_coefficient_near_zero_is_a_note_and_no_objection() -> None:
    """The model is right and its numerator has a coefficient that is zero."""
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([-1.0, 1.0], N // 20), 20)
    oscillator = TransferFunction([7.5], [1.0, 2.1, 7.5])
    y = simulate(oscillator, Record(u, u, dt=DT))[:, 0] + 0.02 * rng.standard_normal(N)
    record = Record(u, y, dt=DT)
    found = validate(identify(record, Structure(2, 1), throw=False), record)
    assert found.ok
    assert [(one.code, one.severity) for one in found.findings] == [("not-determined", "note")]
    assert "To be known: standard error above half" in found.verdict


def test_what_the_estimate_warns_of_is_named_beside_a_residual_of_noise() -> None:
    """A residual that shows nothing is no word against needless poles or slow noise."""
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([-1.0, 1.0], N // 20), 20)
    y = simulate(TransferFunction([2.0], [1.0, 2.0]), Record(u, u, dt=DT))[:, 0]
    record = Record(u, y + 0.5 * rng.standard_normal(N), dt=DT)
    slow = Finding("drift", "warning", "A slow disturbance moves y: it is taken for noise.")
    many = Finding("order-high", "warning", "0 poles explain the record as well: no more.")
    estimate = replace(identify(record, Structure(1, 0)), findings=(many, slow), fit=np.zeros(1))
    found = validate(estimate, record)
    assert found.ok
    assert {one.code for one in found.findings} == {"drift", "order-high"}
    assert "0 poles explain the record as well; a slow disturbance moves y." in found.verdict
