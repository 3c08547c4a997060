"""The beginning of a search in one call leads where its pieces lead."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, simulate
from tridentify.estimation.likelihood.charted import shifts
from tridentify.estimation.likelihood.cost import evaluate_variant
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import Recorder
from tridentify.estimation.likelihood.question import Question
from tridentify.estimation.search.banks import Banks
from tridentify.estimation.search.beginning import begun
from tridentify.estimation.search.passes import adapting
from tridentify.estimation.search.starts import laguerre_starts
from tridentify.numerics.slices import drain

DT = 0.05
STRUCTURES = {
    "at rest": Structure(2, 1, offset=False, initial_state="rest"),
    "left open": Structure(2, 1),
    "a drift": Structure(2, 1, drift=True, initial_state="free"),
    "direct part": Structure(2, 2),
}


def question(name, n=250, level=0.0):
    rng = np.random.default_rng(20)
    u = np.repeat(rng.standard_normal(n // 5), 5) + level
    model = TransferFunction([0.2, 3.0], [1.0, 1.2, 6.0])
    y = simulate(model, Record(u - level, u, dt=DT))[:, 0]
    noisy = y + 0.1 * np.std(y) * rng.standard_normal(n)
    return Question.of([Record(u, noisy, dt=DT)], STRUCTURES[name])


@pytest.mark.parametrize("name", STRUCTURES)
def test_one_call_leads_where_the_pieces_lead(name):
    asked = question(name)
    base, variants = asked.base, asked.variants
    found, starts = begun(base, variants), laguerre_starts(base, variants)
    first = starts[0]
    assert (found.name, found.variant) == (first.name, first.variant)
    assert found.criterion == pytest.approx(first.criterion, rel=1e-12)
    assert [one.name for one in found.starts] == [one.name for one in starts]
    ways = [evaluate_variant(base, first.variant, poles) for poles in first.candidates()]
    best = min(ways, key=lambda point: point.objective)
    recorder = Recorder()
    end = drain(adapting(base, first.variant, best.poles, recorder))
    np.testing.assert_allclose(found.first, best.poles, rtol=1e-10)
    np.testing.assert_allclose(found.point.poles, end.poles, rtol=1e-9)
    assert found.point.aicc == pytest.approx(end.aicc, rel=1e-12)
    passes = zip(found.recorder.passes, recorder.passes, strict=True)
    assert all(np.allclose(one.theta, other.theta, rtol=1e-8) for one, other in passes)


def test_ranks_are_those_of_the_pieces_where_constants_go_back_on_the_inputs():
    asked = question("left open", level=2.0)
    base, variants = asked.base, asked.variants
    assert any(shifts(variant) for variant in variants)
    poles = np.array([[-1.0 + 0j] * 5, [-4.0 + 0j] * 5])
    _, orders, criteria = Banks.ranked(base, poles, variants, 4, 3)
    by_pieces = Banks.of(base, poles).orders(variants, 4, 3)
    np.testing.assert_array_equal(orders, by_pieces[0])
    np.testing.assert_allclose(criteria, by_pieces[1], rtol=1e-11)


def test_a_long_record_begins_piece_by_piece():
    asked = question("at rest", n=1000)
    assert begun(asked.base, asked.variants) is None
