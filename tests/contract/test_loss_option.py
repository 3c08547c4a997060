"""`loss=...`: robust fits against a dense optimiser, and what the estimate says about outliers."""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np
import pytest
from scipy import optimize, stats

from oracles import by_modes
from tridentify import (
    Estimate,
    OutputError,
    Record,
    Structure,
    ThreeModel,
    TransferFunction,
    identify,
)
from tridentify import errors as err

pytestmark = pytest.mark.unjudged

DT = 0.05
TRUTH = np.array([1.0, 3.0, 0.2, 0.5])
AT_REST = Structure(2, 1, offset=False, initial_state="rest")
LOSSES = ("huber", "student")
robust = pytest.mark.parametrize("loss", LOSSES)


def respond(theta, u, dt=DT):
    return by_modes(theta[2:], np.append(1.0, theta[:2]), u, dt)


def input_of(n_samples, seed=1):
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], -(-n_samples // 10))
    return np.repeat(signs, 10)[:n_samples]


def outlying(n_samples=600, share=0.1, level=0.05, seed=0, one_sided=False):
    """(record, positions of the outliers, noise standard deviation)."""
    rng = np.random.default_rng(seed)
    u = input_of(n_samples)
    clean = respond(TRUTH, u)
    sigma = level * clean.std()
    noise = rng.standard_normal(n_samples)
    bad = rng.random(n_samples) < share
    sign = 1.0 if one_sided else rng.choice([-1.0, 1.0], bad.sum())
    noise[bad] += sign * rng.uniform(10.0, 50.0, bad.sum())
    return Record(u, clean + sigma * noise, dt=DT), np.flatnonzero(bad), sigma


@functools.cache
def solved(loss, share=0.1):
    record, _, _ = outlying(share=share)
    return record, identify(record, AT_REST, ThreeModel(loss=loss))


# ---------------------------------------------------------------------------- independent routes
@pytest.mark.parametrize("share", [0.0, 0.1])
def test_huber_is_the_minimum_that_a_dense_optimiser_finds(share):
    record, _, _ = outlying(share=share, level=0.01)
    found = identify(record, AT_REST, ThreeModel(loss="huber"))
    u, y = record.u[:, 0], record.y[:, 0]
    limit = 1.345 * math.sqrt(found.noise_variance[0])
    dense = optimize.least_squares(
        lambda theta: (respond(theta, u) - y) / limit,
        TRUTH,
        jac="3-point",
        loss="huber",
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    assert np.allclose(found.theta, dense.x, rtol=1e-6)


def test_huber_scale_is_that_of_the_final_residual():
    record, found = solved("huber")
    r = record.y[:, 0] - respond(found.theta, record.u[:, 0])
    k = 1.345
    x = np.clip(r / math.sqrt(found.noise_variance[0]), -k, k)
    expected = stats.norm.expect(lambda z: z * z, lb=-k, ub=k) + 2.0 * k * k * stats.norm.sf(k)
    assert np.sum(x**2) / (r.size - 4) == pytest.approx(expected, rel=1e-4)


@pytest.mark.slow
def test_student_is_the_maximum_of_the_likelihood():
    rng = np.random.default_rng(2)
    u = input_of(800)
    clean = respond(TRUTH, u)
    record = Record(u, clean + 0.05 * clean.std() * rng.standard_t(3, u.size), dt=DT)
    found = identify(record, AT_REST, ThreeModel(loss="student"))

    def cost(v):
        r = record.y[:, 0] - respond(v[:4], u)
        return -stats.t.logpdf(r, math.exp(v[4]), scale=math.exp(v[5])).sum()

    start = np.concatenate([TRUTH, [math.log(3.0), math.log(0.05 * clean.std())]])
    dense = optimize.minimize(
        cost, start, method="Nelder-Mead",
        options={"xatol": 1e-9, "fatol": 1e-10, "maxiter": 20_000, "maxfev": 20_000},
    )  # fmt: skip
    assert np.allclose(found.theta, dense.x[:4], rtol=3e-6)


@robust
def test_standard_errors_are_those_of_the_sandwich(loss):
    """(sum psi' J' J)^-1 (sum psi^2 J' J) (sum psi' J' J)^-1 with the independence of both."""
    record, found = solved(loss)
    u = record.u[:, 0]
    r = record.y[:, 0] - respond(found.theta, u)
    columns = []
    for k in range(4):
        step = 1e-6 * np.eye(4)[k]
        columns.append((respond(found.theta + step, u) - respond(found.theta - step, u)) / 2e-6)
    j = np.stack(columns, axis=1)
    if loss == "huber":
        s, k = math.sqrt(found.noise_variance[0]), 1.345
        psi, slope = np.clip(r / s, -k, k), np.abs(r / s) <= k
    else:
        nu, _, s = stats.t.fit(r, floc=0.0)
        nu = max(nu, 1.0)
        s = optimize.brentq(lambda v: np.mean((nu + 1) * r**2 / (nu * v**2 + r**2)) - 1, 1e-6, 9.0)
        x = r / s
        psi, slope = (nu + 1) * x / (nu + x**2), (nu + 1) * (nu - x**2) / (nu + x**2) ** 2
    n = r.size
    few = 1.0 + 4 / n * np.var(slope) / np.mean(slope) ** 2
    variance = (few * s) ** 2 * np.sum(psi**2) / (n - 4) / np.mean(slope) ** 2
    wanted = np.sqrt(np.diag(variance * np.linalg.inv(j.T @ j)))
    assert np.allclose(found.std, wanted, rtol=2e-3)


# ------------------------------------------------------------------------------ what it is for
@robust
@pytest.mark.parametrize("one_sided", [False, True])
@pytest.mark.fast("True-huber", "False-student")
def test_outliers_hardly_move_the_estimate(loss, one_sided):
    record, bad, sigma = outlying(one_sided=one_sided)
    structure = dataclasses.replace(AT_REST, offset=True)
    found = identify(record, structure, ThreeModel(loss=loss))
    clean = np.array(record.y)
    clean[bad] = np.nan
    without = identify(Record(record.u, clean, dt=DT), structure, ThreeModel(noise="white"))
    plain = identify(record, structure, ThreeModel(noise="white"), throw=False)
    assert np.all(np.abs(found.theta - without.theta) < 2.0 * without.std)
    assert np.all(np.abs(found.theta - TRUTH) < 4.0 * found.std)
    assert np.all(found.std < 1.6 * without.std)
    assert np.all(plain.std > 5.0 * found.std)
    assert math.sqrt(found.noise_variance[0]) == pytest.approx(sigma, rel=0.3)
    assert found.fit[0] > 90.0


@robust
def test_outliers_are_named_with_their_weights(loss):
    record, bad, _ = outlying()
    _, found = solved(loss)
    assert found.loss == loss
    assert found.outliers.shape[1] == 4
    # an outlier of 10 standard deviations can be met by noise of 3
    assert np.array_equal(found.outliers[:, 2].astype(int), bad)
    assert np.all(found.outliers[:, :2] == 0)
    assert np.all((found.outliers[:, 3] > 0) & (found.outliers[:, 3] < 0.4))
    assert any(f"{bad.size} of {record.n_samples} samples" in x for x in found.trace.decisions)
    assert "noise taken as white" in found.trace.decisions[-1]


@robust
def test_clean_record_keeps_its_estimate(loss):
    record, found = solved(loss, 0.0)
    plain = identify(record, AT_REST, ThreeModel(noise="white", finish="likelihood"))
    assert found.outliers.shape == (0, 4)
    assert np.all(np.abs(found.theta - plain.theta) < plain.std)
    assert np.allclose(found.std, plain.std, rtol=0.1)
    assert found.fit == pytest.approx(plain.fit, abs=0.1)
    assert plain.loss == "squared"
    assert plain.outliers.shape == (0, 4)


@robust
def test_every_output_has_its_own_scale(loss):
    rng = np.random.default_rng(11)
    u = input_of(600)
    one, two = respond(TRUTH, u), respond(np.array([1.0, 3.0, 0.0, 40.0]), u)
    y = np.column_stack([one, two])
    sigma = np.array([0.05, 0.1]) * y.std(axis=0)
    noise = rng.standard_normal(y.shape)
    bad = rng.random(u.size) < 0.08
    noise[bad, 1] += 40.0
    structure = Structure(2, [[1], [0]], offset=False, initial_state="rest")
    found = identify(Record(u, y + sigma * noise, dt=DT), structure, ThreeModel(loss=loss))
    assert np.allclose(np.sqrt(found.noise_variance), sigma, rtol=0.25)
    assert set(found.outliers[:, 1]) == {1.0}
    assert np.array_equal(found.outliers[:, 2].astype(int), np.flatnonzero(bad))
    truth = np.array([1.0, 3.0, 0.2, 0.5, 40.0])
    assert np.all(np.abs(found.theta - truth) < 4.0 * found.std)


@robust
def test_missing_samples_and_several_records(loss):
    first, bad, _ = outlying(400, seed=3)
    second, also, _ = outlying(300, seed=4)
    y = np.array(first.y)
    gone = np.arange(20, 60)
    y[gone] = np.nan
    records = [Record(first.u, y, dt=DT), second]
    found = identify(records, AT_REST, ThreeModel(loss=loss))
    where = found.outliers[:, [0, 2]].astype(int).tolist()
    wanted = [[0, k] for k in bad if k not in gone] + [[1, k] for k in also]
    assert where == wanted
    assert np.all(np.abs(found.theta - TRUTH) < 4.0 * found.std)
    assert found.n_samples == 700


@robust
@pytest.mark.fast("huber")
def test_output_error_by_hand_ends_on_the_same_minimum(loss):
    record, reference = solved(loss)
    start = TransferFunction([1.0], [1.0, 2.0, 2.0])
    for method in (OutputError(start, loss=loss), OutputError(loss=loss)):
        found = identify(record, AT_REST, method)
        assert np.allclose(found.theta, reference.theta, rtol=1e-5)
        assert found.method == "OutputError"


@robust
@pytest.mark.parametrize("factor", [1e-6, 1e6])
@pytest.mark.fast("1e-06-huber", "1000000.0-student")
def test_time_scale_does_not_matter(loss, factor):
    record, reference = solved(loss)
    other = Record(record.u, record.y, dt=DT * factor)
    found = identify(other, AT_REST, ThreeModel(loss=loss))
    scale = factor ** -np.array([1.0, 2.0, 1.0, 2.0])
    assert np.allclose(found.theta, scale * reference.theta, rtol=1e-5)
    assert np.array_equal(found.outliers[:, :3], reference.outliers[:, :3])


@robust
def test_record_without_noise_keeps_its_coefficients_despite_outliers(loss):
    u = input_of(300)
    y = respond(TRUTH, u)
    y[[10, 100, 101, 250]] += [5.0, -3.0, 2.0, 80.0]
    found = identify(Record(u, y, dt=DT), AT_REST, ThreeModel(loss=loss), throw=False)
    assert np.allclose(found.theta, TRUTH, rtol=1e-8)


# -------------------------------------------------------------------------------------- options
@robust
def test_a_saved_estimate_keeps_loss_and_outliers(loss, tmp_path):
    _, found = solved(loss)
    again = Estimate.load(found.save(tmp_path / "model.json"))
    assert again.loss == loss
    assert np.array_equal(again.outliers, found.outliers)
    assert not again.outliers.flags.writeable


@pytest.mark.parametrize("method", [ThreeModel, OutputError])
@pytest.mark.parametrize("value", ["Huber", "l1", "", None, True, 1.0, ["huber"]], ids=repr)
def test_other_losses_are_refused(method, value):
    with pytest.raises(err.OptionError, match="expected 'squared', 'huber' or 'student'"):
        method(loss=value)


@robust
def test_noise_model_with_a_robust_loss_is_refused(loss):
    with pytest.raises(err.OptionError, match="noise='ar'"):
        ThreeModel(loss=loss, noise="ar")


@robust
def test_posterior_is_left_out_and_said(loss):
    record, _, _ = outlying()
    found = identify(record, AT_REST, ThreeModel(loss=loss, finish="posterior"))
    assert any("posterior mean is for squared loss" in x for x in found.trace.decisions)
    assert np.array_equal(found.theta, solved(loss)[1].theta)


@robust
def test_the_same_record_gives_the_same_estimate(loss):
    record, found = solved(loss)
    again = identify(record, AT_REST, ThreeModel(loss=loss))
    assert np.array_equal(again.theta, found.theta)
    assert again.record_fingerprint == identify(record, AT_REST).record_fingerprint
