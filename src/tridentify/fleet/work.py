"""What a worker does: the records of one task through its child, and what comes of them.

A worker is a thread with a child process of its own (`keeper`): of this program, or of a Dask
worker anywhere. It writes the rows of a batch itself and gives back counts; where the results of a
batch can be added up, it gives back their sum.
"""

from __future__ import annotations

import threading
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
    """The children of this process, one for each thread that asks."""

    def __init__(self) -> None:
        self._own = threading.local()
        self._all: list[Keeper] = []
        self._guard = threading.Lock()

    def keeper(self, limits: Limits) -> Keeper:
        """The child of the calling thread."""
        found: Keeper | None = getattr(self._own, "keeper", None)
        if found is None or found.limits != limits or found.closed:
            if found is not None:
                found.close()
            found = self._own.keeper = Keeper(limits)
            with self._guard:
                self._all = [one for one in self._all if not one.closed] + [found]
        return found

    def close(self) -> None:
        """End all of them."""
        with self._guard:
            for keeper in self._all:
                keeper.close()
            self._all = []


WORKERS = Workers()
"""Of this process; a Dask worker has no other place to keep them between two tasks."""


def fit_batch(task: Task) -> Counts:
    """Identify a batch and write its part.

    Raises
    ------
    OutputPathError
        The part cannot be written.
    TridentifyError
        No child process can be started.
    """
    rows = [fit_row(one) for one in WORKERS.keeper(task.limits).outcomes(task.job, task.items)]
    write_part(task.target, rows)
    failed = sum(not row["ok"] for row in rows)
    return Counts(len(rows), failed, median(row["seconds"] for row in rows))
