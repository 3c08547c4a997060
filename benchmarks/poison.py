"""What `fleet.py` gives its workers, who import it by this name: records that go wrong, and a job
that does nothing."""

from __future__ import annotations

import os
import signal
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rival import fit as by_hand

from tridentify import Estimate, Record, Structure, ThreeModel
from tridentify.fleet.attempt import RecordJob
from tridentify.fleet.job import Item
from tridentify.record.formats.assemble import Wanted

Array = NDArray[np.float64]


MARKS = {1e6 * (k + 1): one for k, one in enumerate(("exception", "endless loop", "crash", "huge"))}
"""First value of the input -> what happens: rows of a data set have no name."""


@dataclass(frozen=True)
class Poisoned:
    """`ThreeModel`, but records of some names, or marks, do what no record should."""

    name: str = "poisoned"

    def estimate(
        self, records: Sequence[Record], structure: Structure, progress: Any = None
    ) -> Estimate:
        kind = MARKS.get(float(records[0].u[0, 0]), records[0].name)
        if kind == "endless loop":
            while True:
                pass
        if kind == "crash":
            os.kill(os.getpid(), signal.SIGSEGV)
        if kind == "huge":
            np.ones(1 << 36)
        if kind == "exception":
            raise ZeroDivisionError("nobody thought of this")
        return ThreeModel().estimate(records, structure, progress)


@dataclass(frozen=True)
class Nothing(RecordJob):
    """A job that does nothing."""

    wanted: Wanted = Wanted(["u"], ["y"])  # noqa: RUF009 - frozen

    def begin(self) -> None:
        """Nothing."""

    def run(self, item: Item, records: Sequence[Record]) -> dict[str, Any]:
        return {}


def fit_by_hand(u: Array, y: Array, dt: float) -> list[float]:
    """The rival's answer."""
    return [float(v) for v in by_hand(u, y, dt).theta]
