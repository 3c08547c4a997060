"""What was found of the causes before is not fitted a second time, unless something changed."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, simulate
from tridentify.estimation.likelihood.setup.nuisance import Nuisances
from tridentify.judgement.causes import explain as module
from tridentify.judgement.causes.attempts.explanation import Explanations
from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.explain import explain

PLANT = TransferFunction([4.0], [1.0, 1.2, 4.0])
SHAPE = Structure(2, 0)


@cache
def asked() -> Present:
    """A record whose output is clipped, and the model that made it."""
    rng = np.random.default_rng(8)
    u = np.repeat(rng.standard_normal(40), 10)
    y = simulate(PLANT, Record(u, u, dt=0.05))[:, 0]
    record = Record(u, np.clip(y, -0.8, 0.8) + 0.02 * rng.standard_normal(u.size), dt=0.05)
    none = Nuisances("rest", False, False)
    poles = np.roots([1.0, 1.2, 4.0]).astype(complex)
    return Present.of([record], SHAPE, np.zeros((1, 1)), none, [np.zeros(0)], poles)


@cache
def first() -> Explanations:
    found = explain(asked())
    assert found is not None
    return found


def refuse(*_, **__):
    raise AssertionError("fitted again")


@pytest.mark.slow
def test_the_same_question_is_answered_from_what_is_known(monkeypatch):
    known = first()
    assert known.best is not None
    for name in ("settle", "_rivals", "_sharper"):
        monkeypatch.setattr(module, name, refuse)
    again = explain(asked(), known=known)
    assert again is not None
    assert [(one.rival.code, one.gain) for one in again.found] == [
        (one.rival.code, one.gain) for one in known.found
    ]
    assert again.present is known.present


@pytest.mark.parametrize("changed", ["samples", "order", "nuisances", "behaviour"])
def test_another_question_is_not(monkeypatch, changed):
    present = asked()
    (record,) = present.records
    y = np.array(record.y)
    y[7, 0] += 0.1
    other = {
        "samples": lambda: replace(present, records=(Record(record.u, y, dt=0.05),)),
        "order": lambda: replace(present, order=3),
        "nuisances": lambda: replace(present, nuisances=Nuisances("rest", True, False)),
        "behaviour": lambda: replace(
            present, records=(Record(record.u, record.y, dt=0.05, intersample="foh"),)
        ),
    }[changed]()
    assert present.is_same(asked())
    assert not present.is_same(other)
    monkeypatch.setattr(module, "settle", refuse)
    with pytest.raises(AssertionError, match="fitted again"):
        explain(other, known=first())


def test_lost_rows_are_looked_for_anew(monkeypatch):
    monkeypatch.setattr(module, "settle", refuse)
    with pytest.raises(AssertionError, match="fitted again"):
        explain(asked(), known=first(), torn=[(0, 3)])


def test_what_was_asked_of_one_cause_alone_is_not_an_answer_to_all():
    only = explain(asked(), only="saturation")
    assert only is not None
    assert only.asked is None
