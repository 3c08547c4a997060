"""The gradient rule against the equations it is made of, solved by other means."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal

from oracles import levels
from tridentify import (
    Record,
    Structure,
    SvfLeastSquares,
    TransferFunction,
    identify,
    online,
    simulate,
)
from tridentify.errors import OptionError, UnsupportedError
from tridentify.numerics.realization import cascade, numerators, sort_poles
from tridentify.numerics.recursive import along, descend
from tridentify.online.gradient_rule.periods import moments_of, scatter, signals_of, stable_poles
from tridentify.online.gradient_rule.plan import Basis, gains, inverse_of
from tridentify.online.kernels import gradient_slots, slots
from tridentify.online.layout import NuisanceColumns, Setting

DT = 0.05
ASKED = Structure(2, 1, offset=False, initial_state="rest")
PLANT = TransferFunction([0.2, 0.5], [1.0, 1.0, 3.0])
TRUTH = np.array([1.0, 3.0, 0.2, 0.5])


def recorded(n_samples, noise=0.0, seed=1, plant=PLANT, dt=DT, hold=4):
    u = levels(n_samples, hold, seed)
    y = simulate(plant, Record(u, u, dt=dt))[:, 0]
    draws = np.random.default_rng(seed + 99).standard_normal(n_samples)
    return u, y + noise * np.std(y) * draws


def walked(method, u, y, structure=ASKED, dt=DT, **options):
    state = method.init(structure, dt, **options)
    return method.feed(state, np.array(u, dtype=float), np.array(y, dtype=float))


def setting(structure=ASKED, dt=DT, m=1, p=1):
    names = tuple(f"u{j}" for j in range(m)), tuple(f"y{i}" for i in range(p))
    return Setting(structure, dt, *names, (), "zoh")


# --------------------------------------------------------------------------- one step of the rule
def test_one_step_is_backward_euler():
    """``theta' - theta = h P phi (y - phi' theta')``: the error on the right is the new one."""
    rng = np.random.default_rng(0)
    root = rng.standard_normal((3, 3))
    p, phi, theta, y, h = root @ root.T, rng.standard_normal(3), rng.standard_normal(3), 1.7, 0.4
    x = np.concatenate([theta, phi, np.zeros(3)])
    size = along(x, 3, 3, p.ravel().copy(), 0, 6)
    assert size == pytest.approx(phi @ p @ phi)
    descend(x, 0, 3, 6, size, h, y - phi @ theta, 1.0)
    assert x[:3] - theta == pytest.approx(h * p @ phi * (y - phi @ x[:3]))


def test_a_step_that_is_not_finite_is_none():
    x = np.array([1.0, 2.0, 3.0, 4.0])
    descend(x, 0, 2, 2, 1.0, 1.0, np.inf, 1.0)
    descend(x, 0, 2, 2, np.inf, 1.0, np.nan, 1.0)
    assert x.tolist() == [1.0, 2.0, 3.0, 4.0]


def test_orthogonal_gains_are_the_inverse_and_plain_ones_its_diagonal():
    rng = np.random.default_rng(1)
    z = rng.standard_normal((500, 3)) @ rng.standard_normal((3, 3))
    moments, table = z.T @ z / 500, rng.standard_normal((2, 3))
    means = table @ moments @ table.T
    assert gains(table, moments, True) == pytest.approx(np.linalg.inv(means))
    assert gains(table, moments, False) == pytest.approx(np.diag(1 / np.diagonal(means)))


def test_a_regressor_that_was_never_seen_is_left_alone():
    means = np.diag([2.0, 0.0])
    assert inverse_of(means) == pytest.approx(np.array([[0.5, 0.0], [0.0, 0.0]]))


# -------------------------------------------------------------------------- the tables of a basis
@pytest.mark.parametrize("adapted", [True, False])
def test_the_filter_driven_by_a_model_is_the_product_of_their_transfer_functions(adapted):
    """At points of the plane, ``filtered(row)`` against polynomials multiplied out."""
    nuisance = NuisanceColumns(False, False, False)
    poles = sort_poles(np.array([-0.4 + 1.5j, -0.4 - 1.5j]))
    if adapted:
        basis = Basis.on_model(setting(), nuisance, poles)
    else:
        wide = sort_poles(np.roots([1.0, 5.0, 6.0, 7.0]).astype(complex))
        basis = Basis.fixed(setting(), nuisance, 2.0, 3, wide)
    row = np.zeros(basis.width)
    row[: basis.kept] = np.random.default_rng(2).standard_normal(basis.kept)
    first, second = cascade(basis.poles[: basis.kept]), cascade(basis.filter_poles)
    num = row[: basis.kept] @ numerators(first.poles)
    bank, points = basis.bank, np.array([0.3 + 1.0j, 2.0 - 0.4j, 5.0j])
    states = [np.linalg.solve(s * np.eye(bank.order) - bank.a, bank.b) for s in points]
    for found, rows in zip(basis.filtered(row), basis.picked, strict=True):
        own = rows @ numerators(second.poles)
        expected = np.polyval(num, points) * np.polyval(own, points)
        for pole in (*first.poles, *second.poles):
            expected = expected / (points - pole)
        assert states @ found[: bank.order] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("zeros", [0, 1, 2])
@pytest.mark.parametrize("unit", [1.0, 1e-6, 1e5])
def test_coefficients_come_back_from_the_unknowns(zeros, unit):
    """On the model's own filter, and on a wider one."""
    asked = Structure(2, zeros)
    theta = np.array([1.0, 3.0, 0.7, 0.2, 0.5][: 3 + zeros]) * unit ** -np.array(
        [1.0, 2.0, *range(2 - zeros, 3)]
    )
    poles = sort_poles(np.roots([1.0, *theta[:2]]).astype(complex))
    for wider in (poles, sort_poles(np.append(poles, -3.0 / unit))):
        nuisance = NuisanceColumns(True, True, False)
        basis = Basis.fixed(setting(asked, DT * unit), nuisance, 2.0 / unit, 2, wider)
        constant, matrix = basis.physical
        assert constant + matrix @ basis.unknowns_of(theta) == pytest.approx(theta, rel=1e-9)


def test_poles_are_reflected_and_held_below_the_sampling():
    poles = stable_poles(np.array([-1.0, 4.0]), setting())
    assert poles == pytest.approx(np.roots([1.0, 1.0, 4.0]))
    fast = stable_poles(np.array([1e9]), setting(Structure(1, 0)))
    assert fast == pytest.approx([-20.0 / DT])
    assert stable_poles(np.array([np.nan, 1.0]), setting()) is None


# -------------------------------------------------------------------------------- the kernel
def dense_reference(u, y, basis, rate):
    """Step 1 by a loop over dense vectors, with regressors from `scipy.signal.lsim`."""
    bank = basis.bank
    t = np.arange(len(u)) * DT
    system = (bank.a, bank.b[:, None], np.eye(bank.order), np.zeros((bank.order, 1)))
    phi = scipy.signal.lsim(system, u, t, interp=False)[1][:, : basis.kept]
    theta, mean = np.zeros(basis.kept), 0.0
    for k, (row, target) in enumerate(zip(phi, y, strict=True)):
        size = row @ row
        mean += (size - mean) / (k + 1.0)
        gain = rate * DT * basis.kept / mean if mean > 0 else 0.0
        theta = theta + gain * row * (target - row @ theta) / (1.0 + gain * size)
    return theta, phi


def test_step_1_on_the_paper_basis_is_the_rule_written_out():
    u, y = recorded(30)
    method = online.Gradient(gamma=2.0, filter=(1.0, 5.0, 6.0, 7.0), rate=0.7)
    state, _, _ = walked(method, u, y)
    basis = Basis.of(state.stage.setting, state.stage.blueprint)
    rate = state.stage.blueprint.constants[gradient_slots.RATE]
    expected, phi = dense_reference(u, y, basis, rate)
    found = signals_of(basis, state.stage.blueprint, state.values)[0][0, : basis.kept]
    assert found == pytest.approx(expected, rel=1e-9)
    seen = moments_of(state.stage.blueprint, state.values)[:3, :3]
    assert seen == pytest.approx(phi.T @ phi / len(u), rel=1e-9)


@pytest.mark.slow
def test_the_equation_error_of_the_true_model_vanishes():
    """Started at the truth nothing moves: all three models are exact between the samples."""
    u, y = recorded(3000)
    method = online.Gradient(start=PLANT)
    state, innovations, _ = walked(method, u, y)
    assert np.abs(innovations).max() < 1e-12
    assert method.estimate(state).theta == pytest.approx(TRUTH, rel=1e-10)


def test_the_parallel_model_does_not_jump_when_the_bank_moves():
    u, y = recorded(4000, noise=0.05)
    method = online.Gradient(gamma=2.0)
    state = method.init(ASKED, DT)
    jumps = []
    for k in range(4000):
        before, (state, _) = state, method.step(state, float(u[k]), float(y[k]))
        old, new = before.stage.blueprint, state.stage.blueprint
        if not np.array_equal(old.poles, new.poles):
            outputs = []
            for one in (method.kernels().step, None):
                x = before.values.copy()
                x[slots.INBOX : slots.INBOX + 2] = u[k], y[k]
                stage = before.stage
                if one is None:
                    x, stage = state.values, state.stage
                else:
                    one(old.ints, old.constants, x, DT)
                basis = Basis.of(stage.setting, stage.blueprint)
                row = x[int(stage.blueprint.ints[slots.AT_ROW]) :][: basis.width]
                outputs.append(signals_of(basis, stage.blueprint, x)[0][0] @ row)
            jumps.append(abs(outputs[1] - outputs[0]))
    assert jumps
    assert max(jumps[1:]) < 0.02 * np.std(y)


# ------------------------------------------------------------------------------ what comes of it
PLANTS = {
    "first order": (TransferFunction([8.0], [1.0, 4.0]), Structure(1, 0), DT, 4),
    "overdamped": (TransferFunction([8.0], [1.0, 5.0, 4.0]), Structure(2, 0), DT, 4),
    "wrong way first": (TransferFunction([-1.0, 2.0], [1.0, 1.5, 4.0]), Structure(2, 1), DT, 4),
    "two modes": (
        TransferFunction([-6400.0, 1600.0], [1.0, 5.0, 408.0, 416.0, 1600.0]),
        Structure(4, 1),
        0.01,
        7,
    ),
}


@pytest.mark.parametrize("name", list(PLANTS))
@pytest.mark.fast("overdamped", "two modes")
def test_without_noise_it_ends_at_the_truth(name):
    plant, asked, dt, hold = PLANTS[name]
    u, y = recorded(5000, plant=plant, dt=dt, hold=hold)
    method = online.Gradient()
    state, _, _ = walked(method, u, y, asked, dt)
    truth = np.concatenate([plant.den[0][0][1:], plant.num[0][0]])
    assert method.estimate(state).theta == pytest.approx(truth, rel=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [1e-6, 1e5])
def test_from_the_paper_basis_it_converges_to_the_truth(seconds):
    """Aircraft, repeated square input of T = 50 s, nothing known but gamma and c(p)."""
    dt = 0.05 * seconds
    plant = TransferFunction([0.5 / seconds**2], [1.0, 1.0 / seconds, 3.0 / seconds**2])
    u = np.where(np.arange(10_000) % 1000 < 500, 1.0, -1.0)
    y = simulate(plant, Record(u, u, dt=dt))[:, 0]
    c = np.array([1.0, 5.0, 6.0, 7.0]) / seconds ** np.arange(4)
    method = online.Gradient(gamma=2.0 / seconds, filter=tuple(c))
    state, _, _ = walked(method, u, y, Structure(2, 0, offset=False, initial_state="rest"), dt)
    truth = np.array([1.0, 3.0, 0.5]) / seconds ** np.array([1, 2, 2])
    assert method.estimate(state).theta == pytest.approx(truth, rel=1e-5)


@pytest.mark.slow
def test_a_start_that_is_wrong_by_a_third_is_forgotten():
    u, y = recorded(10_000)
    start = TransferFunction([0.3, 0.4], [1.0, 1.4, 2.2])
    method = online.Gradient(start=start)
    state, _, _ = walked(method, u, y)
    assert method.estimate(state).theta == pytest.approx(TRUTH, rel=1e-5)


@pytest.mark.slow
def test_two_inputs_and_outputs_share_a_denominator():
    num = [[[0.2, 0.5], [2.0]], [[1.0], [0.3, -1.0]]]
    den = [[[1.0, 1.0, 3.0]] * 2] * 2
    plant = TransferFunction(num, den)
    u = np.column_stack([levels(6000, 4, 1), levels(6000, 5, 2)])
    y = simulate(plant, Record(u, np.zeros((6000, 2)), dt=DT)) + np.array([3.0, -7.0])
    asked = Structure(2, [[1, 0], [0, 1]], offset=True)
    method = online.Gradient()
    names = {"input_names": ["a", "b"], "output_names": ["c", "d"]}
    state, _, _ = walked(method, u, y, asked, **names)
    truth = [1.0, 3.0, 0.2, 0.5, 2.0, 1.0, 0.3, -1.0]
    assert method.estimate(state).theta == pytest.approx(truth, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["overdamped", "wrong way first"])
def test_unbiased_where_svf_least_squares_is_not_and_the_standard_errors_are_credible(name):
    plant, asked, dt, hold = PLANTS[name]
    truth = np.concatenate([plant.den[0][0][1:], plant.num[0][0]])
    method, n = online.Gradient(), asked.common_poles
    errors, stds, rivals = [], [], []
    for draw in range(40):
        u, y = recorded(10_000, 0.3, 1000 + draw, plant, dt, hold)
        state, _, _ = walked(method, u, y, asked, dt)
        found = method.estimate(state)
        errors.append(found.theta - truth)
        stds.append(found.std)
        if draw < 10:
            svf = identify(Record(u, y, dt=dt), asked, SvfLeastSquares())
            rivals.append(svf.theta - truth)
    errors, stds = np.array(errors), np.array(stds)
    bias, spread = errors.mean(axis=0), errors.std(axis=0)
    rival = np.abs(np.mean(rivals, axis=0) / truth)[:n].max()
    assert np.all(np.abs(bias) < 1.3 * spread)  # of second order, as the module says
    assert np.abs(bias / truth)[:n].max() < 0.25 * rival
    inside = (np.abs(errors) < 1.96 * stds).mean(axis=0)
    assert np.all(inside > 0.7)
    assert np.all(np.median(stds, axis=0) < 2.0 * spread)


# ---------------------------------------------------------------------------- rough treatment
@pytest.mark.slow
@pytest.mark.parametrize("rate", [1e3, 1e9])
def test_a_huge_rate_does_not_blow_up(rate):
    u, y = recorded(5000, 0.1)
    method = online.Gradient(rate=rate)
    state, innovations, _ = walked(method, u, y)
    late = innovations[500:, 0]
    assert np.all(np.isfinite(late))
    assert np.abs(late).max() < 10.0 * np.std(y)
    assert np.all(np.isfinite(state.values[state.stage.blueprint.ints[gradient_slots.X_FITS] :]))


@pytest.mark.slow
def test_samples_that_cannot_be_leave_no_trace():
    u, y = recorded(12_000, 0.05)
    clean = walked(online.Gradient(), u, y)[0]
    bad = y.copy()
    bad[3000:3010] = np.nan
    bad[5000], bad[5500], bad[6000] = np.inf, 1e300, -1e30
    method = online.Gradient()
    state, _, flags = walked(method, u, bad)
    assert flags[5500] & slots.MISSING_OUTPUT
    assert flags[6000] & slots.OUTLIER
    one, two = method.estimate(state), method.estimate(clean)
    assert not state.changes
    assert np.all(np.abs(one.theta - two.theta) < 2.0 * two.std)
    assert np.all(np.isfinite(state.values))


def test_a_constant_input_for_long_does_no_harm():
    """The same estimate as before the rest, and no smaller standard error from it."""
    u, y = recorded(60_000, 0.05)
    u[10_000:50_000] = 1.0
    noise = 0.05 * np.std(y) * np.random.default_rng(5).standard_normal(u.size)
    y = simulate(PLANT, Record(u, u, dt=DT))[:, 0] + noise
    method = online.Gradient()
    state, _, _ = walked(method, u[:10_000], y[:10_000])
    before = method.estimate(state)
    state, _, flags = method.feed(state, u[10_000:50_000].copy(), y[10_000:50_000].copy())
    assert flags[-1] & slots.NOT_EXCITED
    rest = method.estimate(state)
    assert np.all(np.abs(rest.theta - before.theta) < 3.0 * before.std)
    assert np.all(rest.std > 0.5 * before.std)
    state, _, _ = method.feed(state, u[50_000:].copy(), y[50_000:].copy())
    after = method.estimate(state)
    assert np.all(np.abs(after.theta - TRUTH) < 4.0 * after.std)


@pytest.mark.slow
def test_a_change_of_the_plant_is_found_and_followed():
    u = levels(16_000)
    y = simulate(PLANT, Record(u, u, dt=DT))[:, 0]
    other = TransferFunction([0.2, 0.5], [1.0, 1.5, 4.0])
    y[8_000:] = simulate(other, Record(u, u, dt=DT))[8_000:, 0]
    y += 0.05 * np.std(y) * np.random.default_rng(3).standard_normal(y.size)
    for method in (online.Gradient(), online.Gradient(start=PLANT)):
        state, _, _ = walked(method, u, y)
        assert len(state.changes) >= 1
        assert 8_000 <= state.changes[0] < 10_000
        found = method.estimate(state)
        assert found.theta == pytest.approx([1.5, 4.0, 0.2, 0.5], rel=0.05)


@pytest.mark.parametrize("options", [{}, {"gamma": 2.0}, {"start": PLANT}], ids=str)
@pytest.mark.fast("{'gamma': 2.0}")
def test_running_is_folding_and_a_file_resumes_bit_for_bit(options, tmp_path):
    u, y = recorded(1500, 0.1)
    y[700:720] = np.nan
    method = online.Gradient(**options)
    whole, innovations, _ = walked(method, u, y)
    state, one_by_one = method.init(ASKED, DT), []
    for k in range(1500):
        if k in (300, 1100):
            state.save(tmp_path / "state.json")
            state = online.State.load(tmp_path / "state.json")
            method = state.method
        state, innovation = method.step(state, float(u[k]), float(y[k]))
        one_by_one.append(innovation)
    assert np.array_equal(one_by_one, innovations[:, 0], equal_nan=True)
    assert np.array_equal(state.values, whole.values, equal_nan=True)
    assert repr(state.method) == repr(whole.method)


def test_scatter_is_that_of_the_mean():
    """The mean of k independent periods has a k-th of the variance of one, times Student's."""
    rng = np.random.default_rng(0)
    batches = np.column_stack([np.full(4000, 7.0), rng.standard_normal((4000, 2))])
    assert 4000 * np.diagonal(scatter(batches)) == pytest.approx([1.0, 1.0], rel=0.1)


# ---------------------------------------------------------------------------------- refusals
@pytest.mark.parametrize(
    "options",
    [
        {"rate": 0.0},
        {"rate": "fast"},
        {"gamma": np.nan},
        {"n_operators": 0},
        {"n_operators": 2.0},
        {"filter": (1.0, -2.0)},
        {"filter": ()},
        {"start": 1.0},
        {"start": PLANT, "gamma": 2.0},
        {"on_change": "ignore"},
    ],
    ids=str,
)
def test_options_out_of_range(options):
    with pytest.raises(OptionError, match=r"^found .*; expected .*; .*$"):
        online.Gradient(**options)


def test_what_it_does_not_do_is_refused():
    with pytest.raises(UnsupportedError, match="drift"):
        online.Gradient().init(Structure(2, 1, drift=True), DT)
    with pytest.raises(OptionError, match="degree"):
        online.Gradient(filter=(1.0, 2.0)).init(ASKED, DT)
    with pytest.raises(OptionError, match="start"):
        online.Gradient(start=TransferFunction([1.0, 1.0, 1.0], [1.0, 1.0, 3.0])).init(ASKED, DT)
