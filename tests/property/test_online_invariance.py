"""What must hold for on-line estimators on any record: units of signals and time, any chunking."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tridentify import Record, Structure, TransferFunction, online, simulate

DT = 0.05
REST = {"offset": False, "initial_state": "rest"}
SEED = st.integers(0, 10_000)
EXPONENT = st.integers(-30, 30)
# shares of what the profile has: `make test` is content with few
FEW = settings(max_examples=max(1, settings.default.max_examples // 20), deadline=None)
SOME = settings(max_examples=max(1, settings.default.max_examples // 6), deadline=None)
METHODS = {
    "three-model": lambda s: online.ThreeModel(),
    "three-model, forgetting": lambda s: online.ThreeModel(forgetting=0.998),
    "least squares": lambda s: online.RecursiveLeastSquares(),
    "least squares, filter": lambda s: online.RecursiveLeastSquares(
        filter=(1.0, 4.0 / s, 4.0 / s**2), forgetting=0.999
    ),
    "kalman": lambda s: online.Kalman(drift=0.01 / np.sqrt(s), filter=(1.0, 4.0 / s, 4.0 / s**2)),
    "gradient": lambda s: online.Gradient(),
}
every_method = pytest.mark.parametrize("key", list(METHODS))


def signals(seed, n_samples=1000, noise=0.05):
    rng = np.random.default_rng(seed)
    omega, damping = np.exp(rng.uniform(0.3, 1.6)), rng.uniform(0.2, 0.9)
    u = np.repeat(np.sign(rng.standard_normal(-(-n_samples // 5))), 5)[:n_samples]
    plant = TransferFunction([1.0, omega**2], [1.0, 2 * damping * omega, omega**2])
    y = simulate(plant, Record(u, u, dt=DT))[:, 0]
    return u, y + noise * np.std(y) * rng.standard_normal(n_samples)


def stream(method, u, y, dt=DT):
    return online.run(method, Record(u, y, dt=dt), Structure(2, 1, **REST), every=250 * dt)


@every_method
@FEW
@given(seed=SEED, u_exponent=EXPONENT, y_exponent=EXPONENT, sign=st.sampled_from([-1, 1]))
def test_units_and_signs_scale_the_numerator_alone(key, seed, u_exponent, y_exponent, sign):
    u, y = signals(seed)
    c, d = 2.0**u_exponent, sign * 2.0**y_exponent
    one, two = stream(METHODS[key](1.0), u, y), stream(METHODS[key](1.0), c * u, d * y)
    factor = np.array([1.0, 1.0, d / c, d / c])
    plain, scaled = one.estimate, two.estimate
    allowed = 2e-3 * np.abs(factor) * plain.std + 1e-6 * np.abs(factor * plain.theta)
    assert np.all(np.abs(scaled.theta - factor * plain.theta) <= allowed)
    assert np.allclose(scaled.std, np.abs(factor) * plain.std, rtol=5e-3)
    assert two.state.seen == one.state.seen
    assert two.state.changes == one.state.changes


@every_method
@FEW
@given(seed=SEED, exponent=EXPONENT)
def test_unit_of_time_moves_coefficients_by_powers(key, seed, exponent):
    u, y = signals(seed)
    slower = 2.0**exponent
    plain = stream(METHODS[key](1.0), u, y)
    other = stream(METHODS[key](slower), u, y, DT * slower)
    factor = slower ** -np.array([1.0, 2.0, 1.0, 2.0])
    allowed = 2e-3 * plain.estimate.std + 1e-6 * np.abs(plain.estimate.theta)
    assert np.all(np.abs(other.estimate.theta / factor - plain.estimate.theta) <= allowed)
    assert np.allclose(other.estimate.std / factor, plain.estimate.std, rtol=5e-3)
    assert other.state.seen == plain.state.seen
    assert other.state.changes == plain.state.changes


@every_method
@SOME
@given(
    seed=SEED,
    cuts=st.lists(st.integers(1, 499), max_size=5),
    gaps=st.lists(st.integers(0, 499), max_size=20),
)
@pytest.mark.fast("three-model", "least squares", "kalman")
def test_any_chunking_is_the_same_stream(key, seed, cuts, gaps, tmp_path_factory):
    """Saved and loaded at any sample, with any samples missing: as in one go."""
    folder = tmp_path_factory.mktemp("state")
    u, y = signals(seed, 500)
    y[[g for g in gaps if g]] = np.nan
    method = METHODS[key](1.0)
    whole = stream(method, u, y)
    state, innovations = method.init(Structure(2, 1, **REST), DT), []
    for k in range(500):
        if k in cuts:
            state.save(folder / "state.json")
            state = online.State.load(folder / "state.json")
        state, innovation = state.method.step(state, u[k], y[k])
        innovations.append(np.ravel(innovation))
    assert np.array_equal(np.array(innovations), whole.innovations, equal_nan=True)
    state.save(folder / "one.json")
    whole.state.save(folder / "two.json")
    assert (folder / "one.json").read_bytes() == (folder / "two.json").read_bytes()


@every_method
@FEW
@given(seed=SEED, later=st.integers(510, 990))
@pytest.mark.fast("three-model", "least squares, filter", "gradient")
def test_what_comes_later_does_not_change_what_was_said(key, seed, later):
    """Causal: the trajectory up to a sample does not know the samples after it."""
    u, y = signals(seed)
    rng = np.random.default_rng(seed)
    other_u, other_y = u.copy(), y.copy()
    other_u[later:] = rng.standard_normal(1000 - later)
    other_y[later:] = rng.standard_normal(1000 - later)
    structure, method = Structure(2, 1, **REST), METHODS[key](1.0)
    runs = [
        online.run(method, Record(*pair, dt=DT), structure, every=50 * DT)
        for pair in ((u, y), (other_u, other_y))
    ]
    before = runs[0].time < (later - 0.5) * DT
    assert before.sum() >= 9
    assert np.array_equal(runs[0].theta[before], runs[1].theta[before], equal_nan=True)
    assert np.array_equal(runs[0].std[before], runs[1].std[before], equal_nan=True)
    assert np.array_equal(runs[0].innovations[:later], runs[1].innovations[:later], equal_nan=True)
