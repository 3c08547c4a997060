"""The precision of plans against finite differences of `simulate`, and what follows from it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from oracles import cramer_rao
from tridentify import OutputError, Record, Structure, TransferFunction, identify, simulate
from tridentify.errors import (
    ChannelCountError,
    ConstantInputError,
    DelayError,
    OptionError,
    OrderError,
    ParameterNameError,
    UndeterminedError,
    UnsupportedError,
)
from tridentify.excitation import Excitation, doublet, multisine, prbs, precision
from tridentify.studies.cramer_rao import output_sensitivities

pytestmark = pytest.mark.unjudged

SECOND = TransferFunction([1.0, 3.0], [1.0, 2.0, 9.0])
REST = {"offset": False, "initial_state": "rest"}


def response(theta, structure, like, record):
    num, den = structure.split(theta, like.n_outputs, like.n_inputs)
    delay = like.delay
    if structure.delay == "free":
        delay = np.tile(theta[-like.n_inputs :], (like.n_outputs, 1))
    return simulate(TransferFunction(num, den, delay=delay), record)


def nuisances(like, record, *, free, offset, drift):
    """Columns (n_samples, n_outputs, m) of what is estimated along."""
    columns = []
    n_samples, n_outputs = record.n_samples, like.n_outputs
    for i in range(n_outputs):
        for on, course in ((offset, np.ones(n_samples)), (drift, record.t - record.t[0])):
            if on:
                own = np.zeros((n_samples, n_outputs))
                own[:, i] = course
                columns.append(own)
        for j in range(like.n_inputs if like.common_denominator is None else 1):
            order = like.den[i][j].size - 1
            for k in range(order if free else 0):
                row = np.zeros(order)
                row[k] = 1.0
                one = TransferFunction([1.0], like.den[i][j])
                own = np.zeros((n_samples, n_outputs))
                still = Record(np.zeros(n_samples), np.zeros(n_samples), t=record.t)
                own[:, i] = simulate(one, still, free_response=row[None])[:, 0]
                columns.append(own)
    return np.stack(columns, axis=2) if columns else np.zeros((n_samples, n_outputs, 0))


def by_differences(
    theta, structure, like, records, noise, *, free=False, offset=False, drift=False
):
    """The bound from central differences, with dense columns for all that is estimated along."""
    theta = np.asarray(theta, dtype=float)
    rows, widths = [], []
    for record in records:
        slopes = []
        for k in range(theta.size):
            step = np.zeros(theta.size)
            step[k] = 1e-5 * (abs(theta[k]) or 1.0)
            apart = response(theta + step, structure, like, record)
            apart = apart - response(theta - step, structure, like, record)
            slopes.append(apart / (2 * step[k]))
        beside = nuisances(like, record, free=free, offset=offset, drift=drift)
        seen = ~np.isnan(record.y) if record.n_outputs == like.n_outputs else True
        weight = np.where(seen, 1.0 / np.broadcast_to(noise, like.n_outputs), 0.0)
        weight = np.broadcast_to(weight, slopes[0].shape)
        own = np.stack(slopes, axis=2) * weight[:, :, None]
        beside = beside * weight[:, :, None]
        q, _ = np.linalg.qr(beside.reshape(own[..., 0].size, -1))
        flat = own.reshape(-1, theta.size)
        rows.append(flat - q @ (q.T @ flat))
        widths.append(flat.shape[1])
    whole = np.vstack(rows)
    size = np.linalg.norm(whole, axis=0)
    return np.linalg.inv((whole / size).T @ (whole / size)) / np.outer(size, size)


def switched(n, n_inputs=1, seed=0, hold=9):
    rng = np.random.default_rng(seed)
    return np.repeat(rng.choice([-1.0, 1.0], (n // hold + 1, n_inputs)), hold, axis=0)[:n]


def agree(found, expected, rtol=2e-6):
    """In correlations and standard errors."""
    std = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found.std, std, rtol=rtol)
    np.testing.assert_allclose(found.cov / np.outer(std, std), expected / np.outer(std, std),
                               atol=10 * rtol)  # fmt: skip


def test_it_is_the_bound_of_the_closed_form_at_rest():
    plan = doublet(1.0, dt=0.02, for_frequency=3.0, tail=4.0)
    found = precision(SECOND, plan, Structure(2, 1, **REST), noise_std=0.05)
    columns = output_sensitivities(SECOND, plan.u[:, 0], plan.dt)
    agree(found, cramer_rao(columns, 0.05**2), rtol=1e-9)


@pytest.mark.parametrize("rate", [1.0, 1e6, 1e-6])
@pytest.mark.parametrize("intersample", ["zoh", "foh"])
def test_nuisance_terms_are_counted_at_any_rate(intersample, rate):
    model = TransferFunction([1.0 * rate, 3.0 * rate**2], [1.0, 2.0 * rate, 9.0 * rate**2])
    structure = Structure(2, 1, offset=True, drift=True, initial_state="free")
    plan = Excitation(switched(300), 0.03 / rate, intersample)
    found = precision(model, plan, structure, noise_std=0.1)
    theta = [2.0 * rate, 9.0 * rate**2, rate, 3.0 * rate**2]
    record = plan.record()
    expected = by_differences(
        theta, structure, model, [record], 0.1, free=True, offset=True, drift=True
    )
    agree(found, expected, rtol=1e-5)


def test_uneven_time_and_missing_samples_are_seen():
    rng = np.random.default_rng(2)
    t = np.cumsum(rng.uniform(0.01, 0.05, 240))
    y = np.zeros(240)
    y[50:90] = np.nan
    record = Record(switched(240), y, t=t)
    structure = Structure(2, 1, offset=True, initial_state="rest")
    found = precision(SECOND, record, structure, noise_std=0.1)
    expected = by_differences([2, 9, 1, 3], structure, SECOND, [record], 0.1, offset=True)
    agree(found, expected)


def test_several_channels_and_experiments_add_up():
    model = TransferFunction([[[1.0, 3.0], [2.0]], [[4.0], [0.5, 1.0]]], [1.0, 2.0, 9.0])
    structure = Structure(2, [[1, 0], [0, 1]], offset=True, initial_state="rest")
    plans = [Excitation(switched(200, 2, seed), 0.04) for seed in (0, 1)]
    noise = np.array([0.1, 0.3])
    found = precision(model, plans, structure, noise_std=noise)
    records = [plan.record(output_names=["a", "b"]) for plan in plans]
    theta = [2, 9, 1, 3, 2, 4, 0.5, 1]
    agree(found, by_differences(theta, structure, model, records, noise, offset=True))
    assert found.names[2] == "b1[y1,u1]"


def test_denominators_of_their_own_and_known_delays():
    model = TransferFunction([[[2.0], [3.0]]], [[[1.0, 1.5], [1.0, 1.2, 9.0]]], delay=[[0, 0.137]])
    structure = Structure([[1, 2]], [[0, 0]], delay=[[0.0, 0.137]], **REST)
    plan = Excitation(switched(400, 2), 0.02)
    found = precision(model, plan, structure, noise_std=0.1)
    expected = by_differences([1.5, 2, 1.2, 9, 3], structure, model, [plan.record()], 0.1)
    agree(found, expected)
    assert precision(model, plan, Structure([[1, 2]], [[0, 0]], **REST), noise_std=0.1).std[
        0
    ] == pytest.approx(found.std[0])


def test_a_delay_that_is_estimated_along_costs_precision():
    model = TransferFunction([3.0], [1.0, 1.2, 9.0], delay=0.137)
    structure = Structure(2, 0, delay="free", **REST)
    plan = Excitation(switched(400), 0.02)
    found = precision(model, plan, structure, noise_std=0.1)
    expected = by_differences([1.2, 9, 3, 0.137], structure, model, [plan.record()], 0.1)
    agree(found, expected, rtol=1e-5)
    known = precision(model, plan, Structure(2, 0, delay=0.137, **REST), noise_std=0.1)
    assert np.all(found.std[:3] >= known.std)
    assert found.names[-1] == "delay"


@pytest.mark.judged
def test_what_is_known_has_no_error_and_helps_the_rest():
    plan = Excitation(switched(300), 0.03)
    free = precision(SECOND, plan, Structure(2, 1, **REST), noise_std=0.1)
    fixed = precision(SECOND, plan, Structure(2, 1, fixed={"a1": 2.0}, **REST), noise_std=0.1)
    whole = np.linalg.inv(free.cov)
    np.testing.assert_allclose(fixed.cov[1:, 1:], np.linalg.inv(whole[1:, 1:]), rtol=1e-8)
    assert fixed.std[0] == 0.0
    assert "known" in fixed.summary()
    prior = precision(
        SECOND, plan, Structure(2, 1, priors={"a1": (2.0, 0.05)}, **REST), noise_std=0.1
    )
    whole[0, 0] += 1 / 0.05**2
    np.testing.assert_allclose(prior.cov, np.linalg.inv(whole), rtol=1e-8)


def test_an_integrator_is_planned_for():
    model = TransferFunction([4.0], [1.0, 2.0, 0.0])
    plan = Excitation(switched(300), 0.03)
    structure = Structure(2, 0, fixed={"a0": 0.0}, drift=False, **REST)
    found = precision(model, plan, structure, noise_std=0.1)
    expected = by_differences([2, 0, 4], structure, model, [plan.record()], 0.1)
    information = np.linalg.inv(expected)[np.ix_([0, 2], [0, 2])]
    np.testing.assert_allclose(
        found.std[[0, 2]], np.sqrt(np.diag(np.linalg.inv(information))), rtol=1e-5
    )
    assert precision(model, plan, noise_std=0.1).std[1] == 0.0


def test_amplitude_and_repetitions_for_a_wish_are_those_that_give_it():
    structure = Structure(2, 1, offset=True, initial_state="free")
    plan = Excitation(switched(300), 0.03)
    here = precision(SECOND, plan, structure, noise_std=0.2)
    wish = {"a0": 0.02, "b1": 0.04}
    size = here.amplitude_for(wish)
    there = precision(SECOND, plan.scaled(size), structure, noise_std=0.2)
    over = [there.relative[there.names.index(name)] / goal for name, goal in wish.items()]
    assert max(over) == pytest.approx(1.0, rel=1e-6)
    times = here.repetitions_for(wish)
    enough = precision(SECOND, [plan] * times, structure, noise_std=0.2)
    fewer = precision(SECOND, [plan] * (times - 1), structure, noise_std=0.2)
    goals = np.array([wish[name] for name in wish])
    places = [here.names.index(name) for name in wish]
    assert np.all(enough.relative[places] <= goals * (1 + 1e-9))
    assert np.any(fewer.relative[places] > goals)


def test_amplitude_for_a_wish_with_a_prior():
    structure = Structure(2, 1, priors={"a1": (2.0, 0.1)}, **REST)
    plan = Excitation(switched(300), 0.03)
    here = precision(SECOND, plan, structure, noise_std=0.2)
    size = here.amplitude_for({"a1": 0.03})
    there = precision(SECOND, plan.scaled(size), structure, noise_std=0.2)
    assert there.relative[0] == pytest.approx(0.03, rel=1e-6)


@pytest.fixture(scope="module")
def estimate():
    rng = np.random.default_rng(0)
    u = switched(300)
    y = simulate(SECOND, Record(u, u, dt=0.03))[:, 0]
    record = Record(u, y + 0.05 * rng.standard_normal(y.size), dt=0.03)
    return identify(record, Structure(2, 1, **REST), OutputError()), record


@pytest.mark.judged
def test_the_estimate_of_a_record_has_the_errors_that_a_plan_of_it_says(estimate):
    found, record = estimate
    ahead = precision(found, record)
    np.testing.assert_allclose(ahead.std, found.std, rtol=1e-6)
    assert ahead.draws.shape == (40, 4)
    median, worst = ahead.relative_quantiles
    assert np.all(worst >= median)
    np.testing.assert_allclose(median, ahead.relative, rtol=0.1)
    # what other draws give is a column where it differs from what the estimate gives
    assert "95 % of draws" not in ahead.summary()
    assert "95 % of draws" in replace(ahead, draws=1.5 * ahead.draws).summary()


def test_coloured_noise_of_an_estimate_is_planned_with(estimate):
    found, record = estimate
    slow = replace(found, noise_model=(np.array([-0.9]),))
    ahead, white = precision(slow, record, n_draws=0), precision(found, record, n_draws=0)
    n = record.n_samples
    lags = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    cov = found.noise_variance[0] * 0.9**lags
    columns = output_sensitivities(found.model, record.u[:, 0], record.dt)
    expected = np.linalg.inv(columns.T @ np.linalg.solve(cov, columns))
    np.testing.assert_allclose(ahead.std, np.sqrt(np.diag(expected)), rtol=1e-6)
    assert np.any(ahead.std > 1.2 * white.std)


@pytest.mark.judged
def test_what_the_structure_leaves_open_is_taken_along_and_said():
    plan = doublet(1.0, dt=0.02, for_frequency=3.0, lead=0.2, tail=4.0)
    open_ = precision(SECOND, plan, noise_std=0.05)
    stated = precision(
        SECOND, plan, Structure(2, 1, offset=True, initial_state="free"), noise_std=0.05
    )
    np.testing.assert_allclose(open_.std, stated.std)
    assert "leaves to the data" in open_.summary()
    assert not stated.notes


@pytest.mark.judged
def test_what_it_shows_is_readable():
    ahead = precision(SECOND, prbs(7, dt=0.1), Structure(2, 1, **REST), noise_std=0.1)
    assert "strongest correlation" in ahead.summary()
    assert max(map(len, ahead.summary().splitlines())) <= 100
    assert "<table>" in ahead._repr_html_()
    assert "a0" in repr(ahead)
    assert ahead.to_dict()["names"] == list(ahead.names)
    np.testing.assert_allclose(np.diag(ahead.correlations), 1.0)


UNSTABLE = TransferFunction([1.0], [1.0, -2.0, 9.0])
PLAN = prbs(6, dt=0.1)
RAMPED = Excitation(np.eye(60)[57], 0.1)


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: precision(SECOND, PLAN), OptionError, "noise_std"),
        (lambda: precision(SECOND, PLAN, noise_std=-1.0), OptionError, "noise_std"),
        (lambda: precision(SECOND, [], noise_std=1.0), OptionError, "Excitation"),
        (lambda: precision(SECOND, PLAN, noise_std=1.0, n_draws=-1), OptionError, "n_draws"),
        (lambda: precision(SECOND, PLAN, Structure(3, 0), noise_std=1.0), OrderError, "3 poles"),
        (lambda: precision(SECOND, PLAN, Structure(2, 0), noise_std=1.0), OrderError, "0 zeros"),
        (lambda: precision(UNSTABLE, PLAN, noise_std=1.0), UnsupportedError, "left half plane"),
        (
            lambda: precision(SECOND, prbs(6, dt=0.1, n_inputs=2), noise_std=1.0),
            ChannelCountError,
            "2 inputs",
        ),
        (
            lambda: precision(SECOND, RAMPED, Structure(2, 1, **REST), noise_std=1.0),
            UndeterminedError,
            "tell the coefficients apart",
        ),
        (
            lambda: precision(
                SECOND,
                Excitation(np.ones(50), 0.1),
                Structure(2, 1, initial_state="free", offset=True),
                noise_std=1.0,
            ),
            ConstantInputError,
            "changes",
        ),
        (
            lambda: precision(
                SECOND, multisine(10.0, dt=0.1, harmonics=[3]), Structure(2, 1, **REST),
                noise_std=1.0,
            ).factor_for({"a7": 0.1}),
            ParameterNameError,
            "a7",
        ),
        (
            lambda: precision(SECOND, PLAN, noise_std=1.0).factor_for({"a0": 0.0}),
            OptionError,
            "positive relative",
        ),
        (lambda: precision(SECOND, PLAN, noise_std=1.0).factor_for({}), OptionError, "no wish"),
        (
            lambda: precision(
                TransferFunction([1.0], [1.0, 1.0], delay=0.2),
                PLAN,
                Structure(1, 0, delay=0.3),
                noise_std=1.0,
            ),
            DelayError,
            "expected the same",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_planned_is_refused(call, error, words):
    with pytest.raises(error, match=words):
        call()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_estimates_scatter_as_the_plan_says(seed):
    rng = np.random.default_rng(seed)
    decay, w = rng.uniform(0.2, 0.7), rng.uniform(1.0, 6.0)
    model = TransferFunction([rng.uniform(0.5, 2.0), w**2], [1.0, 2 * decay * w, w**2])
    structure = Structure(2, 1, offset=True, initial_state="free")
    plan = prbs(8, dt=0.25 / w, clock=0.5 / w)
    ahead = precision(model, plan, structure, noise_std=0.1)
    y = simulate(model, plan.record())
    found = []
    for _ in range(400):
        record = plan.record(y + 0.1 * rng.standard_normal(y.shape))
        found.append(identify(record, structure, OutputError(start=model)).theta)
    scatter = np.cov(np.array(found).T)
    # 400 draws: standard deviations are known to 3.5 %
    np.testing.assert_allclose(np.sqrt(np.diag(scatter)), ahead.std, rtol=0.13)
    std = np.sqrt(np.diag(scatter))
    np.testing.assert_allclose(scatter / np.outer(std, std), ahead.correlations, atol=0.15)
