"""Parquet and Feather (Arrow IPC) files, by polars; only the columns asked for are decoded.

A column that holds no numbers is refused by its declared type, before anything of it is unpacked.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tridentify.numerics.arrays import Array
from tridentify.record.formats.channels import SampledFile
from tridentify.record.formats.frames import FrameTable, frame_channel, not_numbers

if TYPE_CHECKING:
    import polars as pl


class ArrowFile(SampledFile):
    """A Parquet or Feather file as an `OpenFile`."""

    def __init__(self, path: Path) -> None:
        import narwhals as nw
        import polars as pl

        self.path = path
        with path.open("rb") as stream:
            parquet = stream.read(4) == b"PAR1"
        plain = _plainly_named(path)
        self._lazy = pl.scan_parquet(plain, glob=False) if parquet else pl.scan_ipc(plain)
        rows = int(self._lazy.select(pl.len()).collect().item())
        self._kinds = dict(nw.from_native(self._lazy).collect_schema())
        self.n_samples = rows
        self.channels = tuple(
            frame_channel(name, kind.is_temporal(), rows) for name, kind in self._kinds.items()
        )

    def read(self, indices: Sequence[int]) -> list[Array]:
        """Give columns as numbers, nan where nothing stands."""
        return self._columns(indices, self._lazy)

    def part(self, indices: Sequence[int], start: int, stop: int) -> Array:
        """(stop - start, n) samples of some columns, of which only these rows are decoded."""
        return np.column_stack(self._columns(indices, self._lazy.slice(start, stop - start)))

    def _columns(self, indices: Sequence[int], rows: pl.LazyFrame) -> list[Array]:
        import narwhals as nw
        import polars as pl

        names = [self.channels[index].header for index in indices]
        for name in names:
            kind = self._kinds[name]
            if not (kind.is_numeric() or kind.is_temporal() or kind == nw.Boolean):
                raise not_numbers(kind, name, self.path)
        frame = rows.select([pl.col(name) for name in dict.fromkeys(names)]).collect()
        table = FrameTable(nw.from_native(frame, eager_only=True), self.path)
        known = [channel.header for channel in table.channels]
        return table.read([known.index(name) for name in names])

    def place(self, row: int) -> str:
        """Name a row by its number, from 1."""
        return f"row {row + 1}"


def _plainly_named(path: Path) -> Path:
    """Give a name in UTF-8 without brackets, which polars takes for patterns, to the same file."""
    if not re.search(r"[*?\[\]{}\udc80-\udcff]", str(path)):
        return path
    alias = Path(tempfile.mkdtemp(), "file")
    try:
        alias.symlink_to(path.absolute())
    except (OSError, NotImplementedError):
        return path
    return alias


open_file = ArrowFile
