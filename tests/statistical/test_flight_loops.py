"""An A-4 of the JSBSim engine under two controllers, identified by the reference and in open loop.

The truth is the linearised engine. A model of two poles is not quite what flies: how far the
coefficients of the same flight without gusts and sensor noise are from the truth is added to every
standard error.
"""

from __future__ import annotations

import sys

import numpy as np
import pytest

from tridentify import Record, identify

pytestmark = pytest.mark.slow

DRAWS = 8
SCORES = 3.0


@pytest.fixture(scope="module")
def flights(repository):
    """The script that flies them; skips without the engine."""
    pytest.importorskip("jsbsim", reason="needs jsbsim, of the extra tridentify[jsbsim]")
    sys.path.insert(0, str(repository / "examples"))
    try:
        import jsbsim_loops
    finally:
        sys.path.pop(0)
    return jsbsim_loops


@pytest.fixture(scope="module")
def damped(flights):
    loop = flights.Loop(flights.CASES["damper"])
    return loop, [loop.fly(seed) for seed in range(100, 100 + DRAWS)]


@pytest.fixture(scope="module")
def held(flights):
    loop = flights.Loop(flights.CASES["hold"])
    return loop, [loop.fly(seed) for seed in range(100, 100 + DRAWS)]


def by(flights, way, records):
    found = [identify(one, flights.STRUCTURE, flights.WAYS[way], throw=False) for one in records]
    assert {one.route for one in found} == {"reference" if way == "reference" else "open-loop"}
    return found


def errors(found, names):
    """Coefficients and their standard errors, a row an estimate."""
    rows = [[one.parameters[name] for name in names] for one in found]
    return tuple(np.array([[getattr(r, a) for r in row] for row in rows]) for a in ("value", "std"))


def of_the_mean(value, truth, linear):
    """Error of the mean over the flights in standard errors, which the flights themselves tell."""
    spread = value.std(axis=0, ddof=1) / np.sqrt(len(value))
    return (value.mean(axis=0) - truth) / np.hypot(spread, linear)


@pytest.fixture(scope="module")
def linear(flights, damped):
    """How far two poles are from the truth in still air and without sensor noise."""
    loop, records = damped
    still = np.zeros(records[0].n_samples)
    record = loop.record(records[0].reference[:, 0], still, np.zeros((len(still), 2)))
    clean = Record(record.u, record.y, dt=record.dt)
    found = by(flights, "open loop, white noise", [clean])
    off = np.abs(errors(found, loop.truth)[0][0] - list(loop.truth.values()))
    assert np.all(off < 0.1 * np.abs(list(loop.truth.values())))
    return off


def test_a_damper_in_gusts_biases_open_loop_and_not_the_reference_route(flights, damped, linear):
    loop, records = damped
    truth = np.array(list(loop.truth.values()))
    value, std = errors(by(flights, "reference", records), loop.truth)
    assert np.all(np.abs(of_the_mean(value, truth, linear)) < SCORES)
    # gusts are slow: 12 other flights gave 1.26
    assert np.sqrt(np.mean(((value - truth) / np.hypot(std, linear)) ** 2)) < 1.6
    value, _ = errors(by(flights, "open loop, white noise", records), loop.truth)
    scores = of_the_mean(value, truth, linear)
    # what the elevator does to the pitch acceleration, a tenth and more too little
    which = list(loop.truth).index("b1")
    assert truth[which] < 0.0
    assert scores[which] > SCORES
    assert value[:, which].mean() > 0.9 * truth[which]


def test_the_unstable_pole_is_found_by_the_reference(flights, held):
    loop, records = held
    assert loop.growth > 0.5
    for one in by(flights, "reference", records):
        pole, error = flights.rightmost(one)
        assert pole > 0.0
        assert abs(pole - loop.growth) < SCORES * error
        assert error < 0.15 * loop.growth
        assert "unstable" in {found.code for found in one.findings}


def test_open_loop_with_white_noise_is_sure_of_a_stable_aircraft(flights, held):
    """Its controller keeps it in bounds, and a pole at zero by several of its standard errors."""
    loop, records = held
    found = [flights.rightmost(one) for one in by(flights, "open loop, white noise", records)]
    poles, errors_ = np.array(found).T
    assert np.all(poles < 0.1 * loop.growth)
    assert np.mean((loop.growth - poles) / errors_) > SCORES
