"""Candidates that leave a zero open at their maximum: what is said of them, and when they go on."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, ThreeModel, TransferFunction, identify, simulate
from tridentify import select_structure as select
from tridentify.estimation.likelihood.open_zero import STAYED

pytestmark = pytest.mark.unjudged

PLANT = TransferFunction([2.0, 3.0], [1.0, 2.0, 9.0])
RIGHT, LARGE = (Structure(n, m, offset=False, initial_state="rest") for n, m in ((2, 1), (3, 2)))


@pytest.fixture(scope="module")
def record():
    rng = np.random.default_rng(71)
    u = np.repeat(rng.choice([-1.0, 1.0], 50), 6)
    y = simulate(PLANT, Record(u, u, dt=0.05))
    return Record(u, y + 0.05 * np.std(y) * rng.standard_normal(y.shape), dt=0.05)


def test_a_needless_pair_stays_at_the_maximum_and_says_so(record):
    found = select(record, [RIGHT, LARGE])
    right, large = found.rows
    assert found.recommended is right
    assert right.identified
    assert not large.identified
    assert large.doubts
    assert STAYED in large.estimate.trace.decisions
    assert "of (3, 2) those of the likelihood's maximum" in found.summary().replace("\n  ", " ")
    # it has the likelihood's maximum all the same, and no less than the smaller one
    assert large.deviance < right.deviance


def test_what_is_recommended_was_carried_to_its_end(record):
    (alone,) = select(record, [LARGE]).rows
    whole = identify(record, LARGE)
    assert alone.identified
    assert np.array_equal(alone.estimate.theta, whole.theta)
    assert np.array_equal(alone.estimate.cov, whole.cov)


def test_a_zero_that_is_determined_changes_nothing(record):
    method = ThreeModel()
    one, other = (method.estimate([record], RIGHT, whole=whole) for whole in (True, False))
    assert np.array_equal(one.theta, other.theta)
    assert one.trace.decisions == other.trace.decisions


def test_poles_that_are_known_need_no_search(record):
    method = ThreeModel(noise="white")
    searched = method.estimate([record], RIGHT)
    poles = np.roots(searched.model.den[0][0]).astype(complex)
    near = method.estimate([record], RIGHT, near=poles * 1.05)
    assert len(near.trace.starts) == 1
    assert near.theta == pytest.approx(searched.theta, abs=1e-3 * np.min(searched.std))
    assert near.std == pytest.approx(searched.std, rel=1e-3)
