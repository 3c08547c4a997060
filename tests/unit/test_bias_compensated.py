"""Bias-compensated least squares: what is subtracted, what is left, and what is claimed of it."""

from __future__ import annotations

import numpy as np
import pytest

from oracles import register
from tridentify import (
    BiasCompensatedLeastSquares,
    Record,
    Status,
    Structure,
    SvfLeastSquares,
    TransferFunction,
    identify,
    simulate,
)
from tridentify import errors as err
from tridentify.estimation.likelihood.setup.nuisance import build, candidates
from tridentify.estimation.methods.filtered.asymptotic_bias import asymptotic_bias
from tridentify.estimation.methods.filtered.bias_compensated_least_squares import smallest_pair
from tridentify.estimation.methods.filtered.filter_cascade import filter_cascade
from tridentify.estimation.methods.filtered.noise_through_filters import separate
from tridentify.estimation.methods.filtered.state_variable_filters import with_filtered

pytestmark = pytest.mark.unjudged

PLANT = TransferFunction([3.0], [1.0, 4.0, 3.0])
TRUTH = np.array([4.0, 3.0, 3.0])
AT_REST = Structure(2, 0, offset=False, initial_state="rest")
FILTER = (1.0, 8.0, 16.0)
DT = 0.05


PRBS = register(7, (7, 6), 1016, 8)


def noisy(model, u, snr, seed, dt=DT):
    clean = simulate(model, Record(u, u, dt=dt))
    sigma = np.std(clean, axis=0) * 10 ** (-snr / 20)
    noise = np.random.default_rng(seed).standard_normal(clean.shape)
    return Record(u, clean + sigma * noise, dt=dt)


def separated(record, structure, coefficients, weight=1.0):
    problem = build([record], structure, candidates([record], structure)[0])
    c = filter_cascade(coefficients, problem.n_poles)
    experiments = [with_filtered(e, c) for e in problem.experiments]
    ones = np.ones(problem.n_outputs)
    return separate(problem, experiments, c, weight * ones, ones)


# ------------------------------------------------------------------------- the equations
@pytest.mark.slow
def test_expected_share_of_the_noise_is_what_many_draws_leave():
    """Noise alone as the output: the mean of Y' (1 - Q Q') Y is Lambda, and less without Z."""
    rng, u, total = np.random.default_rng(1), PRBS[:120], 0.0
    structure = Structure(2, 0, offset=True, initial_state="free")
    for _ in range(400):
        parts = separated(Record(u, rng.standard_normal(u.size), dt=DT), structure, FILTER)
        total = total + parts.triangle.T @ parts.triangle / 400
    scale = np.sqrt(np.outer(np.diag(parts.noise), np.diag(parts.noise)))
    assert np.allclose(total / scale, parts.noise / scale, atol=0.04)
    # the columns of Z take a visible share of so short a record; leaving it out would show
    assert np.max(np.abs(parts.whole_noise - parts.noise) / scale) > 0.1


def test_pair_solves_the_compensated_equations_and_nothing_below_it_does():
    parts = separated(noisy(PLANT, PRBS, 10, 0), AT_REST, FILTER)
    alpha, level = smallest_pair(parts)
    signal, noise = parts.triangle.T @ parts.triangle, parts.noise
    left = (signal - level * noise) @ alpha
    assert np.max(np.abs(left)) < 1e-9 * np.max(np.abs(signal @ alpha))
    scale = np.sqrt(np.diag(noise))
    compensated = (signal - level * noise) / np.outer(scale, scale)
    values = np.linalg.eigvalsh(compensated)
    assert values[0] > -1e-9 * values[-1]
    assert alpha[-1] == 1.0


def test_level_is_the_noise_variance():
    record = noisy(PLANT, np.tile(PRBS, 8), 10, 3)
    clean = simulate(PLANT, record)
    level = smallest_pair(separated(record, AT_REST, FILTER))[1]
    # relative standard deviation about sqrt(2 / 8128)
    assert level == pytest.approx(np.mean((record.y - clean) ** 2), rel=0.08)


@pytest.mark.parametrize("weight", [1e-8, 1e8])
def test_weights_do_not_matter_with_one_output(weight):
    record = noisy(PLANT, PRBS, 10, 0)
    one, level = smallest_pair(separated(record, AT_REST, FILTER))
    other, same = smallest_pair(separated(record, AT_REST, FILTER, weight))
    assert np.allclose(one, other, rtol=1e-8)
    assert same == pytest.approx(level, rel=1e-8)


# ------------------------------------------------------------------------- the method
def test_without_noise_it_is_the_series_parallel_model():
    """Both then have the error of the straight lines alone, which is of order dt^2."""
    u = np.repeat(PRBS[::4], 20)
    record = Record(u, simulate(PLANT, Record(u, u, dt=0.004)), dt=0.004)
    found = identify(record, AT_REST, BiasCompensatedLeastSquares(filter=FILTER))
    assert np.allclose(found.theta, TRUTH, rtol=2e-3)


def test_one_draw_says_what_it_did():
    estimate = identify(noisy(PLANT, PRBS, 10, 0), AT_REST, BiasCompensatedLeastSquares())
    assert estimate.status is Status.SETTLED
    assert estimate.method == "BiasCompensatedLeastSquares"
    first, last = estimate.trace.passes[0], estimate.trace.passes[-1]
    assert "recorded output" in first.steps[0].note
    assert "noise of standard deviation" in last.steps[0].note
    assert np.array_equal(last.theta, estimate.theta)
    assert len(estimate.trace.starts) > 3
    # the choice among the filters is by the simulated output
    assert min(s.cost for s in estimate.trace.starts) == pytest.approx(last.cost)
    assert np.all(np.abs(estimate.theta - TRUTH) < 4 * estimate.std)
    said = float(last.steps[0].note.split()[-1])
    assert said == pytest.approx(np.sqrt(estimate.noise_variance[0]), rel=0.1)


def test_each_output_has_its_own_noise():
    plant = TransferFunction([[[-7.0, -6.5]], [[-0.1, -5.0]]], [1.0, 2.4, 6.3])
    u = np.tile(PRBS, 4)
    clean = simulate(plant, Record(u, u, dt=DT))
    rng = np.random.default_rng(0)
    sigma = np.std(clean, axis=0) * np.array([0.02, 0.7])
    record = Record(u, clean + sigma * rng.standard_normal(clean.shape), dt=DT)
    structure = Structure(2, 1, offset=False, initial_state="rest")
    found = identify(record, structure, BiasCompensatedLeastSquares(filter=(1.0, 8.0, 16.0)))
    truth = np.array([2.4, 6.3, -7.0, -6.5, -0.1, -5.0])
    assert np.all(np.abs(found.theta - truth) < 4 * found.std)
    # the quiet output determines the denominator
    assert found.std[0] < 0.02 * truth[0]
    assert np.allclose(np.sqrt(found.noise_variance), sigma, rtol=0.1)


def test_several_experiments_offset_and_free_state():
    first, second = noisy(PLANT, PRBS, 15, 1), noisy(PLANT, PRBS[300:900], 15, 2)
    pair = [first, Record(second.u[100:], second.y[100:] + 4.0, dt=DT)]
    structure = Structure(2, 0, offset=True, initial_state="free")
    found = identify(pair, structure, BiasCompensatedLeastSquares(filter=FILTER))
    assert np.all(np.abs(found.theta - TRUTH) < 4 * found.std)
    residual = [found.residual(record, experiment=k) for k, record in enumerate(pair)]
    assert np.std(residual[1]) == pytest.approx(np.std(residual[0]), rel=0.2)


@pytest.mark.parametrize("rate", [1e-6, 1e6])
def test_fast_and_slow_systems_are_alike(rate):
    record = noisy(PLANT, PRBS, 10, 0)
    other = Record(record.u, record.y, dt=DT / rate)
    scale = np.array([rate, rate**2, rate**2])
    first = identify(record, AT_REST, BiasCompensatedLeastSquares())
    second = identify(other, AT_REST, BiasCompensatedLeastSquares())
    assert np.allclose(second.theta / scale, first.theta, rtol=1e-6)
    assert np.allclose(second.std / scale, first.std, rtol=1e-5)


def test_missing_samples_are_refused():
    record = noisy(PLANT, PRBS, 10, 0)
    y = record.y.copy()
    y[5] = np.nan
    with pytest.raises(err.UnsupportedError, match="missing"):
        identify(Record(record.u, y, dt=DT), AT_REST, BiasCompensatedLeastSquares())


@pytest.mark.parametrize("filter", [(1.0, -2.0, 1.0), (1.0, 2.0), (), "p", (np.nan, 1.0, 1.0)])
def test_filters_that_make_no_sense_are_refused(filter):
    with pytest.raises(err.OptionError, match="found"):
        identify(noisy(PLANT, PRBS, 10, 0), AT_REST, BiasCompensatedLeastSquares(filter=filter))


# ------------------------------------------------------------------------- statistics
def draws(method, snr, count):
    """Estimates, standard errors and the number of draws that gave no usable model."""
    values, errors, failed = [], [], 0
    for k in range(count):
        estimate = identify(noisy(PLANT, PRBS, snr, 2000 + k), AT_REST, method, throw=False)
        failed += not (estimate.status.ok and np.all(np.isfinite(estimate.std)))
        values.append(estimate.theta)
        errors.append(estimate.std)
    return np.array(values), np.array(errors), failed


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("filter", [None, FILTER, (1.0, 6.0, 12.0, 8.0)], ids=str)
def test_bias_is_a_small_part_of_the_raw_fit_s(filter):
    raw, _, _ = draws(SvfLeastSquares(filter=filter), 10, 200)
    values, errors, failed = draws(BiasCompensatedLeastSquares(filter=filter), 10, 200)
    assert failed == 0
    bias, before = values.mean(axis=0) - TRUTH, raw.mean(axis=0) - TRUTH
    assert np.all(np.abs(bias) < 0.2 * np.abs(before)), bias / before
    # the standard errors are those of the spread, to what 200 draws and the choice of filter show
    assert np.allclose(np.median(errors, axis=0), values.std(axis=0), rtol=0.2)
    inside = np.abs(values - TRUTH) < 1.959963985 * errors
    assert np.all(inside.mean(axis=0) > 0.90)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_at_much_noise_a_long_record_shows_no_bias():
    """Consistent: at 0 dB, where the raw fit loses a third of a1 however long the record is."""
    coefficients, u = (1.0, 6.0, 12.0, 8.0), np.tile(PRBS, 8)
    method = BiasCompensatedLeastSquares(filter=coefficients)
    values = np.array([identify(noisy(PLANT, u, 0, k), AT_REST, method).theta for k in range(60)])
    bias = values.mean(axis=0) - TRUTH
    sampling = values.std(axis=0, ddof=1) / np.sqrt(len(values))
    record = Record(PRBS, PRBS, dt=DT)
    lines = asymptotic_bias(PLANT, record, 0.0, coefficients)
    raw = asymptotic_bias(PLANT, record, np.var(simulate(PLANT, record)), coefficients)
    assert np.all(np.abs(bias) < 4.0 * sampling + 2.0 * np.abs(lines))
    assert np.all(np.abs(raw) > 20.0 * sampling)
