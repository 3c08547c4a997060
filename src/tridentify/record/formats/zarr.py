"""Zarr stores: every array of one dimension in a group is a channel, read part by part.

The columns of an array of two dimensions are ``y[0]``, ``y[1]``, ... as in NumPy archives.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tridentify.errors import LengthMismatchError, UnreadableFileError, shown
from tridentify.numerics.arrays import Array
from tridentify.record.formats.channels import Channel, SampledFile, header_channel, real_numbers
from tridentify.record.formats.requirements import require

MARKS = ("zarr.json", ".zgroup", ".zarray")
"""Files by which the folder of a store is known, versions 3 and 2."""


class ZarrStore(SampledFile):
    """A Zarr store as a file that is read in parts."""

    def __init__(self, path: Path) -> None:
        require("zarr", "zarr", "a Zarr store")
        import zarr

        self.path = path
        opened: Any = zarr.open(str(path), mode="r")
        named = {"x": opened} if hasattr(opened, "shape") else dict(opened.arrays())
        self._places: list[tuple[Any, int | None]] = []
        channels: list[Channel] = []
        for name in sorted(named):
            array, samples = named[name], int(named[name].shape[0]) if named[name].shape else 0
            if len(array.shape) == 1:
                channels.append(header_channel(name, samples))
                self._places.append((array, None))
            elif len(array.shape) == 2:
                for k in range(array.shape[1]):
                    channels.append(header_channel(f"{name}[{k}]", samples))
                    self._places.append((array, k))
        lengths = {channel.samples or 0 for channel in channels}
        if not lengths or min(lengths) < 1:
            raise UnreadableFileError(
                f"found no array of samples in {shown(path.name)}; expected arrays of one or two "
                "dimensions, samples first; name the group that holds them"
            )
        if len(lengths) > 1:
            raise LengthMismatchError(
                f"found arrays of {min(lengths)} and {max(lengths)} samples in {shown(path.name)}; "
                "expected one length; name a group whose arrays were sampled together"
            )
        self.channels = tuple(channels)
        self.n_samples = lengths.pop()

    def part(self, indices: Sequence[int], start: int, stop: int) -> Array:
        """(stop - start, n) samples of some channels; positions in `channels`."""
        columns = []
        for index in indices:
            array, column = self._places[index]
            rows = array[start:stop] if column is None else array[start:stop, column]
            columns.append(real_numbers(rows, shown(self.channels[index].header), self.path))
        return np.column_stack(columns)

    def read(self, indices: Sequence[int]) -> list[Array]:
        """Give channels as numbers."""
        return list(self.part(indices, 0, self.n_samples).T)
