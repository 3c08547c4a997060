"""Draws at work: a process beside each worker makes them, and what comes back are their rows."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from tridentify.errors import TridentifyError, shown
from tridentify.fleet.workers.children import WORKERS
from tridentify.fleet.workers.dispatch import Batches, Lost, dispatch
from tridentify.fleet.workers.engines import engine
from tridentify.fleet.workers.job import CRASHED, OVER_TIME, Limits, Outcome
from tridentify.studies.declared.draw import Row, draw_row, no_answer
from tridentify.studies.declared.nouns import DeclaredMethod, StudyCell

LONGEST = 3600.0
"""What one draw may take [s]: what takes an hour where milliseconds are usual will not end."""

ROUNDS = 4
"""How often a draw is tried whose process ends: whoever ends processes, people or a machine that is
out of memory, would otherwise be a failure of the method."""

FAULT = "fault"
"""Status of a draw that could not even be simulated."""


@dataclass(frozen=True)
class Draw:
    """One noise draw of a cell, for one method.

    Attributes
    ----------
    cell : StudyCell
    method : DeclaredMethod
    number : int
        Of the draw, from 0.
    """

    cell: StudyCell
    method: DeclaredMethod
    number: int

    @property
    def kind(self) -> tuple[str, str]:
        """What its time depends on."""
        return self.cell.name, self.method.name

    def trace(self) -> str:
        """Nothing: it is made of its number."""
        return ""


@dataclass(frozen=True)
class Drawing:
    """The job of a study: make a draw, and identify it.

    Attributes
    ----------
    seed : int
        Of the study.
    """

    seed: int

    def begin(self) -> None:
        """Load the compiled functions; the first time on a machine they are compiled."""
        from tridentify.estimation.machine_code import load_kernels

        load_kernels()

    def attempt(self, item: Draw, read: Callable[[str], None]) -> dict[str, Any]:
        """The row of a draw; a method that fails is a row, too."""
        begin = time.perf_counter()
        try:
            told: dict[str, Any] = {
                "value": dict(draw_row(item.cell, item.method, self.seed, item.number))
            }
        except Exception as error:
            told = {"status": FAULT, "message": f"{type(error).__name__}: {error}"}
        return told | {"seconds": time.perf_counter() - begin}


@dataclass(frozen=True)
class Task:
    """A batch for one worker.

    Attributes
    ----------
    job : Drawing
    draws : tuple of Draw
    """

    job: Drawing
    draws: tuple[Draw, ...]


def work(task: Task) -> list[tuple[Row, float]]:
    """Row and time [s] of each draw of a batch, in their order; what a worker does.

    Raises
    ------
    TridentifyError
        A draw cannot be made, or no child process can be started.
    """
    found: dict[Draw, Outcome] = {}
    left = task.draws
    with WORKERS.keeper(Limits(LONGEST)) as keeper:
        for _ in range(ROUNDS):
            found |= {one.item: one for one in keeper.outcomes(task.job, left)}
            left = tuple(draw for draw in left if found[draw].status == CRASHED)
            if not left:
                break
    return [(_row(found[draw]), found[draw].seconds) for draw in task.draws]


def rows_of(draws: Iterator[Draw], seed: int, workers: Any) -> Iterator[list[Row]]:
    """Rows of all draws in batches of about a second, in whatever order they come.

    Parameters
    ----------
    draws : iterator of Draw
    seed : int
        Of the study.
    workers : int, str or distributed.Client
        As `workers.engines.engine` takes it.

    Yields
    ------
    list of mapping

    Raises
    ------
    OptionError
        The workers are no number and no address.
    MissingDependencyError
        They are an address, and Dask is not installed.
    TridentifyError
        No scheduler answers, it has no workers, or they are lost again and again.
    """
    job = Drawing(seed)
    batches = Batches(kind=lambda draw: draw.kind)
    with engine(workers) as found:
        for draws_done, result in dispatch(
            draws, found, work, lambda _, batch: Task(job, batch), batches
        ):
            if isinstance(result, Lost):
                raise TridentifyError(_loss(result))
            for draw, (_, seconds) in zip(draws_done, result, strict=True):
                batches.measured(1, seconds, draw.kind)
            yield [row for row, _ in result]


def _loss(lost: Lost) -> str:
    draw: Draw = lost.item
    return (
        f"found workers that were lost again and again, the last with draw {draw.number} of "
        f"{shown(draw.cell.name)} by {shown(draw.method.name)} ({shown(lost.reason, 80)}); "
        "expected them to stay; look after the workers and run it again: draws that are done "
        "are kept"
    )


def _row(outcome: Outcome) -> Row:
    """The row of a draw, also if its process ended: whatever a method does, the study goes on."""
    draw: Draw = outcome.item
    if outcome.status == FAULT:
        raise TridentifyError(" ".join(outcome.message.split()))
    if outcome.status == OVER_TIME:
        told = f"no answer within {LONGEST:g} s"
    elif outcome.status == CRASHED:
        told = "its process ended, again and again"
    else:
        return outcome.value
    return no_answer(draw.cell, draw.method, draw.number, told, outcome.seconds)
