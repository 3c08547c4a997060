"""The front door of a fleet: many records and one structure in, a row for each of them out."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from tridentify.errors import TooFewSamplesError
from tridentify.estimation.methods.base import Method
from tridentify.fleet import working
from tridentify.fleet.local import refuse_references, summable
from tridentify.fleet.rows import Fit
from tridentify.fleet.run import Run
from tridentify.fleet.sources import items_of
from tridentify.fleet.store import Store
from tridentify.fleet.workers.engines import checked_workers
from tridentify.identify import checked_structure
from tridentify.judgement.choice import checked_method
from tridentify.record.checks.samples import Intersample
from tridentify.record.formats.assemble import Instants, Wanted
from tridentify.structure import AutoStructure, Structure
from tridentify.writing.lock import alone_in


def fit(
    source: Any,
    structure: Structure | AutoStructure | Sequence[int] | None,
    method: Method | None = None,
    *,
    key: str | None = None,
    inputs: Sequence[str] = ("u",),
    outputs: Sequence[str] = ("y",),
    time: str | None = None,
    dt: float | None = None,
    references: Sequence[str] = (),
    intersample: Intersample = "auto",
    reference_intersample: Intersample | None = None,
    units: Mapping[str, str] | None = None,
    start: float | None = None,
    stop: float | None = None,
    instants: Instants = "auto",
    out: str | os.PathLike[str] = "results/",
    workers: Any = None,
    resume: bool = True,
    judge: bool = True,
    together: bool = False,
    pool: bool = False,
    time_limit: float = 60.0,
    memory_limit: int = working.MEMORY,
    progress: bool | working.Progress = True,
) -> Run:
    """Identify every unit of a fleet, and leave a row for each, whatever comes of it.

    Parameters
    ----------
    source : str, path, data frame, mapping or iterable
        A pattern of files of any format that is read (``"logs/**/*.parquet"``); a Parquet file or
        folder, or a data frame of pandas, polars or pyarrow, with the column ``key``; records by
        key; or an iterable of records, of (key, record) or of files. A record may be a list of
        records: experiments on one unit.
    structure : Structure, AutoStructure or pair of int
        As `tridentify.identify` takes it; None for orders that each record chooses.
    method : Method, optional
        Likewise.
    key : str, optional
        Column that tells the units of a data set or frame apart; the rows of one stand together.
    inputs, outputs, time, dt, references, intersample, reference_intersample, units, start, stop
        How files and frames are read, as `tridentify.read_record` takes it; by default the
        columns ``u`` and ``y``.
    instants : {"auto", "outputs", "all"}
        Likewise.
    out : path-like
        Folder of the results.
    workers : int, str or distributed.Client, optional
        Processes of this machine, by default one; or the address of a Dask scheduler. Its workers
        must see the files and the folder under the same names.
    resume : bool
        Whether rows that are there, of the same settings, are kept and their units left alone;
        otherwise what is there is removed.
    judge : bool
        Whether findings are looked for. They take as long as the estimate, and without them a row
        has no cautions.
    together : bool
        Whether one model is fitted to all records as well (`Run.together`), ``run.common``.
    pool : bool
        Whether the units are taken as members of a population (`Run.pool`), ``run.population``;
        None, and a note that says why, where there are too few of them.
    time_limit : float
        Of one record, reading included [s].
    memory_limit : int
        Of the process that works on one record [bytes].
    progress : bool or callable
        True writes to the log ``tridentify.fleet``; a callable is told how many are done of how
        many, None where that is not known.

    Returns
    -------
    Run

    Raises
    ------
    OptionError
        An option is not one of those offered, or results of other settings are in the folder.
    OutputPathError
        The folder cannot be written, its disk is full, or another run is at work in it. What was
        done stays; the next call goes on there.
    DataError
        No file fits the pattern.
    MissingDependencyError
        ``workers`` is an address and Dask is not installed.

    Notes
    -----
    A unit that is refused, fails, crashes its process or exceeds a limit is a row with the reason
    (`Run.failed`), never an exception.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> from tridentify import Record, TransferFunction, fleet, simulate
    >>> u = np.sign(np.sin(np.arange(200) ** 1.5))
    >>> def record(a):
    ...     y = simulate(TransferFunction([2.0], [1.0, a]), Record(u, u, dt=0.02))
    ...     return Record(u, y, dt=0.02)
    >>> units = {"left": record(4.0), "right": record(5.0), "none": Record(u, 0 * u, dt=0.02)}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     run = fleet.fit(units, (1, 0), out=folder)
    ...     table = run.table()
    >>> table[["key", "status", "exception"]].values.tolist()
    [['left', 'converged', ''], ['none', 'bad input', 'ZeroOutputError'],
    ['right', 'converged', '']]
    >>> table["a0"].tolist()
    [4.0, nan, 5.0]
    """
    limits = working.checked_limits(time_limit, memory_limit)
    wanted = Wanted(
        inputs, outputs, time, dt, intersample, units, start, stop, instants, references,
        reference_intersample,
    )  # fmt: skip
    job = Fit(checked_structure(structure), checked_method(method), judge, wanted)
    checked_workers(workers)
    items, total = items_of(source, key)  # refused before a folder is made
    question = working.Question(source, key, job, workers, limits)
    store = Store(Path(out))
    if together or pool:
        summable(job.structure)
        refuse_references(references)
    say = working.telling(progress)
    with alone_in(store.folder):
        notes = store.begin(job.in_words(), resume=resume)
        for note in notes:
            working.LOG.warning(note)
        done = store.keys()
        waiting = (item for item in items if item.key not in done)
        working.work_off(waiting, question, store, say, total, len(done))
    run = Run(store, question, notes)
    if together:
        run = replace(run, common=run.together())
    if not pool:
        return run
    try:
        return replace(run, population=run.pool())
    except TooFewSamplesError as error:
        return replace(run, notes=(*run.notes, str(error)))
