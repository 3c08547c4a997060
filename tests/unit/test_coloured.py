"""Coloured noise: whitened triangles, the alternation, what the estimate says of it."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from tridentify import (
    Estimate,
    Record,
    Structure,
    ThreeModel,
    TransferFunction,
    identify,
    simulate,
)
from tridentify.errors import OptionError, TooFewSamplesError, UnsupportedError
from tridentify.estimation.likelihood import answer, curvature
from tridentify.estimation.likelihood.cost import evaluate
from tridentify.estimation.likelihood.curvature import taken
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import coefficients
from tridentify.estimation.likelihood.noise.noise_model import leaves_coloured_noise
from tridentify.estimation.likelihood.question import Question
from tridentify.estimation.likelihood.setup.nuisance import Nuisances, build
from tridentify.models.regression import BLOCK, Experiment, regress, response_of, restricted
from tridentify.numerics.autoregression import whiten
from tridentify.numerics.levinson import autocovariance, polynomial
from tridentify.numerics.realization import cascade

pytestmark = pytest.mark.unjudged

DT = 0.05
BANK = cascade(np.array([-0.8, -1 + 2j, -1 - 2j, -6.0]))
NOISE = (np.array([-1.2, 0.5]), np.zeros(0), polynomial(np.array([-0.9, 0.4, 0.1])))
TRUTH = TransferFunction([0.2, 0.5], [1.0, 1.0, 3.0])
THETA = np.array([1.0, 3.0, 0.2, 0.5])


def experiment(n=80, *, noise=NOISE, missing=0.0, free=True, offset=True, drift=True):
    rng = np.random.default_rng(7)
    u = rng.standard_normal((n, 2)) + np.array([0.5, -2.0])
    y = rng.standard_normal((n, 3)) + 1.0
    y[rng.random(y.shape) < missing] = np.nan
    return Experiment(u, y, 0.1, "foh", free, offset, drift, noise)


def gram(regression, i):
    z = np.column_stack([regression.signals[i], regression.targets[i]])
    return z.T @ z


def same(found, expected):
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.max(np.abs(found - expected) / scale) < 1e-10


def columns(e):
    """The columns as they are, one by one over time."""
    n_signals = BANK.order * (e.u.shape[1] + e.free) + e.u.shape[1] + e.offset + e.drift
    return response_of(e, BANK, np.eye(n_signals))


# ---------------------------------------------------------------------------- whitened triangles
@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_triangle_is_that_of_generalised_least_squares(missing):
    e = experiment(missing=missing)
    regression = regress(e, BANK)
    signals = columns(e)
    for i, a in enumerate(NOISE):
        seen = np.isfinite(e.y[:, i])
        z = np.column_stack([signals, e.y[:, i]])[seen]
        covariance = toeplitz(autocovariance(a, e.n_samples - 1))[np.ix_(seen, seen)]
        same(gram(regression, i), z.T @ np.linalg.solve(covariance, z))
        assert regression.counts[i] == seen.sum()
        assert regression.log_scale[i] == pytest.approx(np.linalg.slogdet(covariance)[1], abs=1e-9)


@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_blocks_make_no_difference(missing, monkeypatch):
    e = experiment(2 * BLOCK + 100, missing=missing)
    found = regress(e, BANK)
    monkeypatch.setattr("tridentify.models.regression.BLOCK", e.n_samples)
    monkeypatch.setattr("tridentify.models.regression.NEGLIGIBLE", 0.0)
    expected = regress(e, BANK)
    for i in range(3):
        same(gram(found, i), gram(expected, i))


def test_fewer_nuisance_columns_are_those_of_a_smaller_record():
    constants = np.array([3.0, -0.5])
    whole = regress(experiment(missing=0.2), BANK)
    found = restricted(whole, BANK, free=False, offset=True, drift=False, constants=constants)
    e = experiment(missing=0.2, free=False, drift=False)
    moved = Experiment(e.u + constants, e.y, e.dt, e.intersample, False, True, False, NOISE)
    expected = regress(moved, BANK)
    for i in range(3):
        same(gram(found, i), gram(expected, i))
    assert found.log_scale == expected.log_scale


def test_white_noise_takes_the_shared_triangle():
    e = experiment(noise=(np.zeros(0),) * 3)
    regression = regress(e, BANK)
    assert regression.signals[0] is regression.signals[1]
    assert regression.log_scale == ()


# -------------------------------------------------------------------------------- the alternation
def excitation(n, seed=0):
    rng = np.random.default_rng(seed)
    return np.repeat(rng.choice([-1.0, 1.0], -(-n // 10)), 10)[:n]


def coloured(a, n=1000, *, seed=0, level=0.15, dt=DT):
    """Record with noise of a given standard deviation relative to that of the output."""
    u = excitation(n, seed)
    y = simulate(TRUTH, Record(u, u, dt=dt))[:, 0]
    noise = lfilter([1.0], np.append(1.0, a), np.random.default_rng(seed).standard_normal(n + 500))
    noise = noise[500:] / np.sqrt(autocovariance(np.array(a), 0)[0])
    return Record(u, y + level * np.std(y) * noise, dt=dt)


REST = {"offset": False, "initial_state": "rest"}
STRUCTURE = Structure(2, 1, **REST)


def dense_estimate(record, a, start):
    """Gauss-Newton on generalised least squares with the dense covariance; theta and cov."""
    n = record.n_samples
    root = np.linalg.cholesky(toeplitz(autocovariance(a, n - 1)))

    def output(theta):
        return simulate(TransferFunction(theta[2:], np.append(1.0, theta[:2])), record)[:, 0]

    theta = start.copy()
    for _ in range(20):
        steps = 1e-6 * np.abs(theta)
        scores = np.column_stack(
            [
                (output(theta + h * unit) - output(theta - h * unit)) / (2 * h)
                for h, unit in zip(steps, np.eye(4), strict=True)
            ]
        )
        scores = np.linalg.solve(root, scores)
        error = np.linalg.solve(root, record.y[:, 0] - output(theta))
        theta = theta + np.linalg.lstsq(scores, error, rcond=None)[0]
    variance = error @ error / (n - 4 - a.size)
    return theta, variance * np.linalg.inv(scores.T @ scores)


def test_estimate_is_dense_generalised_least_squares_at_its_own_noise_model(monkeypatch):
    record = coloured([-0.9], 400)
    allowed = identify(record, STRUCTURE, ThreeModel(noise="ar"))
    # what it costs that the noise is estimated has tests of its own
    monkeypatch.setattr(answer, "estimated_noise", lambda *_: None)
    estimate = identify(record, STRUCTURE, ThreeModel(noise="ar"))
    assert np.array_equal(estimate.theta, allowed.theta)
    assert np.all((estimate.std < allowed.std) & (allowed.std < 1.15 * estimate.std))
    (a,) = estimate.noise_model
    theta, cov = dense_estimate(record, a, estimate.theta)
    assert np.allclose(theta, estimate.theta, rtol=0, atol=1e-3 * estimate.std)
    assert np.allclose(np.sqrt(np.diag(cov)), estimate.std, rtol=1e-3)


@pytest.mark.judged
def test_noise_model_is_that_of_the_residual():
    record = coloured([-0.9], 4000)
    estimate = identify(record, STRUCTURE)
    (a,) = estimate.noise_model
    assert a[0] == pytest.approx(-0.9, abs=0.05)
    residual = estimate.residual(record)[:, 0]
    assert estimate.noise_variance[0] == pytest.approx(
        residual @ residual / estimate.degrees_of_freedom, rel=1e-9
    )
    assert estimate.degrees_of_freedom == record.n_samples - 4 - a.size
    innovations = whiten(residual, a)[0]
    assert np.var(innovations) < 0.3 * np.var(residual)
    assert not any("not white" in line for line in estimate.cautions)


@pytest.mark.parametrize("missing", [False, True])
def test_what_the_fit_took_has_the_covariance_of_the_fitted_output(missing):
    """``X C X'`` by finite differences of the simulation, at the estimate's own noise model."""
    record = coloured([-0.9], 200)
    if missing:
        y = record.y[:, 0].copy()
        y[[20, 21, 90]] = np.nan
        record = Record(record.u, y, dt=DT)
    a = np.array([-0.9])
    problem = build([record], STRUCTURE, Nuisances("rest", False, False)).whitened((a,))
    point = evaluate(problem, np.roots([1.0, 1.0, 3.0]))
    series = np.stack(taken(point, 0), axis=1)
    seen = np.isfinite(record.y[:, 0])
    assert np.array_equal(np.isnan(series).any(axis=1), ~seen)

    theta = coefficients(point)
    scores = []
    for unit in np.eye(4):
        step = 1e-5 * np.abs(theta) * unit
        ends = [
            simulate(TransferFunction(t[2:], np.append(1.0, t[:2])), record)[:, 0]
            for t in (theta + step, theta - step)
        ]
        scores.append((ends[0] - ends[1]) / (2 * step.sum()))
    scores = np.stack(scores, axis=1)[seen]
    covariance = toeplitz(autocovariance(a, 199))[np.ix_(seen, seen)]
    variance = point.rss[0] / (seen.sum() - 4 - 1)
    unknowns = variance * np.linalg.inv(scores.T @ np.linalg.solve(covariance, scores))
    expected = scores @ unknowns @ scores.T
    found = series[seen] @ series[seen].T
    assert np.max(np.abs(found - expected)) < 1e-6 * np.max(np.abs(expected))


def test_fit_is_that_of_the_simulated_output():
    record = coloured([-0.9])
    estimate = identify(record, STRUCTURE)
    residual = record.y[:, 0] - simulate(estimate.model, record)[:, 0]
    expected = 100 * (1 - np.linalg.norm(residual) / np.linalg.norm(record.y - record.y.mean()))
    assert estimate.fit[0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.judged
@pytest.mark.slow
def test_standard_errors_grow_with_slow_noise(monkeypatch):
    record = coloured([-0.95], seed=2)
    seen = identify(record, STRUCTURE, ThreeModel(noise="white"))
    monkeypatch.setattr(curvature, "scatter_of_scores", lambda *_: None)
    white, auto = (identify(record, STRUCTURE, ThreeModel(noise=n)) for n in ("white", "auto"))
    assert white.noise_model[0].size == 0
    assert any("not white" in line for line in white.cautions)
    assert np.all(auto.std > 1.2 * white.std)
    # without a noise model the scores show it
    assert seen.errors == "scores"
    assert np.all(seen.std > 1.2 * white.std)


@pytest.mark.parametrize("seed", range(5))
def test_white_noise_is_left_white(seed):
    record = coloured([], seed=seed)
    white, auto = (identify(record, STRUCTURE, ThreeModel(noise=n)) for n in ("white", "auto"))
    assert np.array_equal(white.theta, auto.theta)
    assert np.array_equal(white.cov, auto.cov)
    assert white.aicc == auto.aicc
    assert any("portmanteau" in line for line in auto.trace.decisions)


@pytest.mark.parametrize("seed", range(3))
def test_white_noise_is_left_white_where_the_record_starts_in_equilibrium(seed):
    # the residual that is tested belongs to the input as it is counted, from its first value
    rng = np.random.default_rng(seed)
    plant = TransferFunction([3e-7], [1.0, 6e-4, 4e-8])
    u = np.repeat(rng.uniform(1.0, 3.0, 24), 12)
    clean = simulate(plant, Record(u - u[0], u, dt=300.0))[:, 0] + 21.0
    record = Record(u, clean + 0.1 * rng.standard_normal(u.size), dt=300.0)
    found = identify(record, Structure(2, 0))
    assert found.nuisance[0].initial_state == "equilibrium"
    assert found.noise_model[0].size == 0
    assert abs(found.nuisance[0].offset[0] - 21.0) < 0.1
    assert 0.08 < found.noise_variance[0] ** 0.5 < 0.12


def test_model_of_white_noise_costs_little():
    record = coloured([], seed=1)
    white, ar = (identify(record, STRUCTURE, ThreeModel(noise=n)) for n in ("white", "ar"))
    assert ar.noise_model[0].size >= 1
    assert np.all(np.abs(ar.theta - white.theta) < 0.5 * white.std)
    assert np.allclose(ar.std, white.std, rtol=0.2)
    # the noise model is not worth its coefficients
    assert ar.aicc > white.aicc - 2.0


def test_criterion_prefers_the_noise_model_where_the_noise_is_coloured():
    record = coloured([-0.9])
    white, auto = (identify(record, STRUCTURE, ThreeModel(noise=n)) for n in ("white", "auto"))
    assert auto.aicc < white.aicc - 100.0


def test_noise_free_record_is_not_whitened():
    u = excitation(400)
    record = Record(u, simulate(TRUTH, Record(u, u, dt=DT)), dt=DT)
    for noise in ("auto", "ar"):
        estimate = identify(record, STRUCTURE, ThreeModel(noise=noise))
        assert estimate.noise_model[0].size == 0
        assert np.allclose(estimate.theta, THETA, rtol=1e-9)


WANDERING = np.array([2.6, 2.6, 1.2, 2.2])


def beside_a_slow_sine(seed: int) -> Record:
    """A plant beside a disturbance of less than one period, larger than its response."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(100), 6)
    model = TransferFunction(WANDERING[2:], np.append(1.0, WANDERING[:2]))
    y = simulate(model, Record(u, u, dt=0.2))[:, 0]
    turns = rng.uniform(0.1, 0.6) * np.arange(u.size) / u.size + rng.random()
    y = y + 1.5 * np.std(y) * np.sin(2.0 * np.pi * turns)
    return Record(u, y + 0.003 * rng.standard_normal(u.size), dt=0.2)


def far_off(record: Record) -> bool:
    """Whether an end is more than 4 stated errors from the truth."""
    estimate = ThreeModel().estimate([record], Structure(2, 1))
    return bool(np.any(np.abs(estimate.theta - WANDERING) > 4.0 * estimate.std))


def test_a_plant_that_took_a_slow_disturbance_for_a_mode_is_asked_with_a_model_of_the_noise():
    """White weights end at a mode as slow as the record, and their residual follows the input."""
    assert not far_off(beside_a_slow_sine(0))


@pytest.mark.slow
def test_slow_disturbances_seldom_become_a_mode_of_the_plant():
    """Of the first 30 all but two were far off where that residual alone decided."""
    assert sum(far_off(beside_a_slow_sine(seed)) for seed in range(1000, 1060)) <= 9


@pytest.mark.judged
@pytest.mark.slow
def test_missing_response_is_not_taken_for_noise():
    """Without noise, a model of too low an order: nearly all of its residual is a response."""
    u = excitation(800)
    system = TransferFunction([8.0, 40.0], np.poly([-1 + 3j, -1 - 3j, -4.0]).real)
    record = Record(u, simulate(system, Record(u, u, dt=DT)), dt=DT)
    estimate = identify(record, STRUCTURE)
    assert estimate.noise_model[0].size == 0
    assert any("follows the input" in line for line in estimate.trace.decisions)
    assert any("not white" in line for line in estimate.cautions)
    asked = identify(record, STRUCTURE, ThreeModel(noise="ar"), throw=False)
    assert asked.noise_model[0].size > 0


@pytest.mark.judged
def test_each_output_has_its_own_noise():
    first, second = coloured([-0.9], seed=3), coloured([], seed=4)
    gain = simulate(TransferFunction([1.0, 2.0], [1.0, 1.0, 3.0]), first)[:, 0]
    noise = 0.1 * np.std(gain) * np.random.default_rng(5).standard_normal(second.n_samples)
    record = Record(first.u, np.column_stack([first.y[:, 0], gain + noise]), dt=DT)
    estimate = identify(record, STRUCTURE)
    assert [a.size > 0 for a in estimate.noise_model] == [True, False]
    assert np.all(np.abs(estimate.theta - [*THETA, 1.0, 2.0]) < 4.5 * estimate.std)
    assert "y1: AR(" in estimate.summary()


def test_experiments_share_the_noise_model_and_gaps_are_allowed():
    records = [coloured([-0.9], 500, seed=k) for k in (6, 7)]
    y = records[0].y[:, 0].copy()
    y[50:90], y[200] = np.nan, np.nan
    records[0] = Record(records[0].u, y, dt=DT)
    estimate = identify(records, STRUCTURE)
    (a,) = estimate.noise_model
    assert a[0] == pytest.approx(-0.9, abs=0.15)
    assert estimate.degrees_of_freedom == 1000 - 41 - 4 - a.size
    assert np.all(np.abs(estimate.theta - THETA) < 4.5 * estimate.std)


@pytest.mark.parametrize("factor", [1e-6, 1e6])
@pytest.mark.fast("1e-06")
def test_time_scale_makes_no_difference(factor):
    record = coloured([-0.9], 500)
    estimate = identify(record, STRUCTURE)
    scaled = identify(Record(record.u, record.y, dt=DT * factor), STRUCTURE)
    powers = np.array([factor, factor**2, factor, factor**2])
    assert np.allclose(scaled.theta * powers, estimate.theta, rtol=1e-5)
    assert np.allclose(scaled.std * powers, estimate.std, rtol=1e-4)
    assert scaled.noise_model[0].size == estimate.noise_model[0].size


# --------------------------------------------------------------------------------- what is said
def test_unknown_option_is_refused():
    with pytest.raises(OptionError, match="found noise='pink'"):
        ThreeModel(noise="pink")


def test_experiments_with_different_steps():
    records = [coloured([-0.95], 500, seed=8), coloured([-0.95], 500, seed=9, dt=0.04)]
    with pytest.raises(UnsupportedError, match=r"0\.04 to 0\.05"):
        identify(records, STRUCTURE, ThreeModel(noise="ar"))
    estimate = identify(records, STRUCTURE)
    assert any("noise taken as white" in line for line in estimate.trace.decisions)


@pytest.mark.slow
def test_too_few_samples():
    record = coloured([-0.9], 25)
    with pytest.raises(TooFewSamplesError, match="noise model"):
        identify(record, STRUCTURE, ThreeModel(noise="ar"))
    estimate = identify(record, STRUCTURE, throw=False)
    assert any("too few samples" in line for line in estimate.trace.decisions)


@pytest.mark.judged
def test_summary_and_trace_say_what_was_done():
    estimate = identify(coloured([-0.9]), STRUCTURE)
    assert f"noise model y: AR({estimate.noise_model[0].size})" in estimate.summary()
    assert any("samples whitened by autoregressions" in d for d in estimate.trace.decisions)
    assert [one.number for one in estimate.trace.passes] == list(
        range(1, len(estimate.trace.passes) + 1)
    )
    assert any("samples whitened" in one.note for one in estimate.trace.passes)


def test_noise_model_survives_saving_and_old_files_still_load(tmp_path):
    estimate = identify(coloured([-0.9]), STRUCTURE)
    again = Estimate.load(estimate.save(tmp_path / "model.json"))
    assert len(again.noise_model) == 1
    assert np.array_equal(again.noise_model[0], estimate.noise_model[0])
    with pytest.raises(ValueError, match="read-only"):
        again.noise_model[0][0] = 0.0
    document = json.loads((tmp_path / "model.json").read_text(encoding="utf-8"))
    del document["noise_model"]
    (tmp_path / "old.json").write_text(json.dumps(document), encoding="utf-8")
    old = Estimate.load(tmp_path / "old.json")
    assert [a.size for a in old.noise_model] == [0]


def test_the_search_leaves_coloured_noise_to_whitened_samples() -> None:
    rng = np.random.default_rng(8)
    u = np.repeat(rng.choice([-1.0, 1.0], 100), 6)
    model = TransferFunction([0.5], [1.0, 1.0, 3.0])
    clean = simulate(model, Record(u, u, dt=0.05))[:, 0]
    white = rng.standard_normal(u.size)
    slow = lfilter([1.0], [1.0, -0.9], white)
    poles = np.array([-0.5 + 1.658j, -0.5 - 1.658j])
    for noise, expected in ((slow / slow.std(), True), (white, False)):
        record = Record(u, clean + 0.2 * clean.std() * noise, dt=0.05)
        problem = Question.of([record], Structure(2, 0)).base
        assert leaves_coloured_noise(evaluate(problem, poles)) is expected
    # a residual that follows the input asks for other poles, whatever its colour
    record = Record(u, clean + 0.01 * clean.std() * slow / slow.std(), dt=0.05)
    problem = Question.of([record], Structure(1, 0)).base
    assert not leaves_coloured_noise(evaluate(problem, np.array([-3.0 + 0j])))
