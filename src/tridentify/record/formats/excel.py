"""Excel workbooks (``.xlsx``), by openpyxl: every sheet is read as the text table that it shows.

So title lines, a line of units, ``NA`` and ``-``, dates and times of day mean what they mean in
delimited text (`text.text_table`). Formulas count with the value that was last saved, an
error such as ``#DIV/0!`` is a missing sample.

Where several sheets hold numbers their channels are ``Sheet1.alpha``, ``Sheet2.alpha``, each sheet
with a clock of its own: its column ``t`` or ``time``.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import replace
from datetime import date, datetime, time, timedelta
from pathlib import Path
from typing import Any

from tridentify.numerics.arrays import Array
from tridentify.record.formats.channels import SECONDS, Channel, SampledFile
from tridentify.record.formats.text.cells import SEPARATORS
from tridentify.record.formats.text.csv import TextFile
from tridentify.record.formats.time.serial_days import clock_seconds
from tridentify.record.formats.time_names import named_time

ERRORS = frozenset(("#DIV/0!", "#N/A", "#NAME?", "#NULL!", "#NUM!", "#REF!", "#VALUE!"))


class ExcelFile(SampledFile):
    """A workbook as an `OpenFile`.

    Parameters
    ----------
    path : Path

    Raises
    ------
    EmptyFileError, MissingHeaderError, DuplicateColumnError
        As for delimited text, of the first sheet that holds numbers.
    """

    def __init__(self, path: Path) -> None:
        from openpyxl import load_workbook

        self.path = path
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        with path.open("rb") as stream:  # it judges a path by its suffix
            book: Any = load_workbook(stream, read_only=True, data_only=True)
            tables = [(sheet.title, *self._table(sheet)) for sheet in book.worksheets]
        several = [(title, file) for title, file, numbers in tables if numbers] or [
            (title, file) for title, file, _ in tables[:1]
        ]
        self._sheets = {title: TextFile(file) for title, file in several}
        self._places: list[tuple[str, int]] = []
        found: list[Channel] = []
        for title, sheet in self._sheets.items():
            for number, channel in enumerate(sheet.channels):
                self._places.append((title, number))
                found.append(channel if len(self._sheets) == 1 else _of_sheet(channel, title))
        self.channels = tuple(found)

    def read(self, indices: Sequence[int]) -> list[Array]:
        """Give channels as numbers, nan for a blank cell."""
        wanted = [self._places[index] for index in indices]
        columns: dict[tuple[str, int], Array] = {}
        for title, sheet in self._sheets.items():
            numbers = [number for name, number in wanted if name == title]
            columns |= zip(
                [(title, number) for number in numbers],
                sheet.read(numbers) if numbers else [],
                strict=True,
            )
        return [columns[place] for place in wanted]

    def instants(self, clock: str) -> Array | None:
        """Give the column of a sheet that is called t or time [s], if it is the only one."""
        # channels of one sheet alone do not name it
        sheet = self._sheets[clock] if clock else next(iter(self._sheets.values()))
        named = named_time([channel.name for channel in sheet.channels])
        if len(named) != 1 or sheet.channels[named[0]].unit not in SECONDS:
            return None
        return clock_seconds(sheet.channels[named[0]], sheet.read(named)[0])

    def _table(self, sheet: Any) -> tuple[Path, bool]:
        """Write a sheet as text; say where, and whether it holds numbers."""
        # some programs write a range that is too small
        sheet.reset_dimensions()
        rows = [_stripped(map(cell_text, row)) for row in sheet.iter_rows(values_only=True)]
        width = max(map(len, rows), default=0)
        folder = Path(tempfile.mkdtemp(dir=self._folder.name))
        file = folder / self.path.name
        with file.open("w", encoding="utf-8", newline="") as stream:
            for row in rows:
                padded = [*row, *[""] * (width - len(row))] if row else []
                stream.write(",".join(map(_quoted, padded)) + "\n")
        return file, any(cell[:1].isdigit() for row in rows for cell in row)


def _of_sheet(channel: Channel, title: str) -> Channel:
    return replace(channel, header=f"{title}.{channel.header}", clock=title)


def _stripped(cells: Iterable[str]) -> list[str]:
    row = list(cells)
    while row and not row[-1]:
        row.pop()
    return row


def cell_text(value: object) -> str:
    """Write the value of a cell as delimited text would have it.

    Examples
    --------
    >>> [cell_text(value) for value in (None, 0.5, True, "#N/A", timedelta(hours=30), time(9, 5))]
    ['', '0.5', '1', '', '30:00:00.000000', '09:05:00']
    """
    if value is None or value in ERRORS:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, timedelta):
        seconds = value // timedelta(seconds=1)
        return (
            f"{seconds // 3600}:{seconds // 60 % 60:02}:{seconds % 60:02}.{value.microseconds:06}"
        )
    if isinstance(value, datetime | date | time):
        return value.isoformat()
    return " ".join(str(value).split())


def _quoted(cell: str) -> str:
    if any(mark in cell for mark in SEPARATORS + '"'):
        return '"' + cell.replace('"', '""') + '"'
    return cell


open_file = ExcelFile
