"""ULog files of PX4 and others, by pyulog.

A channel is a field of a topic, ``vehicle_angular_velocity.xyz[1]``; of a topic that was logged by
several instances, the second is ``sensor_gyro#1.x`` and so on. Every topic has a clock of its own:
its time stamps, counted from the start of the vehicle. The format knows no units but that of time.
A file that is cut off in the middle of a message is read up to there, as the format foresees.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tridentify.errors import UnreadableFileError, shown
from tridentify.numerics.arrays import Array
from tridentify.record.formats.channels import Channel

STAMP = "timestamp"


class UlogFile:
    """An ULog file as an `OpenFile`."""

    def __init__(self, path: Path) -> None:
        from pyulog import ULog

        self.path = path
        log = ULog(str(path))
        if log.file_corruption:
            raise UnreadableFileError(
                f"found damaged messages in {shown(path.name)}; expected a sound ULog file; check "
                "that it was written and copied completely"
            )
        self._topics = {
            f"{data.name}#{data.multi_id}" if data.multi_id else str(data.name): data.data
            for data in log.data_list
        }
        self.channels = tuple(
            Channel(
                f"{topic}.{field}",
                f"{topic}.{field}",
                "us" if field == STAMP else "",
                topic,
                len(values),
            )
            for topic, fields in self._topics.items()
            for field, values in fields.items()
        )

    def read(self, indices: Sequence[int]) -> list[Array]:
        """Give fields as numbers."""
        chosen = [self.channels[index] for index in indices]
        return [
            np.asarray(
                self._topics[channel.clock][channel.name[len(channel.clock) + 1 :]],
                dtype=np.float64,
            )
            for channel in chosen
        ]

    def instants(self, clock: str) -> Array | None:
        """Give the time stamps of a topic [s]."""
        return np.asarray(self._topics[clock][STAMP], dtype=np.float64) * 1e-6

    def place(self, row: int) -> str:
        """Name a message by its number, from 1."""
        return f"message {row + 1}"


open_file = UlogFile
