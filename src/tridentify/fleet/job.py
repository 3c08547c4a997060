"""What is done with every record, and what comes of it: the words that a fleet shares.

A `Job` runs in a process of its own, beside the worker that hands it its records
(`workers.keeper`): whatever a record does to it is one `Outcome`, never the end of the run.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from tridentify.fleet.workers.job import CRASHED, OVER_TIME
from tridentify.record.formats.assemble import Wanted
from tridentify.record.record import Record

OVER_MEMORY = "over memory"
BAD_INPUT = "bad input"
NO_ANSWER = "no answer"
FAULT = "fault"
FAILURES = (BAD_INPUT, NO_ANSWER, OVER_TIME, OVER_MEMORY, CRASHED, FAULT)
"""Status of a record without an estimate: refused, not determined by its data, beyond a limit, the
end of its process, or an exception that is none of this package."""


class Place(Protocol):
    """Where the records of one unit lie."""

    @property
    def label(self) -> str:
        """The file, where there is one, for people."""

    def records(self, wanted: Wanted) -> tuple[Record, ...]:
        """Read them."""

    def trace(self) -> str:
        """A fingerprint of what could not be read; empty where there is none."""


@dataclass(frozen=True)
class Item:
    """One unit of the fleet.

    Attributes
    ----------
    key : str
        Its name, unlike all others.
    place : Place
    attempt : int
        How often it was tried before.
    about : tuple of float
        Coefficients that are its own, for a job that looks near them.
    """

    key: str
    place: Place
    attempt: int = 0
    about: tuple[float, ...] = ()

    def trace(self) -> str:
        """A fingerprint of what could not be read; empty where there is none."""
        return self.place.trace()
