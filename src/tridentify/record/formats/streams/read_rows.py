"""Rows that were read from lines, and lines that gave none."""

from __future__ import annotations

from dataclasses import dataclass

from tridentify.numerics.arrays import Array, Indices

AROUND = " \r\n\v\f"  # a tab may stand beside a blank cell


@dataclass(frozen=True)
class BadLine:
    """A line that gives no row: its number, from 1, and what was found and expected."""

    line: int
    text: str


@dataclass(frozen=True)
class Rows:
    """Rows of consecutive lines.

    Attributes
    ----------
    values : ndarray, shape (n_rows, n_columns)
        Time if there is a column of it, inputs, outputs; nan where nothing stands.
    lines : ndarray of int, shape (n_rows,)
        Number of the line of each row.
    stops : ndarray of int, shape (n_rows,)
        Position in the source behind the line of each row.
    problems : list of BadLine
        Lines that give no row (or, for a known step, one of nan), in their order.
    """

    values: Array
    lines: Indices
    stops: Indices
    problems: list[BadLine]


class BadLineError(Exception):
    """A line gives no row."""


def decoded(line: bytes) -> str:
    """Text of a line, without what stands around it.

    Raises
    ------
    BadLineError
    """
    try:
        return line.decode("utf-8").removeprefix("\ufeff").strip(AROUND)
    except UnicodeDecodeError as error:
        raise BadLineError(
            f"found the byte 0x{line[error.start]:02x}, which is no UTF-8; expected text"
        ) from error
