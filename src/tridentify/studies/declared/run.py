"""All draws of a declared study, on one process or several, from wherever it was ended."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import ExitStack
from dataclasses import replace
from itertools import islice
from pathlib import Path

from tridentify.errors import OptionError
from tridentify.numerics.threads import one_blas_thread
from tridentify.studies.base import Count
from tridentify.studies.declared.cells import Meeting, draws_of, meetings
from tridentify.studies.declared.draw import Row, draw_row
from tridentify.studies.declared.nouns import DeclaredStudy
from tridentify.studies.declared.reading import read_study
from tridentify.studies.declared.result import DeclaredResult
from tridentify.studies.declared.results import DrawStore, key_of
from tridentify.studies.processes import process_pool

BATCH = 5
"""Draws that a process takes at a time: a tenth of a second to a second, so that handing out costs
little, and a kill loses little."""
WAITING = 3
"""Batches a process that are handed out at a time: enough that none waits for its next."""

Batch = tuple[Meeting, int, tuple[int, ...]]
"""Who meets whom, the seed, and the numbers of the draws."""


def run_study(
    study: DeclaredStudy | str | os.PathLike[str],
    *,
    out: str | os.PathLike[str] | None = None,
    workers: int | None = None,
    draws: int | None = None,
    seed: int | None = None,
    progress: Count | None = None,
) -> DeclaredResult:
    """Run a study that a file declares.

    Parameters
    ----------
    study : DeclaredStudy or path-like
        A study, or its file in TOML.
    out : path-like, optional
        Folder to which draws are appended as they are done. A run that was ended, however it was,
        goes on from what is there. Without it nothing is written.
    workers : int, optional
        Processes; by default as many as there are processors. Only the times depend on it.
    draws, seed : int, optional
        In place of those of the study. With more draws a folder is gone on with; with fewer, its
        first ones count.
    progress : callable, optional
        Called with the number of draws that are done and the number of all draws.

    Returns
    -------
    DeclaredResult
        Its `table` is text, its `to_frame` a data frame with a row for each cell, method and
        coefficient.

    Raises
    ------
    UnreadableFileError
        The file is missing or no TOML, or the folder holds something else.
    OptionError
        The file declares no study, or the folder holds draws of another one.
    OutputPathError
        The folder cannot be written, or another run is at work in it.
    TridentifyError
        A process died.

    Notes
    -----
    Several processes are spawned: a script calls this below ``if __name__ == "__main__":``.

    Examples
    --------
    >>> from tridentify.studies import run_study, study_from
    >>> study = study_from(
    ...     {
    ...         "draws": 4,
    ...         "systems": {"aircraft": {"num": [0.5], "den": [1, 1, 3]}},
    ...         "inputs": {"step": {"kind": "step", "dt": 0.05, "samples": 100}},
    ...         "noises": {"white": {"ratio": [0, 0.1]}},
    ...         "methods": {"ours": {"kind": "three-model"}},
    ...     }
    ... )
    >>> result = run_study(study, workers=1)
    >>> [(row.cell, row.draws, row.failed) for row in result.statistics][::3]
    [('aircraft / step / white ratio 0', 1, 0), ('aircraft / step / white ratio 0.1', 4, 0)]
    """
    chosen = study if isinstance(study, DeclaredStudy) else read_study(study)
    chosen = _with(chosen, draws, seed)
    processes = (os.cpu_count() or 1) if workers is None else _at_least("workers", workers, 1)
    with ExitStack() as stack:
        rows: list[Row] = []
        keep: Callable[[Sequence[Row]], None] = rows.extend
        if out is not None:
            store = DrawStore(Path(out))
            stack.enter_context(store.alone())
            rows = store.begin(chosen.settings())

            def keep(new: Sequence[Row]) -> None:
                store.append(new)
                rows.extend(new)

        _fill(chosen, rows, keep, processes, progress)
    return DeclaredResult.of(chosen, rows)


def _fill(
    study: DeclaredStudy,
    rows: Sequence[Row],
    keep: Callable[[Sequence[Row]], None],
    processes: int,
    progress: Count | None,
) -> None:
    """Do what is not done yet, and hand it on as it comes."""
    done = {key_of(row) for row in rows}
    batches = _batches(study, done)
    total = sum(draws_of(study, cell) for cell, _ in meetings(study))
    finished = total - sum(len(numbers) for _, _, numbers in batches)
    if progress is not None:
        progress(finished, total)
    for new in _answers(batches, processes):
        keep(new)
        finished += len(new)
        if progress is not None:
            progress(finished, total)


def _batches(study: DeclaredStudy, done: set[tuple[str, str, int]]) -> list[Batch]:
    """What is left, the first draws of all cells before the next: cells cost unequal times.

    So the remaining time can be told early, and what is there early is of all cells.
    """
    found = []
    for first in range(0, study.draws, BATCH):
        for cell, method in meetings(study):
            numbers = range(first, min(first + BATCH, draws_of(study, cell)))
            left = tuple(k for k in numbers if (cell.name, method.name, k) not in done)
            if left:
                found.append(((cell, method), study.seed, left))
    return found


def _answers(batches: Sequence[Batch], processes: int) -> Iterator[list[Row]]:
    """Rows of every batch, in whatever order they come."""
    if not batches:
        return
    if processes == 1:
        for batch in batches:
            yield _worked(batch)
        return
    left = iter(batches)
    with process_pool(min(processes, len(batches))) as pool:
        waiting: set[Future[list[Row]]] = set()
        while True:
            room = WAITING * processes - len(waiting)
            waiting |= {pool.submit(_worked, batch) for batch in islice(left, room)}
            if not waiting:
                return
            ready, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            for future in ready:
                yield future.result()


def _worked(batch: Batch) -> list[Row]:
    """All draws of a batch; on one thread, as sums over several round differently."""
    (cell, method), seed, numbers = batch
    with one_blas_thread():
        return [draw_row(cell, method, seed, k) for k in numbers]


def _with(study: DeclaredStudy, draws: int | None, seed: int | None) -> DeclaredStudy:
    if draws is not None:
        study = replace(study, draws=_at_least("draws", draws, 1))
    if seed is not None:
        study = replace(study, seed=_at_least("seed", seed, 0))
    return study


def _at_least(what: str, value: int, lowest: int) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < lowest:
        raise OptionError(
            f"found {what}={value!r}; expected a whole number, at least {lowest}; correct it"
        )
    return value
