"""What stands in for longer ways: each against that way, worked out by other means."""

from __future__ import annotations

import gc
import pickle
import weakref

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, simulate
from tridentify.estimation.likelihood.cost import evaluate
from tridentify.estimation.search.compiled_reduction import observability
from tridentify.identify import search
from tridentify.judgement.causes.attempts.fewer import (
    _answers,
    _by_itself,
    _fitted,
    _is_noise,
)
from tridentify.judgement.causes.attempts.revisit import (
    point_of,
    poles_of_estimate,
    problem_of,
    stated,
)
from tridentify.judgement.causes.timing.shifts import FINE, _knots
from tridentify.models.compiled_regression import cascades
from tridentify.numerics.joined_by_lines import joined_by_lines

ASKED = Structure(2, 0, offset=False, initial_state="rest")


def recorded(seed, noise, n=250):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], n // 5 + 1), 5)[:n]
    y = simulate(TransferFunction([0.5], [1.0, 1.0, 3.0]), Record(u, u, dt=0.05))[:, 0]
    return Record(u, y + noise * rng.standard_normal(n), dt=0.05, intersample="zoh")


def test_lines_are_found_between_samples_of_any_distance():
    rng = np.random.default_rng(0)
    for every in range(2, 20):
        y = np.interp(np.arange(24 * every) / every, np.arange(25), rng.standard_normal(25))
        found = joined_by_lines(y[1:], np.zeros((y.size - 1, 1)))
        assert found == (every, every - 1)


@pytest.mark.parametrize("poles", [[-2.0] * 6, [-1.0 + 3.0j, -1.0 - 3.0j, -0.5, -0.5]])
def test_the_gramian_solves_its_equation_written_out(poles):
    a = cascades(np.array([poles], dtype=np.complex128))[0][0]
    n = len(a)
    c = np.random.default_rng(1).standard_normal((2, n))
    eye = np.eye(n)
    dense = np.linalg.solve(np.kron(a.T, eye) + np.kron(eye, a.T), -(c.T @ c).ravel())
    np.testing.assert_allclose(
        observability(a, c.T @ c), dense.reshape(n, n), rtol=1e-10, atol=1e-12
    )


@pytest.mark.parametrize("planted", [[1.5, 1.5], [1.0, -1.5, 0.5, 2.0]])
def test_delays_at_the_knots_are_those_that_cost_least(planted):
    knots = np.linspace(0.0, 299.0, len(planted))
    tried = np.arange(-10.0, 10.0 + FINE / 2, FINE)
    along = np.interp(np.arange(300), knots, planted)
    assert _knots((tried - along[:, None]) ** 2, tried, knots).tolist() == planted


def test_an_estimate_is_looked_at_where_its_search_ended():
    record, other = recorded(1, 0.05), recorded(2, 0.05)
    estimate = search(record, ASKED).estimate
    nuisances = stated(estimate)
    problem = problem_of(estimate, [record], nuisances)
    anew = evaluate(problem, poles_of_estimate(estimate, problem))
    kept = point_of(estimate, [record], nuisances)
    np.testing.assert_allclose(kept.poles, anew.poles, rtol=1e-9)
    np.testing.assert_allclose(kept.objective, anew.objective, rtol=1e-12)
    np.testing.assert_allclose(kept.residuals()[0], anew.residuals()[0], atol=1e-10)
    assert point_of(estimate, [other], nuisances).objective != kept.objective
    search(other, ASKED)
    np.testing.assert_allclose(
        point_of(estimate, [record], nuisances).objective, anew.objective, rtol=1e-12
    )


@pytest.mark.parametrize(("noise", "answers"), [(0.02, True), (0.01, True), (2.0, False)])
def test_what_answers_plainly_is_no_noise_by_both_fits_either(noise, answers):
    record = recorded(3, noise)
    estimate = search(record, ASKED).estimate
    alone = _by_itself([record])
    assert alone is not None
    plain = _answers(estimate, alone)
    fitted = _fitted(estimate, [record])
    assert fitted is not None
    assert not (plain and _is_noise(fitted))
    assert plain == answers


def test_what_was_worked_out_of_an_estimate_goes_with_it():
    record = recorded(4, 0.05)
    estimate = search(record, ASKED).judged()
    point = weakref.ref(point_of(estimate, [record], stated(estimate)))
    copied = pickle.loads(pickle.dumps(estimate))
    assert copied.names == estimate.names
    assert point_of(copied, [record], stated(copied)) is not point()
    assert point() is not None
    del estimate
    gc.collect()
    assert point() is None
