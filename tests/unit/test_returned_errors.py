"""Errors of coefficients that come back through a driven input which hangs on the model."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import loops
import numpy as np
import pytest
from scipy.linalg import toeplitz

from oracles import continuous_loop
from tridentify import Record, Structure, ThreeModel, TransferFunction, simulate
from tridentify.estimation.closed_loop.driven import described_otherwise, driven
from tridentify.estimation.closed_loop.noise_driven import colour
from tridentify.estimation.methods.by_reference.passes import apart, model_like, root, without_rest
from tridentify.estimation.methods.by_reference.reference import Loop
from tridentify.estimation.methods.by_reference.returned_errors import (
    _back,
    _no_less,
    _sparing,
    _tables,
    with_returned_errors,
)
from tridentify.estimation.methods.output_error import OutputError

N, DT = 800, 0.1


def returned(found):
    """``(Z' T)^{-1} Z' Z`` of the free coefficients, and the same without what returns."""
    free = np.flatnonzero(found.estimate.std > 0)
    return _back(_tables(found, free), free)[:2]


CHANNEL = ([1.0, 1.0], [1.0, 0.5, 1.0])
PI = (np.zeros((1, 1)), np.ones(1), np.array([15.0]), 10.0)
SLOW = (np.zeros((1, 1)), np.ones(1), np.array([0.3]), 0.2)
STRUCTURE = Structure(2, 1)


def silent(_: str) -> None:
    pass


def record_of(seed: int, law: tuple = PI) -> Record:
    rng = np.random.default_rng(seed)
    r = np.repeat(rng.choice([-1.0, 1.0], N // 20), 20)
    u, y = continuous_loop(CHANNEL, law, r, 0.015 * rng.standard_normal(N), DT)
    return Record(u, y, dt=DT, reference=r)


def rooted(record: Record):
    """The root with white noise, its driven input apart from the noise."""
    near = partial(OutputError, max_passes=60)
    first = near(TransferFunction(*CHANNEL))
    loops = [Loop(driven(record, between=True), "continuous")]
    begun = root(loops, STRUCTURE, first.estimate([loops[0].instrument], STRUCTURE), near, silent)
    return near, root(begun.loops, STRUCTURE, begun.estimate, near, silent, 12, renewed=True)


@pytest.mark.slow
def test_they_are_what_a_pass_makes_of_moved_coefficients():
    """The passes' own derivative, by a pass from coefficients that are one error off."""
    near, found = rooted(record_of(3))
    estimate = found.estimate

    def image(theta):
        model = model_like(estimate, theta)
        loops = apart(found.loops, estimate, model)
        pairs = [without_rest(one, model) for one in loops]
        return near(model).estimate(pairs, STRUCTURE).theta

    theta, std = np.array(estimate.theta), np.array(estimate.std)
    own = image(theta)
    passed = np.column_stack([(image(theta + h) - own) / h.sum() for h in np.diag(std)])
    back, held = returned(found)
    # in units of the errors
    apart_by = (np.linalg.inv(back) - (np.eye(4) - passed)) * std / std[:, None]
    assert np.abs(passed * std / std[:, None]).max() > 0.12
    assert np.abs(apart_by).max() < 0.015
    assert back[2, 2] > 1.15 * held[2, 2]


@pytest.mark.slow
def test_the_errors_are_widened_and_told():
    estimate = ThreeModel(controller="continuous").estimate([record_of(3)], STRUCTURE)
    assert any("hangs on the model" in one for one in estimate.trace.decisions)


@pytest.mark.slow
def test_nothing_comes_back_where_the_samples_are_the_input():
    estimate = ThreeModel(controller="sampled").estimate([record_of(4)], STRUCTURE)
    assert not any("hangs on the model" in one for one in estimate.trace.decisions)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, 5, 6])
def test_little_comes_back_where_the_samples_tell_the_input(seed):
    back, held = returned(rooted(record_of(seed, SLOW))[1])
    assert np.sqrt(np.diag(back) / np.diag(held)).max() < 1.05


@pytest.mark.slow
def test_nothing_comes_back_of_a_root_that_was_not_found_with_a_model():
    record = record_of(5)
    near = partial(OutputError, max_passes=60)
    loops = [Loop(driven(record, between=True), "continuous")]
    first = near(TransferFunction(*CHANNEL)).estimate([loops[0].instrument], STRUCTURE)
    found = root(loops, STRUCTURE, first, near, silent)
    back, held = returned(found)
    np.testing.assert_allclose(back, held, rtol=1e-12)
    after, told = with_returned_errors(found)
    assert told == ""
    assert after.loops is found.loops
    np.testing.assert_array_equal(after.estimate.theta, found.estimate.theta)
    np.testing.assert_allclose(after.estimate.cov, back @ found.estimate.cov @ back.T, rtol=1e-9)


def test_errors_are_those_of_the_record_where_the_input_is_mostly_noise():
    """A held input under high gain, 150 samples: the passes' own derivative once more."""
    rng = np.random.default_rng(7)
    r = np.repeat([1.0, -1.0, 1.0, 1.0, -1.0, -1.0], 25)
    noise, slow = 0.5 * rng.standard_normal(r.size), np.exp(-0.05)
    u, y, state, summed = np.zeros(r.size), np.zeros(r.size), 0.0, 0.0
    for k in range(r.size):
        y[k] = state + noise[k]
        u[k] = 8.0 * (r[k] - y[k]) + summed
        summed += 0.4 * (r[k] - y[k])
        state = slow * state + (1.0 - slow) / 0.5 * u[k]
    structure, truth = Structure(1, 0), TransferFunction([1.0], [1.0, 0.5])
    near = partial(OutputError, max_passes=60)
    loops = [Loop(driven(Record(u, y, dt=DT, reference=r)), "sampled")]
    first = near(truth).estimate([loops[0].instrument], structure)
    found = root(loops, structure, first, near, silent)
    theta, std = np.array(found.estimate.theta), np.array(found.estimate.std)

    def image(theta):
        model = model_like(found.estimate, theta)
        return near(model).estimate([without_rest(loops[0], model)], structure).theta

    step = 0.1 * std
    passed = np.column_stack([(image(theta + h) - image(theta)) / h.sum() for h in np.diag(step)])
    back, held = returned(found)
    np.testing.assert_array_equal(back, held)
    apart_by = (np.linalg.inv(back) - (np.eye(2) - passed)) * std / std[:, None]
    assert np.abs(passed * std / std[:, None]).max() > 0.1
    assert np.abs(apart_by).max() < 0.03


@pytest.mark.slow
def test_what_the_controller_makes_of_noise_between_samples_colours_the_errors():
    """The colour by one sample of noise in the loop itself; the errors with its whole matrix."""
    _, found = rooted(record_of(6))
    loop = found.loops[0]
    estimate = replace(found.estimate, errors="likelihood")
    pulse = np.eye(1, N)[0]
    u, y = continuous_loop(CHANNEL, PI, np.zeros(N), pulse, DT)
    made = simulate(TransferFunction(*CHANNEL), Record(u, np.zeros(N), dt=DT))[:, 0]
    response = colour(loop, estimate.model)[:, 0, 0]
    assert abs(y - made)[1] > 0.3
    np.testing.assert_allclose(response, y - made, atol=0.04)

    z = np.column_stack(
        [
            simulate(model_like(estimate, np.array(estimate.theta) + h), loop.instrument)[:, 0]
            - simulate(estimate.model, loop.instrument)[:, 0]
            for h in np.diag(estimate.std)
        ]
    )
    z = z / estimate.std
    by_hand = np.linalg.inv(z.T @ z) * estimate.noise_variance[0]
    estimate = replace(estimate, cov=by_hand)
    whole = toeplitz(response, np.zeros(N)) / np.linalg.norm(response)
    middle = by_hand @ z.T @ whole @ whole.T @ z @ by_hand / estimate.noise_variance[0]
    back = returned(found)[0]
    after = with_returned_errors(replace(found, estimate=estimate))[0].estimate
    np.testing.assert_allclose(after.std, np.sqrt(np.diag(back @ middle @ back.T)), rtol=0.03)
    assert np.max(after.std / np.sqrt(np.diag(back @ by_hand @ back.T))) > 1.3


def swing(law: tuple, dt: float) -> float:
    """By how much other descriptions of a driven input differ from it, in its own size."""
    rng = np.random.default_rng(8)
    r = np.repeat(rng.choice([-1.0, 1.0], 10), 20)
    u, y = continuous_loop(CHANNEL, law, r, 0.1 * rng.standard_normal(r.size), dt)
    part = driven(Record(u, y, dt=dt, reference=r), between=True)
    own, others = part.inputs_between(1), described_otherwise(part)
    return max(float(np.std(one.inputs_between(1) - own)) for one in others) / float(np.std(own))


def test_descriptions_of_a_driven_input_differ_where_the_loop_is_fast_for_its_samples():
    assert swing(PI, 2.5 * DT) > 5.0 * swing(SLOW, DT)


def coarse(seed: int) -> loops.Drawn:
    """A short record of a loop with a continuous controller that is fast for its samples."""
    return loops.draw(
        seed,
        n=200,
        snr=20.0,
        excitation="prbs",
        of=lambda law, kind: not law.sampled and kind != "LQG",
        keep=lambda one: (
            bool(one.poles.real.max() < loops.STABLE)
            and driven(referenced(one), between=True).rate * one.record.dt > 0.9
        ),
    )


def referenced(drawn: loops.Drawn) -> Record:
    seen = drawn.record
    return Record(seen.u, seen.y, dt=seen.dt, reference=drawn.reference)


@pytest.mark.slow
def test_errors_reach_the_truth_in_loops_that_are_fast_for_their_samples():
    """Of 16 loops; without other descriptions two in five hold the truth, and half are far off."""
    z = []
    for seed in range(46_000, 46_016):
        drawn = coarse(seed)
        found = ThreeModel(controller="continuous").estimate([referenced(drawn)], drawn.structure)
        z.extend((found.theta - drawn.theta) / found.std)
    assert np.mean(np.abs(z) < 2.5) > 0.65
    assert np.mean(np.abs(z) < 5.0) > 0.85


def test_orders_of_noise_that_chance_chose_make_no_error_smaller():
    rng = np.random.default_rng(9)
    noise = np.zeros((400, 1))
    for k in range(1, 400):
        noise[k] = 0.7 * noise[k - 1] + rng.standard_normal(1)
    assert _sparing(noise, (np.array([-0.7]),)) is None
    far = np.concatenate([[-0.7], np.zeros(11)])
    far[-1] = 0.1
    response = _sparing(noise, (far,))
    np.testing.assert_allclose(response[:3, 0, 0], [1.0, 0.7, 0.49], atol=0.1)
    tall, low = np.array([[4.0, 1.0], [1.0, 1.0]]), np.diag([1.0, 9.0])
    np.testing.assert_allclose(_no_less(tall, low), [[4.0, 3.0], [3.0, 9.0]])


@pytest.mark.slow
def test_an_end_whose_errors_follow_the_reference_gives_way_to_a_stable_plant():
    """A slow pole ends to the right of zero; the plant that is stable explains what that misses."""
    theta, rng, dt = np.array([1.8, 1.0, 0.175, 0.28, 0.45]), np.random.default_rng(12), 0.48
    moved = np.repeat(rng.standard_normal(100), 2)
    noise = np.repeat(0.045 * rng.standard_normal(200), loops.FINE)
    plant, law = loops.System.of(theta[3:], np.r_[1.0, theta[:3]]), loops.System.of([5.7], [1.0])
    held = loops.Controller(law, False)
    u, y = loops.run(plant, held, np.zeros((200, 1)), noise[:, None], moved[:, None], dt)
    record = Record(u, y, dt=dt, reference=moved)
    found = ThreeModel(controller="continuous", noise="white").estimate([record], Structure(3, 1))
    assert found.model.is_stable
    assert np.max(np.abs(found.theta - theta) / found.std) < 2.0
