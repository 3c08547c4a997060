"""The paper's short, noisy step record over many draws: no outliers, no loss, honest intervals.

The bound comes from central differences of a closed form. Slow; run by `make test-all`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from tridentify import Record, Status, Structure, ThreeModel, identify

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600), pytest.mark.unjudged(always=True)]

TRUTH = np.array([1.0, 3.0, 0.5])
DT, N, DRAWS = 0.05, 100, 200
STRUCTURE = Structure(2, 0, offset=False, initial_state="rest")


def step_response(theta):
    """Of ``b0 / (p^2 + a1 p + a0)`` with a complex pair."""
    a1, a0, b0 = theta
    t = DT * np.arange(N)
    half = 0.5 * a1
    w = np.sqrt(a0 - half**2)
    return b0 / a0 * (1.0 - np.exp(-half * t) * (np.cos(w * t) + half / w * np.sin(w * t)))


def bound(std):
    """Cramer-Rao."""
    columns = []
    for step in 1e-5 * np.eye(3):
        columns.append((step_response(TRUTH + step) - step_response(TRUTH - step)) / 2e-5)
    scores = np.stack(columns, axis=1)
    return std * np.sqrt(np.diag(np.linalg.inv(scores.T @ scores)))


class Outcome(NamedTuple):
    """Of all draws at one noise level."""

    errors: np.ndarray
    likelihood: np.ndarray
    intervals: np.ndarray
    taken: np.ndarray
    bound: np.ndarray


@pytest.fixture(scope="module", params=[1.0, 3.0], ids=["ratio 1", "ratio 3"])
def outcome(request):
    clean = step_response(TRUTH)
    std = request.param * np.sqrt(np.mean(clean**2))
    found, rivals, intervals, taken = [], [], [], []
    for seed in np.random.SeedSequence(2025).spawn(DRAWS):
        y = clean + std * np.random.default_rng(seed).standard_normal(N)
        record = Record(np.ones(N), y, dt=DT)
        estimate = identify(record, STRUCTURE, throw=False)
        rival = identify(record, STRUCTURE, ThreeModel(finish="likelihood"), throw=False)
        found.append(estimate.theta / TRUTH - 1.0)
        rivals.append(rival.theta / TRUTH - 1.0)
        intervals.append([p.interval() for p in estimate.parameters.values()])
        taken.append(estimate.status is Status.POSTERIOR_MEAN)
    return Outcome(
        np.array(found), np.array(rivals), np.array(intervals), np.array(taken), bound(std)
    )


def test_the_posterior_decides_most_of_these_records(outcome):
    assert outcome.taken.mean() > 0.5


def test_no_draw_runs_away(outcome):
    worst = np.abs(outcome.errors).max(axis=1)
    assert worst.max() < 30.0, f"draw {worst.argmax()}: {outcome.errors[worst.argmax()]}"


def test_the_likelihood_alone_does_run_away(outcome):
    """Else this record would not need a posterior."""
    assert np.abs(outcome.likelihood).max() > 2.0 * np.abs(outcome.errors).max()


def test_damping_is_within_reach_of_the_bound(outcome):
    rmse = np.sqrt(np.mean(outcome.errors[:, 0] ** 2)) * TRUTH[0]
    assert rmse < 1.5 * outcome.bound[0]


def test_the_middle_is_not_paid_for_the_tails(outcome):
    """Medians over draws, root mean square over coefficients; 10 % is their sampling error."""
    middle, rival = (
        np.sqrt(np.mean(np.median(np.abs(e), axis=0) ** 2))
        for e in (outcome.errors, outcome.likelihood)
    )
    assert middle < 1.1 * rival


def test_intervals_cover(outcome):
    low, high = outcome.intervals[:, :, 0], outcome.intervals[:, :, 1]
    covered = np.mean((low <= TRUTH) & (high >= TRUTH), axis=0)
    assert covered[0] >= 0.85
    assert np.all(covered >= 0.8)
