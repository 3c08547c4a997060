"""Step responses and their sensitivities against closed forms, and stacks of exponentials."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from tridentify import TransferFunction, uncertainty
from tridentify.errors import OptionError
from tridentify.numerics import delta_method
from tridentify.numerics.exponential import exponentials, step_states
from tridentify.uncertainty.step import powers_of

T = np.array([0.0, 0.1, 0.15, 1.0, 2.0, 7.5])


def modal(num, den, t):
    """Unit step response by residues; poles simple and away from zero."""
    poles = np.roots(den)
    residues = np.polyval(num, poles) / np.polyval(np.polyder(den), poles)
    direct = num[0] / den[0] if len(num) == len(den) else 0.0
    return direct + ((residues / poles) * np.expm1(np.outer(t, poles))).sum(axis=1).real


PLANTS = {
    "first order": ([2.0], [1.0, 4.0]),
    "pair and zero": ([-6.2, -5.1], [1.0, 2.1, 5.5]),
    "biproper": ([1.5, 0.3, 2.0], [1.0, 2.1, 5.5]),
    "rao-garnier": ([-6400.0, 1600.0], [1.0, 5.0, 408.0, 416.0, 1600.0]),
    "unstable": ([1.0, 2.0], [1.0, -0.5, 2.0]),
}


@pytest.mark.parametrize("name", PLANTS)
def test_step_response_and_jacobian_match_residues(name):
    num, den = map(np.asarray, PLANTS[name])
    n = len(den) - 1

    def value(theta):
        return modal(theta[n:], np.append(1.0, theta[:n]), T)

    response, jacobian = delta_method.step_response(num, den, powers_of(den), T)
    theta = np.concatenate([den[1:], num])
    assert response == pytest.approx(value(theta), rel=1e-9, abs=1e-9 * np.abs(response).max())
    for k in range(theta.size):
        step = np.zeros(theta.size)
        step[k] = 1e-6 * abs(theta[k])
        expected = (value(theta + step) - value(theta - step)) / (2 * step[k])
        tolerance = 1e-6 * np.abs(expected).max()
        assert jacobian[:, k] == pytest.approx(expected, rel=1e-6, abs=tolerance)


def test_late_step_has_minus_the_impulse_response_as_its_derivative():
    den, num = np.array([1.0, 4.0]), np.array([2.0])
    _, jacobian = delta_method.step_response(num, den, powers_of(den), [-1.0, 0.5])
    assert jacobian[0].tolist() == [0.0] * 3
    assert jacobian[1, -1] == pytest.approx(-2.0 * np.exp(-2.0))


def test_repeated_poles_are_no_special_case():
    den = np.poly([-2.0, -2.0, -2.0])
    response, jacobian = delta_method.step_response([8.0], den, powers_of(den), T)
    x = 2.0 * T
    assert response == pytest.approx(1 - np.exp(-x) * (1 + x + x**2 / 2), abs=1e-13)
    assert np.all(np.isfinite(jacobian))


@settings(max_examples=25, deadline=None)
@given(scale=st.floats(-6, 6))
def test_time_scaling_leaves_the_relative_band_alone(scale):
    rate = 10.0**scale
    den, num = np.array([1.0, 1.0, 3.0]), np.array([0.5])
    powers = rate ** np.arange(3)
    response, jacobian = delta_method.step_response(num, den, powers_of(den), T)
    fast, slope = delta_method.step_response(
        num * rate**2, den * powers, powers_of(den * powers), T / rate
    )
    assert fast == pytest.approx(response, abs=1e-12)
    units = np.array([rate, rate**2, rate**2])
    assert slope[:, :3] * units == pytest.approx(jacobian[:, :3], abs=1e-12)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), exponents=st.lists(st.floats(-9, 3), min_size=1, max_size=5))
def test_stack_of_exponentials_matches_one_by_one(seed, exponents):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 6))
    stack = rng.standard_normal((len(exponents), n, n)) - 2 * np.eye(n) * np.sqrt(n)
    stack *= 10.0 ** np.array(exponents)[:, None, None]
    for one, found in zip(stack, exponentials(stack), strict=True):
        expected = expm(one)
        norm = max(np.abs(expected).max(), 1e-300)
        assert np.abs(found - expected).max() <= 1e-11 * max(norm, 1.0)


def test_a_matrix_that_is_not_finite_spoils_no_other():
    stack = np.array([[[np.nan]], [[-1.0]], [[np.inf]]])
    found = exponentials(stack).ravel()
    assert found[1] == pytest.approx(np.exp(-1.0))
    assert np.all(np.isnan(found[[0, 2]]))


def test_uneven_times_agree_with_even_ones():
    a, b = np.array([[[-0.3, -2.0], [1.5, 0.0]]]), np.array([[1.0, 0.0]])
    even = np.linspace(0.0, 4.0, 41)
    uneven = even[[0, 1, 7, 8, 30, 40]]
    all_of_them = step_states(a, b, even)[[0, 1, 7, 8, 30, 40]]
    assert step_states(a, b, uneven) == pytest.approx(all_of_them, abs=1e-13)


@pytest.mark.slow
def test_band_holds_the_model_and_has_the_width_of_monte_carlo(double):
    band = uncertainty.step_band(double.estimate, T, level=0.9)
    rng = np.random.default_rng(3)
    draws = rng.multivariate_normal(double.estimate.theta, double.estimate.cov, size=4000)
    for i, first in enumerate((2, 4)):
        values = np.array([modal(d[first : first + 2], [1.0, d[0], d[1]], T) for d in draws])
        own = modal(double.estimate.model.num[i][0], double.estimate.model.den[i][0], T)
        assert band.response[:, i, 0] == pytest.approx(own, abs=1e-10)
        half = 1.6448536 * values.std(axis=0)
        assert band.high[:, i, 0] - own == pytest.approx(half, rel=0.06, abs=1e-12)
        assert own - band.low[:, i, 0] == pytest.approx(half, rel=0.06, abs=1e-12)


def test_known_delay_shifts_the_band(single):
    late = TransferFunction(
        single.estimate.model.num[0][0],
        single.estimate.model.den[0][0],
        delay=0.5,
        input_names=single.estimate.model.input_names,
        output_names=single.estimate.model.output_names,
    )
    delayed = dataclasses.replace(single.estimate, model=late)
    band = uncertainty.step_band(delayed, T + 0.5)
    at_once = uncertainty.step_band(single.estimate, T)
    assert band.low == pytest.approx(at_once.low, abs=1e-12)
    drawn = uncertainty.sampled_step_band(uncertainty.sample(delayed, 100), T + 0.5)
    same = uncertainty.sampled_step_band(uncertainty.sample(single.estimate, 100), T)
    assert drawn.high == pytest.approx(same.high, abs=1e-12)


@pytest.mark.parametrize("t", [[1.0, 0.5], [0.0, np.nan], [[0.0, 1.0]]])
def test_times_that_do_not_rise_are_refused(single, t):
    with pytest.raises(OptionError, match="rising"):
        uncertainty.step_band(single.estimate, t)


@pytest.mark.parametrize("level", [0.0, 1.0, 95, "0.95", True])
def test_levels_that_are_no_probability_are_refused(single, level):
    with pytest.raises(OptionError, match="probability"):
        uncertainty.step_band(single.estimate, T, level)
