"""Rows of a selection that are spared the posterior, and what the recommendation turns on."""

from __future__ import annotations

import gc

import numpy as np
import pytest

from tridentify import Record, Structure, ThreeModel, TransferFunction, select_structure, simulate
from tridentify.estimation.methods import three_model
from tridentify.estimation.posterior.maximum_or_mean import PUT_OFF
from tridentify.judgement.selection import select

CANDIDATES = [Structure(n, m) for n, m in ((1, 0), (2, 0), (3, 0), (3, 1))]


@pytest.fixture(scope="module")
def record():
    rng = np.random.default_rng(2)
    u = np.repeat(rng.choice([-1.0, 1.0], 50), 6)
    y = simulate(TransferFunction([3.0], [1.0, 2.0, 9.0]), Record(u, u, dt=0.05))[:, 0]
    return Record(u, y + 0.1 * np.std(y) * rng.standard_normal(u.size), dt=0.05)


@pytest.fixture(scope="module")
def selection(record):
    return select_structure(record, CANDIDATES)


def test_some_rows_are_put_off_and_the_notes_say_so(selection):
    assert selection.recommended.label == "2, 0"
    assert selection.recommended.identified
    late = [row for row in selection.rows if not row.identified]
    assert late
    assert any("no posterior weighed" in note for note in selection.all_notes())
    for row in late:
        assert row.estimate.status.name != "POSTERIOR_MEAN"


@pytest.mark.slow
def test_the_recommendation_is_that_with_every_posterior_weighed(record, selection, monkeypatch):
    monkeypatch.setattr(select, "far_behind", lambda table: [])
    whole = ThreeModel.estimate

    def estimate(self, records, structure, progress=None, *, near=None, put_off=False):
        return whole(self, records, structure, progress, near=near)

    monkeypatch.setattr(ThreeModel, "estimate", estimate)
    full = select_structure(record, CANDIDATES)
    assert full.recommended.label == selection.recommended.label
    assert full.reason == selection.reason
    for one, other in zip(full.rows, selection.rows, strict=True):
        assert one.identified
        assert one.deviance == other.deviance
        if other.identified:
            assert np.array_equal(one.estimate.theta, other.estimate.theta)
            assert np.array_equal(one.cross_fit, other.cross_fit)


def test_a_posterior_that_was_put_off_is_the_same_when_it_is_weighed(record):
    structure, method = Structure(3, 1), ThreeModel()
    first = method.estimate([record], structure, put_off=True)
    assert PUT_OFF in first.trace.decisions
    later, whole = method.resumed(first), method.estimate([record], structure)
    assert np.array_equal(later.theta, whole.theta)
    assert np.array_equal(later.cov, whole.cov)
    assert later.status is whole.status
    assert method.resumed(whole) is None


def test_nothing_is_kept_once_the_selection_is_there(selection):
    gc.collect()
    kept = list(three_model._UNWEIGHED)
    assert not any(row.estimate is one for row in selection.rows for one in kept)
