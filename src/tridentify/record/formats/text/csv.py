"""Delimited text (CSV, TSV) as an open file.

The first line that is no comment names the columns; a unit may follow in brackets, as in
``alpha [rad]``, or stand in a line of units below. A blank cell, ``nan``, ``NA``, ``-`` or the word
of an error (``#DIV/0!``, ``Bad``) is a missing sample; dates and times of day count from the first.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from tridentify.errors import DataWarning, shown
from tridentify.numerics.arrays import Array
from tridentify.record.formats.channels import CALLER, Channel, SampledFile, header_channel
from tridentify.record.formats.text.text_opening import TextTable
from tridentify.record.formats.text.text_rows import Passed
from tridentify.record.formats.text.text_table import open_table, read_columns


class TextFile(SampledFile):
    """A delimited text file as an `OpenFile`.

    Parameters
    ----------
    path : Path

    Raises
    ------
    UnreadableFileError, EmptyFileError, MissingHeaderError, DuplicateColumnError
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._table = open_table(path)
        self._lines: Sequence[int] = [0]
        self._told: set[str] = set()
        self.broken: tuple[str, ...] = ()
        self.channels = tuple(
            Channel(name, header_channel(name).name, "s", dated=True)
            if dated
            else _with_unit(header_channel(name), unit)
            for name, unit, dated in zip(
                self._table.names, self._table.units, self._table.dated, strict=True
            )
        )
        if self._table.titles:
            warnings.warn(_passed_over(self._table), DataWarning, stacklevel=CALLER)

    def read(self, indices: Sequence[int]) -> list[Array]:
        """Give columns as numbers, nan for a blank cell."""
        values, self._lines, passed = read_columns(self._table, indices)
        self._tell(passed)
        return values

    def read_on(self, indices: Sequence[int]) -> list[Array]:
        """Give columns without lines of text and rows of another length, which `broken` tells."""
        values, self._lines, passed = read_columns(self._table, indices, go_on=True)
        self.broken = tuple(map(str, passed.among))
        self._tell(passed)
        return values

    def _tell(self, passed: Passed) -> None:
        """Warn of what was left out below the rows, or was taken for missing, once each."""
        for text in left_out(self.path.name, passed):
            kind = text.rpartition("; ")[2]
            if kind not in self._told:
                self._told.add(kind)
                warnings.warn(text, DataWarning, stacklevel=CALLER + 1)

    def begins_with_text(self, index: int) -> bool:
        """Whether a column holds texts from its first row on."""
        return self._table.textual[index]

    def place(self, row: int) -> str:
        """Name a row by its line in the file."""
        line = self._lines[row] if len(self._lines) > 1 else self._lines[0] + row
        return f"line {line}"


def left_out(file: str, passed: Passed) -> list[str]:
    """Tell what is below the last row, and which words were taken for missing samples.

    Examples
    --------
    >>> left_out("run.csv", Passed(below=((9, "END"),)))
    ["found text below the last row of 'run.csv', in line 9 ('END'); left out"]
    """
    told = []
    if passed.below:
        first, last = passed.below[0], passed.below[-1]
        lines = f"line {first[0]}" if first == last else f"lines {first[0]} to {last[0]}"
        said = shown("; ".join(text for _, text in passed.below), 80)
        told.append(
            f"found text below the last row of {shown(file)}, in {lines} ({said}); left out"
        )
    if passed.words:
        count = sum(passed.words.values())
        cells = "a cell" if count == 1 else f"{count:,} cells"
        said = " or ".join(shown(word) for word, _ in passed.words.most_common(3))
        told.append(f"found {cells} of {shown(file)} with {said}; taken for missing samples")
    return [*told, *passed.said]


def _passed_over(table: TextTable) -> str:
    """Tell which lines above the header are not read."""
    count = len(table.titles)
    lines = "a line" if count == 1 else f"{count} lines"
    return (
        f"found {lines} above the header of {shown(table.path.name)} "
        f"({shown('; '.join(table.titles), 80)}); taken for a title and passed over"
    )


def _with_unit(channel: Channel, unit: str) -> Channel:
    return channel if channel.unit or unit in ("", "-") else replace(channel, unit=unit)
