"""Delays from inputs with few edges: no local minimum, no sample left out without need."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import OutputError, Record, Structure, TransferFunction, identify, simulate
from tridentify.estimation.likelihood.mixture import Component, combined
from tridentify.estimation.search.delay_search import price
from tridentify.estimation.search.repeated_input import repeats

DT = 0.01
LATER = "are left out"
REPEATS = "repeats itself"


def few_edges(edges, delay, *, n=300, sign=-1.0, offset=0.0, seed=1):
    """A lightly damped system behind an input of two levels, at 20 dB."""
    u = np.zeros(n)
    for k in edges:
        u[k:] = 1.0 - u[k:]
    model = TransferFunction([100.0 * sign], [1.0, 8.0, 100.0], delay=delay)
    y = simulate(model, Record(u, u, dt=DT))[:, 0] + offset
    noise = np.random.default_rng(seed).standard_normal(n)
    return Record(u, y + 0.1 * np.std(y) * noise, dt=DT)


def free(**options):
    return Structure(2, 0, delay="free", **options)


EDGES = (([30], 0.0), ([30], 0.1), ([25, 40, 52], 0.035), ([140, 160], 0.0))


@pytest.mark.parametrize(
    ("edges", "delay", "sign"),
    [
        pytest.param(*case, sign, marks=[pytest.mark.slow] if twin else [])
        for case in EDGES
        for sign in (-1.0, 1.0)
        for twin in [sign > 0.0 and case is not EDGES[0]]
    ],
)
@pytest.mark.fast("edges1-0.0-1.0")
def test_the_edges_are_seen_however_early_they_come(edges, delay, sign):
    record = few_edges(edges, delay, sign=sign)
    known = identify(record, Structure(2, 0, delay=delay, initial_state="free"), OutputError())
    estimate = identify(record, free(initial_state="free"), OutputError())
    assert estimate.parameters["delay"].value == pytest.approx(delay, abs=0.02)
    assert estimate.model.dc_gain[0, 0] == pytest.approx(sign, abs=0.1)
    assert estimate.fit[0] > known.fit[0] - 1.0
    left_out = int(np.isnan(estimate.predict(record)).sum())
    assert left_out <= np.ceil(estimate.theta[-1] / DT) + 4
    assert not any(LATER in line for line in estimate.cautions)


@pytest.mark.slow
def test_a_long_delay_is_found_and_what_it_leaves_out_is_told():
    record = few_edges([40, 90, 150], 0.6)
    estimate = identify(record, free(initial_state="free", offset=True), OutputError())
    assert estimate.parameters["delay"].value == pytest.approx(0.6, abs=0.02)
    (told,) = [line for line in estimate.cautions if LATER in line]
    # two samples of room, and ten before the record in which the input rested as well
    assert told.startswith("17 % of the output samples (52")
    assert "of 300" in told
    rest = identify(record, free(initial_state="rest"), OutputError())
    assert rest.parameters["delay"].value == pytest.approx(0.6, abs=0.02)
    assert not any(LATER in line for line in rest.cautions)


def test_samples_left_out_count_from_a_tenth_on():
    assert price(30.0, 300.0) == 0.0
    assert price(60.0, 300.0) == 30.0


@pytest.mark.slow
def test_what_an_input_that_comes_again_leaves_open_is_told():
    u = np.tile(np.repeat([1.0, -1.0], 25), 16)
    model = TransferFunction([6.0], [1.0, 2.0, 6.0], delay=0.05)
    y = simulate(model, Record(u, u, dt=0.02))[:, 0]
    y = y + 0.03 * np.random.default_rng(0).standard_normal(u.size)
    estimate = identify(Record(u, y, dt=0.02), free(), OutputError())
    assert estimate.parameters["delay"].value == pytest.approx(0.05, abs=0.01)
    (told,) = [line for line in estimate.cautions if REPEATS in line]
    assert "after 0.5 s, inverted" in told
    assert "with the gain reversed" in told
    once = identify(few_edges([40, 90, 150], 0.1), free(), OutputError())
    assert not any(REPEATS in line for line in once.cautions)


@pytest.mark.parametrize(
    ("u", "expected"),
    [
        (np.tile([0.0, 0.0, 1.0, 0.0, 1.0], 20), (5.0, 1)),
        (np.sin(2.0 * np.pi * np.arange(300) / 50.0), (25.0, -1)),
        (np.random.default_rng(0).standard_normal(200).repeat(3), None),
        (np.concatenate([np.zeros(50), np.ones(150)]), None),
        (np.ones(50), None),
    ],
    ids=["pattern", "sine", "noise", "step", "constant"],
)
def test_after_how_long_an_input_repeats_itself(u, expected):
    found = repeats(Record(u, u, dt=1.0), 0)
    assert found == (None if expected is None else pytest.approx(expected))


def test_uneven_time_is_not_asked_whether_it_repeats():
    t = np.cumsum(np.random.default_rng(1).uniform(0.5, 1.5, 200))
    u = np.sign(np.sin(t))
    assert repeats(Record(u, u, t=t), 0) is None


def test_a_minimum_without_a_known_curvature_does_not_count():
    good = Component(0.0, np.zeros(2), np.eye(2))
    for bad in (
        Component(np.nan, np.ones(2), np.eye(2)),
        Component(5.0, np.ones(2), np.full((2, 2), np.inf)),
    ):
        found = combined([good, bad], np.zeros(2))
        assert found.shares == pytest.approx([1.0])
        assert found.cov == pytest.approx(np.eye(2))
