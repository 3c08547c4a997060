"""Parquet and Feather (Arrow IPC) files, by polars; only the columns asked for are decoded."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tridentify.formats.channels import Channel, FloatArray
from tridentify.formats.frames import FrameTable, frame_channel

__all__ = ["ArrowFile", "open_file"]


class ArrowFile:
    """A Parquet or Feather file as an `OpenFile`."""

    def __init__(self, path: Path) -> None:
        import narwhals as nw
        import polars as pl

        self.path = path
        with path.open("rb") as stream:
            parquet = stream.read(4) == b"PAR1"
        scan = pl.scan_parquet if parquet else pl.scan_ipc
        self._lazy = scan(path, glob=False) if parquet else scan(path)
        rows = int(self._lazy.select(pl.len()).collect().item())
        schema = nw.from_native(self._lazy).collect_schema()
        self.channels: tuple[Channel, ...] = tuple(
            frame_channel(name, kind.is_temporal(), rows) for name, kind in schema.items()
        )

    def read(self, indices: Sequence[int]) -> list[FloatArray]:
        """Give columns as numbers, nan where nothing stands."""
        import narwhals as nw
        import polars as pl

        names = [self.channels[index].header for index in indices]
        frame = self._lazy.select([pl.col(name) for name in dict.fromkeys(names)]).collect()
        table = FrameTable(nw.from_native(frame, eager_only=True), self.path)
        known = [channel.header for channel in table.channels]
        return table.read([known.index(name) for name in names])

    def instants(self, clock: str) -> FloatArray | None:
        """Give nothing: the time is a column."""

    def place(self, row: int) -> str:
        """Name a row by its number, from 1."""
        return f"row {row + 1}"


open_file = ArrowFile
