"""Rows of numbers from lines of CSV or JSON, and what is wrong with lines that give none.

Clean lines of CSV go through polars or `float` a block at a time. A block with anything unusual is
halved until few lines are left, and these are read one by one; both ways give the same numbers, so
that the result does not depend on how the bytes were cut.

What is recognised: JSON where the first line begins with a brace; the separator of CSV (comma,
semicolon, tab, bar) by its count in the first line; lines of comments that begin with ``#`` or
``%``, the last of which may be the header; a line of units below the header; a header that comes
again, also with its columns in another order. A cell that is blank, nan or null is missing.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, fields
from itertools import chain
from operator import itemgetter
from typing import Any

import numpy as np

from tridentify.errors import DataError, MissingHeaderError, UnitError, UnreadableFileError, shown
from tridentify.numerics.arrays import Array, Indices
from tridentify.record.checks.values import (
    check_keys,
    checked,
    finite_number,
    text_by_text,
    texts,
    whole_number,
)
from tridentify.record.formats.channels import SECONDS
from tridentify.record.formats.streams import blocks
from tridentify.record.formats.streams.header import Asked, HeaderColumns, find_columns
from tridentify.record.formats.streams.lines import LONGEST_LINE, WholeLines
from tridentify.record.formats.streams.read_rows import AROUND, BadLine, BadLineError, Rows, decoded
from tridentify.record.formats.text.cells import (
    SEPARATORS,
    all_numbers,
    has_decimal_comma,
    read_number,
    unit_cells,
)
from tridentify.record.formats.text.text_opening import COMMENTS, EXCEL
from tridentify.record.formats.text.title_lines import best_separator

_FEW = 16
"""Lines that are read one by one rather than in halves: those among them that are wrong are
named."""
_PARTS = ("lines", "form", "separator", "names", "header_units", "columns")
_BOM = b"\xef\xbb\xbf"


class RowReader:
    r"""Reads lines, of which the first say what the columns are.

    Parameters
    ----------
    asked : Asked

    Attributes
    ----------
    lines : int
        Lines that were read, all kinds.

    Examples
    --------
    >>> reader = RowReader(Asked(("u",), ("y",)))
    >>> rows = reader.read(WholeLines(b"t,u,y\n0,1,2\nx,1,3\n", 0, 20))
    >>> rows.values.tolist(), rows.problems[0].line
    ([[0.0, 1.0, 2.0]], 3)
    """

    def __init__(self, asked: Asked) -> None:
        self.asked = asked
        self.lines = 0
        self._form = asked.form
        self._separator = ""
        self._names: tuple[str, ...] = ()
        self._columns: HeaderColumns | None = None
        self._units: dict[str, str] = {}
        self._line = self._first = 1
        self._former: list[tuple[int, tuple[str, ...], HeaderColumns]] = []
        self._comment = ""
        self._skipped: set[int] = set()
        self._problems: dict[int, str] = {}

    # ------------------------------------------------------------------------------ saved, resumed
    def to_dict(self, line: int) -> dict[str, Any]:
        """Give what the lines up to this one have said, as plain values.

        Parameters
        ----------
        line : int
            One of those that were read last.
        """
        names, columns = self._names, self._columns
        for number, former_names, former_columns in reversed(self._former):
            if line < number:
                names, columns = former_names, former_columns
        return {
            "lines": line,
            "form": self._form,
            "separator": self._separator,
            "names": list(names),
            "header_units": self._units,
            "columns": asdict(columns) if columns else None,
        }

    def go_on_from(self, document: Mapping[str, Any]) -> None:
        """Take up what `to_dict` gave.

        Raises
        ------
        TypeError, ValueError
            It cannot have given that.
        """
        check_keys(document, _PARTS)
        self.lines = whole_number(document["lines"])
        self._form, self._separator = document["form"], document["separator"]
        csv_lines = self._form == "csv" and self._separator in tuple(SEPARATORS)
        if not csv_lines and (self._form, self._separator) != ("json", ""):
            raise ValueError("lines that are neither CSV nor JSON")
        self._names = texts(document["names"])
        self._units = text_by_text(document["header_units"])
        if csv_lines or document["columns"] is not None:
            self._columns = self._columns_from(document["columns"])

    def _columns_from(self, document: Mapping[str, Any]) -> HeaderColumns:
        check_keys(document, [one.name for one in fields(HeaderColumns)])
        found = HeaderColumns(
            texts(document["headers"]),
            tuple(whole_number(place) for place in checked(document["places"], list)),
            whole_number(document["width"]),
            finite_number(document["scale"]),
            tuple((name, unit) for name, unit in map(texts, checked(document["units"], list))),
        )
        asked = self.asked
        wanted = len(asked.inputs) + len(asked.outputs) + (not asked.uniform)
        headers = tuple(self._names[place] for place in found.places)
        if (len(headers), found.width) != (wanted, len(self._names)) or headers != found.headers:
            raise ValueError("columns that are not those of the names")
        if len(set(found.places)) < wanted or found.scale not in SECONDS.values():
            raise ValueError("columns that stand for several things")
        return found

    @property
    def units(self) -> dict[str, str]:
        """Units of the channels, as far as the header says."""
        return dict(self._columns.units) if self._columns else {}

    @property
    def clock(self) -> str:
        """The column of time; empty without one."""
        columns = self._columns
        return "" if columns is None or self.asked.uniform else columns.headers[0]

    # --------------------------------------------------------------------------------------- rows
    def read(self, lines: WholeLines) -> Rows:
        """Read whole lines.

        Parameters
        ----------
        lines : WholeLines
            What follows the lines before.

        Returns
        -------
        Rows

        Raises
        ------
        MissingHeaderError, MissingColumnError, DuplicateColumnError, SamplingError, UnitError
            The first lines do not say what the columns are.
        UnreadableFileError
            They are no text.
        """
        text, first = lines.text, self.lines + 1
        self._first = first
        self._skipped, self._problems, self._former = set(), {}, []
        if lines.too_long:
            self.lines += 1
            said = f"found a line of {lines.stop - lines.start} bytes; expected at most "
            self._problems[0] = f"{said}{LONGEST_LINE}"
            stops = np.array([lines.stop])
            return self._rows(self._nothing(1), first, stops)
        ends = np.flatnonzero(np.frombuffer(text, dtype=np.uint8) == 10) + 1
        opened = 0
        while not self._open and opened < len(ends):
            begin = int(ends[opened - 1]) if opened else 0
            if self._read_opening(text[begin : int(ends[opened])]):
                self._skipped.add(opened)
                opened += 1
                self.lines += 1
        body = int(ends[opened - 1]) if opened else 0
        values = [self._nothing(opened)]
        if opened < len(ends):
            values.append(self._body(text[body:], ends[opened:] - body, opened))
            self.lines += len(ends) - opened
        return self._rows(np.concatenate(values), first, ends + lines.start)

    def _rows(self, values: Array, first: int, stops: Indices) -> Rows:
        dropped = set(self._skipped)
        if not (self.asked.uniform and self._open):
            dropped.update(self._problems)
        numbers = np.arange(first, first + len(stops))
        problems = [BadLine(first + k, text) for k, text in sorted(self._problems.items())]
        if dropped:
            keep = np.ones(len(stops), dtype=np.bool_)
            keep[list(dropped)] = False
            values, numbers, stops = values[keep], numbers[keep], stops[keep]
        return Rows(values, numbers, stops, problems)

    def _nothing(self, n_rows: int) -> Array:
        asked = self.asked
        return np.full(
            (n_rows, len(asked.inputs) + len(asked.outputs) + (not asked.uniform)), np.nan
        )

    # ------------------------------------------------------------------------------- the beginning
    @property
    def _open(self) -> bool:
        return self._form == "json" or self._columns is not None

    def _read_opening(self, line: bytes) -> bool:
        """Learn from one of the first lines; say whether it holds nothing more than that."""
        text = self._opening_text(line)
        if not text or text.startswith(COMMENTS) or EXCEL.fullmatch(text):
            self._comment = text.lstrip("#% ") if text.startswith(COMMENTS) else self._comment
            return True
        if not self._form:
            self._form = "json" if text.startswith("{") else "csv"
        if self._form == "json":
            return False
        if self._names:
            return self._read_units(text)
        self._separator = best_separator(text)
        try:
            cells = [cell.strip() for cell in self._cells(text)]
        except BadLineError as error:
            raise MissingHeaderError(
                f"found damaged quotes ({shown(text)}) in the first line of {self.asked.name}; "
                "expected the names of the columns; correct the header"
            ) from error
        numeric = all_numbers(cells) or any(
            cell and read_number(cell, self.asked.decimal) is not None for cell in cells
        )
        if self.asked.columns:
            self._find(self.asked.columns)
            return not numeric
        if not all_numbers(cells):
            self._names = tuple(cells)
            return True
        commented = [cell.strip() for cell in self._comment.split(self._separator)]
        if len(commented) != len(cells) or all_numbers(commented):
            raise MissingHeaderError(
                f"found numbers ({shown(text)}) in the first line of {self.asked.name}; expected "
                "the names of the columns; add a header line or name them (--columns t,u,y)"
            )
        self._find(commented)
        return False

    def _read_units(self, text: str) -> bool:
        try:
            cells = self._cells(text)
        except BadLineError:
            # no units; as a row it is counted among the bad ones
            cells = []
        units = unit_cells(cells, len(self._names))
        self._units = {n: u for n, u in zip(self._names, units, strict=True) if u}
        try:
            self._find(self._names)
        except UnitError:
            if not self._units:
                raise
            # text, but no units
            self._units = {}
            self._find(self._names)
        return bool(self._units)

    def _find(self, names: Sequence[str]) -> None:
        units = [self._units.get(name, "") for name in names]
        self._columns = find_columns(names, units, self.asked)
        self._names = tuple(names)

    def _opening_text(self, line: bytes) -> str:
        if self.lines == 0:
            line = line.removeprefix(_BOM)
            if line[:2] in (b"\xff\xfe", b"\xfe\xff"):
                raise UnreadableFileError(
                    f"found UTF-16 in {self.asked.name}; expected lines of UTF-8 text; convert it"
                )
        if b"\0" in line:
            raise UnreadableFileError(
                f"found binary content in line {self.lines + 1} of {self.asked.name}; expected "
                "lines of CSV or JSON; check the source"
            )
        try:
            return line.decode("utf-8").strip(AROUND)
        except UnicodeDecodeError:
            return line.decode("latin-1").strip(AROUND)

    def _body(self, text: bytes, ends: Indices, offset: int) -> Array:
        """Read lines; `offset` is the number of the first one in what is read now."""
        csv_lines = self._form == "csv"
        values = (self._quick_csv if csv_lines else self._quick_json)(text, ends)
        if values is not None:
            return values
        if len(ends) <= _FEW:
            line = self._csv_line if csv_lines else self._json_line
            return self._one_by_one(line, text, ends, offset)
        half = len(ends) // 2
        cut = int(ends[half - 1])
        left = self._body(text[:cut], ends[:half], offset)
        return np.concatenate([left, self._body(text[cut:], ends[half:] - cut, offset + half)])

    # ---------------------------------------------------------------------------------------- CSV
    def _quick_csv(self, text: bytes, ends: Indices) -> Array | None:
        """Read lines that are as plain as can be, or give None."""
        columns, separator = self._columns, self._separator.encode()
        assert columns is not None
        if any(mark in text for mark in (b'"', b"_", b"#", b"%")) or not text.isascii():
            return None
        marks = np.flatnonzero(np.frombuffer(text, dtype=np.uint8) == separator[0])
        inner = columns.width - 1
        if len(marks) != len(ends) * inner:
            return None
        if inner:
            starts = np.concatenate([[0], ends[:-1]])
            if (marks[::inner] < starts).any() or (marks[inner - 1 :: inner] >= ends).any():
                return None
        if self.asked.decimal == ",":
            if b"." in text:
                return None
            text = text.replace(b",", b".")
        read = blocks.read_with_polars if len(ends) >= blocks.MANY else blocks.read_with_float
        values = read(text, separator.decode(), columns, len(ends))
        return None if values is None else self._sound(values)

    def _sound(self, values: Array) -> Array | None:
        """Give rows with their time in seconds; None if any of them has to be refused."""
        assert self._columns is not None
        if not self.asked.uniform:
            values[:, 0] *= self._columns.scale
            if np.isnan(values[:, 0]).any():
                return None
        return None if np.isinf(values).any() else values

    def _one_by_one(
        self, read: Callable[[str], list[float] | None], text: bytes, ends: Indices, offset: int
    ) -> Array:
        values = self._nothing(len(ends))
        begin = 0
        for k, end in enumerate(ends.tolist()):
            self._line = self._first + offset + k
            try:
                row = read(decoded(text[begin:end]))
                if row is None:
                    self._skipped.add(offset + k)
                else:
                    values[k] = row
            except BadLineError as error:
                self._problems[offset + k] = str(error)
            begin = end
        return values

    def _csv_line(self, text: str) -> list[float] | None:
        """Read a line of CSV; None if it holds no row and that is right."""
        if not text or text.startswith(COMMENTS):
            return None
        cells, columns = self._cells(text), self._columns
        assert columns is not None
        width = columns.width
        if self._is_header(cells):
            return None
        if len(cells) < width or any(cell.strip() for cell in cells[width:]):
            raise BadLineError(f"found {len(cells)} cells; expected {width}")
        return self._checked([self._cell(cells[place]) for place in columns.places])

    def _cell(self, cell: str) -> float | str:
        number = read_number(cell, self.asked.decimal)
        return cell.strip() if number is None else number

    def _checked(self, found: Sequence[float | str]) -> list[float]:
        columns = self._columns
        assert columns is not None
        row = []
        for name, value in zip(columns.headers, found, strict=True):
            if isinstance(value, str):
                where = f"found {shown(value)} in column {shown(name)}"
                comma = self.asked.decimal == "." and has_decimal_comma(value)
                hint = ' with a decimal point, or --decimal ","' if comma else ""
                raise BadLineError(f"{where}; expected a number{hint}")
            if math.isinf(value):
                raise BadLineError(
                    f"found {value} in column {shown(name)}; expected a finite number"
                )
            row.append(value)
        if not self.asked.uniform:
            row[0] *= columns.scale
            if not math.isfinite(row[0]):
                raise BadLineError(
                    f"found no time in column {shown(columns.headers[0])}; expected a number"
                )
        return row

    def _is_header(self, cells: Sequence[str]) -> bool:
        """Whether the header comes again; if its columns are in another order, follow it."""
        columns = self._columns
        assert columns is not None
        names = tuple(cell.strip() for cell in cells)
        if not set(columns.headers) <= set(names) or all_numbers(names):
            return False
        if names != self._names:
            former = (self._line, self._names, columns)
            try:
                self._find(names)
            except DataError:
                return False
            self._former.append(former)
        return True

    def _cells(self, text: str) -> list[str]:
        if '"' not in text:
            return text.split(self._separator)
        try:
            return next(csv.reader([text], delimiter=self._separator))
        except csv.Error as error:
            raise BadLineError(f"found damaged quotes ({error}); expected numbers") from error

    # --------------------------------------------------------------------------------------- JSON
    def _quick_json(self, text: bytes, ends: Indices) -> Array | None:
        """Read lines of numbers and null that are as plain as can be, or give None."""
        if self._columns is None:
            return None
        wanted, lines = itemgetter(*self._columns.headers), []
        try:
            for line in text.replace(b"\r\n", b"\n").decode("utf-8").split("\n")[:-1]:
                found, end = _SCAN(line)
                if end != len(line):
                    return None
                lines.append(wanted(found))
            if not set(map(type, chain.from_iterable(lines))) <= _NUMBERS:
                return None
            values = np.array(lines, dtype=np.float64)
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
            return None
        return self._sound(values)

    def _json_line(self, text: str) -> list[float] | None:
        if not text:
            return None
        try:
            found = _DECODE(text)
        except json.JSONDecodeError as error:
            raise BadLineError(
                f"found broken JSON ({error.msg} at character {error.pos + 1}); expected an object"
            ) from error
        except (ValueError, RecursionError) as error:
            raise BadLineError("found no usable JSON; expected a flat object") from error
        if not isinstance(found, dict):
            raise BadLineError(f"found {shown(found)}; expected a JSON object")
        if self._columns is None:
            try:
                self._find(tuple(found))
            except DataError as error:
                raise BadLineError(str(error)) from error
        columns = self._columns
        assert columns is not None
        try:
            return self._checked([blocks.plain_number(found[name]) for name in columns.headers])
        except KeyError as error:
            raise BadLineError(
                f"found no {shown(error.args[0])} in the object; expected it, or null where a "
                "sample is missing"
            ) from error


_DECODE = json.JSONDecoder().decode
_SCAN = json.JSONDecoder().raw_decode
_NUMBERS = {float, int, type(None)}
