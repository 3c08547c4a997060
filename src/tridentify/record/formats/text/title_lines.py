"""Where a table begins: below lines of title, as loggers and workbooks put above the names.

The header is the first line below which rows follow that fit it, numbers among them. So a title
with fewer cells than the table, or with one cell and separators that a workbook added, is passed
over; and where no line is such a header, the first one is taken for it, so that what is wrong with
the table is told of that one.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from typing import Any

from tridentify.record.formats.text.cells import SEPARATORS, is_value, unit_cells

_UNCLOSED = re.compile(r'(?:^|[,;\t|])\s*"')

LOOKED_AT = 64
"""Lines in which a header is looked for: four times the longest preamble seen in exported logs."""

AGREEING = 3
"""Rows below a header that have to fit it; fewer where the file ends before."""


def best_separator(line: str) -> str:
    """The separator that occurs most often outside of quotes.

    Examples
    --------
    >>> best_separator('t;"a,b,c";y')
    ';'
    """
    plain = re.sub(r'"[^"]*"', "", line)
    return max(SEPARATORS, key=plain.count)


def separator_of(lines: Sequence[str]) -> str:
    """The separator of a header and the rows below it: a blank where columns are aligned by them.

    Examples
    --------
    >>> separator_of(["t,u", "0,1"]), separator_of(["  t   u", "0.0  1.0"])
    (',', ' ')
    >>> separator_of(["pitch rate", "0.5"])
    ','
    """
    best = best_separator(lines[0])
    widths = [len(line.split()) for line in lines[:2]]
    aligned = best not in lines[0] and widths[0] > 1 and widths == [widths[0]] * 2
    return " " if aligned else best


def header_place(lines: Sequence[str]) -> int:
    """Find the line that names the columns.

    Parameters
    ----------
    lines : sequence of str
        The first lines of a file that are neither blank nor comments.

    Returns
    -------
    int
        Index into `lines`; 0 where no line is a header for certain.

    Examples
    --------
    >>> header_place(["Flight 12", "t,u,y", "0,1,2"])
    1
    """
    for place, line in enumerate(lines):
        if _UNCLOSED.search(line) and line.count('"') % 2:
            break  # a cell that goes on in the next line
        separator = separator_of(lines[place:])
        cells, *below = (cells_of(text, separator) for text in lines[place : place + AGREEING + 2])
        values = [is_value(cell) for cell in cells if cell]
        if all(values):
            if len(values) > 1:
                break  # the table has begun
        elif (place == 0 or (len(values) > 1 and not any(values))) and _heads(cells, below):
            return place
    return 0


def dialect(separator: str) -> dict[str, Any]:
    """How the `csv` module reads a line: several blanks in a row are one separator."""
    return {"delimiter": separator, "skipinitialspace": separator == " "}


def cells_of(line: str, separator: str) -> list[str]:
    """Give the cells of one line, without the blanks around them; none where it is no line."""
    try:
        cells = next(csv.reader([line], **dialect(separator)), [])
    except csv.Error:
        return []
    return [cell.strip() for cell in cells]


def _heads(header: list[str], below: list[list[str]]) -> bool:
    rows = below[:AGREEING]
    if below and any(unit_cells(below[0], len(header))):
        if sum(map(bool, below[0])) > sum(map(bool, header)):
            return False  # a title that a workbook filled up, and the names below it
        rows = below[1 : AGREEING + 1]
    if not rows or not any(is_value(cell) for cell in rows[0] if cell):
        return False
    return all(_fits(row, header) for row in rows)


def _fits(row: list[str], header: list[str]) -> bool:
    """Whether every cell has a name above it; that of an index, the first column, may lack one."""
    filled = (k for k in range(1, len(row)) if row[k])
    return len(row) >= len(header) and all(k < len(header) and header[k] for k in filled)
