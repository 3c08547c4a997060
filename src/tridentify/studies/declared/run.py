"""All draws of a declared study, on any workers, from wherever it was ended."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from tridentify.errors import OptionError
from tridentify.studies.base import Count
from tridentify.studies.declared.draw import Row
from tridentify.studies.declared.nouns import DeclaredStudy, draws_of, meetings
from tridentify.studies.declared.reading import read_study
from tridentify.studies.declared.result import DeclaredResult
from tridentify.studies.declared.results import DrawStore, Key, key_of
from tridentify.studies.declared.working import Draw, rows_of
from tridentify.writing.lock import alone_in

TURN = 5
"""Draws of a cell by one method before the others have their turn: what all draws of a cell share
is worked out once for these, and what is there early is of all cells."""


def run_study(
    study: DeclaredStudy | str | os.PathLike[str],
    *,
    out: str | os.PathLike[str] | None = None,
    workers: Any = None,
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
    workers : int, str or distributed.Client, optional
        Processes of this machine, by default as many as there are processors; or the address of a
        Dask scheduler, ``"tcp://host:8786"``. Only the times depend on it.
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
    MissingDependencyError
        ``workers`` is an address and Dask is not installed.
    TridentifyError
        No scheduler answers, or its workers are lost again and again. What was done stays; the
        next call goes on there.

    Notes
    -----
    A draw runs in a process beside its worker. One whose process ends is tried again; one that
    takes an hour, or ends its process every time, counts as a draw without an answer.

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
    if workers is None:
        workers = os.cpu_count() or 1
    elif isinstance(workers, int):
        workers = _at_least("workers", workers, 1)
    with ExitStack() as stack:
        rows: list[Row] = []
        keep: Callable[[Sequence[Row]], None] = rows.extend
        if out is not None:
            store = DrawStore(Path(out))
            stack.enter_context(alone_in(store.folder))
            rows = store.begin(chosen.settings())

            def keep(new: Sequence[Row]) -> None:
                store.append(new)
                rows.extend(new)

        _fill(chosen, rows, keep, workers, progress)
    return DeclaredResult.of(chosen, rows)


def _fill(
    study: DeclaredStudy,
    rows: Sequence[Row],
    keep: Callable[[Sequence[Row]], None],
    workers: Any,
    progress: Count | None,
) -> None:
    """Do what is not done yet, and hand it on as it comes."""
    done = {key_of(row) for row in rows}
    left = _left(study, done)
    total = sum(draws_of(study, cell) for cell, _ in meetings(study))
    finished = total - len(left)
    if progress is not None:
        progress(finished, total)
    if not left:
        return
    for new in rows_of(iter(left), study.seed, workers):
        keep(new)
        finished += len(new)
        if progress is not None:
            progress(finished, total)


def _left(study: DeclaredStudy, done: set[Key]) -> list[Draw]:
    """What is left, the first draws of all cells before the next: cells cost unequal times.

    So the remaining time can be told early, and what is there early is of all cells.
    """
    return [
        Draw(cell, method, k)
        for first in range(0, study.draws, TURN)
        for cell, method in meetings(study)
        for k in range(first, min(first + TURN, draws_of(study, cell)))
        if (cell.name, method.name, k) not in done
    ]


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
