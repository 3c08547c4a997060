"""An end that is known well is not looked for elsewhere, and the passes to it wait to be read."""

from __future__ import annotations

import pickle
from types import SimpleNamespace

import numpy as np
import pytest

from tridentify import Estimate, Record, Structure, TransferFunction, identify, simulate
from tridentify.estimation.answer.trace import Awaited, Pass
from tridentify.estimation.likelihood.setup.nuisance import Nuisances, build
from tridentify.estimation.search import following

PLANTS = (
    (TransferFunction([0.5], [1.0, 1.0, 3.0]), Structure(2, 0)),
    (TransferFunction([1.0, 2.0], [1.0, 1.2, 4.0]), Structure(2, 1)),
    (TransferFunction([6.0], [1.0, 4.0, 7.0, 6.0]), Structure(3, 0)),
    (TransferFunction([2.0], [1.0, 1.5]), Structure(1, 0)),
)


def _record(plant: TransferFunction, seed: int, level: float) -> Record:
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], 60), 5)
    y = simulate(plant, Record(u, u, dt=0.1))[:, 0]
    return Record(u, y + level * y.std() * rng.standard_normal(y.size), dt=0.1, intersample="zoh")


@pytest.mark.slow
@pytest.mark.parametrize("level", [0.05, 0.3])
def test_the_end_is_that_of_the_whole_search(level: float, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[bool] = []

    def told(point: following.Point) -> bool:
        asked.append(known(point))
        return asked[-1]

    known = following.is_known
    cases = [(_record(plant, seed, level), how) for seed in (41, 42) for plant, how in PLANTS]
    monkeypatch.setattr(following, "is_known", told)
    quick = [identify(record, how) for record, how in cases]
    assert sum(asked) >= (len(cases) if level < 0.1 else 1) // 2
    monkeypatch.setattr(following, "is_known", lambda point: False)
    for (record, how), found in zip(cases, quick, strict=True):
        whole = identify(record, how)
        assert np.array_equal(whole.theta, found.theta)
        assert whole.cautions == found.cautions


@pytest.mark.parametrize(
    ("rate", "looseness", "known"),
    [(1.0, 0.05, True), (1e-3, 0.05, False), (50.0, 0.05, False), (1.0, 0.2, False)],
)
def test_a_pole_beyond_the_band_or_a_loose_one_is_not_known(
    rate: float, looseness: float, known: bool
) -> None:
    record = _record(PLANTS[0][0], 43, 0.05)
    problem = build([record], Structure(1, 0), Nuisances("rest", False, False))
    point = SimpleNamespace(problem=problem, poles=np.array([-rate + 0j]), looseness=looseness)
    assert following.is_known(point) is known


def test_passes_are_worked_out_once_and_kept_as_they_are() -> None:
    made: list[int] = []

    def make() -> tuple[Pass, ...]:
        made.append(1)
        return (Pass(1, (), np.array([1.0]), 0.5), Pass(2, (), np.array([2.0]), 0.25))

    passes = Awaited(make)
    assert not made
    assert [one.number for one in passes] == [1, 2]
    assert passes[-1].cost == 0.25
    assert len(passes[:1]) == 1
    assert isinstance(pickle.loads(pickle.dumps(passes)), tuple)
    assert made == [1]


def test_a_trace_that_waits_is_written_and_read(tmp_path) -> None:
    estimate = identify(_record(*PLANTS[0][:1], 44, 0.1), PLANTS[0][1])
    again = Estimate.load(estimate.save(tmp_path / "model.json"))
    assert [one.number for one in again.trace.passes] == [*range(1, len(again.trace.passes) + 1)]
    last = estimate.trace.passes[-1]
    assert last.steps[-1].name == "series"
    assert last.beta_distance < 1e-3
    assert np.array_equal(again.trace.passes[-1].theta, last.theta)
