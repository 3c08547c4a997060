"""Robust losses: their scales against other routes, and what the pseudo-samples promise."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import integrate, optimize, stats

from tridentify.numerics.robust import (
    TUNING,
    huber_scale,
    judge,
    median_scale,
    student_scale,
)


def psi_square(z):
    return min(z * z, TUNING**2)


def test_tuning_is_95_percent_efficient_for_gaussian_noise():
    square = integrate.quad(lambda z: psi_square(z) * stats.norm.pdf(z), -12, 12)[0]
    slope = stats.norm.cdf(TUNING) - stats.norm.cdf(-TUNING)
    assert slope**2 / square == pytest.approx(0.95, abs=1e-4)


def test_proposal_2_solves_its_equation():
    r = np.random.default_rng(3).standard_t(3, 400)
    unknowns = 7.0
    expected = integrate.quad(lambda z: psi_square(z) * stats.norm.pdf(z), -12, 12)[0]

    def left(s):
        return np.sum(np.clip(r / s, -TUNING, TUNING) ** 2) - (r.size - unknowns) * expected

    wanted = optimize.brentq(left, 0.1, 10.0, xtol=1e-13)
    assert huber_scale(r, unknowns, 0.0) == pytest.approx(wanted, rel=1e-8)


@pytest.mark.parametrize(("share", "most"), [(0.1, 1.25), (0.2, 1.6), (0.3, 2.3)])
def test_far_samples_do_not_carry_the_scale_away(share, most):
    r = np.random.default_rng(4).standard_normal(4000)
    r[: int(share * r.size)] = 1e6
    assert huber_scale(r, 0.0, 0.0) < most


@pytest.mark.parametrize("degrees", [1.5, 3.0, 10.0])
def test_student_is_the_maximum_of_the_likelihood(degrees):
    r = 0.01 * np.random.default_rng(5).standard_t(degrees, 3000)
    scale, found = student_scale(r, 0.0)
    nu, _, sigma = stats.t.fit(r / 0.01, floc=0.0)
    assert found == pytest.approx(nu, rel=1e-3)
    assert scale == pytest.approx(0.01 * sigma, rel=1e-3)
    # by the likelihood itself: no neighbour is better
    here = stats.t.logpdf(r, found, scale=scale).sum()
    for a in (0.99, 1.0, 1.01):
        for b in (0.99, 1.0, 1.01):
            assert stats.t.logpdf(r, a * found, scale=b * scale).sum() <= here + 1e-6


def test_gaussian_residuals_have_many_degrees_of_freedom():
    found = [
        student_scale(np.random.default_rng(seed).standard_normal(2000), 0.0)[1]
        for seed in range(10)
    ]
    assert np.median(found) > 50


def test_median_scale_leaves_the_zeros_of_an_absolute_fit_out():
    r = np.random.default_rng(6).standard_normal(1000)
    r[:300] = 0.0
    assert median_scale(r, 300) == pytest.approx(1.0, abs=0.1)
    assert median_scale(r) < 0.7


@pytest.mark.parametrize("loss", ["huber", "student"])
def test_pseudo_residuals_have_the_variance_of_the_estimate(loss):
    """``s^2 mean psi^2 / mean(psi')^2``, by numerical derivatives of the loss itself."""
    r = np.random.default_rng(7).standard_t(4, 5000)
    judged = judge(r, loss, 0.0, 1.0, 1.0)
    if loss == "huber":
        s = huber_scale(r, 0.0, 0.0)

        def psi(x):
            return np.clip(x, -TUNING, TUNING)
    else:
        s, nu = student_scale(r, 0.0)

        def psi(x):
            return (nu + 1) * x / (nu + x * x)

    slope = np.mean((psi(r / s + 1e-6) - psi(r / s - 1e-6)) / 2e-6)
    wanted = s**2 * np.mean(psi(r / s) ** 2) / slope**2
    assert np.mean(judged.pseudo**2) == pytest.approx(wanted, rel=1e-3)
    assert np.array_equal(np.sign(judged.pseudo), np.sign(r))


@pytest.mark.parametrize("loss", ["huber", "student"])
def test_weights_fall_with_distance_and_missing_samples_stay_missing(loss):
    r = np.random.default_rng(8).standard_t(3, 300)
    r[[4, 50]] = np.nan
    judged = judge(r, loss, 2.0, 1.0, 1.0)
    assert np.array_equal(np.isnan(judged.weights), np.isnan(r))
    assert np.array_equal(np.isnan(judged.pseudo), np.isnan(r))
    seen = np.isfinite(r)
    order = np.argsort(np.abs(r[seen]))
    assert np.all(np.diff(judged.weights[seen][order]) <= 1e-15)
    assert judged.weights[seen].max() == pytest.approx(1.0, abs=1e-4)
    assert math.isinf(judged.degrees) == (loss == "huber")


@pytest.mark.parametrize("loss", ["huber", "student"])
def test_units_do_not_matter(loss):
    r = np.random.default_rng(9).standard_t(3, 300)
    one, other = judge(r, loss, 3.0, 1.0, 1.0), judge(1e-9 * r, loss, 3.0, 1e-9, 1.0)
    assert other.spread == pytest.approx(1e-9 * one.spread, rel=1e-9)
    assert np.allclose(other.pseudo, 1e-9 * one.pseudo, rtol=1e-6, atol=1e-18)


@pytest.mark.parametrize("loss", ["huber", "student"])
def test_residuals_of_zero_have_a_scale_of_rounding(loss):
    r = np.zeros(50)
    r[3] = 1.0
    judged = judge(r, loss, 2.0, 1.0, 1.0)
    assert np.all(np.isfinite(judged.pseudo))
    assert np.abs(judged.pseudo).max() < 1e-10
