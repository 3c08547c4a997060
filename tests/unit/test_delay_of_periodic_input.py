"""An input that repeats itself explains an output as well with a delay of a period more."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import (
    OutputError,
    Record,
    Structure,
    TransferFunction,
    advise,
    identify,
    simulate,
)
from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.search.delays import repeated_inputs
from tridentify.estimation.search.repeated_input import longest_told, repeats

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


def nodes_of_a_circuit(seed):
    """A square wave after one lag and after two, both measured; its edges lie within a sample."""
    rng, fine = np.random.default_rng([seed, 3]), 10
    start = rng.integers(0, fine)
    square = np.where((np.arange(330 * fine) - 39 * fine + start) // (51 * fine) % 2, -0.5, 0.5)
    first = lfilter([0.05], [1.0, -0.95], square)
    second = lfilter([0.04], [1.0, -0.96], first)
    nodes = np.stack([first, second])[:, ::fine]
    u, y = np.round(nodes * 512.0 + rng.uniform(-0.4, 0.4, nodes.shape)) / 512.0
    return Record(u, y, dt=0.001, intersample="auto")


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_an_output_a_little_early_is_not_taken_for_half_a_period_late(seed):
    record = nodes_of_a_circuit(seed)
    found = advise(record)
    assert "delay" not in [finding.code for finding in found.findings]
    assert all(seen.value < 0.002 for seen in found.delays)
    estimate = identify(record, Structure(1, 0, delay="free"))
    assert estimate.parameters["delay"].value < 0.002
    assert estimate.parameters["b0"].value > 0


@pytest.mark.slow
@pytest.mark.parametrize("half", [(0.0, 0.164), (0.165, 0.329)])
def test_nor_where_little_more_than_a_period_is_recorded(half):
    record = nodes_of_a_circuit(0).slice(*half)
    estimate = identify(record, Structure(1, 0, delay="free"))
    assert estimate.parameters["delay"].value < 0.002
    assert estimate.parameters["b0"].value > 0


def test_half_a_cycle_of_a_loop_that_switches_is_no_delay():
    """Half of the time for which it stays on one side, though no two of these are alike."""
    for seed in range(6):
        lengths = np.random.default_rng(seed).integers(33, 39, 7)
        u = np.convolve(np.repeat([1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0], lengths), np.ones(6))
        assert repeats(Record(u, u, dt=0.5), 0) is None
        assert longest_told([Record(u, u, dt=0.5)], 0) == pytest.approx(9.0, abs=0.8)
