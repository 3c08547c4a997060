"""Records from data frames of pandas, polars, pyarrow and whatever else narwhals takes, and back.

Times of a frame become seconds: a duration as it is, a date and time counted from its first value,
so that no digit is lost to the decades since 1970.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from tridentify.errors import (
    DataWarning,
    DuplicateColumnError,
    EmptyFileError,
    OptionError,
    SampleTypeError,
    SamplingError,
    TextInColumnError,
    shown,
)
from tridentify.numerics.arrays import Array, Flags
from tridentify.record.checks.samples import Intersample
from tridentify.record.checks.times import uniform_step
from tridentify.record.formats.assemble import Wanted, record_from
from tridentify.record.formats.channels import CALLER, Channel, SampledFile, header_channel
from tridentify.record.formats.requirements import require
from tridentify.record.formats.time.clock import time_channels
from tridentify.record.formats.time.dates import Instants, read_moment, without_clock_change
from tridentify.record.formats.time_names import is_called_time
from tridentify.record.record import Record, in_memory

if TYPE_CHECKING:
    import narwhals as nw


class FrameTable(SampledFile):
    """A data frame as an `OpenFile`.

    Parameters
    ----------
    frame : narwhals.DataFrame
    path : Path
        What messages call it.
    """

    def __init__(self, frame: nw.DataFrame[Any], path: Path = Path("the frame")) -> None:
        self.path = path
        self.frame = frame
        self._names = [name for name in frame.columns if isinstance(name, str)]
        self._kinds = kinds = frame.schema
        self.channels = tuple(
            frame_channel(name, kinds[name].is_temporal() or self._is_dated(name), len(frame))
            for name in self._names
        )
        if not len(frame):
            raise EmptyFileError.found(
                "no row in ", path.name, "rows of numbers", "check that it was saved completely"
            )

    def read(self, indices: Sequence[int]) -> list[Array]:
        """Give columns as numbers, nan where nothing stands."""
        return [self._floats(self._names[index]) for index in indices]

    def place(self, row: int) -> str:
        """Name a row by its number, from 0 as in the frame."""
        return f"row {row}"

    def _is_dated(self, name: str) -> bool:
        """Whether a column of text begins with a date or a time of day."""
        import narwhals as nw

        if self._kinds[name] != nw.String:
            return False
        first = self.frame.get_column(name).drop_nulls().head(1).to_list()
        return bool(first) and read_moment(first[0]) is not None

    def _dates(self, name: str) -> Array:
        """A column of dates or times of day as text, in seconds from the first."""
        instants = Instants()
        for row, cell in enumerate(self.frame.get_column(name).to_list()):
            if not instants.take(cell or "", row):
                raise TextInColumnError(
                    f"found {shown(cell)} in column {shown(name)}, {self.place(row)} of "
                    f"{shown(self.path.name)}; expected a date or time as above it; correct it, or "
                    "convert the column to datetime"
                )
        values = instants.values()
        _say(instants.choice, name)
        return values

    def _dated(self, name: str, column: nw.Series[Any]) -> Array:
        """A column of instants, in seconds from the first."""
        import narwhals as nw

        counts, missing = _nanoseconds(column.dt.timestamp("ns"))
        if isinstance(column.dtype, nw.Datetime) and column.dtype.time_zone is None:
            counts, told = without_clock_change(counts, ~missing)
            _say(told, name)
        if not missing.all():
            counts = counts - counts[int(np.argmin(missing))]
        return np.where(missing, np.nan, counts * 1e-9)

    def _floats(self, name: str) -> Array:
        import narwhals as nw

        column, kind = self.frame.get_column(name), self._kinds[name]
        if isinstance(kind, nw.Duration):
            counts, missing = _nanoseconds(column.dt.total_nanoseconds())
            return np.where(missing, np.nan, counts * 1e-9)
        if isinstance(kind, nw.Datetime | nw.Date):
            exact = column.cast(nw.Datetime("ns")) if isinstance(kind, nw.Date) else column
            return self._dated(name, exact)
        if isinstance(kind, nw.Boolean) or kind.is_numeric():
            return _float_array(column)
        if self._is_dated(name):
            return self._dates(name)
        raise not_numbers(kind, name, self.path)


def not_numbers(kind: object, name: str, path: Path) -> TextInColumnError:
    """Make the error about a column that holds something else."""
    return TextInColumnError(
        f"found {shown(str(kind))[1:-1]} in column {shown(name)} of {shown(path.name)}; expected "
        "numbers; convert the column to float"
    )


def frame_channel(name: str, temporal: bool, samples: int) -> Channel:
    """Describe a column; dates and durations are read as seconds.

    Examples
    --------
    >>> frame_channel("when", True, 3).unit, frame_channel("q [deg/s]", False, 3).unit
    ('s', 'deg/s')
    """
    channel = header_channel(name, samples)
    return replace(channel, header=name, unit="s", dated=True) if temporal else channel


def _float_array(column: nw.Series[Any]) -> Array:
    import narwhals as nw

    floats = column if column.dtype == nw.Float64 else column.cast(nw.Float64)
    values = floats.fill_null(float("nan")) if floats.null_count() else floats
    return np.asarray(values.to_numpy(), dtype=np.float64)


def _nanoseconds(series: nw.Series[Any]) -> tuple[NDArray[np.int64], Flags]:
    """Whole numbers, and where there is none."""
    missing = np.asarray(series.is_null().to_numpy(), dtype=bool)
    whole = series.fill_null(0) if missing.any() else series
    return np.asarray(whole.to_numpy()).astype(np.int64), missing


def _say(found: str, name: str) -> None:
    if found:
        warnings.warn(f"found {found} in column {shown(name)}", DataWarning, stacklevel=CALLER + 1)


def record_from_frame(
    frame: Any,
    *,
    time: str | None = None,
    dt: float | None = None,
    inputs: Sequence[str],
    outputs: Sequence[str],
    references: Sequence[str] = (),
    intersample: Intersample = "auto",
    reference_intersample: Intersample | None = None,
    units: Mapping[str, str] | None = None,
    start: float | None = None,
    stop: float | None = None,
    name: str = "",
) -> Record:
    """Make a record of some columns of a data frame.

    Parameters
    ----------
    frame : pandas.DataFrame, polars.DataFrame, pyarrow.Table or another that narwhals takes
        Eager; a missing value of an output becomes nan, one of an input or reference is refused.
    time : str, optional
        Column of time: numbers [s], or in the unit of its name or of `units`; durations; or dates,
        also as text (ISO 8601), which count from the first. By default the index of a pandas frame,
        if that is one of dates or durations or is called ``t`` or ``time``, else the one column
        that is called so, in any case and with or without a unit in brackets, or ``timestamp``,
        ``datetime`` or ``date`` and holds dates. An index that has a
        name may also be named.
    dt, inputs, outputs, references, intersample, reference_intersample, units, start, stop
        As in `read_record`.
    name : str
        What to call the record.

    Returns
    -------
    Record

    Raises
    ------
    SampleTypeError
        `frame` is no eager data frame.
    MissingColumnError, DuplicateColumnError, TextInColumnError, EmptyFileError
        A column does not exist, occurs twice, or holds no numbers; there is no row.
    SamplingError
        Nothing is time by its name; an index of even steps without a name is not taken unasked.
    DataError
        As `read_record`.

    Examples
    --------
    >>> import polars as pl
    >>> frame = pl.DataFrame({"t [ms]": [0, 20, 40], "u": [0, 1, 1], "q [deg/s]": [0, None, 2]})
    >>> record = record_from_frame(frame, time="t", inputs=["u"], outputs=["q"])
    >>> record
    Record(3 samples, 0.04 s, dt=0.02 s, auto, inputs: u, outputs: q [deg/s])
    >>> record.y.ravel()
    array([ 0., nan,  2.])
    """
    table, time = _eager(frame, time, dt)
    source = FrameTable(table)
    if time is None and dt is None and not time_channels(source):
        _check_index(table)
    wanted = Wanted(
        inputs, outputs, time, dt, intersample, units, start, stop,
        references=references, reference_intersample=reference_intersample,
    )  # fmt: skip
    return record_from(source, wanted, name)


def _eager(frame: Any, time: str | None, dt: float | None) -> tuple[nw.DataFrame[Any], str | None]:
    """Give the frame, with its index as a column if that is its time, and the name of time."""
    import narwhals as nw

    try:
        table = nw.from_native(frame, eager_only=True)
    except TypeError as error:
        raise SampleTypeError(
            f"found {type(frame).__module__}.{type(frame).__name__}; expected an eager data frame "
            "of pandas, polars or pyarrow; collect a lazy one, and give arrays to Record"
        ) from error
    except nw.exceptions.NarwhalsError as error:
        raise _repeated(error) from error
    index: Any = nw.maybe_get_index(table)
    if index is None or getattr(index, "nlevels", 1) != 1:
        return table, time
    label = index.name if isinstance(index.name, str) else "index"
    timed = time is None and dt is None and _is_time(index, label)
    if not timed and (time != label or time in table.columns):
        return table, time
    native: Any = nw.to_native(table)
    try:
        return nw.from_native(native.reset_index(names=label), eager_only=True), label
    except (ValueError, nw.exceptions.NarwhalsError) as error:
        raise _repeated(error) from error


def _is_time(index: Any, label: str) -> bool:
    """Whether an index is one of dates or durations, or of numbers and called t or time."""
    kind = getattr(index.dtype, "kind", "")
    called = is_called_time(header_channel(label).name)
    return kind in "mM" or (kind in "fiu" and called)


def _check_index(table: nw.DataFrame[Any]) -> None:
    """Refuse to guess whether an index of numbers without a name is time.

    Raises
    ------
    SamplingError
        It rises evenly, as time does.
    """
    import narwhals as nw

    index: Any = nw.maybe_get_index(table)
    kind = getattr(getattr(index, "dtype", None), "kind", "")
    if kind != "f" or index.name is not None or len(index) < 2:
        return
    step = uniform_step(np.asarray(index, dtype=np.float64))
    if step is not None and step > 0.0:
        raise SamplingError(
            f"found no column of time, and an index without a name that rises by {step:.6g}; "
            'expected to know whether that is seconds; give time="index" (or reset_index() and '
            "name the column) if it is, else dt"
        )


def _repeated(error: Exception) -> DuplicateColumnError:
    return DuplicateColumnError(
        f"found column names that occur twice ({shown(str(error), 80)}); expected every name once; "
        "rename one"
    )


def frame_from_record(
    record: Record, backend: Literal["polars", "pandas", "pyarrow"] = "polars"
) -> Any:
    """Make a data frame of a record, one row for every sample.

    Parameters
    ----------
    record : Record
    backend : {"polars", "pandas", "pyarrow"}
        Which library's frame.

    Returns
    -------
    polars.DataFrame, pandas.DataFrame or pyarrow.Table
        Columns ``t [s]``, inputs, outputs and references, with their units in brackets, such that
        `record_from_frame` reads them back; a missing sample is nan.

    Raises
    ------
    OptionError
        No such backend.
    MissingDependencyError
        The library is not installed.

    Examples
    --------
    >>> from tridentify import Record
    >>> record = Record([0, 1], [0, 0.5], dt=0.1, units={"y": "deg"})
    >>> frame_from_record(record).columns
    ['t [s]', 'u', 'y [deg]']
    """
    if backend not in ("polars", "pandas", "pyarrow"):
        raise OptionError(
            f"found backend={shown(backend)}; expected 'polars', 'pandas' or 'pyarrow'; choose one"
        )
    require(backend, backend, f"a frame of {backend}")
    import narwhals as nw

    record = in_memory(record)
    columns = {"t [s]": record.t}
    sides = [(record.input_names, record.u), (record.output_names, record.y)]
    if record.reference is not None:
        sides.append((record.reference_names, record.reference))
    for names, samples in sides:
        for k, name in enumerate(names):
            unit = record.units.get(name, "")
            columns[f"{name} [{unit}]" if unit else name] = samples[:, k].copy()
    return nw.from_dict(columns, backend=backend).to_native()
