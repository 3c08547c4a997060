"""Records from CSV files.

The first line names the columns; a unit may follow in brackets, as in ``alpha [rad]``. Cells are
separated by commas, semicolons or tabs, and a blank cell or ``nan`` is a missing sample.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from tridentify.checks.samples import Intersample, sample_range, time_axis
from tridentify.errors import (
    ChannelNameError,
    DuplicateColumnError,
    MissingColumnError,
    NonUniformTimeError,
    NotFiniteError,
    SamplingError,
    TooFewSamplesError,
    UnitError,
    shown,
)
from tridentify.formats.text_table import TextTable, open_table, read_columns
from tridentify.record import Record

__all__ = ["read_record"]

FloatArray = NDArray[np.float64]

JITTER = 0.05
"""Largest departure of a step of recorded time from a stated `dt`, as a fraction of it."""

SECONDS = {
    "": 1.0,
    "s": 1.0,
    "sec": 1.0,
    "second": 1.0,
    "seconds": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "µs": 1e-6,
    "μs": 1e-6,
    "ns": 1e-9,
    "min": 60.0,
    "h": 3600.0,
}

_UNIT = re.compile(r"(?P<name>.*\S)\s*(\[(?P<square>[^][]*)\]|\((?P<round>[^()]*)\))")


@dataclass(frozen=True)
class Column:
    """A column of a file: where it is, what it is called without its unit, and the unit."""

    index: int
    header: str
    name: str
    unit: str


def read_record(
    path: str | os.PathLike[str],
    *,
    time: str | None = None,
    dt: float | None = None,
    inputs: Sequence[str],
    outputs: Sequence[str],
    intersample: Intersample = "zoh",
    units: Mapping[str, str] | None = None,
    start: float | None = None,
    stop: float | None = None,
) -> Record:
    r"""Read one experiment from a CSV file with a header.

    Parameters
    ----------
    path : path-like
        UTF-8 text; comma, semicolon or tab between cells.
    time : str, optional
        Name of the column of time. Its unit is seconds unless the header or `units` say otherwise.
    dt : float, optional
        Uniform sampling interval [s]. Together with `time` it replaces the recorded steps, which
        must then agree with it to 5 percent; without, time begins at zero. Give at least one.
    inputs, outputs : sequence of str
        Names of the columns, with or without the unit in brackets.
    intersample : {"zoh", "foh"}
        What the input does between samples.
    units : mapping of str to str, optional
        Units by column name, before those of the header.
    start, stop : float, optional
        Keep the samples from `start` to `stop` [s], both ends included.

    Returns
    -------
    Record
        Named after the file; only the columns that are asked for are read.

    Raises
    ------
    UnreadableFileError, EmptyFileError, MissingHeaderError, RaggedRowError
        The file cannot be read, or is no table with a header.
    MissingColumnError, DuplicateColumnError, TextInColumnError
        A column does not exist, occurs twice, or holds text.
    SamplingError, NonUniformTimeError, TimeNotIncreasingError, EmptyRangeError
        Time is not stated, does not agree with `dt`, runs backwards, or has no samples in range.
    DataError
        Whatever else `Record` refuses.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> from tridentify import read_record
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "doublet.csv")
    ...     _ = path.write_text("t,elevator [rad],q\n0,0,0\n0.5,1,0\n1,1,0.2\n")
    ...     read_record(path, time="t", inputs=["elevator"], outputs=["q"])
    Record('doublet', 3 samples, 1 s, dt=0.5 s, zoh, inputs: elevator [rad], outputs: q)
    """
    wanted_in, wanted_out = _as_names("input", inputs), _as_names("output", outputs)
    if time is None and dt is None:
        raise SamplingError(
            "found neither a time column nor dt; expected at least one; name the column of time "
            "or give dt [s]"
        )
    table = open_table(path)
    known = _columns(table)
    clock = None if time is None else _find(table, known, time)
    sources = [_find(table, known, name) for name in wanted_in]
    results = [_find(table, known, name) for name in wanted_out]
    channels = sources + results
    names = _channel_names(channels)
    units = {**{c.header: c.unit for c in known if c.unit}, **_given_units(known, clock, units)}

    values, lines = read_columns(table, [c.index for c in ([clock] if clock else []) + channels])
    recorded = None if clock is None else _seconds(table, clock, values.pop(0), lines, units)
    t = _sampling_instants(recorded, dt, len(values[0]))
    if len(t) < 2:
        raise TooFewSamplesError(
            f"found {len(t)} row in {shown(table.path.name)}; expected at least 2; "
            "record for longer"
        )
    first, last = sample_range(t, start, stop)
    for column, sample in zip(sources, values, strict=False):
        _check_finite(table, column, sample, lines, first, last)
    record = Record(
        _stack(values[: len(sources)], first, last),
        _stack(values[len(sources) :], first, last),
        t=t[first:last],
        intersample=intersample,
        input_names=names[: len(sources)],
        output_names=names[len(sources) :],
        units=_kept_units(dict(zip(names, channels, strict=True)), clock, units),
        name=table.path.stem,
    )
    # the mean step may differ from a stated one in the last digit
    return record if dt is None else record._derive(dt=float(dt))


def _as_names(kind: str, names: Sequence[str]) -> tuple[str, ...]:
    chosen = (names,) if isinstance(names, str) else tuple(names)
    if not chosen:
        raise ChannelNameError(
            f"found no {kind} asked for; expected at least one column; name the {kind} columns"
        )
    return chosen


def _columns(table: TextTable) -> list[Column]:
    columns = []
    for index, header in enumerate(table.names):
        match = _UNIT.fullmatch(header)
        unit = (match["square"] or match["round"] or "").strip() if match else ""
        # x[0] and q(1) are numbered names, not units
        if match is None or unit.isdigit():
            columns.append(Column(index, header, header, ""))
        else:
            columns.append(Column(index, header, match["name"].strip(), unit))
    return columns


def _find(table: TextTable, columns: list[Column], name: str) -> Column:
    wanted = str(name).strip()
    exact = [column for column in columns if column.header == wanted and wanted]
    fits = exact or [column for column in columns if column.name == wanted and wanted]
    if not fits:
        listed = ", ".join(column.header for column in columns if column.header)
        raise MissingColumnError(
            f"found no column {shown(name)} in {shown(table.path.name)}; expected one of "
            f"{shown(listed, 300)[1:-1]}; correct the name"
        )
    if len(fits) > 1:
        raise DuplicateColumnError(
            f"found {len(fits)} columns {shown(name)} in {shown(table.path.name)}; expected one; "
            f"name it with its unit: {' or '.join(column.header for column in fits)}"
        )
    return fits[0]


def _channel_names(columns: list[Column]) -> tuple[str, ...]:
    for column in columns:
        if columns.count(column) > 1:
            raise ChannelNameError(
                f"found the column {shown(column.header)} asked for more than once; expected "
                "different columns as inputs and outputs; drop one"
            )
    short = [column.name for column in columns]
    return tuple(c.name if short.count(c.name) == 1 else c.header for c in columns)


def _given_units(
    columns: list[Column], clock: Column | None, units: Mapping[str, str] | None
) -> dict[str, str]:
    given: dict[str, str] = {}
    for name, unit in (units or {}).items():
        fits = [column.header for column in columns if name in (column.header, column.name)]
        if not fits and name == "t" and clock is not None:
            fits = [clock.header]
        if not fits:
            raise UnitError(
                f"found a unit for {shown(name)}; expected the name of a column; correct the name"
            )
        given.update(dict.fromkeys(fits, unit))
    return given


def _kept_units(
    channels: Mapping[str, Column], clock: Column | None, units: Mapping[str, str]
) -> dict[str, str]:
    kept = {name: units[c.header] for name, c in channels.items() if c.header in units}
    return kept | ({"t": "s"} if clock is not None and clock.header in units else {})


def _seconds(
    table: TextTable, clock: Column, time: FloatArray, lines: list[int], units: Mapping[str, str]
) -> FloatArray:
    _check_finite(table, clock, time, lines, 0, len(time))
    unit = units.get(clock.header, "")
    if unit not in SECONDS:
        raise UnitError(
            f"found the unit {shown(unit)} of the time column {shown(clock.header)}; expected s, "
            "ms, us, ns, min or h; convert the column to seconds or correct the unit"
        )
    seconds: FloatArray = time * SECONDS[unit]
    return seconds


def _sampling_instants(recorded: FloatArray | None, dt: float | None, n_samples: int) -> FloatArray:
    if dt is None:
        return time_axis(None, recorded, n_samples)[1]
    step, t = time_axis(dt, None, n_samples)
    if recorded is None or step is None:
        return t
    time_axis(None, recorded, n_samples)
    steps = np.diff(recorded)
    apart = np.abs(steps - step) > JITTER * step
    if apart.any():
        first = int(np.argmax(apart))
        raise NonUniformTimeError(
            f"found a step of {steps[first]:.6g} s after {recorded[first]:.6g} s of recorded time; "
            f"expected {step:.6g} s within 5 percent, as stated by dt; leave dt out or correct it"
        )
    shifted = t + recorded[0]
    shifted.flags.writeable = False
    return cast(FloatArray, shifted)


def _check_finite(
    table: TextTable, column: Column, values: FloatArray, lines: list[int], first: int, last: int
) -> None:
    finite = np.isfinite(values[first:last])
    if not finite.all():
        row = first + int(np.argmin(finite))
        line = lines[row] if len(lines) > 1 else lines[0] + row
        raise NotFiniteError(
            f"found {values[row]} (or a blank) in column {shown(column.header)}, line {line} of "
            f"{shown(table.path.name)}; expected a finite number; repair it or cut the record"
        )


def _stack(columns: list[FloatArray], first: int, last: int) -> FloatArray:
    stacked = np.empty((last - first, len(columns)))
    for index, values in enumerate(columns):
        stacked[:, index] = values[first:last]
    stacked.flags.writeable = False
    return stacked
