"""Importance sampling of densities whose moments are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import multivariate_normal, multivariate_t

from tridentify.estimation.posterior.sampling import (
    Box,
    ProposalMixture,
    StudentKernels,
    effective_size,
    normalised,
    resample,
    sample,
)

ROOT = np.array([[0.5, 0.0], [-0.4, 0.2]])
CENTRES = np.array([[0.0, 0.0], [3.0, -1.0], [-2.0, 2.0]])
WIDE = ProposalMixture((Box(np.full(2, -10.0), np.full(2, 10.0)),), (1.0,))


def generator(seed=0):
    return np.random.default_rng(seed)


# ------------------------------------------------------------------------------------- proposals
def test_box_is_uniform():
    box = Box(np.array([-1.0, 2.0]), np.array([3.0, 4.0]))
    drawn = box.draw(4000, generator())
    assert drawn.shape == (4000, 2)
    assert np.all((drawn >= box.low) & (drawn <= box.high))
    assert drawn.mean(axis=0) == pytest.approx([1.0, 3.0], abs=0.1)
    assert drawn.std(axis=0) == pytest.approx(np.array([4.0, 2.0]) / np.sqrt(12.0), rel=0.05)
    assert np.exp(box.log_density(drawn)) == pytest.approx(np.full(4000, 1.0 / 8.0))
    assert np.all(box.log_density(np.array([[3.1, 3.0], [0.0, 1.9]])) == -np.inf)


def test_kernels_are_student_densities():
    kernels = StudentKernels(CENTRES, ROOT)
    points = generator().normal(size=(50, 2)) * 4.0
    each = [multivariate_t(c, ROOT @ ROOT.T, df=4).pdf(points) for c in CENTRES]
    assert np.exp(kernels.log_density(points)) == pytest.approx(np.mean(each, axis=0), rel=1e-9)


def test_kernels_far_away_do_not_underflow():
    kernels = StudentKernels(CENTRES, 1e-3 * ROOT)
    points = np.full((1, 2), 1e8)
    expected = multivariate_t(CENTRES[0], 1e-6 * ROOT @ ROOT.T, df=4).logpdf(points)
    assert kernels.log_density(points) == pytest.approx(expected, rel=1e-6)


def test_kernels_draw_what_their_density_says():
    kernels = StudentKernels(CENTRES, ROOT)
    drawn = kernels.draw(40_000, generator())
    assert drawn.mean(axis=0) == pytest.approx(CENTRES.mean(axis=0), abs=0.06)
    spread = 4.0 / (4.0 - 2.0) * ROOT @ ROOT.T + np.cov(CENTRES.T, bias=True)
    assert np.cov(drawn.T) == pytest.approx(spread, abs=0.15)
    # Importance weights of draws against their own density add up to the volume of the box.
    inside = np.all(np.abs(drawn - 0.5) < 1.0, axis=1)
    volume = np.mean(inside / np.exp(kernels.log_density(drawn)))
    assert volume == pytest.approx(4.0, rel=0.1)


def test_mixtures_draw_and_weigh_their_parts():
    mixture = ProposalMixture(
        (StudentKernels(CENTRES[:1], ROOT), Box(np.full(2, 50.0), np.full(2, 51.0))), (0.8, 0.2)
    )
    drawn = mixture.draw(1000, generator())
    assert np.sum(np.all(drawn >= 50.0, axis=1)) == 200
    far = mixture.log_density(np.array([[50.5, 50.5]]))
    assert np.exp(far) == pytest.approx([0.2], rel=1e-3)
    near = np.array([[0.1, 0.2]])
    expected = 0.8 * multivariate_t(CENTRES[0], ROOT @ ROOT.T, df=4).pdf(near)
    assert np.exp(mixture.log_density(near)) == pytest.approx(expected)


def test_a_part_with_a_small_share_is_still_drawn():
    mixture = ProposalMixture((WIDE, Box(np.full(2, 50.0), np.full(2, 51.0))), (0.999, 0.001))
    assert np.any(mixture.draw(20, generator()) >= 50.0)


# --------------------------------------------------------------------------------------- weights
@given(st.lists(st.floats(-1e5, 1e5), min_size=1, max_size=20))
def test_weights_add_up_whatever_their_size(logs):
    weights = normalised(np.array(logs))
    assert weights.sum() == pytest.approx(1.0)
    assert np.all(weights >= 0.0)
    assert normalised(np.array(logs) + 1e5) == pytest.approx(weights, abs=1e-9)
    assert 1.0 - 1e-9 <= effective_size(weights) <= len(logs) + 1e-9


def test_effective_size_counts_equal_weights():
    assert effective_size(np.full(7, 1.0 / 7.0)) == pytest.approx(7.0)
    assert effective_size(np.array([0.0, 1.0, 0.0])) == pytest.approx(1.0)


@given(st.integers(0, 10_000), st.integers(1, 300))
def test_resampling_takes_each_point_its_share_of_times(seed, count):
    weights = normalised(generator(seed).normal(size=30) * 2.0)
    chosen = resample(weights, count, generator(seed + 1))
    times = np.bincount(chosen, minlength=30)
    assert times.sum() == count
    assert np.all(np.abs(times - count * weights) < 1.0 + 1e-9)


def test_resampling_never_takes_the_impossible():
    chosen = resample(np.array([0.0, 0.4, 0.0, 0.6, 0.0]), 1000, generator())
    assert set(chosen.tolist()) == {1, 3}


# -------------------------------------------------------------------------------------- sampling
LOBES = (
    (0.7, np.array([-4.0, 3.0]), np.diag([0.04, 0.3])),
    (0.3, np.array([5.0, -2.0]), np.eye(2) * 0.2),
)


def lobes(points):
    """A mixture of two Gaussians far apart, times a constant that is not to matter."""
    each = [np.log(w) + multivariate_normal(m, c).logpdf(points) for w, m, c in LOBES]
    return np.logaddexp.reduce(each, axis=0) - 5000.0


def moments():
    mean = sum(w * m for w, m, _ in LOBES)
    second = sum(w * (c + np.outer(m, m)) for w, m, c in LOBES)
    return mean, second - np.outer(mean, mean)


@pytest.mark.parametrize("seed", range(4))
def test_moments_of_two_distant_lobes(seed):
    found = sample(lobes, WIDE, 1000, (1000.0,) * 8, generator(seed))
    mean, covariance = moments()
    assert found.weights.sum() == pytest.approx(1.0)
    assert found.points.shape == (found.weights.size, 2)
    assert found.effective == pytest.approx(effective_size(found.weights))
    assert found.effective >= 1000.0
    std = np.sqrt(np.diag(covariance))
    own = found.weights @ found.points
    assert np.all(np.abs(own - mean) < 4.0 * std / np.sqrt(found.effective))
    centred = found.points - own
    spread = (centred.T * found.weights) @ centred
    assert spread / np.outer(std, std) == pytest.approx(covariance / np.outer(std, std), abs=0.15)
    share = found.weights[found.points[:, 0] < 0.0].sum()
    assert share == pytest.approx(0.7, abs=4.0 * np.sqrt(0.21 / found.effective))


@pytest.mark.slow
def test_the_estimate_is_not_biased():
    """Over many seeds the mean is much nearer than one run's error allows."""
    runs = [sample(lobes, WIDE, 400, (150.0,) * 6, generator(seed)) for seed in range(60)]
    means = np.array([run.weights @ run.points for run in runs])
    mean = moments()[0]
    error = np.abs(means.mean(axis=0) - mean)
    assert np.all(error < 3.5 * means.std(axis=0) / np.sqrt(len(runs)) + 0.01)


@pytest.mark.slow
def test_effective_size_is_worth_what_it_says():
    """The scatter over seeds is that of so many independent draws, within a factor of two."""
    runs = [sample(lobes, WIDE, 400, (150.0,) * 6, generator(seed)) for seed in range(60)]
    shares = np.array([run.weights[run.points[:, 0] < 0.0].sum() for run in runs])
    independent = 0.7 * 0.3 / np.mean((shares - 0.7) ** 2)
    stated = np.mean([run.effective for run in runs])
    assert 0.5 * stated < independent < 3.0 * stated


def test_a_misplaced_start_costs_draws_and_no_bias():
    """Nearly all first draws from a kernel where nothing is."""
    wrong = StudentKernels(np.array([[8.0, 8.0]]), 0.1 * np.eye(2))
    first = ProposalMixture((*WIDE.parts, wrong), (0.1, 0.9))
    found = sample(lobes, first, 1000, (800.0,) * 10, generator())
    mean, covariance = moments()
    assert found.effective >= 800.0
    error = np.abs(found.weights @ found.points - mean)
    assert np.all(error < 4.0 * np.sqrt(np.diag(covariance) / found.effective))


NEEDLE = np.array([1.0, -2.0, 3.0])
BOX = Box(np.full(3, -10.0), np.full(3, 10.0))
LED = StudentKernels(NEEDLE[None] + 0.02, 0.02 * np.eye(3))


@pytest.mark.parametrize(
    ("width", "first"),
    [(0.1, ProposalMixture((BOX,), (1.0,))), (0.002, ProposalMixture((BOX, LED), (0.5, 0.5)))],
    ids=["from the box", "where a kernel leads"],
)
def test_a_needle_is_found(width, first):
    """A two-hundredth of each side of the box; far less where the start is near."""

    def needle(points):
        return -0.5 * np.sum((points - NEEDLE) ** 2, axis=1) / width**2

    found = sample(needle, first, 1000, (300.0,) * 12, generator())
    assert found.effective >= 300.0
    error = np.abs(found.weights @ found.points - NEEDLE)
    assert np.all(error < 4.0 * width / np.sqrt(found.effective))


class Counted:
    """A density that keeps what it was asked."""

    def __init__(self):
        self.asked = []

    def __call__(self, points):
        self.asked.append(points)
        return lobes(points)


@pytest.mark.parametrize("goals", [(0.0,), (0.0, 1e9), (1e9, 1e9, 0.0, 1e9), (1e9, 1e9, 1e9)])
def test_rounds_stop_at_the_goal_or_when_they_run_out(goals):
    density = Counted()
    found = sample(density, WIDE, 200, goals, generator())
    rounds = goals.index(0.0) + 1 if 0.0 in goals else len(goals)
    assert len(density.asked) == rounds
    assert np.array_equal(found.points, np.concatenate(density.asked))


def test_no_more_rounds_than_the_goal_needs():
    density = Counted()
    found = sample(density, WIDE, 500, (300.0,) * 10, generator())
    assert found.effective >= 300.0
    before = np.concatenate(density.asked[:-1])
    assert len(density.asked) > 1
    assert effective_size(normalised(lobes(before))) < 300.0


@pytest.mark.parametrize("impossible", [np.nan, -np.inf, np.inf])
def test_impossible_points_weigh_nothing(impossible):
    def half(points):
        return np.where(points[:, 0] > 0.0, impossible, lobes(points))

    found = sample(half, WIDE, 1000, (500.0,) * 8, generator())
    assert np.all(found.weights[found.points[:, 0] > 0.0] == 0.0)
    mean = found.weights @ found.points
    std = np.sqrt(np.diag(LOBES[0][2]) / found.effective)
    assert np.all(np.abs(mean - LOBES[0][1]) < 4.0 * std)


def test_the_same_seed_gives_the_same_draws():
    one, other = (sample(lobes, WIDE, 300, (200.0,) * 5, generator(3)) for _ in range(2))
    assert np.array_equal(one.points, other.points)
    assert np.array_equal(one.weights, other.weights)


# ----------------------------------------------------------------------------------------- tilts
def heavy(points):
    """Student's t with six degrees of freedom, a tail on either side."""
    return -3.5 * np.log1p(points[:, 0] ** 2 / 6.0)


def squared(points):
    return 2.0 * np.log(np.abs(points) + 1e-9)


def variance(seed, tilts):
    found = sample(heavy, WIDE_LINE, 500, (300.0,) * 8, generator(seed), *tilts)
    share = found.weights * np.exp(squared(found.points)[:, 0])
    return share.sum(), effective_size(share / share.sum()), found.effective


WIDE_LINE = ProposalMixture((Box(np.array([-200.0]), np.array([200.0])),), (1.0,))


@pytest.mark.slow
def test_what_is_told_of_a_tail_is_known_as_well_as_the_middle():
    """The variance of a heavy tail, 6 / 4, hangs on few draws of the density itself."""
    told = np.array([variance(seed, (squared,)) for seed in range(8)])
    assert np.all(told[:, 1] >= 300.0 - 1e-6)
    assert np.all(told[:, 2] <= told[:, 1] + 1e-6)
    assert told[:, 0] == pytest.approx(np.full(8, 1.5), rel=0.25)


def test_kernels_take_the_shape_of_the_place_they_are_in():
    """A needle beside a hill: each has kernels of its own width, and both are known."""
    places = ((0.5, np.array([-3.0, 0.0]), 1e-4), (0.5, np.array([3.0, 0.0]), 0.5))

    def both(points):
        each = [np.log(w) + multivariate_normal(m, c).logpdf(points) for w, m, c in places]
        return np.logaddexp.reduce(each, axis=0)

    near = StudentKernels(np.array([[-3.0, 0.0], [3.0, 0.0]]), 0.1 * np.eye(2))
    first = ProposalMixture((*WIDE.parts, near), (0.5, 0.5))
    found = sample(both, first, 500, (400.0,) * 8, generator())
    assert found.effective >= 400.0
    assert found.weights[found.points[:, 0] < 0.0].sum() == pytest.approx(0.5, abs=0.1)
