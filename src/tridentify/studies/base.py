"""The seam: what a study is, and what it gives back.

A study is a frozen set of options with a name, a line that says what it shows, and one verb,
`Study.run`. Its result is numbers; pictures of them are drawn on a higher floor.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

Count = Callable[[int, int], None]
"""Told how many of how many records are done."""


@runtime_checkable
class StudyResult(Protocol):
    """What a study found."""

    def table(self) -> str:
        """Text for people: the numbers, and what they can and cannot mean."""

    def to_dict(self) -> dict[str, Any]:
        """Numbers for machines: lists, text, finite numbers, and None where there is no number."""


@runtime_checkable
class Study(Protocol):
    """A study: options only, no data."""

    @property
    def name(self) -> str:
        """What the command line calls it."""

    @property
    def description(self) -> str:
        """What it shows, in a few words."""

    def run(
        self,
        *,
        draws: int = 200,
        seed: int = 0,
        workers: Any = None,
        progress: Count | None = None,
    ) -> StudyResult:
        """Run it.

        Parameters
        ----------
        draws : int
            Noise draws per condition.
        seed : int
            Of all draws. The result does not depend on anything else.
        workers : int, str or distributed.Client, optional
            Processes, by default as many as there are processors, or those of a Dask scheduler.
        progress : callable, optional
            Called with the number of records that are done and the number of all records.

        Returns
        -------
        StudyResult

        Raises
        ------
        OptionError
            For numbers that make no sense.
        """
