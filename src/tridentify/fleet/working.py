"""A fleet at work: items to the workers, counts back, and the rows of what no worker survives."""

from __future__ import annotations

import hashlib
import logging
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain
from typing import Any

from tridentify.errors import OptionError, shown
from tridentify.fleet.job import Item
from tridentify.fleet.rows import Fit, fit_row
from tridentify.fleet.store import Store, write_part
from tridentify.fleet.work import Counts, Task, fit_batch
from tridentify.fleet.workers.dispatch import Batches, Lost, dispatch
from tridentify.fleet.workers.engines import engine
from tridentify.fleet.workers.job import CRASHED, Limits, Outcome

MEMORY = 1 << 32
"""Memory of the process that works on one record [bytes]: its libraries take half a gigabyte of
addresses, the rest is for a record of some ten million samples."""

Progress = Callable[[int, int | None], None]
"""Told how many records of how many are done."""

LOG = logging.getLogger("tridentify.fleet")


@dataclass(frozen=True, eq=False)
class Question:
    """What a fleet was asked.

    Attributes
    ----------
    source : object
        As it was given.
    key : str, optional
        Column of the key.
    job : Fit
    workers : object
    limits : Limits
    """

    source: Any
    key: str | None
    job: Fit
    workers: Any
    limits: Limits


def checked_limits(seconds: float, memory: int) -> Limits:
    """Limits that make sense.

    Raises
    ------
    OptionError
    """
    if not isinstance(seconds, int | float) or isinstance(seconds, bool) or not 0 < seconds < 1e7:
        raise OptionError.found("time_limit=", seconds, "seconds for each record")
    if not isinstance(memory, int) or isinstance(memory, bool) or memory < 1 << 28:
        raise OptionError.found("memory_limit=", memory, f"bytes, {1 << 28} at least")
    return Limits(float(seconds), memory)


def telling(progress: bool | Progress) -> Progress:
    """What to tell of the progress."""
    if callable(progress):
        return progress
    if not progress:
        return lambda done, total: None
    told = [0]

    def log(done: int, total: int | None) -> None:
        tenth = 10 * done // total if total else done // 1000
        if tenth > told[0] or done == total:
            told[0] = tenth
            LOG.info("%d of %s records done", done, "?" if total is None else total)

    return log


def work_off(
    items: Iterator[Item],
    question: Question,
    store: Store,
    say: Progress,
    total: int | None,
    done: int,
) -> None:
    """All items to the workers; what they cannot answer for gets its row here."""

    def task(name: str, batch: tuple[Item, ...]) -> Task:
        target = os.path.abspath(store.parts / f"part-{name}.parquet")
        return Task(name, question.job, batch, question.limits, target)

    first = next(items, None)
    if first is None:
        return
    batches = Batches()
    with engine(question.workers) as found:
        everything = chain([first], items)
        for batch, result in dispatch(everything, found, fit_batch, task, batches):
            if isinstance(result, Lost):
                _write_lost(result, store)
            elif isinstance(result, Counts):
                batches.measured(result.records, result.typical * result.records)
            done += len(batch)
            say(done, total)


def _write_lost(lost: Lost, store: Store) -> None:
    """The row of a unit with which every worker was lost."""
    text = (
        f"found workers that were lost with this record ({shown(lost.reason, 80)}); expected an "
        "answer; look at the record on its own"
    )
    row = fit_row(Outcome(lost.item, {}, CRASHED, text, "WorkerLostError"))
    mark = hashlib.sha256(lost.item.key.encode("utf-8", "surrogatepass")).hexdigest()[:16]
    name = f"part-lost-{mark}-{lost.item.attempt}.parquet"
    write_part(str(store.parts / name), [row])
