"""Moments of the mixture that stands for the uncertainty of estimated delays."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from scipy import stats

from tridentify import OutputError, Record, Structure, TransferFunction, identify, simulate
from tridentify.estimation.likelihood.cost import Point, evaluate
from tridentify.estimation.likelihood.curvature import Curvature
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import finish
from tridentify.estimation.likelihood.mixture import (
    Cell,
    Component,
    combined,
    component,
    fast_poles,
    mixture,
)
from tridentify.estimation.likelihood.setup.nuisance import Nuisances, build
from tridentify.estimation.search.delays import _in_words

pytestmark = pytest.mark.unjudged

DT = 0.05
ROOM = 0.6
FIRST = TransferFunction([2.0], [1.0, 1.5], delay=0.337)
SECOND = TransferFunction([4.0], [1.0, 0.8, 4.0], delay=0.337)


def record(model, noise=0.1, seed=0, intersample="zoh", n=400):
    rng = np.random.default_rng(seed)
    u = np.repeat(np.sign(rng.standard_normal((n // 6 + 1, 1))), 6, axis=0)[:n]
    y = simulate(model, Record(u, u, dt=DT, intersample=intersample))
    y = y + noise * np.std(y) * rng.standard_normal(y.shape)
    return Record(u, y, dt=DT, intersample=intersample)


def minimum(model, **options) -> Point:
    data = record(model, **options)
    order = len(model.den[0][0]) - 1
    known = Structure(order, 0, delay=ROOM, offset=False, initial_state="rest")
    problem = build([data], known, Nuisances("rest", False, False)).freed(np.array([ROOM]))
    poles = np.roots(model.den[0][0]).astype(np.complex128)
    at = partial(evaluate, problem)
    return finish(at, at(problem.admissible(poles)[0], delays=model.delay[0]), None)[0]


def test_two_minima_have_the_moments_of_their_mixture():
    a = Component(np.log(3.0), np.array([1.0, 0.0]), np.diag([1.0, 4.0]))
    b = Component(0.0, np.array([5.0, 2.0]), np.diag([2.0, 1.0]))
    found = combined([a, b], a.mean)
    assert found.shares == pytest.approx([0.75, 0.25])
    away = np.array([4.0, 2.0])
    assert found.cov == pytest.approx(
        0.75 * a.cov + 0.25 * (b.cov + np.outer(away, away)), rel=1e-14
    )


def test_what_hardly_counts_is_left_out():
    a = Component(0.0, np.zeros(1), np.eye(1))
    b = Component(-7.0, np.zeros(1), 1e12 * np.eye(1))
    assert combined([a, b], a.mean).cov == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("low", "high"), [(-0.5, 1.0), (2.0, 2.5), (-9.0, -8.0), (1.0, 1.001), (0.3, np.inf)]
)
def test_a_truncated_gaussian_has_the_moments_of_scipys(low, high):
    whole = Component(0.0, np.array([0.4, 1.0]), np.array([[0.49, 0.3], [0.3, 2.0]]))
    found = whole.within(0, low, high)
    ends = (low - 0.4) / 0.7, (high - 0.4) / 0.7
    truth = stats.truncnorm(*ends, loc=0.4, scale=0.7)
    tail = stats.norm.cdf if low < 0 else stats.norm.sf
    mass = np.log(abs(tail(ends[1]) - tail(ends[0])))
    assert found.log_mass == pytest.approx(mass, rel=1e-6)
    assert found.mean[0] == pytest.approx(truth.mean(), rel=1e-6)
    assert found.cov[0, 0] == pytest.approx(truth.var(), rel=1e-3)
    # the other follows by regression on the truncated one
    slope = 0.3 / 0.49
    assert found.mean[1] == pytest.approx(1.0 + slope * (found.mean[0] - 0.4))
    assert found.cov[1, 1] == pytest.approx(2.0 - slope * 0.3 + slope**2 * found.cov[0, 0])


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
def test_the_slope_along_a_delay_is_that_of_finite_differences(intersample):
    point = minimum(FIRST, intersample=intersample)
    problem = point.problem.delayed(np.array([0.362]))
    here, step = evaluate(problem, point.poles), 1e-6
    ahead, behind = (
        evaluate(problem, point.poles, delays=problem.delays + sign * step).objective
        for sign in (1.0, -1.0)
    )
    assert here.delay_slopes[0] == pytest.approx((ahead - behind) / (2 * step), rel=1e-5)


@pytest.mark.parametrize(
    ("model", "intersample"), [(SECOND, "zoh"), (FIRST, "foh"), (SECOND, "foh")]
)
def test_one_minimum_without_kinks_stays_as_it_is(model, intersample):
    point = minimum(model, intersample=intersample)
    assert mixture(point, []) is None
    assert mixture(point, [(point.problem.delays + 0.02, point.poles)]) is None


def test_cells_end_at_the_steps_of_every_hold():
    problem = minimum(FIRST).problem
    cell = Cell.around(problem, np.array([0.337]))
    assert (*cell.low, *cell.high) == pytest.approx((0.3, 0.35))
    assert Cell.around(problem, np.array([0.35])).low == (pytest.approx(0.35),)
    assert Cell.around(minimum(SECOND).problem, np.array([0.337])).kinked == []


@pytest.mark.slow
def test_the_cells_share_the_integral_of_the_profile_likelihood():
    """Against the cost along the delay, all else at its best, integrated piece by piece."""
    best = minimum(FIRST, noise=1.0)
    found = mixture(best, [])
    assert found is not None
    assert len(found.shares) > 1
    grid = np.arange(0.1, 0.55, 0.0025) + 0.00125
    costs = []
    for delay in grid:
        held = best.problem.delayed(np.array([delay])).freed(None)
        at = partial(evaluate, held)
        costs.append(finish(at, at(best.poles), None)[0].objective)
    density = np.exp(-0.5 * (np.array(costs) - min(costs)))
    density /= density.sum()
    mean = density @ grid
    spread = np.sqrt(density @ (grid - best.problem.delays[0]) ** 2)
    assert found.shares @ found.means[:, -1] == pytest.approx(mean, abs=0.15 * spread)
    assert np.sqrt(found.cov[-1, -1]) == pytest.approx(spread, rel=0.2)


def test_a_pole_beyond_the_band_is_held():
    point = minimum(SECOND)
    assert fast_poles(point).size == 0
    fast = evaluate(point.problem, np.array([-2.0 + 0j, -60.0 + 0j]))
    (row,) = fast_poles(fast)
    moved = [np.log(-np.roots([1.0, 62.0 + h, 120.0 + k]).min()) for h, k in ((1e-4, 0), (0, 1e-4))]
    assert row[:2] == pytest.approx((np.array(moved) - np.log(60.0)) / 1e-4, rel=1e-4)
    held = Curvature.at(fast, held=row[None]).covariance
    cov = Curvature.at(fast).covariance
    # what is left is the covariance given that combination
    along = cov @ row
    assert held == pytest.approx(cov - np.outer(along, along) / (row @ along), rel=1e-6, abs=1e-9)
    infinite = Cell((-np.inf,), (np.inf,))
    assert component(fast, infinite).cov == pytest.approx(held)
    assert component(fast, infinite, whole=True).cov == pytest.approx(cov)


def test_a_pole_at_its_limit_leaves_variances_positive():
    point = minimum(FIRST)
    limit = np.array([-400.0 + 0j])
    far = evaluate(point.problem, limit, delays=np.array([0.35]))
    found = component(far, Cell.around(far.problem, np.array([0.36])))
    assert np.all(np.diag(found.cov) >= 0)
    assert found.cov[-1, -1] < DT**2


def test_other_delays_are_named_where_they_hold_a_share():
    means = np.array([[0.3], [0.8], [0.82], [1.5]])
    told = _in_words(np.array([0.7, 0.1, 0.16, 0.04]), means, np.array([0.3]), DT)
    assert told == "other delays explain the record almost as well: 0.82 s (26 %)"
    assert _in_words(np.array([1.0]), means[:1], np.array([0.3]), DT) == ""


def test_no_interval_of_a_delay_begins_before_zero():
    estimate = identify(
        record(TransferFunction([2.0], [1.0, 1.5])),
        Structure(1, 0, delay="free", offset=False, initial_state="rest"),
        OutputError(),
    )
    low, high = estimate.parameters["delay"].interval()
    assert 0.0 <= low < high
    assert estimate.std[-1] > 0


@pytest.mark.slow
def test_intervals_of_a_kinked_delay_cover():
    structure = Structure(1, 0, delay="free", offset=False, initial_state="rest")
    hits = []
    for seed in range(60):
        estimate = identify(record(FIRST, noise=0.5, seed=seed), structure, OutputError())
        low, high = estimate.parameters["delay"].interval()
        hits.append(low <= 0.337 <= high)
    # 95 % of 60 is 57; 51 and fewer have a probability below 0.3 %
    assert sum(hits) > 51
