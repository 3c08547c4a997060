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

from tridentify.errors import UnreadableFileError, shown
from tridentify.numerics.arrays import Array
from tridentify.record.formats.apart.isolation import check_size
from tridentify.record.formats.channels import (
    Channel,
    SampledFile,
    header_channel,
    real_numbers,
    refuse_objects,
)
from tridentify.record.formats.npy import MOST_COLUMNS, read_header


@dataclass(frozen=True)
class ArchiveMember:
    """Where a channel stands in the archive."""

    array: str
    column: int | None


class NpzFile(SampledFile):
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
                what = f"array {shown(name)}"
                refuse_objects(self._kinds[name], f"{what} of {shown(self.path.name)}")
                arrays[name] = real_numbers(archive[name], what, self.path)
        return [
            arrays[source.array]
            if source.column is None
            else arrays[source.array][:, source.column]
            for source in (self._sources[index] for index in indices)
        ]


def _array_header(
    archive: zipfile.ZipFile, entry: zipfile.ZipInfo
) -> tuple[tuple[int, ...], np.dtype[np.generic]]:
    with archive.open(entry) as stream:
        shape, _, kind = read_header(stream)
    if any(extent < 0 for extent in shape):
        raise ValueError(f"array of shape {shown(shape)}")
    return shape, kind


open_file = NpzFile
