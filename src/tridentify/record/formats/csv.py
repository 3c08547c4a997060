"""Delimited text (CSV, TSV) as an open file.

The first line that is no comment names the columns; a unit may follow in brackets, as in
``alpha [rad]``, or stand in a line of units below. A blank cell, ``nan``, ``NA`` or ``-`` is a
missing sample; dates and times of day count from the first one.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from tridentify.errors import DataWarning, shown
from tridentify.numerics.arrays import Array
from tridentify.record.formats.channels import CALLER, Channel, SampledFile, header_channel
from tridentify.record.formats.text_table import TextTable, open_table, read_columns


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
        values, self._lines = read_columns(self._table, indices)
        return values

    def place(self, row: int) -> str:
        """Name a row by its line in the file."""
        line = self._lines[row] if len(self._lines) > 1 else self._lines[0] + row
        return f"line {line}"


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
