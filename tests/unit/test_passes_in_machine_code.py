"""A fit and adapted passes in one call of machine code are those of Python, whatever the structure.

The routes are told apart by taking the machine code's samples away.
"""

from __future__ import annotations

import numpy as np
import pytest

from tridentify.estimation.likelihood import cost
from tridentify.estimation.likelihood.cost import evaluate, evaluate_variant
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import Recorder
from tridentify.estimation.likelihood.setup.problem import Variant
from tridentify.estimation.search import passes
from tridentify.numerics.slices import drain
from unit.test_descent import PROBLEMS, start_of


def nothing(*_: object) -> None:
    """Machine code does not serve."""


@pytest.mark.parametrize("repeats", [2, 3])
@pytest.mark.parametrize("name", PROBLEMS)
def test_the_fit_is_the_same_in_one_call(name, repeats, monkeypatch):
    problem = PROBLEMS[name]
    at_once = evaluate(problem, start_of(problem), repeats)
    monkeypatch.setattr(cost, "fitted", nothing)
    plain = evaluate(problem, start_of(problem), repeats)
    assert not at_once.triangles.given
    assert plain.triangles.given
    for field, other in zip(at_once.linear, plain.linear, strict=True):
        np.testing.assert_array_equal(field, other)
    np.testing.assert_array_equal(at_once.counts, plain.counts)
    np.testing.assert_array_equal(at_once.triangles.nuisance, plain.triangles.nuisance)
    for one, same in zip(at_once.regressions, plain.regressions, strict=True):
        assert (one.layout, one.counts, one.log_scale) == (same.layout, same.counts, same.log_scale)
        for own, those in zip(
            (*one.signals, *one.targets), (*same.signals, *same.targets), strict=True
        ):
            np.testing.assert_array_equal(own, those)


@pytest.mark.parametrize("constant", [None, 0.7])
@pytest.mark.parametrize("name", PROBLEMS)
def test_passes_are_the_same(name, constant, monkeypatch):
    base = PROBLEMS[name]
    e = base.experiments[0]
    if constant is not None and not (e.free and e.offset):
        return
    constants = None if constant is None else np.full(base.n_inputs, constant)
    variant = Variant(False, e.offset, False, (constants,) * len(base.experiments))
    told, plain = Recorder(), Recorder()
    found = drain(passes.adapting(base, variant, start_of(base), told))
    monkeypatch.setattr(passes, "given", nothing)
    other = drain(passes.adapting(base, variant, start_of(base), plain))
    np.testing.assert_allclose(found.poles, other.poles, rtol=1e-9)
    assert len(told.passes) == len(plain.passes) > 1
    for one, same in zip(told.passes, plain.passes, strict=True):
        np.testing.assert_allclose(one.theta, same.theta, rtol=1e-7, atol=1e-9)
        assert (one.number, one.note) == (same.number, same.note)
        assert [(s.kind, s.note) for s in one.steps] == [(s.kind, s.note) for s in same.steps]
        assert one.gradient == pytest.approx(same.gradient, rel=1e-5, abs=1e-9)


def test_a_place_is_carried_to_a_problem_of_the_same_samples():
    problem = PROBLEMS["two of each"]
    variant = Variant(False, True, False, (None,))
    point = evaluate_variant(problem, variant, start_of(problem))
    promised = point.decrease()
    carried = point.carried_to(problem)
    assert carried.problem is problem
    assert carried.seen is point.seen
    assert carried.decrease() == promised == evaluate(problem, start_of(problem)).decrease()
