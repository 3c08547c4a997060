"""The same work as a pure function of frames, for engines that bring their own distribution.

Spark, Ray and others hand a function one frame after the other and want frames of one schema back.
`fit_frame` takes a frame with the rows of one unit or of several and gives one row a unit; what it
gives depends on nothing else, and it leaves nothing behind.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tridentify.errors import SampleTypeError
from tridentify.estimation.methods.base import Method
from tridentify.fleet.rows import COLUMNS, Fit, fit_row, to_frame
from tridentify.fleet.sources import items_of
from tridentify.fleet.workers.children import WORKERS
from tridentify.fleet.workers.job import Outcome
from tridentify.fleet.working import MEMORY, checked_limits
from tridentify.identify import checked_structure
from tridentify.judgement.choice import checked_method
from tridentify.record.checks.samples import Intersample
from tridentify.record.formats.assemble import Wanted
from tridentify.record.formats.requirements import require
from tridentify.structure import AutoStructure, Structure
from tridentify.writing.views import pandas_frame

WHOLE = "__unit__"
"""Column that marks a frame as one unit, for as long as it is worked on."""


def fit_frame(
    frame: Any,
    structure: Structure | AutoStructure | Sequence[int] | None = None,
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
    judge: bool = True,
    time_limit: float | None = None,
    memory_limit: int = MEMORY,
) -> Any:
    """Identify the units in a frame: rows of samples in, one row a unit out.

    Parameters
    ----------
    frame : pandas.DataFrame, pyarrow.Table, pyarrow.RecordBatch or polars.DataFrame
        All samples of each of its units, in the order of time.
    structure, method
        As `fleet.fit`; None for orders that each unit chooses.
    key : str, optional
        Column that tells the units apart; without one the frame is one unit, and its key is empty.
    inputs, outputs, time, dt, references, intersample, reference_intersample, units
        As `tridentify.record_from_frame` takes them.
    judge : bool
        Whether findings are looked for.
    time_limit : float, optional
        Of one unit [s]. With a limit, units are identified in a process beside this one, which may
        crash, hang or grow; without, in this one.
    memory_limit : int
        Of that process [bytes].

    Returns
    -------
    frame of the same kind
        The columns `fleet.COLUMNS`, of `arrow_schema`; units in the order in which they appear.

    Raises
    ------
    OptionError, SampleTypeError
        The options, the key or the frame cannot be used; a unit that cannot is a row.

    Examples
    --------
    With Spark ``frame.groupBy("unit").applyInPandas(partial(fit_frame, structure=(2, 1),
    key="unit"), ddl())``, with Ray ``data.groupby("unit").map_groups(...)`` of the same partial.

    >>> import numpy as np
    >>> import polars as pl
    >>> from tridentify import Record, TransferFunction, simulate
    >>> from tridentify.fleet import fit_frame
    >>> u = np.sign(np.sin(np.arange(200) ** 1.5))
    >>> y = simulate(TransferFunction([2.0], [1.0, 4.0]), Record(u, u, dt=0.02))[:, 0]
    >>> frame = pl.DataFrame({"unit": ["left"] * 200, "u": u, "y": y})
    >>> row = fit_frame(frame, (1, 0), key="unit", dt=0.02)
    >>> row["key"].to_list(), row["coefficients"].to_list()
    (['left'], [[4.0, 2.0]])
    """
    wanted = Wanted(
        inputs, outputs, time, dt, intersample, units,
        references=references, reference_intersample=reference_intersample,
    )  # fmt: skip
    job = Fit(checked_structure(structure), checked_method(method), judge, wanted)
    table = _polars(frame)
    if key is None:
        import polars as pl

        table, key = table.with_columns(pl.lit("").alias(WHOLE)), WHOLE
    items = list(items_of(table, key)[0])
    if time_limit is None:
        outcomes = [Outcome(item, **job.attempt(item)) for item in items]
    else:
        limits = checked_limits(time_limit, memory_limit)
        with WORKERS.keeper(limits) as keeper:
            outcomes = list(keeper.outcomes(job, items))
    return _like(frame, [fit_row(one) for one in outcomes])


def _polars(frame: Any) -> Any:
    """Any of the frames as one of polars."""
    import narwhals as nw
    import polars as pl

    if type(frame).__name__ == "RecordBatch":
        return pl.from_arrow(frame)
    try:
        return nw.from_native(frame, eager_only=True).to_polars()
    except TypeError as error:
        raise SampleTypeError(
            f"found {type(frame).__name__}; expected a frame of pandas, pyarrow or polars in "
            "memory; collect a lazy one"
        ) from error


def _like(frame: Any, rows: Sequence[Mapping[str, Any]]) -> Any:
    """Rows as a frame of the same kind as another."""
    kind = type(frame).__module__.partition(".")[0]
    if kind == "pyarrow":
        import pyarrow

        if type(frame).__name__ == "RecordBatch":
            return pyarrow.RecordBatch.from_pylist(list(rows), schema=arrow_schema())
        return pyarrow.Table.from_pylist(list(rows), schema=arrow_schema())
    if kind == "pandas":
        made = pandas_frame({name: [row[name] for row in rows] for name in COLUMNS})
        kinds = {"number": "float64", "count": "int64", "flag": "bool"}
        return made.astype({n: kinds[k] for n, k in COLUMNS.items() if k in kinds})
    return to_frame(rows)


def arrow_schema() -> Any:
    """The columns of `fit_frame`, the same for every structure.

    Returns
    -------
    pyarrow.Schema

    Raises
    ------
    MissingDependencyError
        pyarrow is not installed.
    """
    require("pyarrow", "pyarrow", "an Arrow schema")
    import pyarrow

    kinds = {
        "text": pyarrow.string(),
        "texts": pyarrow.list_(pyarrow.string()),
        "number": pyarrow.float64(),
        "numbers": pyarrow.list_(pyarrow.float64()),
        "count": pyarrow.int64(),
        "flag": pyarrow.bool_(),
    }
    return pyarrow.schema([(name, kinds[kind]) for name, kind in COLUMNS.items()])


def ddl() -> str:
    """The same in words, as Spark takes it.

    Examples
    --------
    >>> ddl()[:46]
    'key string, status string, ok boolean, message'
    """
    kinds = {
        "text": "string",
        "texts": "array<string>",
        "number": "double",
        "numbers": "array<double>",
        "count": "bigint",
        "flag": "boolean",
    }
    return ", ".join(f"{name} {kinds[kind]}" for name, kind in COLUMNS.items())
