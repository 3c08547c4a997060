"""The delta method against central differences and against sampling from the covariance."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from tridentify import uncertainty
from tridentify.numerics import delta_method

DENOMINATORS = {
    "resonant": [1.0, 0.2, 4.0],
    "real": [1.0, 3.0, 2.0],
    "mixed": [1.0, 2.0, 5.0, 7.0],
    "stiff": np.poly([-1.0, -1e3, -20 + 60j, -20 - 60j]).real,
    "unstable": [1.0, -0.5, 2.0],
}


def central_differences(function, theta):
    columns = []
    for k in range(theta.size):
        step = np.zeros(theta.size)
        step[k] = 1e-6 * max(abs(theta[k]), 1e-3)
        columns.append((function(theta + step) - function(theta - step)) / (2 * step[k]))
    return np.array(columns).T


@pytest.mark.parametrize("name", DENOMINATORS)
def test_root_sensitivity_matches_central_differences(name):
    den = np.asarray(DENOMINATORS[name], float)
    _, sensitivity = delta_method.root_sensitivity(den)

    def roots(theta):
        return delta_method.root_sensitivity([1.0, *theta])[0]

    expected = central_differences(roots, den[1:])
    assert sensitivity == pytest.approx(expected, rel=1e-5, abs=1e-7 * np.abs(expected).max())


def test_zero_sensitivity_counts_the_leading_coefficient():
    num = np.array([-2.0, 3.0, -7.0])
    _, sensitivity = delta_method.root_sensitivity(num, monic=False)
    expected = central_differences(lambda b: delta_method.root_sensitivity(b, monic=False)[0], num)
    assert sensitivity == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("name", DENOMINATORS)
def test_pole_quantities_match_central_differences(name):
    den = np.asarray(DENOMINATORS[name], float)
    rng = np.random.default_rng(4)
    root = rng.standard_normal((den.size - 1, den.size - 1)) * 0.01 * np.abs(den[1:])[:, None]
    cov = root @ root.T

    def values(theta):
        rows = delta_method.pole_quantities([1.0, *theta], np.zeros_like(cov))
        return np.array([row[1] for row in rows])

    jacobian = central_differences(values, den[1:])
    expected = np.sqrt(np.diag(jacobian @ cov @ jacobian.T))
    found = [row[2] for row in delta_method.pole_quantities(den, cov)]
    assert found == pytest.approx(expected, rel=1e-5)


def test_closed_forms_of_second_order():
    # w = sqrt(a0), z = a1 / (2 sqrt(a0)) for s^2 + a1 s + a0
    rows = delta_method.pole_quantities([1.0, 1.0, 4.0], np.diag([0.04, 0.09]))
    assert rows[0] == ("natural frequency", pytest.approx(2.0), pytest.approx(0.3 / 4), "rad/s")
    by_a1, by_a0 = 1 / 4, -1 / 32
    expected = math.hypot(by_a1 * 0.2, by_a0 * 0.3)
    assert rows[1] == ("damping", pytest.approx(0.25), pytest.approx(expected), "-")


def test_real_poles_are_numbered_with_time_constants():
    rows = delta_method.pole_quantities([1.0, 3.0, 2.0], np.eye(2) * 1e-4)
    assert [row[0] for row in rows] == [
        "real pole 1",
        "time constant 1",
        "real pole 2",
        "time constant 2",
    ]
    assert rows[3][1] == pytest.approx(0.5)
    assert rows[3][2] == pytest.approx(rows[2][2] / 4)


def test_pole_at_zero_has_no_time_constant_and_infinite_gain():
    rows = delta_method.pole_quantities([1.0, 0.0], np.array([[0.01]]))
    assert [row[0] for row in rows] == ["real pole"]
    gain, std = delta_method.dc_gain([-2.0], [1.0, 0.0], np.eye(3))
    assert gain == -math.inf
    assert math.isnan(std)


def test_repeated_pole_has_no_finite_error_and_no_warning():
    rows = delta_method.pole_quantities([1.0, 2.0, 1.0], np.eye(2) * 1e-4)
    assert all(not (row[2] < 1.0) for row in rows)


def test_frequency_response_matches_central_differences():
    num, den, delay = np.array([2.0, -3.0]), np.array([1.0, 0.4, 4.0]), 0.15
    theta = np.array([*den[1:], *num, delay])
    rng = np.random.default_rng(8)
    root = rng.standard_normal((5, 5)) * 0.02
    cov = root @ root.T
    omega = np.geomspace(0.01, 100.0, 15)

    def logarithm(p):
        s = 1j * omega
        return np.log(np.polyval(p[2:4], s) / np.polyval([1.0, *p[:2]], s)) - s * p[4]

    jacobian = central_differences(logarithm, theta)
    magnitude, phase = delta_method.frequency_response_std(num, den, cov, omega)
    for found, part in ((magnitude, jacobian.real), (phase, jacobian.imag)):
        expected = np.sqrt(np.einsum("ij,jk,ik->i", part, cov, part))
        assert found == pytest.approx(expected, rel=1e-6)


def _samples(case, count=20000):
    rng = np.random.default_rng(11)
    estimate = case.estimate
    return rng.multivariate_normal(estimate.theta, estimate.cov, size=count)


def test_monte_carlo_confirms_frequency_response(double):
    draws = _samples(double)
    omega = np.array([0.3, 2.0, 10.0])
    s = 1j * omega
    magnitude, phase = uncertainty.frequency_response_std(double.estimate, omega)
    assert magnitude.shape == phase.shape == (3, 2, 1)
    powers = np.stack((np.ones(3), s, s**2))
    den = powers[2] + draws[:, [0]] * powers[1] + draws[:, [1]]
    for i, first in enumerate((2, 4)):
        num = draws[:, [first]] * powers[1] + draws[:, [first + 1]]
        ratio = np.log(num / den / double.estimate.model.frequency_response(omega)[:, i, 0])
        # 20,000 draws know a standard deviation to half a percent
        assert magnitude[:, i, 0] == pytest.approx(ratio.real.std(axis=0), rel=0.03)
        assert phase[:, i, 0] == pytest.approx(ratio.imag.std(axis=0), rel=0.03)


def test_monte_carlo_confirms_derived_quantities(double):
    draws = _samples(double)
    a1, a0 = draws[:, 0], draws[:, 1]
    expected = {
        "natural frequency": np.sqrt(a0),
        "damping": a1 / (2 * np.sqrt(a0)),
        "dc gain[q,elevator]": draws[:, 3] / a0,
        "dc gain[alpha,elevator]": draws[:, 5] / a0,
    }
    found = {quantity.name: quantity for quantity in uncertainty.derived(double.estimate)}
    assert set(found) == set(expected)
    for name, values in expected.items():
        assert found[name].value == pytest.approx(values.mean(), abs=0.05 * values.std())
        assert found[name].std == pytest.approx(values.std(), rel=0.03)
    assert found["natural frequency"].unit == "rad/s"
    assert found["dc gain[q,elevator]"].unit == "1/s"
    assert found["dc gain[alpha,elevator]"].unit == "-"


def test_pole_ellipse_holds_its_share_of_the_draws(double):
    draws = _samples(double)
    region = uncertainty.poles(double.estimate)
    root, cov = region.roots[0], region.cov[0]
    sampled = (-draws[:, 0] + 1j * np.sqrt(4 * draws[:, 1] - draws[:, 0] ** 2)) / 2
    offsets = np.column_stack(((sampled - root).real, (sampled - root).imag))
    distance = np.einsum("ij,jk,ik->i", offsets, np.linalg.inv(cov), offsets)
    assert np.mean(distance < -2 * math.log(0.05)) == pytest.approx(0.95, abs=0.01)
    ellipse = region.ellipse(0, 0.95) - [root.real, root.imag]
    radius = np.einsum("ij,jk,ik->i", ellipse, np.linalg.inv(cov), ellipse)
    assert radius == pytest.approx(-2 * math.log(0.05))


def test_real_zero_has_an_interval(double):
    region = uncertainty.zeros(double.estimate, 1, 0)
    draws = _samples(double)
    sampled = -draws[:, 5] / draws[:, 4]
    stroke = region.ellipse(0, 0.95)
    assert not stroke[:, 1].any()
    # the ratio is far from Gaussian here (b1 is known to 8 %): order of magnitude only
    width = np.subtract(*np.quantile(sampled, [0.975, 0.025]))
    assert np.ptp(stroke[:, 0]) == pytest.approx(width, rel=0.2)


def test_model_without_zeros_has_none(single):
    assert uncertainty.zeros(single.estimate).roots.size == 0


def test_band_lies_around_the_response(single):
    omega = np.geomspace(0.1, 30.0, 50)
    band = uncertainty.response_band(single.estimate, omega, level=0.99)
    response = single.estimate.model.frequency_response(omega)
    assert band.magnitude == pytest.approx(np.abs(response))
    assert np.all(band.magnitude_low < band.magnitude)
    assert np.all(band.magnitude < band.magnitude_high)
    ratio = np.log(band.magnitude_high / band.magnitude)
    std, _ = uncertainty.frequency_response_std(single.estimate, omega)
    assert ratio == pytest.approx(2.5758293 * std, rel=1e-6)
    assert np.all(np.abs(np.diff(band.phase, axis=0)) < 1.0)


def test_band_of_a_useless_covariance_stays_finite(single):
    for value in (1e8, math.nan):
        estimate = dataclasses.replace(single.estimate, cov=np.eye(3) * value)
        band = uncertainty.response_band(estimate, [0.1, 1.0])
        assert np.all(np.isfinite(band.magnitude_high))
