"""The rows of a delimited text file, cell by cell: numbers, or the line that is at fault."""

from __future__ import annotations

import codecs
import csv
import re
from array import array
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

from tridentify.errors import (
    DataError,
    RaggedRowError,
    TextInColumnError,
    ThousandsSeparatorError,
    UnreadableFileError,
    shown,
)
from tridentify.numerics.arrays import Array
from tridentify.record.formats.apart.isolation import check_size
from tridentify.record.formats.text import text_opening
from tridentify.record.formats.text.cells import (
    Numbers,
    has_decimal_comma,
    has_groups,
    is_error_word,
    is_missing,
    is_value,
    read_number,
)
from tridentify.record.formats.text.text_opening import TextTable
from tridentify.record.formats.text.title_lines import dialect
from tridentify.record.formats.time.dates import Instants

MOST_TEXT_COLUMNS = 1_000_000
"""Columns beyond which a header is taken for damage: their names alone would take a gigabyte."""

MOST_BELOW = 64
"""Lines of text below the last row that are left out: more are no remark at the end."""

_LOOK = 1 << 16
"""Rows between two looks at how much memory they take."""


class DecimalCommaFound(Exception):
    """A cell has a decimal comma where a decimal point was looked for."""


codecs.register_error(text_opening.LATER_BYTES, text_opening.as_latin_1)


def text_rows(
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
                if not cells or not _is_comment(cells[0]):
                    yield cells, reader.line_num
    except UnreadableFileError:
        raise
    except UnicodeError as error:
        raise text_opening.not_text(file, "binary content or another encoding") from error
    except csv.Error as error:
        raise text_opening.not_text(file, f"binary or damaged content ({error})") from error
    except OSError as error:
        raise text_opening.not_text(file, f"a read error ({error.strerror})") from error


def _is_comment(cell: str) -> bool:
    """Whether the first cell begins a comment; #N/A does not."""
    return cell.lstrip().startswith(text_opening.COMMENTS) and not is_missing(cell)


@dataclass(frozen=True)
class Passed:
    """What a reading left out, or took for a missing sample.

    Attributes
    ----------
    below : tuple of (int, str)
        Lines of text below the last row: number, and what they say.
    among : tuple of DataError
        What is wrong with lines among the rows that were left out.
    words : Counter of str
        How often which word of an error stands where a number should.
    said : tuple of str
        How dates were read that have two readings.
    """

    below: tuple[tuple[int, str], ...] = ()
    among: tuple[DataError, ...] = ()
    words: Counter[str] = field(default_factory=Counter)
    said: tuple[str, ...] = ()


def read_exactly(
    table: TextTable, columns: Sequence[int], decimal: str, go_on: bool
) -> tuple[list[Array], Sequence[int], Passed]:
    """Read some columns cell by cell.

    Parameters
    ----------
    table : TextTable
    columns : sequence of int
    decimal : str
        The decimal sign.
    go_on : bool
        As for `read_columns`, as is what is given and raised.

    Raises
    ------
    DecimalCommaFound
        A cell has a decimal comma, and `decimal` is a point.
    """
    stores = [Instants() if table.dated[column] else Numbers(decimal) for column in columns]
    lines = array("q")
    waiting: list[tuple[DataError, int, str]] = []
    among: list[DataError] = []
    words: Counter[str] = Counter()
    for cells, line in text_rows(table.path, table.encoding, table.separator, table.first_line):
        blank = len(cells) < 2 and not "".join(cells).strip()
        if line <= table.header_lines or blank:
            continue
        problem = _take(table, columns, stores, cells, line, words)
        if problem is None:
            if waiting and not go_on:
                raise waiting[0][0]
            among += [error for error, *_ in waiting]
            waiting.clear()
            lines.append(line)
            if len(lines) % _LOOK == 0:
                check_size(8 * len(lines) * (len(columns) + 1), table.path)
        elif go_on and isinstance(problem, RaggedRowError) and not is_text(cells):
            among += [*(error for error, *_ in waiting), problem]
            waiting.clear()
        elif is_text(cells) and (go_on or len(waiting) < MOST_BELOW):
            waiting.append((problem, line, table.separator.join(cells).strip()))
        else:
            raise waiting[0][0] if waiting else problem
    if waiting and not lines:
        raise waiting[0][0]
    for store, column in zip(stores, columns, strict=True):
        if isinstance(store, Numbers) and store.groups.ambiguous:
            where = store.groups
            raise _text_in_column(table, column, where.line, where.cell, decimal)
    below = tuple((line, text) for _, line, text in waiting)
    values = [store.values() for store in stores]
    said = tuple(
        f"found {store.choice} in column {shown(table.names[column])} of {shown(table.path.name)}"
        for store, column in zip(stores, columns, strict=True)
        if isinstance(store, Instants) and store.choice
    )
    return values, lines, Passed(below, tuple(among), words, said)


def _take(
    table: TextTable,
    columns: Sequence[int],
    stores: Sequence[Instants | Numbers],
    cells: list[str],
    line: int,
    words: Counter[str],
) -> DataError | None:
    """Take the cells of a row, or none of them and say what is wrong with it."""
    width = len(table.names)
    if len(cells) < table.width or any(cell.strip() for cell in cells[width:]):
        return RaggedRowError(
            f"found {len(cells)} cells in line {line} of {shown(table.path.name)}; expected "
            f"{width} as in the header; the file may be cut off or damaged: repair that line"
        )
    cells += [""] * (width - len(cells))
    missing = [is_missing(cells[column]) for column in columns]
    if all(missing) and is_text(cells):
        column = next(k for k, cell in enumerate(cells) if not is_missing(cell))
        return _text_in_column(table, column, line, cells[column], ".")
    for place, (store, column) in enumerate(zip(stores, columns, strict=True)):
        cell = cells[column]
        if not store.take("" if missing[place] else cell, line):
            for taken in stores[:place]:
                taken.drop()
            decimal = store.decimal if isinstance(store, Numbers) else ""
            if decimal == "." and has_decimal_comma(cell):
                raise DecimalCommaFound
            return _text_in_column(table, column, line, cell, decimal)
        if missing[place] and is_error_word(cell):
            words[cell.strip()] += 1
    return None


def is_text(cells: Sequence[str]) -> bool:
    """Whether a row says something and has neither a number nor a time.

    Examples
    --------
    >>> is_text(["END", ""]), is_text(["1", "off"]), is_text(["NA", ""])
    (True, False, False)
    """
    told = [cell for cell in cells if not is_missing(cell)]
    return bool(told) and not any(map(is_value, told))


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
    if not decimal:
        return TextInColumnError(
            f"found {shown(cell)} {where}; expected a date or time of day written like those above "
            "it; give time in seconds, or all dates as 2026-11-22T10:30:00.25"
        )
    if re.match(r"\s*\d+[-/:.]\d+[-/:.]\d+", cell):
        advice = "give time in seconds, or all dates as 2026-11-22T10:30:00.25"
    return TextInColumnError(f"found {shown(cell)} {where}; expected a number; {advice}")
