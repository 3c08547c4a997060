"""Columns of numbers from a block of plain CSV lines, all at once or not at all.

Both ways read the same numbers, those that `float` reads. polars is the quicker one where there are
many lines; it gives up on a block as soon as one cell is no number.
"""

from __future__ import annotations

import io
import math

import numpy as np

from tridentify.errors import shown
from tridentify.numerics.arrays import Array
from tridentify.record.formats.streams.header import HeaderColumns
from tridentify.record.formats.text.cells import MISSING

MANY = 256
"""Lines from which polars is the quicker one."""
_BLANK = {token.encode(): b"nan" for word in MISSING for token in (word, word.upper())} | {
    b"NaN": b"nan"
}


def read_with_float(
    text: bytes, separator: str, columns: HeaderColumns, n_rows: int
) -> Array | None:
    """Read some columns of lines, cell by cell.

    Parameters
    ----------
    text : bytes
        Lines of equally many cells, each with its line feed; no quotes, no comments.
    separator : str
    columns : HeaderColumns
    n_rows : int
        Number of lines.

    Returns
    -------
    ndarray, shape (n_rows, n_columns), or None
        None if a cell is no number.
    """
    cells = text[:-1].replace(b"\n", separator.encode()).split(separator.encode())
    values = np.empty((n_rows, len(columns.places)))
    for k, place in enumerate(columns.places):
        column = cells[place :: columns.width]
        try:
            values[:, k] = list(map(float, column))
        except ValueError:
            try:
                values[:, k] = [float(_BLANK.get(cell.strip(), cell)) for cell in column]
            except ValueError:
                return None
    return values


def read_with_polars(
    text: bytes, separator: str, columns: HeaderColumns, n_rows: int
) -> Array | None:
    """Read some columns of lines by polars; otherwise as `read_with_float`."""
    import polars as pl

    order = sorted(set(columns.places))
    kinds = [pl.Float64 if k in order else pl.String for k in range(columns.width)]
    try:
        frame = pl.read_csv(
            io.BytesIO(text),
            separator=separator,
            has_header=False,
            columns=order,
            schema_overrides=kinds,
            infer_schema_length=0,
            null_values=[token.decode() for token in _BLANK if token],
        )
    except pl.exceptions.PolarsError:
        return None
    if frame.height != n_rows or any(kind != pl.Float64 for kind in frame.dtypes):
        return None
    found = frame.to_numpy()
    return np.array(found[:, [order.index(place) for place in columns.places]], order="C")


def plain_number(value: object) -> float | str:
    """Give the number that a value of JSON is, nan for null, text to be shown for what is none."""
    if type(value) is float:
        return value
    if value is None:
        return math.nan
    if type(value) is int:
        try:
            return float(value)
        except OverflowError:
            return math.inf
    return str(value) if isinstance(value, (str, bool)) else shown(value)
