"""Where the numbers of a text file begin, below a preamble that looks like a table itself.

Loggers write pairs of keys and values, in columns, above their table (LabVIEW, ControlDesk,
oscilloscopes): a line of texts with a line of numbers below it is not always the header. The table
is where the longest run of rows of numbers is; its names stand directly above.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import islice

from tridentify.record.formats.channels import SECONDS
from tridentify.record.formats.text.cells import SEPARATORS, is_missing, is_value, unit_cells
from tridentify.record.formats.text.title_lines import AGREEING, cells_of, separator_of

FARTHEST = 4
"""Lines above the first row of numbers in which the names may stand."""

MOST_CHARACTERS = 1 << 18
"""Characters of the first lines that are looked at: a wider table has no preamble of columns."""

_UNIT_LABEL = re.compile(r"(y_)?units?(_label)?:?", re.I)


@dataclass(frozen=True)
class Run:
    """Rows that agree on which of their cells are numbers.

    Attributes
    ----------
    start, length : int
        First row, and how many.
    numbers : frozenset of int
        Columns that hold numbers.
    """

    start: int
    length: int
    numbers: frozenset[int]


@dataclass(frozen=True)
class Place:
    """The line of the names, that of the first numbers, and the separator of both."""

    names: int
    numbers: int
    separator: str


def table_place(lines: Sequence[str], place: int) -> Place | None:
    """Look for another header than that at `place`, if no table of numbers follows that one.

    Parameters
    ----------
    lines : sequence of str
        The first lines of a file that are neither blank nor comments.
    place : int
        The line that `header_place` found.

    Returns
    -------
    Place or None
        None where the numbers follow the header that was found, or no names stand above them.

    Examples
    --------
    >>> block = ["Rate;50;50", "Gain;1;2", "t;u;y", "0;1;2", "1;2;3", "2;3;4"]
    >>> table_place(["Card;1;2", *block], 0)
    Place(names=3, numbers=4, separator=';')
    """
    if sum(map(len, lines)) > MOST_CHARACTERS or _followed(lines, place):
        return None
    if lines[place].count('"') % 2:
        return None  # a quoted name that goes on in the next line
    kinds = {sep: _runs([cells_of(line, sep) for line in lines]) for sep in SEPARATORS}
    found = [(run, sep) for sep, runs in kinds.items() for run in runs if run.length >= AGREEING]
    for run, separator in sorted(found, key=lambda one: (-one[0].length, -len(one[0].numbers))):
        names = _names_above(lines, run, separator)
        if names is not None:
            return Place(names, run.start, separator)
    return None


def _followed(lines: Sequence[str], place: int) -> bool:
    """Whether rows of numbers that fit it follow a header."""
    separator = separator_of(lines[place:])
    header, *rows = (cells_of(line, separator) for line in lines[place:])
    rows = rows[1:] if rows and any(unit_cells(rows[0], len(header))) else rows
    if all(len(row) == len(header) and any(is_value(c) for c in row if c) for row in rows):
        return len(rows) < AGREEING or _agree(rows)
    first = next(iter(_runs(rows)), None)
    if first is None or first.start:
        return False
    wide = len(first.numbers) > 1 and len(header) > max(first.numbers)
    return first.length == len(rows) or (wide and first.length >= AGREEING)


def _agree(rows: Sequence[Sequence[str]]) -> bool:
    """Whether the last row has numbers where the first has."""
    return next(iter(_runs([rows[0], rows[-1]])), Run(0, 0, frozenset())).length == 2


def _runs(rows: Iterable[Sequence[str]]) -> list[Run]:
    """Stretches of rows that agree, of two columns of numbers at least."""
    found: list[Run] = []
    start, numbers, texts = 0, frozenset[int](), frozenset[int]()

    def close(end: int) -> None:
        if len(numbers) > 1 and end > start:
            found.append(Run(start, end - start, numbers))

    number = -1
    for number, row in enumerate(rows):
        filled = [k for k, cell in enumerate(row) if not is_missing(cell)]
        own = frozenset(k for k in filled if is_value(row[k]))
        other = frozenset(filled) - own
        if not own or own & texts or other & numbers:
            close(number)
            start, numbers, texts = number, own, other
            if not own:
                start = number + 1
                texts = frozenset()
        else:
            numbers, texts = numbers | own, texts | other
    close(number + 1)
    return found


def _names_above(lines: Sequence[str], run: Run, separator: str) -> int | None:
    """The line that names all columns of numbers of a run."""
    above = islice(range(run.start - 1, -1, -1), FARTHEST)
    found: list[int] = []
    for k in above:
        cells = cells_of(lines[k], separator)
        if any(is_value(cell) for cell in cells if not is_missing(cell)):
            break
        if all(column < len(cells) and cells[column] for column in run.numbers):
            found.append(k)
        elif found or sum(map(bool, cells)) > 1:
            break
    if len(found) > 1 and _are_units(cells_of(lines[found[0]], separator)):
        return found[1]
    return found[0] if found else None


def _are_units(cells: Sequence[str]) -> bool:
    """Whether a line is one of units for certain, as names of columns may be as short."""
    filled = [cell for cell in cells if cell]
    bracketed = all(cell[0] + cell[-1] in ("[]", "()") for cell in filled)
    return any(unit_cells(cells, len(cells))) and (bracketed or filled[0] in SECONDS)


def labelled_units(lines: Sequence[str], separator: str, width: int) -> tuple[str, ...]:
    """Units that a line of the preamble gives column by column; blanks without such a line.

    Examples
    --------
    >>> labelled_units(["Y_Unit_Label;V;mm;", "X0;0;0;"], ";", 4)
    ('', 'V', 'mm', '')
    """
    for line in reversed(lines):
        label, *units = cells_of(line, separator) or [""]
        if len(units) == width - 1 and _UNIT_LABEL.fullmatch(label):
            return ("", *unit_cells(units, width - 1))
    return ("",) * width
