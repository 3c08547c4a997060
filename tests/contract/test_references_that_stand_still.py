"""References that never move, and fewer of them than inputs."""

import numpy as np
import pytest

from oracles import sampled_loop
from tridentify import (
    Record,
    Structure,
    ThreeModel,
    TransferFunction,
    advise,
    identify,
    validate,
)
from tridentify.errors import ConstantReferenceError
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.closed_loop.moving import with_still
from tridentify.estimation.methods.closed_loop.projection import Projection
from tridentify.estimation.methods.closed_loop.simulated_instruments import (
    ClosedLoopRefinedInstrumentalVariable,
)
from tridentify.estimation.methods.closed_loop.two_stage import TwoStage

PLANT = ([1.0, 2.0], [1.0, 1.2, 4.0])


def held(level, n=400):
    """A loop with a PI controller and a constant set point, in noise."""
    rng, total = np.random.default_rng(0), [0.0]

    def control(k, y):
        total[0] += 0.1 * (level - y[0])
        return 2.0 * (level - y[0]) + total[0]

    u, y = sampled_loop([[PLANT]], control, 0.2 * rng.standard_normal((n, 1)), 0.1)
    return Record(u, y, dt=0.1, reference=np.full(n, level))


@pytest.mark.parametrize(("noise", "route"), [("white", "open-loop"), ("auto", "direct")])
@pytest.mark.slow
def test_a_set_point_that_never_moves_is_none(noise, route):
    record, quick = held(1.0), ThreeModel(starts=1, noise=noise, finish="likelihood")
    found = identify(record, Structure(2, 1), quick)
    assert found.route == route
    assert "the references never move: taken as none" in found.trace.decisions
    (told,) = [one for one in found.findings if one.code == "loop-not-excited"]
    assert told.message.startswith("The reference stands still (r), drives nothing and counts as")


@pytest.mark.slow
def test_advice_tells_of_a_still_reference_and_does_not_count_on_it():
    found = {one.code: one for one in advise(held(1.0)).findings}
    assert found["loop-not-excited"].message.startswith("The reference stands still (r)")
    assert not any("the reference is there" in one.remedy for one in found.values())


def test_what_a_still_reference_means_is_said_beside_what_was_found():
    law = Finding("loop-not-excited", "error", "u follows from y.", "Move the set point.")
    still, alone = held(1.0), held(1.0).select(references=[])
    (said,) = with_still([law], [still], "direct")
    assert said.message.endswith("counts as none: u follows from y.")
    assert with_still([law], [alone], "direct") == (law,)
    ways = {route: with_still([], [still], route)[0] for route in ("direct", "open-loop")}
    assert {route: one.severity for route, one in ways.items()} == {
        "direct": "warning",
        "open-loop": "note",
    }


@pytest.mark.slow
def test_a_plant_that_a_controller_holds_is_found_where_stable_poles_cancel():
    rng, n = np.random.default_rng(12), 600
    total, last, slope = [0.0], [0.0], [0.0]

    def control(k, y):
        total[0] += 0.04 * (20.0 - y[0])
        slope[0] += 0.33 * ((y[0] - last[0]) / 0.05 - slope[0])
        last[0] = y[0]
        return 2.8 * (20.0 - y[0]) + total[0] - 1.2 * slope[0]

    plant = ([1.0], [1.0, 0.65, -0.65])
    u, y = sampled_loop([[plant]], control, 0.05 * rng.standard_normal((n, 1)), 0.05)
    record = Record(u + 5.0, y, dt=0.05, intersample="zoh", reference=np.full(n, 20.0))
    found = identify(record, Structure(2, 0))
    assert found.route == "direct"
    assert np.all(np.abs(found.theta - [0.65, -0.65, 1.0]) < 4.0 * found.std)
    told = {one.code: one for one in found.findings}
    assert "stands still (r)" in told["loop-not-excited"].message
    assert "order-low" not in told


@pytest.mark.slow
def test_a_set_point_that_never_moves_changes_no_digit():
    record, method = held(1.0), ThreeModel(starts=1, noise="white", finish="likelihood")
    both = [record, record.select(references=[])]
    found, without = (method.estimate([one], Structure(2, 1)) for one in both)
    np.testing.assert_array_equal(found.theta, without.theta)


@pytest.mark.slow
def test_experiments_without_a_reference_are_told_beside_others():
    rng = np.random.default_rng(4)
    u = np.repeat(rng.choice([-1.0, 1.0], 20), 10)
    y = np.convolve(u, 0.1 * np.exp(-0.1 * np.arange(60)))[: u.size]
    y = y + 0.01 * rng.standard_normal(u.size)
    both = [Record(u, y, dt=0.1, reference=u), Record(u, y, dt=0.1)]
    found = identify(both, Structure(1, 0), ThreeModel(starts=1, finish="likelihood"))
    told = [one for one in found.trace.decisions if "1 of 2 experiments without a reference" in one]
    assert len(told) == 1


@pytest.mark.slow
def test_experiments_without_a_reference_have_no_part_beside_those_with_one():
    rng, r = np.random.default_rng(5), np.repeat([0.0, 1.0, -1.0, 1.0], 100)
    noise = 0.02 * rng.standard_normal((r.size, 1))
    u, y = sampled_loop([[PLANT]], lambda k, y: 2.0 * (r[k] - y[0]), noise, 0.1)
    whole, alone = Record(u, y, dt=0.1, reference=r), Record(-u, y, dt=0.1)
    quick = ThreeModel(starts=1, finish="likelihood")
    found, own = (identify(one, Structure(2, 1), quick) for one in ([alone, whole], whole))
    np.testing.assert_array_equal(found.theta, own.theta)
    assert found.route == "reference"
    assert "samples-left-out" in {one.code for one in found.findings}
    direct = quick.estimate([alone, whole], Structure(2, 1))
    np.testing.assert_array_equal(direct.theta, own.theta)
    assert "samples-left-out" in {one.code for one in direct.findings}
    codes = [{one.code for one in validate(found, o).findings} for o in ([alone, whole], whole)]
    assert codes[0] == codes[1]


@pytest.mark.parametrize(
    "method",
    [
        ThreeModel(route="reference"),
        TwoStage(),
        Projection(),
        ClosedLoopRefinedInstrumentalVariable(TransferFunction([2.0, 1.0], [1.0, 0.0])),
    ],
    ids=lambda method: method.name,
)
def test_it_is_refused_where_it_is_asked_for(method):
    with pytest.raises(ConstantReferenceError, match=r"no reference that moves \(r\); expected"):
        identify(held(0.0), Structure(2, 1), method)


@pytest.mark.unjudged
@pytest.mark.slow
def test_one_experiment_that_moves_is_enough():
    rng, r = np.random.default_rng(1), np.repeat([0.0, 1.0, -1.0, 1.0], 150)

    def control(k, y):
        return 2.0 * (r[k] - y[0])

    u, y = sampled_loop([[PLANT]], control, 0.05 * rng.standard_normal((r.size, 1)), 0.1)
    found = identify([Record(u, y, dt=0.1, reference=r), held(0.0)], Structure(2, 1))
    assert found.route == "reference"
    assert np.all(np.abs(found.theta - [1.2, 4.0, 1.0, 2.0]) < 4.0 * found.std)


def two_loops(r1, r2, seed):
    """A plant of two inputs, each made by a controller of its own."""
    rng = np.random.default_rng(seed)

    def control(k, y):
        return [1.0 * (r1[k] - y[0]), 0.5 * (r2[k] - y[0])]

    plant = [[([2.0], [1.0, 1.5]), ([1.0], [1.0, 1.5])]]
    u, y = sampled_loop(plant, control, 0.05 * rng.standard_normal((r1.size, 1)), 0.1)
    return Record(u, y, dt=0.1, reference=np.column_stack([r1, r2]))


@pytest.mark.slow
def test_fewer_independent_references_than_inputs_are_a_warning():
    steps = np.repeat([0.0, 1.0, -1.0, 1.0], 100)
    structure = Structure(1, [[0, 0]])
    together = identify(two_loops(steps, 2.0 * steps, 0), structure, throw=False)
    (finding,) = [one for one in together.findings if one.code == "loop-not-excited"]
    assert finding.severity == "warning"
    assert "driven by one independent reference" in finding.message
    apart = identify(two_loops(steps, np.roll(steps, 37), 0), structure)
    assert "loop-not-excited" not in {one.code for one in apart.findings}
    assert np.all(np.abs(apart.theta - [1.5, 2.0, 1.0]) < 4.0 * apart.std)
