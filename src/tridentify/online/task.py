"""Work beside the stream: a slice a sample, in a number of slices that the samples alone decide.

A search or a look at the slow clock takes as long as hundreds of samples. It is therefore a
generator (`numerics.slices`) on the samples and numbers that there were when it began, and every
sample pays for one slice of it. How many slices are done stands in the vector of the estimator;
what they have come to stands here, where all states that came of one beginning share it. So a step
stays a pure function of its state: a state that was left behind finds the slices done already, and
one that was read from a file does them again.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from tridentify.numerics.slices import Slices
from tridentify.numerics.threads import one_blas_thread


class Task:
    """A generator that remembers how far it is.

    Parameters
    ----------
    begin : callable
        Gives the generator; a function of a module, so that the task can be pickled.
    arguments : any
        Of ``begin``; nothing may change them.

    Examples
    --------
    >>> def adding(one):
    ...     yield
    ...     return one + 1
    >>> task = Task(adding, 1)
    >>> task.over_after(2), task.over_after(3), task.result()
    (False, True, 2)
    """

    def __init__(self, begin: Callable[..., Slices[Any]], *arguments: Any) -> None:
        self._begin, self._arguments = begin, arguments
        self._slices: Slices[Any] | None = begin(*arguments)
        self._done, self._found = 0, None
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[Any, ...]:
        return Task, (self._begin, *self._arguments)

    def over_after(self, count: int) -> bool:
        """Whether it is over before the last of so many slices; does those that are missing.

        So whoever makes use of the result has a step for that alone.
        """
        with self._lock, one_blas_thread():
            while self._slices is not None and self._done < count:
                self._next()
        return self._slices is None and self._done < count

    def result(self) -> Any:
        """What it comes to; does all that is missing."""
        with self._lock, one_blas_thread():
            while self._slices is not None:
                self._next()
        return self._found

    def _next(self) -> None:
        assert self._slices is not None
        self._done += 1
        try:
            next(self._slices)
        except StopIteration as end:
            self._slices, self._found = None, end.value
