"""Selection: rows with a delay, where a delay is missing and only there."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, select_structure, simulate

pytestmark = pytest.mark.unjudged

CANDIDATES = [(1, 0), (2, 0), (2, 1), (3, 1)]


def record(num, den, delay: float = 0.0, seed: int = 0) -> Record:
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], 25), 16)
    y = simulate(TransferFunction(num, den, delay=delay), Record(u, u, dt=1.0))
    return Record(u, y + 0.1 * np.std(y) * rng.standard_normal((u.size, 1)), dt=1.0)


@pytest.mark.slow
def test_dead_time_is_recommended_in_place_of_poles_that_stand_for_it():
    given = record([2.0], [10.0, 1.0], 6.3)
    chosen = select_structure(given, CANDIDATES, delays=True).recommended
    assert chosen.label == "1, 0, free delay"
    estimate = chosen.estimate
    assert estimate.parameters["delay"].value == pytest.approx(6.3, abs=0.3)


@pytest.mark.slow
def test_without_such_rows_poles_are_recommended():
    without = select_structure(record([2.0], [10.0, 1.0], 6.3), CANDIDATES).recommended
    assert without.structure.poles > 1
    assert without.structure.delay == 0.0


@pytest.mark.slow
def test_a_plant_without_dead_time_gets_no_such_row():
    found = select_structure(record([3.0], [30.0, 13.0, 1.0]), CANDIDATES, delays=True)
    assert [row.label for row in found.rows] == ["1, 0", "2, 0", "2, 1", "3, 1"]
    assert found.recommended.label == "2, 0"


def test_a_delay_that_is_stated_stays():
    given = record([2.0], [10.0, 1.0], 6.3)
    stated = [Structure(poles, 0, delay=3.0) for poles in (1, 2)]
    found = select_structure(given, stated, delays=True)
    assert all(row.structure.delay == 3.0 for row in found.rows)


def circuit(seed: int, count: int = 400) -> Record:
    """Two stages behind a sample of dead time, with a slow tail and a bend of a percent or two."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1.0, 1.0, count // 2), 2)
    den = np.polymul([1.0, 2500.0, 5e5], [1.0, 66.0])
    whole = TransferFunction(5e5 * np.array([66.0 / 72.0, 66.0]), den, delay=0.001)
    y = simulate(whole, Record(u, u, dt=0.001))[:, 0]
    y = y + 0.015 * y**2
    y = y + 0.008 * np.std(y) * rng.standard_normal(count)
    return Record(u, y, dt=0.001, intersample="zoh")


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_delay_is_found_beside_what_is_slow_and_not_linear(seed):
    asked = [(1, 0), (2, 0), (2, 1), (3, 1), (4, 2)]
    chosen = select_structure(circuit(seed), asked, delays=True).recommended
    # the fast stage lies near half the sample rate: it passes for a little more of dead time
    assert chosen.label in ("1, 0, free delay", "2, 0, free delay")


@pytest.mark.slow
def test_a_delay_that_is_worth_more_than_a_pole_gets_a_row():
    asked = [(1, 0), (2, 0), (4, 2)]
    rows = select_structure(circuit(0, 240), asked, delays=True).rows
    assert "1, 0, free delay" in [row.label for row in rows]


def quarter_car(seed: int, slowest: float) -> Record:
    """Two masses on springs over a road that is measured; the tyre is an order faster."""
    sprung, unsprung, spring, damper, tyre = 300.0, 40.0, 16e3, 1200.0, 180e3
    between = np.array([damper, spring])
    body, wheel = np.array([sprung, damper, spring]), np.array([unsprung, damper, spring + tyre])
    den = np.polysub(np.polymul(body, wheel), np.polymul(between, between))
    plant = TransferFunction(tyre * between / den[0], den / den[0])
    rng = np.random.default_rng(seed)
    kept, road = np.exp(-2.0 * np.pi * slowest * 0.01), np.zeros(1600)
    for k in range(1, road.size):
        road[k] = kept * road[k - 1] + rng.standard_normal()
    road *= 0.02 / np.std(road)
    y = simulate(plant, Record(road, road, dt=0.01, intersample="foh"))
    y = y + 0.02 * np.std(y) * rng.standard_normal(y.shape)
    return Record(road, y, dt=0.01, intersample="foh")


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "slowest"), [(11, 0.2), (12, 1.0)])
def test_a_second_mass_is_no_dead_time_however_little_it_adds(seed, slowest):
    chosen = select_structure(quarter_car(seed, slowest)).recommended
    assert chosen.label == "4, 1"
