"""What is done with many items, and what comes of each: the words that all who work share.

A `Job` runs in a process of its own, beside the worker that hands it its items (`keeper`,
`child`): whatever an item does to it is one `Outcome`, never the end of the run.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

OVER_TIME = "over time"
CRASHED = "crashed"
"""Status of an item that took longer than the limit, or whose process ended."""


class Item(Protocol):
    """Something that a job is done with."""

    def trace(self) -> str:
        """A fingerprint of what went down with its process; empty where there is none."""


@dataclass(frozen=True)
class Limits:
    """What one item may take.

    Attributes
    ----------
    seconds : float
        From the first byte read to the answer [s].
    memory : int
        Of its process [bytes]; 0 for as much as the system gives.
    """

    seconds: float
    memory: int = 0


@dataclass(frozen=True)
class Outcome:
    """What came of one item.

    Attributes
    ----------
    item : Item
    value : dict
        What the job gave, as JSON can hold it; empty if it failed.
    status, message, exception : str
        Why it failed; empty if it did not.
    seconds : float
        What it took, reading included [s].
    fingerprint : str
        Of the records, or of the file if they could not be read; empty where nothing is read.
    """

    item: Any
    value: dict[str, Any] = field(default_factory=dict)
    status: str = ""
    message: str = ""
    exception: str = ""
    seconds: float = 0.0
    fingerprint: str = ""

    @property
    def failed(self) -> bool:
        """Whether there is no value."""
        return bool(self.status)


class Job(Protocol):
    """What is done with an item, in a process that may crash."""

    def begin(self) -> None:
        """Load and compile what is needed, before any item's time runs."""

    def attempt(self, item: Any, read: Callable[[str], None]) -> dict[str, Any]:
        """The fields of `Outcome` beside the item, as JSON can hold them.

        ``read`` is told the fingerprint of what was read, so that it is known if the process ends.
        """
