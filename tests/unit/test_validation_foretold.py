"""A plant that is not stable is judged by what its predictor leaves, one sample ahead."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tridentify import (
    Record,
    Structure,
    ThreeModel,
    TransferFunction,
    identify,
    simulate,
    validate,
)
from tridentify.estimation.answer.loop_taken import LoopTaken
from tridentify.estimation.closed_loop.as_recorded import jumps
from tridentify.judgement.causes.attempts.told_apart import loop_findings, rests

DT, N = 0.05, 400
SLOW = TransferFunction([1.0], [1.0, 0.05])


def record_of(model: TransferFunction, seed: int, noise: float = 0.05) -> Record:
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(N // 8), 8)
    y = simulate(model, Record(u, u, dt=DT))
    return Record(u, y + noise * rng.standard_normal(y.shape), dt=DT)


def foretold(record: Record, structure: Structure):
    """An estimate taken for one of the mirrored predictor."""
    found = identify(record, structure)
    return replace(found, route="direct", loop=LoopTaken("sampled", mirrored=True), findings=())


@pytest.mark.slow
@pytest.mark.unjudged
def test_a_right_one_passes_on_its_own_record_and_on_another() -> None:
    own = record_of(SLOW, 1)
    estimate = foretold(own, Structure(1, 0))
    for record in (own, record_of(SLOW, 2)):
        told = validate(estimate, record)
        assert told.ok
        assert [one.name for one in told.tests] == ["white", "past inputs"]
        assert "one sample ahead" in told.verdict
        assert told.residual[0].shape == told.innovations[0].shape == (N, 1)
        assert "white" in told.summary()


@pytest.mark.unjudged
def test_a_response_that_is_missing_is_found_in_what_it_leaves() -> None:
    second = TransferFunction([9.0], [1.0, 1.2, 9.0])
    record = record_of(second, 3)
    told = validate(foretold(record, Structure(1, 0)), record)
    assert not told.ok
    assert "unmodelled-response" in [one.code for one in told.findings]


@pytest.mark.unjudged
def test_where_there_is_no_predictor_it_says_so_and_does_not_pass() -> None:
    one = [[[1.0]], [[2.0]]]
    record = record_of(TransferFunction(one, [[[1.0, 0.5]], [[1.0, 0.5]]]), 4)
    told = validate(foretold(record, Structure(1, [[0], [0]])), record)
    assert not told.ok
    assert told.tests == ()
    assert told.verdict.startswith("No verdict")
    assert "Nothing was tested" in told.summary()


def test_an_input_that_rests_while_outputs_move_is_no_linear_controllers() -> None:
    """A direct part tells the input from the output as a controller would."""
    rng = np.random.default_rng(5)
    u = np.repeat(rng.standard_normal(N // 4), 4)
    record = Record(u, 2.0 * u + 0.01 * rng.standard_normal(N), dt=DT, intersample="zoh")
    assert rests([record], 0)
    assert loop_findings([record], 2, ("u",), reacts=False) == []
    y = rng.standard_normal(N)
    assert not rests([Record(-0.5 * y, y, dt=DT)], 0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_direct_part_is_no_loop_and_is_named(seed: int) -> None:
    rng = np.random.default_rng([seed, 71])
    u = np.repeat(rng.standard_normal(160), 4)
    y = simulate(TransferFunction([1.0, 8.7, -12.0], [1.0, 8.7, 44.0]), Record(u, u, dt=DT))[:, 0]
    record = Record(u, y + 0.05 * np.std(y) * rng.standard_normal(y.size), dt=DT)
    estimate = identify(record, Structure(2, 0), throw=False)
    assert estimate.route == "open-loop"
    told = validate(estimate, record)
    assert (told.findings[0].code, "2 zeros" in told.findings[0].message) == ("order-low", True)


@pytest.mark.unjudged
def test_a_loop_without_its_reference_is_told_of_no_response() -> None:
    """There the controller makes inputs of past noise, and so do mirrored poles the errors."""
    record = record_of(TransferFunction([9.0], [1.0, 1.2, 9.0]), 3)
    told = validate(replace(foretold(record, Structure(1, 0)), route="reference"), record)
    assert [one.name for one in told.tests] == ["white"]
    assert any("--reference" in one for one in told.notes)


GAIN = 4.0


def continuous_loop(seed: int, noise: float) -> Record:
    """An integrator whose proportional controller works at all times, with a switched reference."""
    rng = np.random.default_rng(seed)
    r = np.repeat(rng.choice([-1.0, 1.0], N // 8), 8)
    y, left = np.zeros(N), np.exp(-GAIN * DT)
    for k in range(N - 1):
        y[k + 1] = r[k] + (y[k] - r[k]) * left
    told = y + noise * rng.standard_normal(N)
    return Record(GAIN * (r - y), told, dt=DT, reference=r)


@pytest.mark.unjudged
def test_an_input_jumps_where_its_reference_does_and_with_it_alone() -> None:
    record = continuous_loop(0, 0.0)
    moves = np.diff(record.reference, axis=0, prepend=record.reference[:1])
    np.testing.assert_allclose(jumps(record), GAIN * moves, atol=1e-9)
    assert not jumps(Record(record.u, record.y, dt=DT)).any()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_what_a_continuous_controller_does_between_the_samples_is_no_response(seed: int) -> None:
    record = continuous_loop(seed, 0.01)
    estimate = identify(record, Structure(1, 0), ThreeModel(controller="continuous"))
    assert estimate.loop.mirrored
    told = validate(estimate, record)
    assert told.ok
    assert [one.name for one in told.tests] == ["white", "past references"]
