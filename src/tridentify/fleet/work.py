"""What a worker does: the records of one task through its child, and what comes of them.

A worker is a thread with a child process of its own (`keeper`): of this program, or of a Dask
worker anywhere. It writes the rows of a batch itself and gives back counts; where the results of a
batch can be added up, it gives back their sum.
"""

from __future__ import annotations

import atexit
import contextlib
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from statistics import median

from tridentify.fleet.job import Item, Job, Limits
from tridentify.fleet.keeper import Keeper
from tridentify.fleet.rows import fit_row
from tridentify.fleet.store import write_part

__all__ = ["Counts", "Task", "Workers", "fit_batch"]


@dataclass(frozen=True)
class Task:
    """A batch for one worker.

    Attributes
    ----------
    name : str
        Of its part: the same if it is handed out again.
    job : Job
    items : tuple of Item
    limits : Limits
    target : str
        The part to write; empty where results are given back.
    """

    name: str
    job: Job
    items: tuple[Item, ...]
    limits: Limits
    target: str = ""


@dataclass(frozen=True)
class Counts:
    """What a worker says of a batch that it wrote.

    Attributes
    ----------
    records, failed : int
    typical : float
        Of what the records took, the median [s]: one that hangs says nothing of the others.
    """

    records: int
    failed: int
    typical: float


class Workers:
    """The children of this process: one for each thread that has work, others at rest."""

    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._busy: list[Keeper] = []
        self._resting: list[Keeper] = []

    @contextlib.contextmanager
    def keeper(self, limits: Limits) -> Iterator[Keeper]:
        """A child for the calling thread; one that rests, if it has the same memory."""
        with self._guard:
            fits = [one for one in self._resting if one.limits.memory == limits.memory]
            found = fits[0] if fits else Keeper(limits)
            self._resting = [one for one in self._resting if one is not found]
            self._busy.append(found)
        found.limits = limits
        try:
            yield found
        finally:
            with self._guard:
                self._busy.remove(found)
                if not found.closed:
                    found.rest()
                    self._resting.append(found)

    def interrupt(self) -> None:
        """End the children at work; the threads that wait for them are told."""
        with self._guard:
            for keeper in self._busy:
                keeper.close()

    def close(self) -> None:
        """End all children."""
        self.interrupt()
        with self._guard:
            for keeper in self._resting:
                keeper.close()
            self._resting = []


WORKERS = Workers()
"""Of this process; a Dask worker has no other place to keep them between two tasks."""
atexit.register(WORKERS.close)


def fit_batch(task: Task) -> Counts:
    """Identify a batch and write its part.

    Raises
    ------
    OutputPathError
        The part cannot be written.
    TridentifyError
        No child process can be started.
    """
    with WORKERS.keeper(task.limits) as keeper:
        rows = [fit_row(one) for one in keeper.outcomes(task.job, task.items)]
    write_part(task.target, rows)
    failed = sum(not row["ok"] for row in rows)
    return Counts(len(rows), failed, median(row["seconds"] for row in rows))
