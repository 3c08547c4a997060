"""A pole that is too slow for the record, and the row that holds it at zero."""

import numpy as np
import pytest
from numpy.random import default_rng
from scipy.linalg import expm

from oracles import by_exponential
from tridentify import Record, Structure, select_structure

pytestmark = pytest.mark.unjudged


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
    asked = [Structure(2, 2), Structure(3, 3)]
    return select_structure(charged_battery(1), asked, integrators=True)


@pytest.mark.slow
def test_a_charge_is_an_integrator(battery):
    chosen = battery.recommended
    assert chosen.structure.fixed == {"a0": 0.0}
    assert chosen.label == "3, 3, integrator"
    assert "at zero" in battery.reason


@pytest.mark.slow
def test_its_lags_are_those_of_the_battery(battery):
    estimate = battery.recommended.estimate
    rates = sorted(estimate.model.poles.real)[:2]
    # roots of s^2 + 0.14 s + 0.002
    assert rates == pytest.approx([-0.12384, -0.01615], rel=0.08)


def test_rows_that_were_asked_for_stay_alone():
    asked = [Structure(2, 2), Structure(3, 3)]
    found = select_structure(charged_battery(2), asked)
    assert [row.structure for row in found.rows] == asked


def level(seed: int, rate: float) -> Record:
    """A tank that is filled and emptied, with a leak of ``rate``."""
    rng = default_rng(seed)
    flow = np.repeat(rng.choice([-1.0, 1.0], 30), 10)
    height = by_exponential([0.02], [1.0, rate], flow, 1.0)
    return Record(flow, height + 0.02 * rng.standard_normal(flow.size), dt=1.0, intersample="zoh")


@pytest.mark.slow
def test_a_level_has_a_pole_at_zero():
    found = select_structure(level(0, 0.0), [Structure(1, 0)], integrators=True)
    assert [row.label for row in found.rows] == ["1, 0", "1, 0, integrator"]
    assert found.recommended.label == "1, 0, integrator"
    assert found.recommended.estimate.parameters["b0"].value == pytest.approx(0.02, rel=0.05)


@pytest.mark.slow
def test_a_leak_that_the_record_shows_stays():
    # a time constant of 400 s in 300 s, seen well
    record = level(0, 0.0025)
    found = select_structure(record, [Structure(1, 0)], integrators=True)
    assert [row.label for row in found.rows] == ["1, 0", "1, 0, integrator"]
    assert found.recommended.label == "1, 0"


def test_rows_with_a_pole_at_zero_may_be_refused():
    found = select_structure(level(0, 0.0), [Structure(1, 0)], integrators=False)
    assert [row.label for row in found.rows] == ["1, 0"]


def drive(seed: int, bias: float = 0.2) -> Record:
    """Position of a drive; the voltage that acts is not quite the one that was recorded."""
    rng = default_rng(seed)
    voltage = np.repeat(rng.choice([-1.0, 1.0], 20), 20)
    position = by_exponential([0.5], [1.0, 2.0, 0.0], voltage + bias, 0.05)
    position = position + 0.002 * rng.standard_normal(voltage.size)
    return Record(voltage, position, dt=0.05, intersample="zoh")


@pytest.mark.slow
def test_a_constant_error_of_the_input_is_no_obstacle_to_a_pole_at_zero():
    found = select_structure(drive(0), [Structure(1, 0), Structure(2, 0)], integrators=True)
    chosen = found.recommended
    assert chosen.label == "2, 0, integrator"
    assert chosen.fit[0] > 97.0
    assert chosen.estimate.structure.drift
    assert chosen.estimate.parameters["a1"].value == pytest.approx(2.0, rel=0.05)


def hydraulic(seed: int, n: int = 600, gain: float = 8.0, noise: float = 2e-4) -> Record:
    """A valve, a spring of oil and a position, held by a controller; the set point is not there."""
    rng = default_rng([91, seed])
    step = 0.005
    goal = np.repeat(rng.uniform(-0.1, 0.1, n // 50), 50)
    system = np.zeros((4, 4))
    system[:3, :3] = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -3600.0, -36.0]]
    system[2, 3] = 4320.0
    moves = expm(step * system)
    state, u, y = np.zeros(3), np.zeros(n), np.zeros(n)
    for k in range(n):
        y[k] = state[0] + noise * rng.standard_normal()
        u[k] = gain * (goal[k] - y[k])
        state = moves[:3, :3] @ state + moves[:3, 3] * u[k]
    return Record(u, y, dt=step, intersample="auto")


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_a_larger_candidate_gets_its_integrator_too(seed):
    found = select_structure(hydraulic(seed))
    assert found.recommended.label == "3, 0, integrator"
    # held, which zeros would make good
    assert "held" in " ".join(found.all_notes())


@pytest.mark.slow
def test_what_goes_along_with_a_held_input_asks_for_no_other_order():
    """A controller passes on the noise at its sensor; that is no reason against the right order."""
    found = select_structure(hydraulic(0, 1200, gain=4.0, noise=1e-3))
    assert found.recommended.label == "3, 0, integrator"
