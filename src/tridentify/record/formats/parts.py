"""Files that are read part by part: which formats can be, and a part as an open file of its own.

Parquet, Feather and NumPy arrays (``.npy``) say where a row stands, so that a stretch of rows can
be read without those before it; so do Zarr stores. Text does not.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, cast

from tridentify.errors import TridentifyError, UnreadableFileError, shown
from tridentify.numerics.arrays import Array
from tridentify.record.formats import npy
from tridentify.record.formats.arrow import ArrowFile
from tridentify.record.formats.channels import Channel, OpenFile
from tridentify.record.formats.text.text_opening import check_readable
from tridentify.record.formats.zarr import MARKS, ZarrStore

ARROW_MARKS = (b"PAR1", b"ARROW1")
"""What Parquet and Feather files begin with."""


class PartedFile(OpenFile, Protocol):
    """A file of which a stretch of rows can be read."""

    @property
    def n_samples(self) -> int:
        """Rows."""

    def part(self, indices: Sequence[int], start: int, stop: int) -> Array:
        """(stop - start, n) samples of some channels; positions in `channels`."""


@dataclass(frozen=True)
class Part:
    """Rows ``start`` to ``stop - 1`` of a file, as an `OpenFile`."""

    source: PartedFile
    start: int
    stop: int

    @property
    def path(self) -> Path:
        """Of the whole file."""
        return self.source.path

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Those of the file."""
        return tuple(replace(one, samples=self.stop - self.start) for one in self.source.channels)

    def read(self, indices: Sequence[int]) -> list[Array]:
        """Give channels as numbers."""
        return list(self.source.part(indices, self.start, self.stop).T)

    def instants(self, clock: str) -> Array | None:
        """Give what the file knows."""
        return self.source.instants(clock)

    def place(self, row: int) -> str:
        """Say where in the whole file a row of the part stands."""
        return self.source.place(self.start + row)


def has_parts(path: str | os.PathLike[str]) -> bool:
    """Whether a file is one of those that are read part by part.

    Examples
    --------
    >>> has_parts("nowhere.parquet")
    False
    """
    file = Path(path)
    if file.is_dir():
        return any((file / mark).exists() for mark in MARKS)
    try:
        with file.open("rb") as stream:
            start = stream.read(8)
    except OSError:
        return False
    return start.startswith((*ARROW_MARKS, npy.MARK))


def open_parts(path: str | os.PathLike[str]) -> PartedFile:
    """Open a file that is read part by part.

    Raises
    ------
    UnreadableFileError
        It is of another format, damaged, or cut off.
    MissingDependencyError
        It is a Zarr store, and the library is not installed.
    """
    file = Path(path)
    if file.is_dir():
        if has_parts(file):
            return ZarrStore(file)
        raise UnreadableFileError(
            f"found the folder {shown(str(file))}; expected a file, or a Zarr store; name the file"
        )
    start = check_readable(file)
    if not start.startswith((*ARROW_MARKS, npy.MARK)):
        raise UnreadableFileError(
            f"found neither Parquet nor Feather nor a NumPy array in {shown(file.name)}; expected "
            "a format of which parts can be read; convert it to Parquet, or read it whole with "
            "read_record"
        )
    try:
        made = npy.NpyFile(file) if start.startswith(npy.MARK) else ArrowFile(file)
    except TridentifyError:
        raise
    except Exception as error:  # of the library that reads it, of whatever kind
        raise damaged(file, error) from error
    return cast("PartedFile", made)


def damaged(path: Path, error: Exception) -> UnreadableFileError:
    """Make the error about a file that its library cannot read to the end."""
    said = str(error).partition("\n")[0]
    return UnreadableFileError(
        f"found {shown(path.name)} damaged ({shown(said, 120)[1:-1]}); expected a file that was "
        "written to its end; write it anew"
    )
