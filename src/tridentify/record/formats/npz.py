"""NumPy archives (``.npz``), without pickle: an array of objects is refused, never loaded.

Every array of one dimension is a channel, ``t`` or ``alpha [deg]``; the columns of one of two
dimensions are ``y[0]``, ``y[1]``, ...
"""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path

import numpy as np

from tridentify.errors import ForeignObjectError, TextInColumnError, UnreadableFileError, shown
from tridentify.numerics.arrays import Array
from tridentify.record.formats.channels import Channel, header_channel
from tridentify.record.formats.isolation import check_size

__all__ = ["NpzFile", "open_file"]

MOST_COLUMNS = 1000
"""As of `matlab_tree`: more columns than that are samples, on their side."""


@dataclass(frozen=True)
class ArchiveMember:
    """Where a channel stands in the archive."""

    array: str
    column: int | None


class NpzFile:
    """A NumPy archive as an `OpenFile`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        channels: list[Channel] = []
        self._sources: list[ArchiveMember] = []
        self._kinds: dict[str, np.dtype[np.generic]] = {}
        self._sizes: dict[str, int] = {}
        with zipfile.ZipFile(path) as archive:
            arrays = [entry for entry in archive.infolist() if entry.filename.endswith(".npy")]
            if not arrays:
                raise UnreadableFileError(
                    f"found a ZIP archive without arrays in {shown(path.name)}; expected an NPZ "
                    "file of NumPy or an Excel workbook (.xlsx); unpack another archive"
                )
            for entry in arrays:
                name = entry.filename.removesuffix(".npy")
                shape, self._kinds[name] = _array_header(archive, entry)
                self._sizes[name] = max(8, self._kinds[name].itemsize) * prod(shape)
                if len(shape) == 1:
                    channels.append(header_channel(name, shape[0]))
                    self._sources.append(ArchiveMember(name, None))
                elif len(shape) == 2 and shape[1] <= MOST_COLUMNS:
                    unit = header_channel(name)
                    for k in range(shape[1]):
                        label = f"{unit.name}[{k}]"
                        channels.append(Channel(label, label, unit.unit, samples=shape[0]))
                        self._sources.append(ArchiveMember(name, k))
        self.channels = tuple(channels)

    def read(self, indices: Sequence[int]) -> list[Array]:
        """Give channels as numbers."""
        arrays: dict[str, Array] = {}
        wanted = {self._sources[index].array for index in indices}
        # one column asked for, the whole array unpacked, and turned to float
        check_size(sum(self._sizes[name] for name in wanted), self.path)
        with np.load(self.path, allow_pickle=False) as archive:
            for name in dict.fromkeys(self._sources[index].array for index in indices):
                self._check_kind(name)
                arrays[name] = np.asarray(archive[name], dtype=np.float64)
        return [
            arrays[source.array]
            if source.column is None
            else arrays[source.array][:, source.column]
            for source in (self._sources[index] for index in indices)
        ]

    def instants(self, clock: str) -> Array | None:
        """Give nothing: the time is an array."""

    def place(self, row: int) -> str:
        """Name a sample by its number, from 1."""
        return f"sample {row + 1}"

    def _check_kind(self, name: str) -> None:
        kind = self._kinds[name]
        if kind.hasobject:
            raise ForeignObjectError(
                f"found Python objects in array {shown(name)} of {shown(self.path.name)}; expected "
                "numbers, since objects would have to be unpickled, which can run any program; "
                "save the array as float"
            )
        if kind.kind not in "fiub":
            raise TextInColumnError(
                f"found {kind} in array {shown(name)} of {shown(self.path.name)}; expected real "
                "numbers; save the array as float"
            )


def _array_header(
    archive: zipfile.ZipFile, entry: zipfile.ZipInfo
) -> tuple[tuple[int, ...], np.dtype[np.generic]]:
    with archive.open(entry) as stream:
        version = np.lib.format.read_magic(stream)
        read = np.lib.format.read_array_header_1_0
        if version != (1, 0):
            read = np.lib.format.read_array_header_2_0
        shape, _, kind = read(stream)
    if any(extent < 0 for extent in shape):
        raise ValueError(f"array of shape {shown(shape)}")
    return shape, kind


open_file = NpzFile
