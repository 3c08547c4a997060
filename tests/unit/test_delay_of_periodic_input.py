"""An input that repeats itself explains an output as well with a delay of a period more."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import OutputError, Record, Structure, TransferFunction, identify, simulate
from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.search.delays import repeated_inputs, repeats

pytestmark = pytest.mark.unjudged


def test_an_input_that_repeats_itself_is_known_by_its_period():
    u = np.tile(np.repeat([1.0, -1.0], 5), 8)
    record = Record(u, u, dt=0.1)
    assert repeats(record, 0) == (pytest.approx(0.5), -1)
    (told,) = repeated_inputs([record])
    assert told.kind is DecisionKind.REPEATED_INPUT
    assert "after 0.5 s, inverted" in told
    once = Record(np.arange(80.0) >= 20.0, u, dt=0.1)
    assert repeats(once, 0) is None
    assert repeated_inputs([record, once]) == []


@pytest.mark.slow
def test_the_shortest_of_equal_delays_is_taken():
    u = np.tile(np.repeat([1.0, -1.0], 25), 20)
    model = TransferFunction([6.0], [1.0, 2.0, 6.0], delay=0.05)
    y = simulate(model, Record(u, u, dt=0.02))[:, 0]
    y = y + 0.03 * np.random.default_rng(0).standard_normal(1000)
    estimate = identify(Record(u, y, dt=0.02), Structure(2, 0, delay="free"), OutputError())
    assert estimate.parameters["delay"].value == pytest.approx(0.05, abs=0.01)
    assert estimate.parameters["b0"].value > 0
