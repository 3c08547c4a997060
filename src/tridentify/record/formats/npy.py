"""NumPy arrays (``.npy``), without pickle, part by part: only what is asked for is ever in memory.

The columns of an array of two dimensions are ``x[0]``, ``x[1]``, ...; an array of one dimension is
``x``, and the fields of a structured one are channels by their names. A part is mapped and copied,
and the map is dropped again: a map that stays would count as memory, page by page.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import prod
from pathlib import Path
from typing import IO, Any

import numpy as np

from tridentify.errors import UnreadableFileError, shown
from tridentify.numerics.arrays import Array
from tridentify.record.formats.apart.isolation import check_size
from tridentify.record.formats.channels import (
    SampledFile,
    header_channel,
    real_numbers,
    refuse_objects,
)

MARK = b"\x93NUMPY"
"""What a file of NumPy begins with."""

MOST_COLUMNS = 1000
"""Columns of an array; more are samples lying on their side."""


def read_header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, whether the first index runs fastest, and kind of the array that follows."""
    first = np.lib.format.read_magic(stream) == (1, 0)
    formats = np.lib.format
    return (formats.read_array_header_1_0 if first else formats.read_array_header_2_0)(stream)


class NpyFile(SampledFile):
    """A NumPy array as an `OpenFile`, and as one that is read in parts."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with path.open("rb") as stream:
            self._shape, self._fortran, self._kind = read_header(stream)
            self._begin = stream.tell()
        self._check_shape()
        self.n_samples = int(self._shape[0])
        names = self._kind.names or (
            ("x",) if len(self._shape) == 1 else [f"x[{k}]" for k in range(self._shape[1])]
        )
        self.channels = tuple(header_channel(name, self.n_samples) for name in names)

    def _check_shape(self) -> None:
        """Refuse what is no table, and a file that ends before the array does."""
        name, shape = shown(self.path.name), self._shape
        wide = len(shape) == 2 and (shape[1] > MOST_COLUMNS or self._kind.names is not None)
        if len(shape) not in (1, 2) or wide or min(shape) < 1:
            raise UnreadableFileError(
                f"found an array of shape {shape} in {name}; expected samples in rows and channels "
                f"in at most {MOST_COLUMNS} columns; save it transposed or reshaped"
            )
        expected = self._begin + prod(shape) * self._kind.itemsize
        there = self.path.stat().st_size
        refuse_objects(self._kind, name)
        if there < expected:
            raise UnreadableFileError(
                f"found {there} bytes in {name}; expected {expected} for an array of shape "
                f"{shape}: the file was cut off; write it anew"
            )

    def part(self, indices: Sequence[int], start: int, stop: int) -> Array:
        """(stop - start, n) samples of some channels; positions in `channels`."""
        columns = []
        mapped = np.memmap(
            self.path, self._kind, "r", self._begin, self._shape, "F" if self._fortran else "C"
        )
        for index in indices:
            rows: Any = mapped[start:stop]
            if self._kind.names:
                rows = rows[self._kind.names[index]]
            elif len(self._shape) == 2:
                rows = rows[:, index]
            columns.append(real_numbers(rows, shown(self.channels[index].header), self.path))
        return np.column_stack(columns)

    def read(self, indices: Sequence[int]) -> list[Array]:
        """Give channels as numbers."""
        check_size(8 * len(indices) * self.n_samples, self.path)
        return list(self.part(indices, 0, self.n_samples).T)


open_file = NpyFile
