"""Columns of numbers from a delimited text file, quickly when it is clean, exactly when it is not.

A clean file (no quotes, no comments, no blank cell, every row as long as the header) goes through
polars. Any other is read cell by cell, which either yields the numbers or names the line that is at
fault.

What is recognised: the separator (comma, semicolon, tab, bar) by its count in the header, blanks
where there is none of these and the next line has as many words; UTF-8,
UTF-16 with a byte-order mark, and what is neither but has no control characters as Latin-1; lines
of comments that begin with ``#`` or ``%``, the last of which may be the header; lines of title
above the header, which are told; a line of units below the header, of which no cell is a number;
columns of dates or times; and a decimal comma, where the cells have one. A group of thousands is
refused: 1,234 is 1.234 to one reader and 1234 to another.

The encoding is told from the first MiB; a byte further on that is no UTF-8 counts as Latin-1. No
more of a file is held than one row and the numbers that are asked for.
"""

from __future__ import annotations

import codecs
import csv
import os
import re
from array import array
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import TextIO

from tridentify.errors import (
    DuplicateColumnError,
    EmptyFileError,
    MissingHeaderError,
    RaggedRowError,
    TextInColumnError,
    ThousandsSeparatorError,
    UnreadableFileError,
    shown,
)
from tridentify.numerics.arrays import Array
from tridentify.record.formats import text_opening
from tridentify.record.formats.cells import (
    Numbers,
    all_numbers,
    has_decimal_comma,
    has_groups,
    is_missing,
    read_number,
    unit_cells,
)
from tridentify.record.formats.dates import Instants, read_moment
from tridentify.record.formats.isolation import check_size
from tridentify.record.formats.title_lines import LOOKED_AT, dialect

MOST_TEXT_COLUMNS = 1_000_000
"""Columns beyond which a header is taken for damage: their names alone would take a gigabyte."""


_LOOK = 1 << 16
"""Rows between two looks at how much memory they take."""


@dataclass(frozen=True)
class TextTable:
    """A delimited text file whose header has been read.

    Attributes
    ----------
    path : Path
        The file.
    encoding : str
        Of its text.
    separator : str
        What stands between two cells.
    names : tuple of str
        The cells of the header, without surrounding blanks.
    units : tuple of str
        The cells of the line of units; blank without one.
    first_line : int
        Number of the first line that is no comment, or of the header in a comment.
    header_lines : int
        Number of the line that the header, or the line of units, ends on.
    titles : tuple of str
        Lines above the header that are no comments.
    dated : tuple of bool
        Which columns hold dates or times, to judge by the first row that says so.
    """

    path: Path
    encoding: str
    separator: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    first_line: int
    header_lines: int
    titles: tuple[str, ...] = ()
    dated: tuple[bool, ...] = ()


def open_table(path: str | os.PathLike[str]) -> TextTable:
    """Read the header of a delimited text file.

    Parameters
    ----------
    path : path-like
        Text with cells separated by commas, semicolons, tabs or bars.

    Returns
    -------
    TextTable

    Raises
    ------
    UnreadableFileError
        The file is missing, no regular file, not permitted, or not text.
    EmptyFileError
        The file holds nothing but blanks.
    MissingHeaderError
        The first line holds numbers.
    DuplicateColumnError
        A name occurs twice.
    """
    file = Path(path)
    text_opening.check_readable(file)
    encoding = text_opening.encoding_of(file)
    opening = text_opening.read_opening(file, encoding)
    rows = _rows(file, encoding, opening.separator, opening.first_line)
    header = next(((cells, n) for cells, n in rows if any(cell.strip() for cell in cells)), None)
    if header is None:
        raise EmptyFileError(
            f"found nothing in {shown(file.name)}; expected a header and rows of numbers; check "
            "that the file was saved"
        )
    cells, line = header
    names = tuple(cell.strip() for cell in cells)
    first_line = opening.first_line
    if all_numbers(names):
        commented = [cell.strip() for cell in opening.comment.split(opening.separator)]
        if len(commented) != len(names) or all_numbers(commented):
            raise MissingHeaderError(
                f"found numbers ({shown(opening.separator.join(names))}) in the first line of "
                f"{shown(file.name)}; expected the names of the columns; add a header line"
            )
        names, units, line = tuple(commented), ("",) * len(commented), first_line - 1
    else:
        below = next(((cells, n) for cells, n in rows if cells), ([], 0))
        units = unit_cells(below[0], len(names))
        line = below[1] if any(units) else line
        rows = chain([] if any(units) else [below], rows)
    if repeated := repeated_name(names):
        raise DuplicateColumnError(
            f"found the column {shown(repeated[0])} {repeated[1]} times in {shown(file.name)}; "
            "expected every name once; rename one in the header"
        )
    dated = _dated([cells for cells, _ in islice(rows, LOOKED_AT)], len(names))
    return TextTable(
        file, encoding, opening.separator, names, units, first_line, line, opening.titles, dated
    )


def _dated(rows: Sequence[Sequence[str]], width: int) -> tuple[bool, ...]:
    """Whether the first cell of a column that is not blank is a date or a time."""
    first = [""] * width
    for row in rows:
        for k, cell in enumerate(row[:width]):
            first[k] = first[k] or ("" if is_missing(cell) else cell)
    return tuple(read_moment(cell) is not None for cell in first)


def repeated_name(names: Sequence[str]) -> tuple[str, int] | None:
    """Give the first name that occurs more than once, and how often; blank ones do not count.

    Examples
    --------
    >>> repeated_name(["t", "", "u", "", "u"])
    ('u', 2)
    """
    counts = Counter(name for name in names if name)
    return next(((name, count) for name, count in counts.items() if count > 1), None)


def read_columns(table: TextTable, columns: Sequence[int]) -> tuple[list[Array], Sequence[int]]:
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
    lines : sequence of int
        Line of the file that the rows stand on: either the first row's alone, the others following
        without a gap, or every row's.

    Raises
    ------
    UnreadableFileError
        The file is not UTF-8 text throughout.
    TextInColumnError, ThousandsSeparatorError
        A cell is not a number, or is one with groups of digits.
    RaggedRowError
        A row is longer or shorter than the header.
    EmptyFileError
        There is no row.
    FileTooLargeError
        The numbers would fill the memory.
    """
    lines: Sequence[int]
    values = _read_clean(table, columns)
    if values is None:
        try:
            values, lines = _read_exactly(table, columns, ".")
        except _DecimalCommaFound:
            values, lines = _read_exactly(table, columns, ",")
    else:
        lines = [table.header_lines + 1]
    if values[0].size == 0:
        raise EmptyFileError(
            f"found a header and no row in {shown(table.path.name)}; expected rows of numbers; "
            "check that the file was saved completely"
        )
    return values, lines


class _DecimalCommaFound(Exception):
    """A cell has a decimal comma where a decimal point was looked for."""


codecs.register_error(text_opening.LATER_BYTES, text_opening.as_latin_1)


def _rows(
    file: Path, encoding: str, separator: str, first_line: int
) -> Iterator[tuple[list[str], int]]:
    """Give cells and line number of every row that is no comment."""
    length = 0

    def lines(stream: TextIO) -> Iterator[str]:
        nonlocal length
        number = 0
        while line := stream.readline(text_opening.LONGEST_ROW):
            number += 1
            length += len(line)
            text_opening.check_row(file, length, number)
            if len(line) > MOST_TEXT_COLUMNS and line.count(separator) >= MOST_TEXT_COLUMNS:
                raise text_opening.not_text(
                    file, f"more than {MOST_TEXT_COLUMNS:,} columns in line {number}"
                )
            aligned = separator == " "  # a blank at the end is no separator
            yield "\n" if number < first_line else f"{line.rstrip()}\n" if aligned else line

    try:
        with file.open(encoding=encoding, errors=text_opening.LATER_BYTES, newline="") as stream:
            reader = csv.reader(lines(stream), **dialect(separator))
            for cells in reader:
                length = 0
                if any("\0" in cell for cell in cells):
                    raise text_opening.not_text(file, f"binary content at line {reader.line_num}")
                if not (cells and cells[0].lstrip().startswith(text_opening.COMMENTS)):
                    yield cells, reader.line_num
    except UnreadableFileError:
        raise
    except UnicodeError as error:
        raise text_opening.not_text(file, "binary content or another encoding") from error
    except csv.Error as error:
        raise text_opening.not_text(file, f"binary or damaged content ({error})") from error
    except OSError as error:
        raise text_opening.not_text(file, f"a read error ({error.strerror})") from error


def _count_clean_rows(table: TextTable) -> int | None:
    """Count the rows, or give None unless their bytes say that all are as long as the header."""
    separators = newlines = returns = 0
    separator, last = table.separator.encode(), b"\n"
    with table.path.open("rb") as stream:
        for _ in range(table.header_lines):
            stream.readline()
        while chunk := stream.read(text_opening.CHUNK):
            # a quote that is never closed makes polars panic; a comment is no row
            if any(mark in chunk for mark in (b'"', b"\0", b"#", b"%")):
                return None
            separators += chunk.count(separator)
            newlines += chunk.count(b"\n")
            returns += chunk.count(b"\r")
            last = chunk[-1:]
    rows = newlines + (last != b"\n")
    full = separators == rows * (len(table.names) - 1)
    return rows if full and returns in (0, newlines) and rows else None


def _read_clean(table: TextTable, columns: Sequence[int]) -> list[Array] | None:
    # polars takes no name that is not UTF-8
    if table.encoding != "utf-8-sig" or not _in_utf_8(table.path):
        return None
    try:
        n_rows = _count_clean_rows(table)
    except OSError:
        # the exact reader meets the same trouble and names it
        return None
    if n_rows is None:
        return None
    check_size(8 * n_rows * len(columns), table.path)
    import polars as pl

    if any(table.dated[column] for column in columns):
        return None
    # by position: how polars names the columns of a file without header depends on its version
    order = sorted(set(columns))
    kinds = [pl.Float64 if k in order else pl.String for k in range(len(table.names))]
    try:
        frame = pl.read_csv(
            table.path,
            separator=table.separator,
            has_header=False,
            skip_rows=table.header_lines,
            columns=order,
            schema_overrides=kinds,
            infer_schema_length=0,
            glob=False,
        )
        series = [frame.to_series(order.index(column)) for column in columns]
    except (pl.exceptions.PolarsError, OSError):
        return None
    if any(item.dtype != pl.Float64 or item.null_count() for item in series):
        return None
    return [item.to_numpy() for item in series] if frame.height == n_rows else None


def _in_utf_8(path: Path) -> bool:
    try:
        str(path).encode()
    except UnicodeEncodeError:
        return False
    return True


def _read_exactly(
    table: TextTable, columns: Sequence[int], decimal: str
) -> tuple[list[Array], Sequence[int]]:
    stores = [Instants() if table.dated[column] else Numbers(decimal) for column in columns]
    lines = array("q")
    width = len(table.names)
    for cells, line in _rows(table.path, table.encoding, table.separator, table.first_line):
        blank = len(cells) < 2 and not "".join(cells).strip()
        if line <= table.header_lines or blank:
            continue
        if len(cells) < width or any(cell.strip() for cell in cells[width:]):
            raise RaggedRowError(
                f"found {len(cells)} cells in line {line} of {shown(table.path.name)}; expected "
                f"{width} as in the header; the file may be cut off or damaged: repair that line"
            )
        for store, column in zip(stores, columns, strict=True):
            cell = cells[column]
            if not store.take("" if is_missing(cell) else cell, line):
                if decimal == "." and has_decimal_comma(cell):
                    raise _DecimalCommaFound
                raise _text_in_column(table, column, line, cell, decimal)
        lines.append(line)
        if len(lines) % _LOOK == 0:
            check_size(8 * len(lines) * (len(columns) + 1), table.path)
    for store, column in zip(stores, columns, strict=True):
        if isinstance(store, Numbers) and store.groups.ambiguous:
            where = store.groups
            raise _text_in_column(table, column, where.line, where.cell, decimal)
    return [store.values() for store in stores], lines


def _text_in_column(
    table: TextTable, column: int, line: int, cell: str, decimal: str
) -> TextInColumnError | ThousandsSeparatorError:
    text = cell.strip()
    where = f"in column {shown(table.names[column])}, line {line} of {shown(table.path.name)}"
    if has_groups(text) or (decimal == "," and "." in text and read_number(text) is not None):
        return ThousandsSeparatorError(
            f"found {shown(cell)} {where}, where points and commas may be decimal signs or groups "
            "of thousands; expected numbers without groups, with one decimal sign; write the file "
            "without them"
        )
    advice = "correct or remove that line"
    if re.match(r"\s*\d+[-/:.]\d+[-/:.]\d+", cell):
        advice = "give time in seconds, or all dates as 2026-11-22T10:30:00.25"
    return TextInColumnError(f"found {shown(cell)} {where}; expected a number; {advice}")
