"""Cells of a table as text: numbers, times, missing samples and units."""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tridentify.numerics.arrays import Array
from tridentify.record.formats.time.dates import read_moment

SEPARATORS = ",;\t|"
MISSING = frozenset(("", "na", "n/a", "#n/a", "nan", "null", "none", "-nan", "-", "--"))

ERROR_WORDS = frozenset(
    (
        *("#div/0!", "#value!", "#ref!", "#name?", "#num!", "#null!", "#nan", "nan(ind)"),
        *("-nan(ind)", "1.#qnan", "-1.#qnan", "1.#ind", "-1.#ind", "bad", "bad input", "no data"),
        *("nodata", "i/o timeout", "invalid", "---", "----", "-----", "------"),
    )
)
"""What workbooks, runtime libraries and historians write in the place of a number that failed."""

_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
_GROUPED = re.compile(r"[-+]?[1-9]\d{0,2}([,.' \u00a0\u2009\u202f’])\d{3}(\1\d{3})*([.,]\d*)?")
_COMMA_GROUP = re.compile(r"[-+]?[1-9]\d{0,2},\d{3}")
_UNIT_CELL = re.compile(r"[\[(]?\s*(1/)?[^\W\d]?[^\d,;|\t=:\"'?!][^,;|\t=:\"'?!]{0,18}[\])]?")


def is_missing(cell: str) -> bool:
    """Whether a cell says that there is no sample."""
    text = cell.strip().lower()
    return text in MISSING or text in ERROR_WORDS


def is_error_word(cell: str) -> bool:
    """Whether a cell says that its number failed.

    Examples
    --------
    >>> is_error_word("#DIV/0!"), is_error_word("NA")
    (True, False)
    """
    return cell.strip().lower() in ERROR_WORDS


def read_number(cell: str, decimal: str = ".") -> float | None:
    """Give the number a cell holds, nan when it is blank, None when it is text.

    Examples
    --------
    >>> read_number(" 3,5 %", ","), read_number("%"), read_number("3 m")
    (3.5, None, None)
    """
    text = cell.strip()
    if is_percentage(text):
        text = text[:-1].rstrip()
    if text.lower() in MISSING:
        return math.nan
    if decimal == ",":
        # with a point as well, one of the two would have to group thousands
        text = "_" if "." in text else text.replace(",", ".", 1)
    try:
        # Python alone reads 1_000 as a number
        return None if "_" in text else float(text)
    except ValueError:
        return None


def is_percentage(cell: str) -> bool:
    """Whether a cell ends in a percent sign behind a digit or a point."""
    number = cell.strip().removesuffix("%").rstrip()
    return cell.strip() != number and number[-1:].isdecimal() and cell.strip()[-1:] == "%"


def is_value(cell: str) -> bool:
    """Whether a cell is a number, with either decimal sign, or a time."""
    numbers = (read_number(cell, decimal) is not None for decimal in ".,")
    return any(numbers) or read_moment(cell) is not None


def all_numbers(cells: Sequence[str]) -> bool:
    """Whether all cells that are not blank are numbers."""
    return all(read_number(cell) is not None for cell in cells if cell)


def unit_cells(cells: Sequence[str], width: int) -> tuple[str, ...]:
    """Give the units of a line of units, or blanks if the line is none."""
    texts = [cell.strip() for cell in cells]
    blank = ("",) * width
    if len(texts) != width or not any(len(text) > 0 for text in texts):
        return blank
    if any(is_value(text) and text != "-" for text in texts if text) or not all(
        _UNIT_CELL.fullmatch(text) or text in ("", "-", "°", "%", "1") for text in texts
    ):
        return blank
    return tuple(re.sub(r"^[\[(]\s*|\s*[\])]$", "", text) for text in texts)


def has_decimal_comma(cell: str) -> bool:
    """Whether a cell is a number with a decimal comma.

    Examples
    --------
    >>> has_decimal_comma("1,5"), has_decimal_comma("1.5")
    (True, False)
    """
    return _DECIMAL_COMMA.fullmatch(cell.strip()) is not None


def has_groups(cell: str) -> bool:
    """Whether a cell may be a number with groups of thousands.

    Examples
    --------
    >>> has_groups("1,234.5"), has_groups("1,23")
    (True, False)
    """
    return _GROUPED.fullmatch(cell.strip()) is not None


class Numbers:
    """A column of numbers that is read cell by cell."""

    def __init__(self, decimal: str) -> None:
        self.decimal = decimal
        self.groups = _Groups()
        self._values = array("d")
        self._percentages: bool | None = None

    def take(self, cell: str, line: int) -> bool:
        """Take a cell; False if it is no number, or the only one with or without a % behind it."""
        number = read_number(cell, self.decimal)
        if number is None:
            return False
        if not math.isnan(number):
            if is_percentage(cell) != (self._percentages is True) and self._percentages is not None:
                return False
            self._percentages = is_percentage(cell)
        self._values.append(number)
        if self.decimal == ",":
            self.groups.note(cell.strip(), line)
        return True

    def drop(self) -> None:
        """Drop the last one."""
        self._values.pop()

    def values(self) -> Array:
        """All of them."""
        return np.array(self._values, dtype=np.float64)


@dataclass
class _Groups:
    """Whether a column with commas may be one of whole numbers with groups of thousands.

    It may if every comma has three digits behind it and one to three before it, and other cells are
    whole numbers without a comma: then nothing tells 1,234 from 1234.
    """

    cell: str = ""
    line: int = 0
    whole: bool = False
    decimals: bool = False

    def note(self, cell: str, line: int) -> None:
        """Look at one cell."""
        if "," not in cell:
            self.whole = self.whole or cell not in ("", "0")
        elif _COMMA_GROUP.fullmatch(cell):
            self.cell, self.line = cell, line
        else:
            self.decimals = True

    @property
    def ambiguous(self) -> bool:
        """Whether nothing speaks for a decimal comma."""
        return bool(self.cell) and self.whole and not self.decimals
