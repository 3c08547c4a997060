"""What the reference drives, apart from the noise that a continuous controller feeds back."""

import numpy as np
import pytest
from scipy.linalg import expm

from tridentify import Record, Structure, ThreeModel, TransferFunction, simulate
from tridentify.estimation.closed_loop.between_samples import Loop
from tridentify.estimation.closed_loop.driven import driven, widest
from tridentify.estimation.closed_loop.noise_driven import apart_from_noise, beside_noise

PLANT = TransferFunction([1.0, 1.0], [1.0, 0.5, 1.0])
DT = 0.1


def loop_of(reference, noise):
    """Input and output of ``u = r - (10 + 15 / s) y``, the noise held between the samples."""
    a = np.array([[-0.5, 1.0, 0.0], [-1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    by_u = np.array([1.0, 1.0, 0.0])
    law = np.array([-10.0, 0.0, 15.0])
    a = a + np.outer(by_u, law)
    b = np.column_stack([by_u, -10.0 * by_u - np.array([0.0, 0.0, 1.0])])
    grown = expm(np.block([[a, b], [np.zeros((2, 5))]]) * DT)
    x, u, y = np.zeros(3), [], []
    for r, v in zip(reference, noise, strict=True):
        y.append(x[0] + v)
        u.append(law @ x + r - 10.0 * v)
        x = grown[:3, :3] @ x + grown[:3, 3:] @ np.array([r, v])
    return np.array(u), np.array(y)


def steps(n):
    return np.repeat(np.random.default_rng(7).choice([-1.0, 1.0], n // 25 + 1), 25)[:n]


@pytest.fixture(scope="module")
def noisy():
    """A loop, its noise, and the input as it would be without."""
    n = 2000
    r, v = steps(n), 0.02 * np.random.default_rng(1).standard_normal(n)
    u, y = loop_of(r, v)
    record = Record(u, y, dt=DT, reference=r)
    return record, v, loop_of(r, np.zeros(n))[0]


def residual(loop):
    """What the plant leaves where the rest of the input counts as held."""
    left = loop.record.y - simulate(PLANT, loop.instrument) - loop.beside(PLANT)
    return left - left.mean(axis=0)


def far(part, truth):
    return float(np.std(part.inputs[:, 0] - truth) / np.std(truth))


@pytest.mark.slow
def test_the_noise_between_samples_colours_what_the_plant_leaves(noisy):
    record, v, _ = noisy
    left = residual(Loop(driven(record, between=True), "continuous"))[:, 0]
    assert np.std(left - v) > 0.2 * np.std(v)


def test_the_driven_input_is_found_apart_from_the_noise(noisy):
    record, v, truth = noisy
    loop = Loop(driven(record, between=True), "continuous")
    left = residual(loop)
    found = far(apart_from_noise(loop, PLANT, left), truth)
    known = widest(record, loop.driven.rate, loop.driven.before)
    assert found < 0.1 * far(loop.driven, truth)
    assert found < 0.25 * far(beside_noise(loop.driven, left), truth)
    # as well as if the noise itself were known
    assert found < 1.5 * far(beside_noise(known, v[:, None]), truth) + 1e-3


def test_a_short_record_keeps_its_operators(noisy):
    record, v, _ = noisy
    short = Record(record.u[:60], record.y[:60], dt=DT, reference=record.reference[:60])
    loop = Loop(driven(short, between=True), "continuous")
    assert np.array_equal(
        apart_from_noise(loop, PLANT, v[:60, None]).weights,
        beside_noise(loop.driven, v[:60, None]).weights,
    )


@pytest.mark.slow
def test_two_outputs_are_each_told_from_their_noise():
    n = 2000
    r = np.column_stack([steps(n), np.roll(steps(n), 700)])
    v = 0.02 * np.random.default_rng(3).standard_normal((n, 2))
    loops = [loop_of(r[:, k], v[:, k]) for k in range(2)]
    truth = np.column_stack([loop_of(r[:, k], np.zeros(n))[0] for k in range(2)])
    u, y = (np.column_stack(one) for one in zip(*loops, strict=True))
    plant = TransferFunction(
        [[[1.0, 1.0], [0.0]], [[0.0], [1.0, 1.0]]], [[[1.0, 0.5, 1.0]] * 2] * 2
    )
    loop = Loop(driven(Record(u, y, dt=DT, reference=r), between=True), "continuous")
    left = loop.record.y - simulate(plant, loop.instrument) - loop.beside(plant)
    part = apart_from_noise(loop, plant, left - left.mean(axis=0))
    before = np.std(loop.driven.inputs - truth, axis=0)
    assert np.all(np.std(part.inputs - truth, axis=0) < 0.3 * before)


@pytest.mark.slow
def test_coarse_samples_of_a_continuous_loop_are_unbiased():
    r = steps(1500)
    structure, true = Structure(2, 1), np.array([0.5, 1.0, 1.0, 1.0])
    errors, held, scaled = [], [], []
    for seed in range(24):
        v = 0.02 * np.random.default_rng(100 + seed).standard_normal(r.size)
        u, y = loop_of(r, v)
        method = ThreeModel(controller="continuous")
        found = method.estimate([Record(u, y, dt=DT, reference=r)], structure)
        errors.append(found.theta - true)
        held.append(np.abs(errors[-1]) < 1.96 * found.std)
        scaled.append(errors[-1] / found.std)
    e = np.array(errors)
    z = e.mean(axis=0) / (e.std(axis=0, ddof=1) / np.sqrt(len(e)))
    assert np.all(np.abs(z) < 3.5)
    assert np.mean(held) > 0.85
    # without what comes back through the driven input, that of the direct gain is 1.3 to 1.4
    assert np.all(np.sqrt(np.mean(np.square(scaled), axis=0)) < 1.35)
