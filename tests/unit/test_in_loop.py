"""Plant and noise found together, in loops whose reference nobody recorded."""

from __future__ import annotations

from dataclasses import replace

import loops
import numpy as np
import pytest
from scipy.optimize import least_squares

from tridentify import Estimate, Record, Structure, ThreeModel, identify
from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.closed_loop.as_recorded import foretold
from tridentify.estimation.closed_loop.joint import Together, descended
from tridentify.estimation.closed_loop.predictor import Plant
from tridentify.estimation.closed_loop.settled import together
from tridentify.estimation.closed_loop.unstable_answer import open_loops
from tridentify.estimation.closed_loop.unstable_starts import starting_plants
from tridentify.estimation.methods.in_loop import NOT_HELD, found_together

NEARLY_ZERO = 1e-6


def sampled(seed: int, kind: str, n: int = 300) -> loops.Drawn:
    """A random loop with a sampled controller and a plant of one kind."""
    edge = {
        "stable": lambda rate: rate < loops.STABLE,
        "integrating": lambda rate: abs(rate) < NEARLY_ZERO,
        "unstable": lambda rate: rate > 0.05,
    }[kind]
    return loops.draw(
        seed,
        n=n,
        snr=20.0,
        excitation="prbs",
        of=lambda law, _: law.sampled,
        keep=lambda one: one.poles.size < 3 and bool(edge(one.poles.real.max())),
    )


def settled(drawn: loops.Drawn):
    """Plant and noise of a random loop, without its truth."""
    n = drawn.poles.size
    records = open_loops([drawn.record])
    return together(records, starting_plants(records, n, [drawn.theta.size - n - 1]))


@pytest.mark.slow
def test_errors_are_what_is_said_of_them():
    law, plant, n = loops.System.of([2.0], [1.0]), loops.System.of([1.0], [1.0, 1.0]), 300
    z = []
    for seed in range(30):
        rng = np.random.default_rng([seed, 77])
        reference = np.repeat(rng.choice([-1.0, 1.0], n // 20), 20)[:, None]
        noise = 0.1 * rng.standard_normal((n, 1))
        u, y = loops.run(plant, loops.Controller(law), reference, noise, np.zeros((n, 1)), 0.2)
        records = open_loops([Record(u, y, dt=0.2, intersample="zoh")])
        end = descended(Together.at(records, Plant(np.ones(1), (np.ones(1),)), np.zeros(0))).place
        z.append((end.plant.theta - 1.0) / np.sqrt(np.diag(end.cov)))
    assert 0.75 < np.std(z) < 1.3
    assert np.all(np.abs(np.mean(z, axis=0)) < 0.6)


@pytest.mark.parametrize("kind", ["stable", "integrating", "unstable"])
@pytest.mark.parametrize("seed", range(910_000, 910_003))
@pytest.mark.fast("910000-unstable")
def test_plants_of_all_kinds_are_found(kind, seed):
    drawn = sampled(seed, kind)
    found = settled(drawn)
    off = np.abs(found.found.plant.theta - drawn.theta)
    assert np.all((off < 5.0 * found.errors) | (off < 0.1 * np.abs(drawn.theta)))
    known = np.abs(drawn.theta) > NEARLY_ZERO
    assert np.all(found.errors[known] < 0.5 * np.abs(drawn.theta[known]))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["stable", "integrating", "unstable"])
def test_intervals_hold_the_truth(kind):
    z = []
    for seed in range(920_000, 920_040):
        drawn = sampled(seed, kind, n=500)
        found = settled(drawn)
        z.extend((found.found.plant.theta - drawn.theta) / found.errors)
    assert np.mean(np.abs(z) < 1.96) > 0.85


def test_the_slopes_are_derivatives_of_the_innovations():
    drawn = sampled(910_020, "unstable")
    n = drawn.poles.size
    plant = Plant(drawn.theta[:n], (drawn.theta[n:],))
    here = Together.at(open_loops([drawn.record]), plant, np.array([-0.3]))
    for k in range(drawn.theta.size + 1):
        step = np.zeros(drawn.theta.size + 1)
        step[k] = 1e-5
        both = [here.moved(sign * step).innovations for sign in (-1.0, 1.0)]
        slope = (both[0] - both[1]) / 2e-5
        # the start follows the coefficients: what it can make of a change is projected out
        basis = here._basis[0]
        slope = slope - basis @ (basis.T @ slope)
        own = here.columns[:, k]
        assert np.linalg.norm(slope - own) < 0.05 * np.linalg.norm(own)


@pytest.mark.parametrize("rate", [1e3, 1e9, 1e16, 1e80, 1e200])
def test_a_plant_on_which_nothing_hangs_is_no_end(rate):
    """A mode that is over at once, and a gain of next to nothing."""
    u, y = np.random.default_rng(3).standard_normal((2, 200))
    records = open_loops([Record(u, y, dt=1.0, intersample="zoh")])
    gone = Plant(np.array([rate, 0.7 * rate]), (np.array([0.04 * rate]),))
    assert together(records, [gone]) is None


def test_a_start_that_is_no_end_is_left_out():
    u, y = np.random.default_rng(3).standard_normal((2, 200))
    records = open_loops([Record(u, y, dt=1.0, intersample="zoh")])
    gone, near = (Plant(np.array([rate, rate]), (np.array([rate]),)) for rate in (1e16, 1.0))
    assert together(records, [gone, near]) is not None


@pytest.mark.slow
def test_an_integrator_rests_at_an_input_that_is_not_its_first():
    drawn = sampled(910_030, "integrating")
    moved = Record(drawn.record.u + 3.0, drawn.record.y + 7.0, dt=drawn.record.dt)
    one, other = settled(drawn), settled(replace(drawn, record=moved))
    np.testing.assert_allclose(
        one.found.plant.theta, other.found.plant.theta, atol=0.01 * one.errors.max()
    )


def test_steps_get_around_the_kink_of_the_mirrored_predictor():
    drawn = sampled(910_040, "integrating", n=500)
    n = drawn.poles.size
    records = open_loops([drawn.record])
    for edge in (1e-3, -1e-3):
        plant = Plant(drawn.theta[:n] + edge, (drawn.theta[n:],))
        assert descended(Together.at(records, plant, np.zeros(0))).still


def continuous(seed: int) -> loops.Drawn:
    """A stable plant under a fast continuous controller that feeds noise through."""
    return loops.draw(
        seed,
        n=400,
        snr=10.0,
        excitation="prbs",
        of=lambda law, kind: not law.sampled and kind == "lead",
        keep=lambda one: bool(one.poles.real.max() < loops.STABLE),
    )


def is_wrong(estimate: Estimate, drawn: loops.Drawn) -> bool:
    """Whether an estimate is plainly wrong by its own errors."""
    off = np.abs(estimate.theta - drawn.theta)
    return bool(np.any((off > 5.0 * estimate.std) & (off > 0.2 * np.abs(drawn.theta))))


def confident_and_wrong(drawn: loops.Drawn) -> tuple[bool, bool]:
    """Whether an estimate is plainly wrong, and whether that is said."""
    estimate = identify(drawn.record, drawn.structure, throw=False)
    wrong = is_wrong(estimate, drawn)
    decides = bool(estimate.trace.about(DecisionKind.BETWEEN_DECIDES))
    told = any(f.severity == "error" and f.code == "feedback" for f in estimate.findings)
    assert told or not decides
    return wrong, told


def said_to_be_held(seed: int, sampled: bool, n: int = 200, snr: float = 30.0) -> loops.Drawn:
    """A random loop whose record says that its input was held."""
    drawn = loops.draw(
        seed, n=n, snr=snr, of=lambda law, kind: law.sampled == sampled and kind != "LQG"
    )
    held = Record(drawn.record.u, drawn.record.y, dt=drawn.record.dt, intersample="zoh")
    return replace(drawn, record=held)


def told_of_between(estimate: Estimate) -> list[str]:
    """Severities of findings that say that coefficients hang on the input between its samples."""
    told = (DecisionKind.RESTS_ON_HELD.value[1:], DecisionKind.BETWEEN_DECIDES.value)
    return [
        one.severity
        for one in estimate.findings
        if one.code == "feedback" and any(words in one.effect for words in told)
    ]


@pytest.mark.parametrize("seed", [5_000, 5_003])
@pytest.mark.slow
def test_what_hangs_on_an_input_that_is_said_to_be_held_is_said(seed):
    drawn = said_to_be_held(seed, sampled=False)
    estimate = identify(drawn.record, drawn.structure, throw=False)
    assert told_of_between(estimate)
    assert "intersample='auto'" in next(o.remedy for o in estimate.findings if o.code == "feedback")


@pytest.mark.slow
def test_no_continuous_controller_that_is_said_to_hold_its_input_is_confident_and_wrong():
    """Where the controller is found at all: a test signal at every sample may hide it."""
    for seed in range(7_300, 7_312):
        drawn = said_to_be_held(seed, sampled=False, n=(200, 500)[seed % 2], snr=20.0)
        estimate = identify(drawn.record, drawn.structure, throw=False)
        if estimate.route != "direct":
            continue
        said = "error" in {one.severity for one in estimate.findings}
        assert said or told_of_between(estimate) or not is_wrong(estimate, drawn)


@pytest.mark.slow
def test_controllers_that_hold_their_input_are_believed():
    for seed in range(7_400, 7_412):
        drawn = said_to_be_held(seed, sampled=True, n=(200, 500)[seed % 2], snr=20.0)
        estimate = identify(drawn.record, drawn.structure, throw=False)
        assert not is_wrong(estimate, drawn)
        assert not any(NOT_HELD in one for one in estimate.trace.decisions)


@pytest.mark.slow
def test_an_input_that_moves_between_its_samples_is_said_to_decide():
    drawn = continuous(930_001)
    assert drawn.record.intersample == "auto"
    assert confident_and_wrong(drawn)[1]


@pytest.mark.slow
def test_no_loop_is_confident_and_wrong_where_nobody_knows_between_the_samples():
    found = [confident_and_wrong(continuous(seed)) for seed in range(930_002, 930_008)]
    assert sum(wrong and not told for wrong, told in found) <= 1


@pytest.mark.parametrize("seed", [720_004, 720_005])
@pytest.mark.slow
def test_a_record_taken_as_held_is_tried_as_moving_between_its_samples(seed):
    drawn = loops.draw(
        seed,
        n=200,
        snr=20.0,
        of=lambda law, kind: kind == "P" and not law.sampled,
        keep=lambda one: one.poles.size == 1,
    )
    record = Record(drawn.record.u, drawn.record.y, dt=drawn.record.dt, intersample="zoh")
    estimate = ThreeModel(route="direct").estimate([record], drawn.structure)
    found = found_together(estimate, [record], stated=False)
    assert found.trace.about(DecisionKind.BETWEEN_DECIDES)
    assert np.all(found.std > 3.0 * found_together(estimate, [record]).std)


def test_an_input_is_foretold_whatever_its_reference_does():
    rng = np.random.default_rng(2)
    n = 400
    law = loops.Controller(loops.System.of([2.0], [1.0]))
    plant = loops.System.of([1.0], [1.0, 1.0])
    reference = np.repeat(rng.choice([-1.0, 1.0], n // 40), 40)[:, None]
    noise = 0.02 * rng.standard_normal((n, 1))
    u, y = loops.run(plant, law, reference, noise, np.zeros((n, 1)), 0.2)
    left = (u - foretold(Record(u, y, dt=0.2)))[50:, 0]
    quiet = np.abs(left) < 0.5
    assert np.mean(quiet) > 0.9
    # what is left at rest is the controller's answer to the noise of the same sample
    assert np.corrcoef(left[quiet], noise[50:, 0][quiet])[0, 1] < -0.8


def test_what_the_route_cannot_do_stays_as_it_was():
    drawn = sampled(910_050, "stable")
    asked = Structure(1, 0, delay=0.1)
    estimate = ThreeModel(route="direct").estimate([drawn.record], asked)
    assert found_together(estimate, [drawn.record]) is estimate


@pytest.mark.slow
def test_what_is_known_of_the_plant_stays_and_narrows_the_rest():
    drawn = sampled(910_050, "stable")
    direct = ThreeModel(route="direct")
    free, known = (
        found_together(direct.estimate([drawn.record], asked), [drawn.record])
        for asked in (Structure(1, 0), Structure(1, 0, fixed={"a0": float(drawn.theta[0])}))
    )
    assert known.theta[0] == drawn.theta[0]
    assert known.std[0] == 0.0
    assert 0.0 < known.std[1] < free.std[1]
    assert abs(known.theta[1] - drawn.theta[1]) < 4.0 * known.std[1]


def risen(here: Together, k: int, value: float) -> float:
    """By how much the innovations are larger with one coefficient held [their variance]."""
    n = here.plant.theta.size
    found = np.concatenate([here.plant.theta, here.noise])
    sizes = np.sqrt(np.diag(here.cov))
    others = np.arange(found.size) != k

    def left(moved: np.ndarray) -> np.ndarray:
        place = found.copy()
        place[k] = value
        place[others] += moved * sizes[others]
        plant = here.plant.with_theta(place[:n])
        return Together.at(here.loops, plant, place[n:]).innovations

    along = here.cov[others, k] / here.cov[k, k] * (value - found[k]) / sizes[others]
    best = least_squares(left, along).fun
    return float(best @ best - here.size) / (here.size / (here.count - here.unknowns))


@pytest.mark.parametrize("seed", [768, 791, 817])
@pytest.mark.fast("791")
def test_errors_reach_to_where_the_likelihood_has_fallen(seed: int) -> None:
    drawn = loops.draw(
        seed, n=200, snr=10.0, of=lambda law, _: law.sampled, keep=lambda one: not one.coloured
    )
    n = drawn.poles.size
    records = open_loops([drawn.record])
    found = together(records, [Plant(drawn.theta[:n], (drawn.theta[n:],))])
    assert found is not None
    curved = np.sqrt(np.diag(found.found.cov))
    k = int(np.argmax(found.errors / curved))
    here = Together.at(records, found.found.plant, found.found.noise)
    falls = [
        min(risen(here, k, here.plant.theta[k] + side * size[k]) for side in (-2.0, 2.0))
        for size in (curved, found.errors)
    ]
    assert falls[0] < 0.6 * 2.0**2  # what it would be if the likelihood were as its curvature
    assert falls[1] > 0.7 * 2.0**2


def test_errors_of_a_loop_that_is_moved_well_are_those_of_the_curvature() -> None:
    drawn = loops.draw(752, n=1500, snr=20.0, excitation="prbs", of=lambda law, _: law.sampled)
    n = drawn.poles.size
    found = together(open_loops([drawn.record]), [Plant(drawn.theta[:n], (drawn.theta[n:],))])
    assert found is not None
    assert np.all(found.errors < 1.05 * np.sqrt(np.diag(found.found.cov)))
