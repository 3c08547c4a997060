"""A known controller: the loop's innovations are its noise, and how it worked shows."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from oracles import continuous_loop, sampled_loop
from tridentify import Record, Structure, ThreeModel, TransferFunction
from tridentify.estimation.closed_loop.innovations import ContinuousLoop, SampledLoop, Start
from tridentify.estimation.closed_loop.recorded_input import sampled_by
from tridentify.estimation.closed_loop.simulated import simulated

pytestmark = pytest.mark.unjudged

CHANNEL = ([1.0, 2.0], [1.0, 1.2, 4.0])
TRUE = np.array([1.2, 4.0, 1.0, 2.0])
PLANT = TransferFunction(*CHANNEL)
LAW = TransferFunction([2.0, 1.0], [1.0, 0.0])
STATES = (np.zeros((1, 1)), np.ones(1), np.array([1.0]), 2.0)
DT = 0.1
FROM_REST = Start(free=False, settled=False, offset=False)


def moved(rng, count, hold=15):
    return np.repeat(rng.choice([-1.0, 1.0], count // hold + 1), hold)[:count]


def continuous(seed=0, count=400, size=0.1, controller=STATES):
    """Noise held between the samples, as the controller reads it."""
    rng = np.random.default_rng(seed)
    r, e = moved(rng, count), size * rng.standard_normal(count)
    u, y = continuous_loop(CHANNEL, controller, r, e, DT)
    return Record(u, y, dt=DT, reference=r), e


def sampled(seed=0, count=400, size=0.1, rule="bilinear", limit=np.inf):
    rng = np.random.default_rng(seed)
    r, e = moved(rng, count), size * rng.standard_normal(count)
    num, den, _ = cont2discrete(([2.0, 1.0], [1.0, 0.0]), DT, method=rule)
    b, a = np.ravel(num), np.ravel(den)
    errors, given = [0.0], [0.0]

    def control(k, y):
        errors.append(r[k] - y[0])
        given.append(-a[1] * given[-1] + b[0] * errors[-1] + b[1] * errors[-2])
        given[-1] = float(np.clip(given[-1], -limit, limit))
        return given[-1]

    u, y = sampled_loop([[CHANNEL]], control, e[:, None], DT)
    return Record(u, y, dt=DT, reference=r), e


def test_innovations_at_the_truth_are_the_noise() -> None:
    """Of both kinds, to the last digits; the loops are simulated by other code."""
    record, e = continuous()
    part = simulated(record, PLANT, LAW)
    assert part is not None
    loop = ContinuousLoop(part, LAW, FROM_REST)
    assert np.allclose(loop.errors(PLANT, np.zeros(0)), e, atol=1e-9)
    assert np.abs(loop.input_left(PLANT, np.zeros(0))).max() < 1e-9
    record, e = sampled()
    found = SampledLoop(record, FROM_REST).errors(PLANT, np.zeros(0))
    assert np.allclose(found, e, atol=1e-9)


def test_innovations_follow_start_and_offset() -> None:
    """What the columns say is what the errors lose."""
    record, _ = continuous()
    part = simulated(record, PLANT, LAW)
    assert part is not None
    loop = ContinuousLoop(part, LAW, Start(free=True, settled=False, offset=True))
    rest = np.array([0.3, -0.2, 0.1])
    change = loop.errors(PLANT, np.zeros(3)) - loop.errors(PLANT, rest)
    assert np.allclose(change, loop.columns(PLANT) @ rest, atol=1e-12)


@pytest.mark.parametrize(
    ("rule", "words"),
    [("bilinear", "trapezoids"), ("backward_diff", "backward"), ("zoh", "held input")],
)
def test_the_rule_of_a_sampled_controller_is_found(rule: str, words: str) -> None:
    found = sampled_by([sampled(rule=rule)[0]], LAW)
    assert found.exact
    assert words in found.words


def test_a_continuous_controller_follows_no_rule() -> None:
    assert not sampled_by([continuous()[0]], LAW).exact


@pytest.mark.parametrize("made", [continuous, sampled])
@pytest.mark.fast("sampled")
def test_the_likeliest_is_taken_and_told(made) -> None:
    record = made(3)[0]
    found = ThreeModel(controller=LAW, noise="white").estimate([record], Structure(2, 1))
    how = "continuous" if made is continuous else "sampled by the rule of trapezoids"
    told = [one for one in found.trace.decisions if "controller as given" in one]
    assert told
    assert how in told[0]
    assert "likeliest" in told[0]
    assert np.all(np.abs(found.theta - TRUE) < 4.0 * found.std)
    assert found.loop is not None
    assert found.loop.sampling == how.split(maxsplit=1)[0]


@pytest.mark.slow
def test_a_fixed_coefficient_stays_where_it_is() -> None:
    structure = Structure(2, 1, fixed={"a0": 4.0})
    record = sampled(4)[0]
    found = ThreeModel(controller=LAW, noise="white").estimate([record], structure)
    assert found.parameters["a0"].value == 4.0
    assert found.parameters["a0"].std == 0.0
    assert any("likeliest" in one for one in found.trace.decisions)
    assert np.all(np.abs(found.theta - TRUE)[[0, 2, 3]] < 4.0 * found.std[[0, 2, 3]])


@pytest.mark.slow
def test_a_controller_with_a_limit_is_not_believed() -> None:
    """The input runs into its limit: the controller given did not make it."""
    record = sampled(5, 300, limit=1.2)[0]
    found = ThreeModel(controller=LAW, noise="white").estimate([record], Structure(2, 1))
    assert "contradiction" in {one.code for one in found.findings}
    assert found.loop is not None
    assert found.loop.controller is None
    assert np.all(np.abs(found.theta - TRUE) < 4.0 * found.std)


@pytest.mark.slow
def test_an_incomplete_record_keeps_the_root() -> None:
    record, _ = sampled(6)
    y = np.array(record.y)
    y[50] = np.nan
    gone = Record(record.u, y, dt=DT, reference=record.reference)
    found = ThreeModel(controller=LAW, noise="white").estimate([gone], Structure(2, 1))
    assert any("needs complete" in one for one in found.trace.decisions)


@pytest.mark.slow
def test_what_the_noise_drives_makes_it_more_precise() -> None:
    """Strong noise in a sampled loop: by the mean square of errors and by what is claimed."""
    errors, claimed = {"given": [], "sampled": []}, {"given": [], "sampled": []}
    for seed in range(60):
        record = sampled(seed, 600, 0.8)[0]
        for name, law in (("given", LAW), ("sampled", "sampled")):
            method = ThreeModel(controller=law, noise="white", finish="likelihood")
            found = method.estimate([record], Structure(2, 1))
            errors[name].append((found.theta - TRUE) / found.std)
            claimed[name].append(found.std)
    ratio = np.median(claimed["given"], axis=0) / np.median(claimed["sampled"], axis=0)
    assert np.all(ratio < 1.0)
    assert ratio.min() < 0.9
    held = np.mean(np.abs(errors["given"]) < 1.96)
    assert 0.90 < held < 0.99


def test_a_rule_needs_no_start_of_the_controller() -> None:
    """Whatever the integrator held before the record is a constant of the input."""
    record = sampled(7)[0]
    shifted = Record(np.asarray(record.u) + 3.0, record.y, dt=DT, reference=record.reference)
    assert sampled_by([shifted], LAW).exact


def test_noise_that_is_filtered_before_the_controller_is_no_rule() -> None:
    """The controller reads something else than what was recorded."""
    record = sampled(8)[0]
    smooth = lfilter([0.3], [1.0, -0.7], np.asarray(record.y)[:, 0])
    assert not sampled_by([Record(record.u, smooth, dt=DT, reference=record.reference)], LAW).seen


def by_lines(held: Record) -> Record:
    """The same with an input that is not stated to be held; its reference is."""
    return Record(
        held.u, held.y, dt=DT, reference=held.reference, intersample="foh",
        reference_intersample="zoh",
    )  # fmt: skip


def test_a_gain_alone_meets_its_rule_however_it_works() -> None:
    """Whether its output was held is told by the record that says so, and by nothing else."""
    from tridentify.estimation.methods.by_reference.given_controller import rule_of

    gain = TransferFunction([2.0], [1.0])
    held, _ = continuous(controller=(np.zeros((0, 0)), np.zeros(0), np.zeros(0), 2.0))
    smooth = by_lines(held)
    stated = rule_of([held], Structure(2, 1), gain)
    assert stated is not None
    assert stated.exact
    assert rule_of([smooth], Structure(2, 1), gain) is None


@pytest.mark.slow
@pytest.mark.parametrize("seed", [61, 62, 63])
def test_a_continuous_gain_is_not_taken_as_sampled(seed: int) -> None:
    held, _ = continuous(seed, controller=(np.zeros((0, 0)), np.zeros(0), np.zeros(0), 2.0))
    method = ThreeModel(controller=TransferFunction([2.0], [1.0]))
    found = method.estimate([by_lines(held)], Structure(2, 1))
    assert np.abs((found.theta - TRUE) / found.std).max() < 4.0
