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
refused: 1,234 is 1.234 to one reader and 1234 to another. Lines of text below the last row are left
out, and told.

The encoding is told from the first MiB; a byte further on that is no UTF-8 counts as Latin-1. No
more of a file is held than one row and the numbers that are asked for.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from itertools import chain, islice
from pathlib import Path

from tridentify.errors import DuplicateColumnError, EmptyFileError, MissingHeaderError, shown
from tridentify.numerics.arrays import Array
from tridentify.record.formats.apart.isolation import check_size
from tridentify.record.formats.text import text_opening
from tridentify.record.formats.text.cells import (
    all_numbers,
    has_groups,
    is_missing,
    is_value,
    unit_cells,
)
from tridentify.record.formats.text.number_rows import labelled_units
from tridentify.record.formats.text.text_opening import TextTable
from tridentify.record.formats.text.text_rows import (
    DecimalCommaFound,
    Passed,
    read_exactly,
    text_rows,
)
from tridentify.record.formats.text.title_lines import LOOKED_AT
from tridentify.record.formats.time.dates import read_moment


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
    rows = text_rows(file, encoding, opening.separator, opening.first_line)
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
        if not any(units):
            units = labelled_units(opening.preamble, opening.separator, len(names))
    if opening.numbers:
        line = max(line, opening.numbers - 1)
        rows = ((cells, n) for cells, n in rows if n > line)
    if repeated := repeated_name(names):
        raise DuplicateColumnError(
            f"found the column {shown(repeated[0])} {repeated[1]} times in {shown(file.name)}; "
            "expected every name once; rename one in the header"
        )
    first = _first_cells([cells for cells, _ in islice(rows, LOOKED_AT)], len(names))
    return TextTable(
        file, encoding, opening.separator, names, units, first_line, line, opening.titles,
        tuple(read_moment(cell) is not None for cell in first),
        tuple(bool(cell) and not is_value(cell) and not has_groups(cell) for cell in first),
    )  # fmt: skip


def _first_cells(rows: Sequence[Sequence[str]], width: int) -> list[str]:
    """The first cell of every column that is not blank."""
    first = [""] * width
    for row in rows:
        for k, cell in enumerate(row[:width]):
            first[k] = first[k] or ("" if is_missing(cell) else cell)
    return first


def repeated_name(names: Sequence[str]) -> tuple[str, int] | None:
    """Give the first name that occurs more than once, and how often; blank ones do not count.

    Examples
    --------
    >>> repeated_name(["t", "", "u", "", "u"])
    ('u', 2)
    """
    counts = Counter(name for name in names if name)
    return next(((name, count) for name, count in counts.items() if count > 1), None)


def read_columns(
    table: TextTable, columns: Sequence[int], *, go_on: bool = False
) -> tuple[list[Array], Sequence[int], Passed]:
    """Read some columns of a table as numbers.

    Parameters
    ----------
    table : TextTable
        What `open_table` gave.
    columns : sequence of int
        Numbers of the columns, from zero.
    go_on : bool
        Leave out lines of text and rows of another length among the rows, instead of refusing.

    Returns
    -------
    values : list of ndarray, shape (n_rows,)
        One array for each of `columns`; nan for a blank cell.
    lines : sequence of int
        Line of the file that the rows stand on: either the first row's alone, the others following
        without a gap, or every row's.
    passed : Passed
        What was left out, and what was taken for missing.

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
    passed = Passed()
    if values is None:
        try:
            values, lines, passed = read_exactly(table, columns, ".", go_on)
        except DecimalCommaFound:
            values, lines, passed = read_exactly(table, columns, ",", go_on)
    else:
        lines = [table.header_lines + 1]
    if values[0].size == 0:
        raise EmptyFileError(
            f"found a header and no row in {shown(table.path.name)}; expected rows of numbers; "
            "check that the file was saved completely"
        )
    return values, lines, passed


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
