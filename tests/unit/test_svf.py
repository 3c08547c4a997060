"""State-variable filters on raw records: least squares, instruments, and their covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lsim

from oracles import register
from tridentify import (
    Record,
    Status,
    Structure,
    SvfInstrumentalVariable,
    SvfLeastSquares,
    TransferFunction,
    identify,
    simulate,
)
from tridentify.errors import DependentInputsError, OptionError, UnsupportedError
from tridentify.estimation.likelihood.setup.nuisance import build, candidates
from tridentify.estimation.methods.filtered.filter_cascade import filter_cascade
from tridentify.estimation.methods.filtered.state_variable_filters import (
    backward,
    filtered_outputs,
    fit,
    unreduced,
    with_filtered,
)
from tridentify.estimation.methods.filtered.svf_instrumental_variable import instrumental_passes
from tridentify.estimation.methods.filtered.svf_least_squares import covariance, least_squares
from tridentify.models.regression import regress

pytestmark = pytest.mark.unjudged

BOTH = [SvfLeastSquares, SvfInstrumentalVariable]
TRUTH = np.array([1.0, 3.0, 0.2, 0.5])
PLANT = TransferFunction([0.2, 0.5], [1.0, 1.0, 3.0])
REST = Structure(2, 1, offset=False, initial_state="rest")


def levels(count, hold, seed=1):
    """Random levels +-1, each held for `hold` samples."""
    signs = np.sign(np.random.default_rng(seed).standard_normal(-(-count // hold)))
    return np.repeat(signs, hold)[:count]


def record(dt=0.05, noise=0.0, seed=0, duration=20.0, model=PLANT, intersample="zoh", free=None):
    """A response to levels held for 0.4 s (for "foh": to the lines that join the same instants)."""
    count = round(duration / dt)
    t = np.arange(count) * dt
    if intersample == "zoh":
        u = levels(count, round(0.4 / dt))
    else:
        corners = levels(round(duration / 0.4) + 2, 1)
        u = np.interp(t, 0.4 * np.arange(corners.size), corners)
    y = simulate(model, Record(u, u, dt=dt, intersample=intersample), free_response=free)
    y = y + noise * np.std(y) * np.random.default_rng(seed).standard_normal(y.shape)
    return Record(u, y, dt=dt, intersample=intersample)


def worst(estimate, truth=TRUTH):
    """Largest relative error of a coefficient."""
    return float(np.max(np.abs(estimate.theta - truth) / np.abs(truth)))


# ------------------------------------------------------------------------------------ the filters
def test_filtered_output_is_that_of_another_simulator():
    e = build([record(noise=0.1)], REST, candidates([record()], REST)[0]).experiments[0]
    c = filter_cascade([1.0, 3.0, 7.0], 2)
    ours = filtered_outputs(e, c, np.ones(e.n_samples))
    t = np.arange(e.n_samples) * e.dt
    for k, signal in enumerate((e.y[:, 0], np.ones(e.n_samples))):
        theirs = lsim((c.a, c.b[:, None], np.eye(2), np.zeros((2, 1))), signal, t, interp=True)[1]
        assert np.allclose(ours[:, 2 * k : 2 * k + 2], theirs, rtol=0, atol=1e-10)


@pytest.mark.parametrize("degree", [2, 3])
def test_backward_is_the_transpose(degree):
    rng = np.random.default_rng(2)
    c = filter_cascade(np.poly([-1.0, -2.0 + 1j, -2.0 - 1j][3 - degree :]).real, 2)
    row, dt, count = rng.standard_normal(degree), 0.1, 30
    e = build([record()], REST, candidates([record()], REST)[0]).experiments[0]
    forward = np.empty((count, count))
    for k in range(count):
        unit = replace(e, y=np.eye(count)[:, k : k + 1], dt=dt)
        forward[:, k] = filtered_outputs(unit, c) @ row
    w = rng.standard_normal((count, 4))
    assert np.allclose(backward(w, row, c, dt), forward.T @ w, rtol=0, atol=1e-13)


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
def test_every_sample_a_row_is_the_same_as_the_triangle(intersample):
    structure = Structure(2, 1, offset=True, initial_state="free")
    data = [record(noise=0.1, intersample=intersample)]
    e = build(data, structure, candidates(data, structure)[0]).experiments[0]
    c = filter_cascade([1.0, 3.0, 7.0], 2)
    extended = with_filtered(e, c)
    rows, short = unreduced(extended, c), regress(extended, c)
    assert rows.signals[0].shape[0] == e.n_samples
    long = np.column_stack([rows.signals[0], *rows.targets])
    brief = np.column_stack([short.signals[0], *short.targets])
    assert np.allclose(long.T @ long, brief.T @ brief, rtol=1e-9, atol=1e-9)


# --------------------------------------------------------------------------------- without noise
@pytest.mark.parametrize("method", BOTH)
@pytest.mark.parametrize("intersample", ["zoh", pytest.param("foh", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "filter",
    [(1.0, 4.0, 4.0), pytest.param((1.0, 6.0, 12.0, 8.0), marks=pytest.mark.slow)],
    ids=["n", "n + 1"],
)
def test_error_of_joining_the_output_falls_with_the_square_of_the_step(method, intersample, filter):
    errors = [
        worst(identify(record(dt, intersample=intersample), REST, method(filter)))
        for dt in (0.1, 0.05, 0.025)
    ]
    assert 1e-4 < errors[0] < 1e-2
    orders = np.diff(np.log2(errors))
    assert np.all(np.abs(orders + 2.0) < 0.1)


def test_error_with_a_direct_term_falls_with_the_step():
    model, truth = TransferFunction([0.3, 0.2, 0.5], [1.0, 1.0, 3.0]), [1.0, 3.0, 0.3, 0.2, 0.5]
    structure = Structure(2, 2, offset=False, initial_state="rest")
    errors = [
        worst(identify(record(dt, model=model), structure, SvfLeastSquares((1, 4, 4))), truth)
        for dt in (0.05, 0.025)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize("method", BOTH)
@pytest.mark.parametrize(
    ("structure", "offset", "drift", "free"),
    [
        (Structure(2, 1, offset=False, initial_state="free"), 0.0, 0.0, True),
        (Structure(2, 1, offset=True, initial_state="rest"), 5.0, 0.0, False),
        (Structure(2, 1, offset=False, drift=True, initial_state="rest"), 0.0, 0.1, False),
        (Structure(2, 1, offset=True, drift=True, initial_state="free"), -5.0, 0.1, True),
    ],
    ids=["free", "offset", "drift", "all"],
)
def test_nuisance_terms_cost_no_accuracy(method, structure, offset, drift, free):
    """Their columns are exact: only the lines between the samples of y remain, as without them."""
    data = record(0.025, free=np.array([[0.7, -1.0]]) if free else None)
    y = data.y + offset + drift * data.t[:, None]
    found = identify(Record(data.u, y, dt=data.dt), structure, method((1.0, 4.0, 4.0)))
    assert worst(found) < 1e-3
    assert found.nuisance[0].drift[0] == pytest.approx(drift, abs=1e-4)
    moved = found.nuisance[0].input_reference[0] * 0.5 / 3.0  # the reference times the static gain
    assert found.nuisance[0].offset[0] == pytest.approx(offset + moved, abs=1e-3)


@pytest.mark.parametrize("method", BOTH)
def test_large_offset_does_not_move_the_coefficients(method):
    structure = Structure(2, 1, offset=True, initial_state="free")
    data = record(noise=0.05)
    far = Record(data.u, data.y + 1e4 * np.std(data.y), dt=data.dt)
    near, moved = (identify(one, structure, method()) for one in (data, far))
    assert np.all(np.abs(near.theta - moved.theta) < 1e-3 * near.std)


# ----------------------------------------------------------------------------------------- noise
def test_least_squares_is_the_textbook_regression():
    """The biased solution of another simulator's regressors, digit by digit."""
    data, c = record(noise=0.5), np.array([1.0, 4.0, 4.0])
    t, columns = data.t, []
    for power in ([1.0, 0.0], [1.0]):
        columns.append(-lsim((power, c), data.y[:, 0], t, interp=True)[1])
    for power in ([1.0, 0.0], [1.0]):
        columns.append(lsim((power, c), data.u[:, 0], t, interp=False)[1])
    second = data.y[:, 0] + columns[0] * c[1] + columns[1] * c[2]  # p^2 / c = 1 - (c1 p + c0) / c
    expected = np.linalg.lstsq(np.column_stack(columns), second, rcond=None)[0]
    found = identify(data, REST, SvfLeastSquares(c))
    assert np.allclose(found.theta, expected, rtol=1e-7)
    assert np.abs(expected[0] / TRUTH[0] - 1.0) > 0.02


def differences(solve, data):
    """Derivatives of coefficients with respect to every output sample."""
    step, columns = 1e-6, []
    for k in range(data.n_samples):
        ends = []
        for sign in (1.0, -1.0):
            y = data.y.copy()
            y[k] += sign * step
            ends.append(solve(Record(data.u, y, dt=data.dt)))
        columns.append((ends[0] - ends[1]) / (2.0 * step))
    return np.array(columns).T


@pytest.mark.parametrize("filter", [(1.0, 4.0, 4.0), (1.0, 6.0, 12.0, 8.0)], ids=["n", "n + 1"])
@pytest.mark.parametrize("instruments", [False, True], ids=["least squares", "instruments"])
@pytest.mark.parametrize(
    "structure", [REST, Structure(2, 1, offset=True, initial_state="free")], ids=["rest", "all"]
)
@pytest.mark.fast("rest-instruments-n", "all-least squares-n + 1")
def test_covariance_is_that_of_the_derivatives(filter, instruments, structure):
    """Equation (2): the solution differentiated by every sample, with the instruments held."""
    data, c = record(noise=0.2, duration=4.0), filter_cascade(filter, 2)
    choice = candidates([data], structure)[0]
    whole = build([data], structure, choice)
    first = fit(whole, [with_filtered(e, c) for e in whole.experiments], c)
    source = first.model if instruments else None

    def solved(one):
        problem = replace(build([one], structure, choice), power=whole.power)
        experiments = [with_filtered(e, c) for e in problem.experiments]
        return fit(problem, experiments, c, source), experiments

    jacobian = differences(lambda one: solved(one)[0].model.theta, data)
    found, experiments = solved(data)
    expected = 0.04 * jacobian @ jacobian.T
    ours = covariance(found, experiments, np.array([0.04]))
    scale = np.sqrt(np.diag(expected))
    assert np.allclose(ours / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-5)


@pytest.mark.parametrize("method", BOTH)
def test_unit_of_time_and_of_the_output_do_not_matter(method):
    data = record(noise=0.1)
    usual = identify(data, Structure(2, 1), method())
    for rate in (1e-6, 1e6):
        other = Record(data.u, 1e3 * data.y, dt=data.dt / rate)
        found = identify(other, Structure(2, 1), method())
        unit = np.array([rate, rate**2, 1e3 * rate, 1e3 * rate**2])
        assert np.allclose(found.theta / unit, usual.theta, rtol=1e-8)
        assert np.allclose(found.std / unit, usual.std, rtol=1e-6)


@pytest.mark.parametrize("method", BOTH)
def test_estimate_says_what_it_is(method):
    found = identify(record(noise=0.1), Structure(2, 1), method())
    assert found.status is Status.SETTLED
    assert np.isnan(found.gradient)
    assert len(found.trace.starts) > 3  # one for every filter of the grid
    assert "lowest AICc" in found.trace.decisions[0]
    (step,) = found.trace.passes[0].steps
    assert step.name == "series-parallel"
    assert "filter (p + " in step.note


def test_filter_with_the_lowest_output_error_is_taken():
    found = identify(record(noise=0.3), REST, SvfLeastSquares())
    assert found.cost == pytest.approx(min(start.cost for start in found.trace.starts))
    assert max(start.cost for start in found.trace.starts) > 1.5 * found.cost


def test_passes_take_instruments_from_the_model_before():
    first = least_squares([record(noise=0.5)], REST, (1.0, 4.0, 4.0))
    _, passes = instrumental_passes(first)
    assert np.array_equal(passes[0].theta, first.fit.model.theta)
    assert np.abs(passes[1].theta[0] - passes[0].theta[0]) > 0.01


def test_reflected_pole_is_said_and_claims_no_covariance():
    """Noise alone: the regression has an unstable root."""
    u, y = levels(100, 5), np.random.default_rng(0).standard_normal(100)
    found = identify(Record(u, y, dt=0.05), Structure(3, 2), SvfLeastSquares(), throw=False)
    assert found.trace.passes[-1].note == "reflected an unstable pole"
    assert found.model.is_stable
    assert np.isnan(found.cov).all()
    sound = identify(record(noise=0.1), Structure(2, 1), SvfLeastSquares())
    assert sound.trace.passes[-1].note == ""
    assert np.isfinite(sound.cov).all()


# -------------------------------------------------------------------------------------- refusals
@pytest.mark.parametrize("method", BOTH)
@pytest.mark.parametrize("filter", [(1.0,), (1.0, -2.0, 3.0), (0.0, 1.0), ("a", "b"), (np.nan, 1)])
def test_bad_filter_is_refused(method, filter):
    with pytest.raises(OptionError, match=r"found .*filter.*expected"):
        method(filter)


@pytest.mark.parametrize("method", BOTH)
def test_filter_of_too_low_a_degree_is_refused(method):
    with pytest.raises(OptionError, match="degree 1 for 2 poles"):
        identify(record(), REST, method((1.0, 2.0)))


@pytest.mark.parametrize("method", BOTH)
def test_missing_outputs_are_refused(method):
    data = record()
    y = data.y.copy()
    y[7] = np.nan
    with pytest.raises(UnsupportedError, match="1 missing output"):
        identify(Record(data.u, y, dt=data.dt), REST, method())


@pytest.mark.parametrize("method", BOTH)
def test_inputs_in_step_are_refused(method):
    data = record()
    both = Record(np.hstack([data.u, 2.0 * data.u]), data.y, dt=data.dt)
    with pytest.raises(DependentInputsError):
        identify(both, Structure(2, 0, offset=False, initial_state="rest"), method())


# ------------------------------------------------------------------------------------ many draws


@pytest.fixture(scope="module")
def draws():
    """Errors and standard errors on 3 / (s^2 + 4 s + 3), 1016 samples, 10 dB, by method."""
    u, truth = register(7, (7, 6), 1016, 8), np.array([4.0, 3.0, 3.0])
    clean = simulate(TransferFunction([3.0], [1.0, 4.0, 3.0]), Record(u, u, dt=0.05))[:, 0]
    structure = Structure(2, 0, offset=False, initial_state="rest")
    found = {method: ([], []) for method in BOTH}
    for seed in range(150):
        noise = np.random.default_rng(1000 + seed).standard_normal(u.size)
        data = Record(u, clean + np.std(clean) * 10**-0.5 * noise, dt=0.05)
        for method, (errors, stds) in found.items():
            estimate = identify(data, structure, method())
            errors.append(estimate.theta - truth)
            stds.append(estimate.std)
    return {method: (np.array(e), np.array(s)) for method, (e, s) in found.items()}


@pytest.mark.slow
def test_least_squares_is_biased_and_instruments_are_not(draws):
    def bias(method):
        errors = draws[method][0]
        return np.abs(errors.mean(axis=0)) / (errors.std(axis=0) / np.sqrt(len(errors)))

    assert np.all(bias(SvfLeastSquares) > 20.0)
    assert np.all(bias(SvfInstrumentalVariable) < 3.0)


@pytest.mark.slow
def test_standard_errors_are_credible(draws):
    """About the truth for instruments; about the biased limit, and not below, for least squares."""
    errors, stds = draws[SvfInstrumentalVariable]
    ratio = errors.std(axis=0) / np.median(stds, axis=0)
    assert np.all((ratio > 0.85) & (ratio < 1.15))
    errors, stds = draws[SvfLeastSquares]
    ratio = errors.std(axis=0) / np.median(stds, axis=0)
    assert np.all((ratio > 0.6) & (ratio < 1.1))
