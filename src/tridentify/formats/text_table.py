"""Columns of numbers from a delimited text file, quickly when it is clean, exactly when it is not.

A clean file (no quotes, no blank cell, every row as long as the header) goes through polars. Any
other is read cell by cell, which either yields the numbers or names the line that is at fault.
"""

from __future__ import annotations

import csv
import math
import os
import re
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tridentify.errors import (
    DuplicateColumnError,
    EmptyFileError,
    MissingHeaderError,
    RaggedRowError,
    TextInColumnError,
    UnreadableFileError,
    shown,
)

FloatArray = NDArray[np.float64]

SEPARATORS = ",;\t"
MISSING = frozenset(("", "na", "n/a", "nan", "null", "none", "-nan"))

_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
_CHUNK = 1 << 20


@dataclass(frozen=True)
class TextTable:
    """A delimited text file whose header has been read.

    Attributes
    ----------
    path : Path
        The file.
    separator : str
        What stands between two cells.
    raw_names : tuple of str
        The cells of the header as they stand.
    header_lines : int
        Number of the line that the header ends on.
    """

    path: Path
    separator: str
    raw_names: tuple[str, ...]
    header_lines: int

    @property
    def names(self) -> tuple[str, ...]:
        """The cells of the header without surrounding blanks."""
        return tuple(name.strip() for name in self.raw_names)


def open_table(path: str | os.PathLike[str]) -> TextTable:
    """Read the header of a delimited text file.

    Parameters
    ----------
    path : path-like
        UTF-8 text, with or without byte-order mark, separated by commas, semicolons or tabs.

    Returns
    -------
    TextTable

    Raises
    ------
    UnreadableFileError
        The file is missing, no regular file, not permitted, or not UTF-8 text.
    EmptyFileError
        The file holds nothing but blanks.
    MissingHeaderError
        The first line holds numbers.
    DuplicateColumnError
        A name occurs twice.
    """
    file = Path(path)
    _check_readable(file)
    separator, cells, line = ",", None, 0
    for separator, cells, line in _rows(file, None):  # noqa: B007
        if any(cell.strip() for cell in cells):
            break
        cells = None
    if cells is None:
        raise EmptyFileError(
            f"found nothing in {shown(file.name)}; expected a header and rows of numbers; check "
            "that the file was saved"
        )
    table = TextTable(file, separator, tuple(cells), line)
    names = [name for name in table.names if name]
    if all(_number(name) is not None for name in names):
        raise MissingHeaderError(
            f"found numbers ({shown(separator.join(names))}) in the first line of "
            f"{shown(file.name)}; expected the names of the columns; add a header line"
        )
    for name in names:
        if names.count(name) > 1:
            raise DuplicateColumnError(
                f"found the column {shown(name)} {names.count(name)} times in {shown(file.name)}; "
                "expected every name once; rename one in the header"
            )
    return table


def read_columns(table: TextTable, columns: Sequence[int]) -> tuple[list[FloatArray], list[int]]:
    """Read some columns of a table as numbers.

    Parameters
    ----------
    table : TextTable
        What `open_table` gave.
    columns : sequence of int
        Numbers of the columns, from zero.

    Returns
    -------
    values : list of ndarray, shape (n_rows,)
        One array for each of `columns`; nan for a blank cell.
    lines : list of int
        Line of the file that the rows stand on: either the first row's alone, the others following
        without a gap, or every row's.

    Raises
    ------
    UnreadableFileError
        The file is not UTF-8 text throughout.
    TextInColumnError
        A cell is not a number.
    RaggedRowError
        A row is longer or shorter than the header.
    EmptyFileError
        There is no row.
    """
    values = _read_clean(table, columns)
    if values is None:
        values, lines = _read_exactly(table, columns)
    else:
        lines = [table.header_lines + 1]
    if values[0].size == 0:
        raise EmptyFileError(
            f"found a header and no row in {shown(table.path.name)}; expected rows of numbers; "
            "check that the file was saved completely"
        )
    return values, lines


def _check_readable(file: Path) -> None:
    problem = ""
    try:
        if file.is_dir():
            problem = "a directory"
        elif not file.exists():
            problem = "no such file"
        elif not file.is_file():
            problem = "no regular file"
        else:
            with file.open("rb") as stream:
                start = stream.read(4)
            if start[:2] in (b"\xff\xfe", b"\xfe\xff"):
                problem = "UTF-16 text"
    except (OSError, ValueError) as error:
        problem = getattr(error, "strerror", None) or str(error)
    if problem:
        raise UnreadableFileError(
            f"found {problem} at {shown(str(file), 200)}; expected a readable CSV file in UTF-8; "
            "check the path, the permission and the format"
        )


def _not_text(file: Path, reason: str) -> UnreadableFileError:
    return UnreadableFileError(
        f"found {reason} in {shown(file.name)}; expected CSV text in UTF-8; save the file as CSV "
        "in UTF-8"
    )


def _rows(file: Path, separator: str | None) -> Iterator[tuple[str, list[str], int]]:
    """Give separator, cells and line number of every row; the first line with text decides."""
    try:
        with file.open(encoding="utf-8-sig", newline="") as stream:
            if separator is None:
                separator = _sniff(stream.readline(_CHUNK) for _ in range(1000))
                stream.seek(0)
            reader = csv.reader(stream, delimiter=separator)
            for cells in reader:
                if any("\0" in cell for cell in cells):
                    raise _not_text(file, f"binary content at line {reader.line_num}")
                yield separator, cells, reader.line_num
    except UnreadableFileError:
        raise
    except UnicodeDecodeError as error:
        raise _not_text(file, "binary content or another encoding") from error
    except csv.Error as error:
        raise _not_text(file, f"binary or damaged content ({error})") from error
    except OSError as error:
        raise _not_text(file, f"a read error ({error.strerror})") from error


def _sniff(lines: Iterator[str]) -> str:
    header = next((line for line in lines if line.strip()), "")
    plain = re.sub(r'"[^"]*"', "", header)
    return max(SEPARATORS, key=plain.count)


def _number(cell: str) -> float | None:
    """Give the number a cell holds, nan when it is blank, None when it is text."""
    text = cell.strip()
    if text.lower() in MISSING:
        return math.nan
    try:
        # Python alone reads 1_000 as a number
        return None if "_" in text else float(text)
    except ValueError:
        return None


def _count_clean_rows(table: TextTable) -> int | None:
    """Count the rows, or give None unless their bytes say that all are as long as the header."""
    separators = newlines = returns = 0
    separator, last = table.separator.encode(), b"\n"
    with table.path.open("rb") as stream:
        for _ in range(table.header_lines):
            stream.readline()
        while chunk := stream.read(_CHUNK):
            # a quote that is never closed makes polars panic
            if b'"' in chunk or b"\0" in chunk:
                return None
            separators += chunk.count(separator)
            newlines += chunk.count(b"\n")
            returns += chunk.count(b"\r")
            last = chunk[-1:]
    rows = newlines + (last != b"\n")
    full = separators == rows * (len(table.raw_names) - 1)
    return rows if full and returns in (0, newlines) and rows else None


def _read_clean(table: TextTable, columns: Sequence[int]) -> list[FloatArray] | None:
    try:
        n_rows = _count_clean_rows(table)
    except OSError:
        # the exact reader meets the same trouble and names it
        return None
    if n_rows is None:
        return None
    import polars as pl

    names = [table.raw_names[column] for column in columns]
    try:
        frame = pl.read_csv(
            table.path,
            separator=table.separator,
            columns=sorted(set(columns)),
            schema_overrides=dict.fromkeys(names, pl.Float64),
            infer_schema_length=0,
            glob=False,
        )
        series = [frame.get_column(name) for name in names]
    except (pl.exceptions.PolarsError, OSError):
        return None
    if any(item.dtype != pl.Float64 or item.null_count() for item in series):
        return None
    return [item.to_numpy() for item in series] if frame.height == n_rows else None


def _read_exactly(table: TextTable, columns: Sequence[int]) -> tuple[list[FloatArray], list[int]]:
    values = [array("d") for _ in columns]
    lines: list[int] = []
    width = len(table.raw_names)
    for _, cells, line in _rows(table.path, table.separator):
        blank = len(cells) < 2 and not "".join(cells).strip()
        if line <= table.header_lines or blank:
            continue
        if len(cells) < width or any(cell.strip() for cell in cells[width:]):
            raise RaggedRowError(
                f"found {len(cells)} cells in line {line} of {shown(table.path.name)}; expected "
                f"{width} as in the header; the file may be cut off or damaged: repair that line"
            )
        for store, column in zip(values, columns, strict=True):
            number = _number(cells[column])
            if number is None:
                raise _text_in_column(table, column, line, cells[column])
            store.append(number)
        lines.append(line)
    return [np.array(store, dtype=np.float64) for store in values], lines


def _text_in_column(table: TextTable, column: int, line: int, cell: str) -> TextInColumnError:
    advice = "correct or remove that line"
    if _DECIMAL_COMMA.fullmatch(cell.strip()):
        advice = "write a decimal point instead of the comma"
    elif re.match(r"\s*\d+[-/:.]\d+[-/:.]\d+", cell):
        advice = "give time in seconds"
    return TextInColumnError(
        f"found {shown(cell)} in column {shown(table.names[column])}, line {line} of "
        f"{shown(table.path.name)}; expected a number; {advice}"
    )
