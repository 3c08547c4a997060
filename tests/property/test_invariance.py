"""What must hold for any record: units, time scales, superposition, order of channels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from oracles import by_exponential
from tridentify import Record, Structure, ThreeModel, TransferFunction, identify, simulate

pytestmark = pytest.mark.unjudged

# shares of what the profile has: `make test` is content with few
FEW = settings(max_examples=max(1, settings.default.max_examples // 12), deadline=None)
SOME = settings(max_examples=max(1, settings.default.max_examples // 4), deadline=None)
DT = 0.05
INTERSAMPLE = st.sampled_from(["zoh", "foh"])
SEED = st.integers(0, 10_000)
EXPONENT = st.integers(-8, 8)


def levels(n_samples, hold, rng):
    return np.repeat(rng.standard_normal(-(-n_samples // hold)), hold)[:n_samples]


def respond(num, den, u, dt=DT):
    return by_exponential(num, den, u, dt)


def plant(rng, n=2):
    """A random stable system whose modes the record can show: (num, den)."""
    roots = []
    while len(roots) < n - 1:
        omega, damping = np.exp(rng.uniform(0.3, 2.0)), rng.uniform(0.15, 0.9)
        root = omega * complex(-damping, np.sqrt(1.0 - damping**2))
        roots += [root, root.conjugate()]
    if len(roots) < n:
        roots.append(-np.exp(rng.uniform(-0.5, 1.5)))
    den = np.real(np.poly(roots))
    zero = rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(0.0, 2.0))
    return den[-1] * np.array([-1.0 / zero, 1.0]), den


def noisy(seed, n=2, noise=0.05, n_samples=400):
    rng = np.random.default_rng(seed)
    num, den = plant(rng, n)
    u = levels(n_samples, 4, rng)
    y = respond(num, den, u)
    return u, y + noise * np.std(y) * rng.standard_normal(n_samples)


# -------------------------------------------------------------------------------- estimation
def same(one, other, expected_theta, expected_std):
    """Equal up to the stop of the passes, a thousandth of a standard error."""
    assert np.all(np.abs(one.theta - expected_theta) <= 2e-3 * expected_std)
    assert np.allclose(one.std, expected_std, rtol=1e-3)
    assert np.allclose(one.fit, other.fit, rtol=1e-5)


@FEW
@given(seed=SEED, u_exponent=EXPONENT, y_exponent=EXPONENT, n=st.sampled_from([1, 2, 3]))
def test_units_scale_the_numerator_and_leave_the_denominator(seed, u_exponent, y_exponent, n):
    u, y = noisy(seed, max(n, 2)) if n > 1 else noisy(seed, 2, noise=0.2)
    c, d = 2.0**u_exponent, 2.0**y_exponent
    structure = Structure(n, 0 if n == 1 else 1)
    plain = identify(Record(u, y, dt=DT), structure, throw=False)
    scaled = identify(Record(c * u, d * y, dt=DT), structure, throw=False)
    factor = np.where([name.startswith("a") for name in plain.names], 1.0, d / c)
    same(scaled, plain, factor * plain.theta, factor * plain.std)
    assert scaled.structure == plain.structure
    assert scaled.status is plain.status


@FEW
@given(seed=SEED, u_exponent=EXPONENT, y_exponent=EXPONENT, n=st.sampled_from([2, 3, 4]))
def test_units_without_noise_scale_exactly(seed, u_exponent, y_exponent, n):
    u, y = noisy(seed, n, noise=0.0)
    c, d = 2.0**u_exponent, 2.0**y_exponent
    plain = identify(Record(u, y, dt=DT), Structure(n, 1))
    scaled = identify(Record(c * u, d * y, dt=DT), Structure(n, 1))
    factor = np.where([name.startswith("a") for name in plain.names], 1.0, d / c)
    assert np.allclose(scaled.theta, factor * plain.theta, rtol=1e-9)


@FEW
@given(seed=SEED, exponent=st.integers(-25, 25), n=st.sampled_from([2, 3, 4]))
def test_time_scale_moves_coefficients_by_powers(seed, exponent, n):
    u, y = noisy(seed, n)
    faster = 2.0**exponent
    structure = Structure(n, 1)
    plain = identify(Record(u, y, dt=DT), structure, throw=False)
    quick = identify(Record(u, y, dt=DT / faster), structure, throw=False)
    powers = np.array([n - int(name[1:]) for name in plain.names], float)
    factor = faster**powers
    same(quick, plain, factor * plain.theta, factor * plain.std)
    assert quick.structure == plain.structure


@FEW
@given(seed=SEED, offset=st.floats(-1e3, 1e3), trim=st.floats(-1e3, 1e3))
def test_trim_does_not_move_coefficients_that_are_free_of_it(seed, offset, trim):
    u, y = noisy(seed)
    structure = Structure(2, 1, offset=True, initial_state="free")
    record, trimmed = Record(u, y, dt=DT), Record(u + trim, y + offset, dt=DT)
    plain, moved = identify(record, structure), identify(trimmed, structure)
    same(moved, plain, plain.theta, plain.std)
    left = moved.residual(trimmed) - plain.residual(record)
    assert np.max(np.abs(left)) < 0.01 * np.std(plain.residual(record))


@FEW
@given(seed=SEED, scale=st.sampled_from([1e-7, 1.0, 1e7]))
def test_order_of_outputs_only_permutes(seed, scale):
    rng = np.random.default_rng(seed)
    _, den = plant(rng)
    u = levels(300, 4, rng)
    y = np.stack([respond(num, den, u) for num in ([1.0, 2.0], [scale * 3.0])], axis=1)
    y = y + 0.05 * np.std(y, axis=0) * rng.standard_normal(y.shape)
    first = identify(Record(u, y, dt=DT), Structure(2, [[1], [0]]))
    second = identify(Record(u, y[:, ::-1], dt=DT), Structure(2, [[0], [1]]))
    order = [0, 1, 3, 4, 2]
    assert np.all(np.abs(first.theta - second.theta[order]) < 2e-3 * first.std)
    assert np.allclose(first.std, second.std[order], rtol=1e-3)


@FEW
@given(seed=SEED)
def test_the_same_record_twice_halves_the_variance(seed):
    # Noise that comes twice is not white: a test of whiteness has every right to object, and errors
    # from the scatter of the scores have it too.
    method = ThreeModel(noise="white")
    u, y = noisy(seed)
    record = Record(u, y, dt=DT)
    structure = Structure(2, 1, offset=False, initial_state="rest")
    once = identify(record, structure, method)
    twice = identify([record, record], structure, method)
    assert np.all(np.abs(once.theta - twice.theta) < 2e-3 * once.std)
    assume(twice.errors == once.errors)
    assert np.allclose(once.std / twice.std, np.sqrt(2.0), rtol=0.02)


# -------------------------------------------------------------------------------- simulation
@SOME
@given(seed=SEED, intersample=INTERSAMPLE, n=st.integers(1, 6))
def test_simulation_superposes(seed, intersample, n):
    rng = np.random.default_rng(seed)
    num, den = plant(rng, n)
    model = TransferFunction(num, den)
    one, two = rng.standard_normal((2, 150))
    a, b = rng.uniform(-3.0, 3.0, 2)

    def run(u):
        return simulate(model, Record(u, u, dt=DT, intersample=intersample))

    expected = a * run(one) + b * run(two)
    tolerance = 1e-11 * max(1.0, np.max(np.abs(expected)))
    assert np.allclose(run(a * one + b * two), expected, rtol=0, atol=tolerance)


@SOME
@given(seed=SEED, intersample=INTERSAMPLE, wait=st.integers(1, 60))
def test_simulation_does_not_know_the_clock(seed, intersample, wait):
    rng = np.random.default_rng(seed)
    model = TransferFunction(*plant(rng, 3))
    u = np.concatenate([[0.0], rng.standard_normal(100)])
    late = np.concatenate([np.zeros(wait), u])
    first = simulate(model, Record(u, u, dt=DT, intersample=intersample))
    second = simulate(model, Record(late, late, dt=DT, intersample=intersample))
    scale = np.max(np.abs(first))
    assert np.allclose(second[wait:], first, rtol=0, atol=1e-11 * scale)
    assert np.allclose(second[:wait], 0.0, rtol=0, atol=0)


@SOME
@given(seed=SEED, split=st.integers(2, 9))
def test_finer_sampling_of_a_held_input_changes_nothing(seed, split):
    rng = np.random.default_rng(seed)
    model = TransferFunction(*plant(rng, 4))
    u = rng.standard_normal(60)
    coarse = simulate(model, Record(u, u, dt=DT))
    fine = np.repeat(u, split)
    found = simulate(model, Record(fine, fine, dt=DT / split))[::split]
    assert np.allclose(found, coarse, rtol=0, atol=1e-11 * np.max(np.abs(coarse)))


@SOME
@given(seed=SEED, exponent=st.integers(-20, 20), n=st.integers(1, 6), intersample=INTERSAMPLE)
def test_simulation_in_another_unit_of_time(seed, exponent, n, intersample):
    rng = np.random.default_rng(seed)
    num, den = plant(rng, n)
    num, den, u = np.atleast_1d(num), np.atleast_1d(den), rng.standard_normal(120)
    faster = 2.0**exponent
    scaled = faster ** np.arange(n + 1.0)
    moved = TransferFunction(num * scaled[-num.size :], den * scaled)
    first = simulate(TransferFunction(num, den), Record(u, u, dt=DT, intersample=intersample))
    second = simulate(moved, Record(u, u, dt=DT / faster, intersample=intersample))
    assert np.allclose(first, second, rtol=0, atol=1e-11 * np.max(np.abs(first)))
