"""What must hold for every method of the table on any record: units, signs, order, survival."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from oracles import by_exponential
from tridentify import METHODS, Record, Status, Structure, ThreeModel, TridentifyError, identify
from tridentify.errors import UnsupportedError

FEW = settings(max_examples=2, deadline=None)
SOME = settings(max_examples=10, deadline=None)
SEED = st.integers(0, 10_000)
REST = {"offset": False, "initial_state": "rest"}
DT = 0.05

# The three-model strategy is the slowest by far, and has an invariance test of its own.
OWN = [pytest.param(key, marks=pytest.mark.slow) for key in METHODS if key == "three-model"]
pytestmark = [
    pytest.mark.unjudged,
    pytest.mark.parametrize("key", [*OWN, *(k for k in METHODS if k != "three-model")]),
]


def respond(num, den, u, dt=DT, intersample="zoh"):
    return by_exponential(num, den, u, dt, intersample)


def levels(n_samples, hold, rng):
    return np.repeat(np.sign(rng.standard_normal(-(-n_samples // hold))), hold)[:n_samples]


def plant(rng):
    """(num, den) of a second-order system that 0.05 s can show and 20 s can settle."""
    omega, damping = np.exp(rng.uniform(0.3, 1.8)), rng.uniform(0.2, 0.9)
    zero = rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(0.5, 2.0))
    return omega**2 * np.array([-1.0 / zero, 1.0]), np.array([1.0, 2 * damping * omega, omega**2])


def signals(seed, noise=0.05, n_samples=400, intersample="zoh"):
    rng = np.random.default_rng(seed)
    num, den = plant(rng)
    u = levels(n_samples, 5, rng)
    y = respond(num, den, u, DT, intersample)
    return u, y + noise * np.std(y) * rng.standard_normal(n_samples)


def attempt(records, structure, key):
    """The estimate, or None where the method declares that it does not support the structure."""
    try:
        return identify(records, structure, METHODS[key](), throw=False)
    except UnsupportedError:
        return None


def same(one, theta, std, rtol=1e-7):
    """Equal up to the stop of the passes, a thousandth of a standard error."""
    assert np.all(np.abs(one.theta - theta) <= 2e-3 * std + rtol * np.abs(theta))
    assert np.allclose(one.std, std, rtol=2e-3)


# --------------------------------------------------------------------------- units and signs
EXPONENT = st.integers(-30, 30)


@FEW
@given(seed=SEED, u_exponent=EXPONENT, y_exponent=EXPONENT, y_sign=st.sampled_from([-1, 1]))
def test_units_and_signs_scale_the_numerator_alone(key, seed, u_exponent, y_exponent, y_sign):
    u, y = signals(seed)
    c, d = 2.0**u_exponent, y_sign * 2.0**y_exponent
    plain = attempt(Record(u, y, dt=DT), Structure(2, 1, **REST), key)
    scaled = attempt(Record(c * u, d * y, dt=DT), Structure(2, 1, **REST), key)
    factor = np.array([1.0, 1.0, d / c, d / c])
    same(scaled, factor * plain.theta, np.abs(factor) * plain.std)
    assert scaled.status is plain.status
    assert np.allclose(scaled.fit, plain.fit, atol=1e-3)
    assert np.allclose(scaled.noise_variance, d**2 * plain.noise_variance, rtol=1e-4)


@FEW
@given(seed=SEED, exponent=st.integers(-30, 30), noise=st.sampled_from([0.0, 0.1]))
def test_unit_of_time_moves_coefficients_by_powers(key, seed, exponent, noise):
    u, y = signals(seed, noise)
    faster = 2.0**exponent
    plain = attempt(Record(u, y, dt=DT), Structure(2, 1, **REST), key)
    quick = attempt(Record(u, y, dt=DT / faster), Structure(2, 1, **REST), key)
    factor = faster ** np.array([1.0, 2.0, 1.0, 2.0])
    assert np.all(np.abs(quick.theta / factor - plain.theta) <= 2e-3 * plain.std + 1e-7)
    assert quick.status is plain.status


@FEW
@given(seed=SEED)
@pytest.mark.fast("refined-instrumental-variable", "output-error")
def test_turning_both_signals_around_changes_nothing(key, seed):
    u, y = signals(seed, 0.2)
    one = attempt(Record(u, y, dt=DT), Structure(2, 1), key)
    two = attempt(Record(-u, -y, dt=DT), Structure(2, 1), key)
    same(two, one.theta, one.std)
    assert two.structure == one.structure


# ---------------------------------------------------------------- experiments and channels
@FEW
@given(seed=SEED)
@pytest.mark.fast("output-error", "svf-least-squares")
def test_the_same_record_twice_is_half_the_variance(key, seed):
    # Noise that comes twice is not white: a test of whiteness has every right to object.
    method = ThreeModel(noise="white") if key == "three-model" else METHODS[key]()
    record = Record(*signals(seed), dt=DT)
    once = identify(record, Structure(2, 1, **REST), method)
    twice = identify([record, record], Structure(2, 1, **REST), method)
    # The compensation takes its noise variance from the degrees of freedom, which double and more.
    assert np.all(np.abs(once.theta - twice.theta) < 0.05 * once.std)
    ratio = once.std / twice.std
    if once.errors == twice.errors == "likelihood":
        assert np.allclose(ratio, np.sqrt(2.0), rtol=0.01)
        return
    # The scores of a band are the same twice: their scatter tells that no more is known, and stands
    # out more. It is nowhere below what the likelihood gives; few blocks may double it.
    assert twice.errors == "scores"
    assert np.all(ratio > 0.5)
    if once.errors == "likelihood":
        assert np.all(ratio < np.sqrt(2.0) * 1.01)


@FEW
@given(seed=SEED)
@pytest.mark.fast("output-error", "svf-least-squares")
def test_two_inputs_superpose(key, seed):
    """One record with both inputs, or two with one each: the same system within its bars."""
    rng = np.random.default_rng(seed)
    num, den = plant(rng)
    u = np.stack([levels(500, 5, rng), levels(500, 7, rng)], axis=1)
    parts = [respond(num, den, u[:, 0]), respond([3.0], den, u[:, 1])]
    clean = np.sum(parts, axis=0)
    y = clean + 0.01 * np.std(clean) * rng.standard_normal(500)
    structure = Structure(2, [[1, 0]], **REST)
    found = attempt(Record(u, y, dt=DT), structure, key)
    if found is None:
        return
    truth = np.concatenate([den[1:], num, [3.0]])
    assert np.all(np.abs(found.theta - truth) < 5.0 * found.std + 0.05 * np.max(np.abs(truth)))
    swapped = attempt(Record(u[:, ::-1], y, dt=DT), Structure(2, [[0, 1]], **REST), key)
    order = [0, 1, 4, 2, 3]
    assert np.all(np.abs(swapped.theta - found.theta[order]) <= 0.01 * found.std[order])


@FEW
@given(seed=SEED, scale=st.sampled_from([1e-8, 1.0, 1e8]))
@pytest.mark.fast("output-error", "svf-instrumental-variable")
def test_order_and_units_of_outputs_are_of_no_account(key, seed, scale):
    rng = np.random.default_rng(seed)
    num, den = plant(rng)
    u = levels(400, 5, rng)
    y = np.stack([respond(num, den, u), respond([3.0], den, u)], axis=1)
    y = y + 0.05 * np.std(y, axis=0) * rng.standard_normal(y.shape)
    plain = attempt(Record(u, y, dt=DT), Structure(2, [[1], [0]], **REST), key)
    if plain is None:
        return
    turned = Record(u, y[:, ::-1] * [scale, 1.0], dt=DT)
    other = attempt(turned, Structure(2, [[0], [1]], **REST), key)
    back = other.theta[[0, 1, 3, 4, 2]] / np.array([1.0, 1.0, 1.0, 1.0, scale])
    assert np.all(np.abs(back - plain.theta) <= 0.01 * plain.std)


@FEW
@given(seed=SEED, offset=st.floats(-1e3, 1e3), trim=st.floats(-1e3, 1e3))
def test_trim_does_not_move_coefficients_that_are_free_of_it(key, seed, offset, trim):
    u, y = signals(seed)
    structure = Structure(2, 1, offset=True, initial_state="free")
    plain = attempt(Record(u, y, dt=DT), structure, key)
    if plain is None:
        return
    moved = attempt(Record(u + trim, y + offset, dt=DT), structure, key)
    assert np.all(np.abs(moved.theta - plain.theta) <= 0.01 * plain.std)


@FEW
@given(seed=SEED, wait=st.integers(1, 40))
def test_quiet_before_the_start_adds_nothing(key, seed, wait):
    """At rest, samples of zeros tell only about the noise; a filter may be chosen a little anew."""
    u, y = signals(seed, noise=0.0)
    plain = attempt(Record(u, y, dt=DT), Structure(2, 1, **REST), key)
    late = Record(np.append(np.zeros(wait), u), np.append(np.zeros(wait), y), dt=DT)
    assert np.allclose(attempt(late, Structure(2, 1, **REST), key).theta, plain.theta, rtol=1e-3)


@FEW
@given(seed=SEED, intersample=st.sampled_from(["zoh", "foh"]))
def test_error_bars_hold_the_truth_of_any_plant(key, seed, intersample):
    rng = np.random.default_rng(seed)
    num, den = plant(rng)
    u, y = signals(seed, 0.02, 600, intersample)
    record = Record(u, y, dt=DT, intersample=intersample)
    found = attempt(record, Structure(2, 1, **REST), key)
    truth = np.append(den[1:], num)
    # Filtering the sampled output costs up to (omega dt)^2 / 4 of a coefficient here.
    bias = 0.25 * den[2] * DT**2 * np.max(np.abs(truth))
    assert np.all(np.abs(found.theta - truth) < 5.0 * found.std + bias)


# ---------------------------------------------------------------------------------- survival
def settled(record, structure, key):
    """Whatever comes, it is an estimate of finite numbers or a known refusal of one line."""
    try:
        found = identify(record, structure, METHODS[key](), throw=False)
    except TridentifyError as refusal:
        assert "\n" not in str(refusal)  # noqa: PT017
        return None
    assert isinstance(found.status, Status)
    assert np.all(np.isfinite(found.theta))
    assert not np.any(found.std < 0)
    assert np.all(np.isfinite(found.predict(record)))
    assert found.summary()
    assert pickle.loads(pickle.dumps(found)).status is found.status
    return found


STRUCTURES = st.sampled_from(
    [
        Structure(1, 0),
        Structure(2, 2, **REST),
        Structure(3, 1, offset=True, initial_state="equilibrium"),
        Structure(4, 3, drift=True, initial_state="free"),
    ]
)


@pytest.mark.slow
@SOME
@given(
    seed=SEED,
    structure=STRUCTURES,
    n_samples=st.sampled_from([12, 40, 150]),
    ratio=st.sampled_from([1.0, 10.0, 1e4]),
)
def test_drowned_in_noise(key, seed, structure, n_samples, ratio):
    u, y = signals(seed, ratio, n_samples)
    settled(Record(u, y, dt=DT), structure, key)


HARD = {
    "an unstable system": lambda u, rng: respond([1.0], [1.0, -0.4, 1.0], u),
    "one that grows fast": lambda u, rng: respond([1.0], [1.0, -3.0], u),
    "a wave of its own": lambda u, rng: np.sin(np.arange(u.size) * 1.3),
    "a ramp": lambda u, rng: np.arange(1.0 * u.size),
    "one spike": lambda u, rng: np.eye(u.size)[70],
    "huge": lambda u, rng: 1e200 * rng.standard_normal(u.size),
    "tiny": lambda u, rng: 1e-200 * rng.standard_normal(u.size),
    "a random walk with heavy tails": lambda u, rng: np.cumsum(rng.standard_cauchy(u.size)),
    "the input itself": lambda u, rng: u,
    "the input, late": lambda u, rng: np.roll(u, 17),
    "before its cause": lambda u, rng: np.roll(respond([1.0], [1.0, 1.0, 3.0], u), -20),
    "a constant and little else": lambda u, rng: -1e3 + rng.standard_normal(u.size),
    "alternating": lambda u, rng: (-1.0) ** np.arange(u.size),
}


FAST = ("an unstable system", "huge", "the input itself")


@pytest.mark.parametrize(
    "case", [c if c in FAST else pytest.param(c, marks=pytest.mark.slow) for c in HARD]
)
def test_hopeless_outputs(key, case):
    rng = np.random.default_rng(6)
    u = levels(200, 6, rng)
    record = Record(u, HARD[case](u, rng), dt=DT)
    for structure in (Structure(2, 1, **REST), Structure(3, 3)):
        settled(record, structure, key)


@pytest.mark.parametrize("n_samples", [2, 4, 5, 8])
def test_short_records(key, n_samples):
    u, y = signals(3, n_samples=n_samples)
    found = settled(Record(u, y, dt=DT), Structure(2, 1, **REST), key)
    if n_samples <= 4:
        assert found is None, "as many unknowns as samples leave nothing to judge by"


def test_one_sample_more_than_unknowns_is_no_certainty(key):
    """Five samples of noise for four unknowns may not come out with tiny standard errors."""
    record = Record([1.0, -1.0, 1.0, 1.0, -1.0], [0.3, -0.2, 0.9, 0.1, -0.7], dt=DT)
    found = settled(record, Structure(2, 1, **REST), key)
    assert found is None or not found.status.ok or np.any(found.std > 0.1 * np.abs(found.theta))


@pytest.mark.slow
@pytest.mark.parametrize("n", [8, 12])
def test_orders_far_above_the_system(key, n):
    u, y = signals(4, 0.01)
    settled(Record(u, y, dt=DT), Structure(n, n - 1, **REST), key)


@pytest.mark.slow
@pytest.mark.timeout(60)
def test_orders_beyond_all_bounds_are_refused(key):
    u, y = signals(4, 0.01)
    assert settled(Record(u, y, dt=DT), Structure(60, 59, **REST), key) is None
