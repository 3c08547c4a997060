"""An integrating plant under a continuous controller, in noise that is held as in simulations.

Where its output stands is no state that the noise does not move, so that the rule which the loop
leaves in the input is as short as that of a sampled controller.
"""

from __future__ import annotations

import numpy as np
import pytest

from oracles import binary, continuous_loop, sampled_loop
from tridentify import Record, Structure, ThreeModel
from tridentify.estimation.closed_loop.input_rule import InputRule, input_rule
from tridentify.estimation.methods.by_reference.controller_kind import assumed, of_integrator

DT = 0.05
DRIVE = ([10.0], [1.0, 2.1, 0.0])
POLE, GAIN, HIGH = 20.0, 2.0, 8.0
LEAD = (np.array([[-POLE]]), np.ones(1), np.array([-POLE * (HIGH - GAIN)]), HIGH)


def continuous(seed: int, n: int = 400) -> Record:
    noise = 0.03 * np.random.default_rng(seed).standard_normal(n)
    r = 0.3 * binary(n, 12, seed)
    u, y = continuous_loop(DRIVE, LEAD, r, noise, DT)
    return Record(u, y, dt=DT, reference=r)


def sampled(seed: int, n: int = 400) -> Record:
    rng, r, state = np.random.default_rng(seed), 0.3 * binary(n, 12, seed), [0.0]
    keeps = np.exp(-POLE * DT)

    def control(k, y):
        error = r[k] - y[0]
        u = (GAIN - HIGH) * state[0] + HIGH * error
        state[0] = keeps * state[0] + (1.0 - keeps) * error
        return u

    u, y = sampled_loop([[DRIVE]], control, 0.03 * rng.standard_normal((n, 1)), DT)
    return Record(u, y, dt=DT, reference=r)


def off(record: Record) -> tuple[float, bool]:
    """Stated errors that damping and gain are off by, and whether it was taken as sampled."""
    found = ThreeModel().estimate([record], Structure(2, 0))
    away = (found.theta[[0, 2]] - [2.1, 10.0]) / found.std[[0, 2]]
    return float(np.max(np.abs(away))), any(
        "controller taken as sampled" in one for one in found.trace.decisions
    )


def test_its_loop_leaves_the_rule_of_a_sampled_controller():
    assert input_rule([continuous(1)], 2) is InputRule.SAMPLED
    assert input_rule([continuous(1)], 1) is not InputRule.SAMPLED
    assert input_rule([sampled(1)], 1) is InputRule.SAMPLED


def test_the_rule_says_nothing_where_the_plant_may_integrate():
    open_loop, structure = ThreeModel(route="open-loop", noise="white"), Structure(2, 0)
    for record, certain in ((continuous(1, 250), False), (sampled(1, 250), True)):
        found = open_loop.estimate([record], structure)
        taken = assumed("unknown", [record], structure)
        assert taken.certain
        assert of_integrator(taken, found, [record]).certain is certain
        stated = assumed("continuous", [record], structure)
        assert stated.against
        assert bool(of_integrator(stated, found, [record]).against) is certain


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.slow
def test_it_is_not_taken_as_sampled_for_that(seed):
    away, _ = off(continuous(seed))
    assert away < 4.0


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.slow
def test_a_sampled_one_is_sampled(seed):
    away, as_sampled = off(sampled(seed))
    assert as_sampled
    assert away < 4.0
