"""Signals with poles at the origin against scipy's integration, and derivatives by differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from tridentify import Record, Structure
from tridentify.estimation.knowledge.fixed_denominator import fit, place, poles_from
from tridentify.estimation.likelihood.setup.nuisance import Nuisances, build

DT = 0.05
MODELS = {
    "no integrator": ([0.5, 2.0], [1.0, 1.0, 3.0], 0),
    "one": ([2.0, 1.0], [1.0, 4.0, 0.0], 1),
    "one, as many zeros as poles": ([2.0, 1.0, 3.0], [1.0, 4.0, 0.0], 1),
    "two beside a pair": ([1.0, 0.5], [1.0, 0.5, 3.0, 0.0, 0.0], 2),
    "two alone": ([1.0, 0.5], [1.0, 0.0, 0.0], 2),
    "one alone": ([3.0], [1.0, 0.0], 1),
    "three alone": ([3.0], [1.0, 0.0, 0.0, 0.0], 3),
}


def dense(num, den, u, dt, intersample, state=None):
    """Companion form with the input's two segments' coefficients as states; one exponential."""
    n = len(den) - 1
    num = np.pad(np.asarray(num, float), (n + 1 - len(num), 0))
    block = np.zeros((n + 2, n + 2))
    block[0, :n], block[0, n] = -np.asarray(den[1:]), 1.0
    block[1:n, : n - 1] = np.eye(n - 1)
    block[n, n + 1] = 1.0
    step = expm(block * dt)
    x, y = np.zeros(n) if state is None else np.array(state, float), np.empty(u.size)
    row = num[1:] - num[0] * np.asarray(den[1:])
    for k in range(u.size):
        y[k] = row @ x + num[0] * u[k]
        slope = (u[min(k + 1, u.size - 1)] - u[k]) / dt if intersample == "foh" else 0.0
        x = (step @ np.concatenate([x, [u[k], slope]]))[:n]
    return y


def problem_of(num, den, intersample, nuisances, state=None, offset=0.7):
    u = np.cumsum(np.random.default_rng(1).standard_normal(200)) * 0.3
    y = dense(num, den, u, DT, intersample, state) + offset
    record = Record(u, y, dt=DT, intersample=intersample)
    return build([record], Structure(len(den) - 1, len(num) - 1), nuisances, shift=False)


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.parametrize("name", MODELS)
def test_the_truth_leaves_no_residual(name, intersample):
    num, den, k = MODELS[name]
    problem = problem_of(num, den, intersample, Nuisances("rest", True, False))
    theta = np.array([*den[1:], *num])
    here = fit(place(problem, theta[: len(den) - 1 - k], k), theta)
    size = np.std(problem.experiments[0].y)
    assert np.sqrt(here.rss[0] / 200) < 1e-12 * size
    assert np.std(here.over_time()[0]) < 1e-12 * size


@pytest.mark.parametrize("name", MODELS)
def test_a_free_initial_state_is_a_free_response(name):
    num, den, k = MODELS[name]
    state = np.arange(1.0, len(den))
    offset = 0.7 if k else 0.0  # an integrator holds a constant of its own
    problem = problem_of(num, den, "zoh", Nuisances("free", False, False), state, offset)
    theta = np.array([*den[1:], *num])
    here = fit(place(problem, theta[: len(den) - 1 - k], k), theta)
    assert np.sqrt(here.rss[0] / 200) < 1e-12 * np.std(problem.experiments[0].y)


@pytest.mark.parametrize(
    ("choice", "columns"),
    [
        (Nuisances("free", False, False), 4),
        (Nuisances("free", True, False), 4),
        (Nuisances("free", True, True), 4),
        (Nuisances("rest", True, True), 2),
    ],
    ids=["free", "free, offset", "free, offset, drift", "rest, offset, drift"],
)
def test_constant_and_ramp_are_taken_once(choice, columns):
    problem = problem_of([1.0, 0.5], [1.0, 0.5, 3.0, 0.0, 0.0], "zoh", choice)
    found = place(problem, np.array([0.5, 3.0]), 2).nuisance_columns(0, 0)
    assert found.shape[1] == columns
    assert np.linalg.matrix_rank(found / np.linalg.norm(found, axis=0)) == columns


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.parametrize("name", MODELS)
def test_gradient_is_that_of_differences(name, intersample):
    num, den, k = MODELS[name]
    n = len(den) - 1
    problem = problem_of(num, den, intersample, Nuisances("free", False, False))
    theta = np.array([*den[1:], *num]) * (1.0 + 0.1 * np.cos(np.arange(n + len(num))))

    def at(values):
        return fit(place(problem, values[: n - k], k), values)

    here = at(theta)
    gradient = -2.0 * here.columns[0].T @ here.residuals[0]
    for c in [*range(n - k), *range(n, theta.size)]:
        step = np.zeros(theta.size)
        step[c] = 1e-5 * abs(theta[c])
        slope = (at(theta + step).rss[0] - at(theta - step).rss[0]) / (2.0 * step[c])
        assert gradient[c] == pytest.approx(slope, rel=1e-5)


def test_poles_of_a_polynomial_keep_its_coefficients():
    rate = 1e6
    a = np.array([3.0 * rate, 4.0 * rate**2, 2.0 * rate**3])
    assert np.allclose(np.poly(poles_from(a)).real[1:], a, rtol=1e-13)
