"""What a worker does: the records of one task through its child, and what comes of them.

A worker is a thread with a child process of its own (`workers.keeper`): of this program, or of a
Dask worker anywhere. It writes the rows of a batch itself and gives back counts; where the results
of a batch can be added up, it gives back their sum.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import median

from tridentify.fleet.attempt import RecordJob
from tridentify.fleet.job import Item
from tridentify.fleet.rows import fit_row
from tridentify.fleet.store import write_part
from tridentify.fleet.workers.children import WORKERS
from tridentify.fleet.workers.job import Limits


@dataclass(frozen=True)
class Task:
    """A batch for one worker.

    Attributes
    ----------
    name : str
        Of its part: the same if it is handed out again.
    job : RecordJob
    items : tuple of Item
    limits : Limits
    target : str
        The part to write; empty where results are given back.
    """

    name: str
    job: RecordJob
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
