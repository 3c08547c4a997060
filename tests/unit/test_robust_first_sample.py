"""Outliers that a free response could hide: the first sample, and ones that come at a period."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, ThreeModel, TransferFunction, identify, simulate

pytestmark = pytest.mark.unjudged


@pytest.mark.parametrize("kind", ["step", "switched"])
@pytest.mark.parametrize("loss", ["huber", "student"])
@pytest.mark.fast("huber-switched", "student-step")
def test_an_outlier_at_the_first_sample_does_not_mislead(kind, loss):
    rng = np.random.default_rng(0)
    u = np.ones(300) if kind == "step" else np.repeat(rng.choice([-1.0, 1.0], 60), 5)
    y = simulate(TransferFunction([0.5], [1.0, 1.0, 3.0]), Record(u, u, dt=0.05))[:, 0]
    y = y + 0.05 * np.std(y) * rng.standard_normal(300)
    y[::17] += 2.0
    estimate = identify(Record(u, y, dt=0.05), Structure(2, 0), ThreeModel(loss=loss))
    assert estimate.theta == pytest.approx([1.0, 3.0, 0.5], rel=0.03)
    assert set(estimate.outliers[:, 2]) == set(range(0, 300, 17))
