"""Batches: how many items each has, how many are in flight, and what becomes of lost ones."""

from __future__ import annotations

from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import pytest

import fleets
from tridentify import Structure
from tridentify.errors import TridentifyError
from tridentify.fleet.job import Item
from tridentify.fleet.places import Given
from tridentify.fleet.rows import Fit
from tridentify.fleet.workers import keeper
from tridentify.fleet.workers.dispatch import (
    FIRST,
    IN_FLIGHT,
    LEAST_SECONDS,
    Batches,
    Lost,
    dispatch,
)
from tridentify.fleet.workers.engines import Engine
from tridentify.fleet.workers.job import Limits
from tridentify.fleet.workers.keeper import Keeper
from tridentify.record.formats.assemble import Wanted


class Scripted(Executor):
    """Does what it is told with the first of the batches that wait, when one more cannot wait."""

    def __init__(self, ends: list[str], room: int) -> None:
        self.ends, self.room = ends, room
        self.waiting: list[tuple[Future[Any], Any]] = []
        self.most = 0

    def submit(self, function: Any, /, *args: Any, **_: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.waiting.append((future, lambda: function(*args)))
        self.most = max(self.most, len(self.waiting))
        if len(self.waiting) == self.room:
            while self.waiting:
                self._end(*self.waiting.pop(0))
        return future

    def _end(self, future: Future[Any], work: Any) -> None:
        how = self.ends.pop(0) if self.ends else "done"
        if how == "done":
            future.set_result(work())
        elif how == "cancelled":
            future.cancel()
            future.set_running_or_notify_cancel()
        else:
            future.set_exception(OSError("worker lost"))


def over(count: int, executor: Executor, width: int = 1) -> list[tuple[tuple[int, ...], Any]]:
    batches = Batches()
    found = dispatch(
        iter(range(count)), Engine(executor, width), sum, lambda _, items: items, batches
    )
    return list(found)


def test_a_batch_takes_about_a_second_whatever_its_kinds() -> None:
    batches = Batches(kind=lambda item: item[0])
    assert len(batches.take(iter([("a", 0)] * 50))) == FIRST
    batches.measured(5, 0.5, "quick")
    batches.measured(1, 0.6 * LEAST_SECONDS, "slow")
    assert len(batches.take(iter([("quick", 0)] * 50))) == 10
    assert len(batches.take(iter([("slow", 0)] * 50))) == 2
    assert len(batches.take(iter([("slow", 0), *[("quick", 0)] * 50]))) == 5
    batches.measured(1, 30.0, "slower")
    assert len(batches.take(iter([("slower", 0)] * 50))) == 1
    assert batches.take(iter(())) == ()


def test_nothing_is_lost_nor_repeated_and_few_are_in_flight() -> None:
    executor = Scripted([], IN_FLIGHT * 2)
    found = over(2 * IN_FLIGHT * FIRST, executor, 2)
    assert sorted(k for items, _ in found for k in items) == list(range(2 * IN_FLIGHT * FIRST))
    assert all(result == sum(items) for items, result in found)
    assert executor.most == 2 * IN_FLIGHT


def test_a_batch_that_is_lost_again_and_again_is_taken_apart() -> None:
    # three times the pair, then one item of it goes well and the other never
    executor = Scripted(["lost"] * 3 + ["done"] + ["lost"] * 3, 1)
    found = dict(over(2, executor))
    assert found[(0,)] == 0
    assert found[(1,)] == Lost(1, "worker lost")


def test_a_scheduler_that_is_gone_is_told_after_what_is_done() -> None:
    executor = Scripted(["cancelled", *["done"] * 2, "cancelled"], IN_FLIGHT)
    items = iter(range(IN_FLIGHT * FIRST))
    found = dispatch(items, Engine(executor, 1), sum, lambda _, i: i, Batches())
    next(found)
    next(found)
    with pytest.raises(TridentifyError, match="found the scheduler gone"):
        next(found)


def starting(monkeypatch: pytest.MonkeyPatch, before: str) -> Keeper:
    """A keeper whose children do something before they serve; it waits for nobody."""
    monkeypatch.setattr(keeper, "BOOT", before + keeper.BOOT)
    monkeypatch.setattr(keeper, "PAUSE", 0.0)
    return Keeper(Limits(10.0, 0))


def counted(place: Path, then: str) -> str:
    return f"import os; open({str(place)!r}, 'a').write('.'); {then}; "


@pytest.mark.parametrize(
    ("then", "starts", "said"),
    [
        ("os._exit(3)", keeper.STARTS, "ended with code 3 before"),
        pytest.param(
            "os.kill(os.getpid(), 9)",
            keeper.KILLS,
            f"was killed {keeper.KILLS} times before",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_child_that_cannot_start_ends_the_run(
    then: str, starts: int, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with (
        starting(monkeypatch, counted(tmp_path / "starts", then)) as one,
        pytest.raises(TridentifyError, match=said),
    ):
        list(one.outcomes(None, [Item("u", Given(()))]))
    assert (tmp_path / "starts").read_text() == "." * starts


@pytest.mark.slow
def test_kills_before_the_first_record_are_waited_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "starts"
    kill = f"os.path.getsize({str(place)!r}) > {keeper.STARTS + 1} or os.kill(os.getpid(), 9)"
    ((key, record),) = fleets.units(1).items()
    with starting(monkeypatch, counted(place, kill)) as one:
        job = Fit(Structure(2, 0), None, False, Wanted("u", "y"))
        (outcome,) = one.outcomes(job, [Item(key, Given((record,)))])
    assert outcome.value["status"] == "converged"
    assert place.read_text() == "." * (keeper.STARTS + 2)
