"""What is said of a delay that the record cannot tell from zero."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tridentify import OutputError, Record, Structure, TransferFunction, identify, simulate
from tridentify.estimation.answer.decision import DecisionKind
from tridentify.judgement.cautions import judged


@pytest.mark.parametrize(("delay", "told"), [(0.0, True), (0.31, False)])
@pytest.mark.fast("0.0-True")
def test_a_delay_that_may_be_zero_is_named_as_such(delay, told):
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([-1.0, 1.0], 60), 5)
    model = TransferFunction([2.0], [1.0, 2.0], delay=delay)
    y = simulate(model, Record(u, u, dt=0.1))[:, 0]
    y = y + 0.05 * np.std(y) * rng.standard_normal(u.size)
    estimate = identify(Record(u, y, dt=0.1), Structure(1, 0, delay="free"), OutputError())
    assert estimate.parameters["delay"].value == pytest.approx(delay, abs=0.02)
    said = [line for line in estimate.cautions if "distinguishable" in line]
    assert bool(said) is told
    assert all("delay" in line for line in said)
    assert not any("Standard error above half" in line for line in estimate.cautions)


def test_other_delays_are_a_caution():
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([-1.0, 1.0], 60), 5)
    y = simulate(TransferFunction([2.0], [1.0, 2.0]), Record(u, u, dt=0.1))[:, 0]
    record = Record(u, y + 0.05 * rng.standard_normal(u.size), dt=0.1)
    estimate = identify(record, Structure(1, 0), OutputError())
    told = DecisionKind.OTHER_DELAYS.told(": 0.8 s (12 %)")
    trace = replace(estimate.trace, decisions=(told,))
    (one,) = [f for f in judged(replace(estimate, trace=trace), [record]) if "0.8 s" in f.text]
    assert one.message.startswith("Other delays explain")
    assert "standard errors allow for them" in one.message


@pytest.mark.slow
def test_a_delay_that_a_numerator_stands_for_is_not_to_be_left_out():
    rng = np.random.default_rng(3)
    t = np.arange(400) * 0.05
    u = np.column_stack(
        [np.repeat(rng.choice([-1.0, 1.0], 80), 5), np.sin(0.4 * t) + np.sin(0.9 * t)]
    )
    first = simulate(TransferFunction([2.0], [1.0, 2.0, 4.0]), Record(u[:, 0], t, dt=0.05))[:, 0]
    slow = simulate(TransferFunction([3.0], [1.0, 2.0, 4.0]), Record(u[:, 1], t, dt=0.05))[:, 0]
    y = first + slow + 0.05 * np.std(first + slow) * rng.standard_normal(t.size)
    structure = Structure(2, [[0, 1]], delay="free")
    record = Record(u, y, dt=0.05, input_names=["u1", "u2"])
    lines = identify(record, structure, OutputError(), throw=False).cautions
    (line,) = (line for line in lines if "cannot be told apart" in line)
    assert line.startswith("delay[u2] and b1[y,u2]")
    assert "fewer zeros for that input" in line
    assert "--delay" in line
    assert not any("distinguishable" in one and "u2" in one for one in lines)


@pytest.mark.slow
def test_advice_to_shift_an_input_names_the_option():
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([-1.0, 1.0], 60), 5)
    y = simulate(TransferFunction([2.0], [1.0, 2.0], delay=0.31), Record(u, u, dt=0.1))[:, 0]
    y = y + 0.02 * np.std(y) * rng.standard_normal(u.size)
    lines = identify(Record(u, y, dt=0.1), Structure(1, 0), OutputError(), throw=False).cautions
    (line,) = (line for line in lines if "a delay is missing" in line)
    assert "--delay" in line
    assert "delay='free'" in line
