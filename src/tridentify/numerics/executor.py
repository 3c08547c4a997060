"""What runs tasks side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Protocol


class Executor(Protocol):
    """Any executor of `concurrent.futures`, or of a library that has its `map`."""

    def map(self, function: Callable[[Any], Any], /, *iterables: Iterable[Any]) -> Iterable[Any]:
        """Results in the order of the arguments."""
