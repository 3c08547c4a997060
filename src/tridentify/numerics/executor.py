"""What runs tasks side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Protocol

from tridentify.errors import OptionError


class Executor(Protocol):
    """Any executor of `concurrent.futures`, or of a library that has its `map`."""

    def map(self, function: Callable[[Any], Any], /, *iterables: Iterable[Any]) -> Iterable[Any]:
        """Results in the order of the arguments."""


def mapping_of(executor: Executor | None) -> Callable[..., Iterable[Any]]:
    """The `map` that runs the tasks: one after the other where there is no executor.

    Raises
    ------
    OptionError
        What is given is no executor.

    Examples
    --------
    >>> list(mapping_of(None)(abs, [-1, 2]))
    [1, 2]
    """
    if executor is None:
        return map
    if not callable(getattr(executor, "map", None)):
        raise OptionError.found(
            "executor=", executor, "an executor of concurrent.futures", "leave it out, or make one"
        )
    return executor.map


def check_told(progress: object) -> None:
    """Refuse what cannot be told of the progress.

    Raises
    ------
    OptionError
        It is neither left out nor callable.
    """
    if not (progress is None or callable(progress)):
        raise OptionError.found(
            "progress=", progress, "a function of one text", "give print, or leave it out"
        )
