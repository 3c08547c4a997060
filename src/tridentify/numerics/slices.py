"""Long work in slices: a generator that pauses where it may, run whole or a little at a time.

Work that is done beside a stream must not hold a sample up, so it is written as a generator that
yields between pieces of a few milliseconds at most, and whose value is the result. Whoever need not
pause asks for all of it at once.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeAlias, TypeVar

T = TypeVar("T")
Slices: TypeAlias = Generator[None, None, T]


def drain(slices: Slices[T]) -> T:
    """All slices one after the other.

    Examples
    --------
    >>> def adding():
    ...     total = 1
    ...     yield
    ...     return total + 1
    >>> drain(adding())
    2
    """
    while True:
        try:
            next(slices)
        except StopIteration as end:
            found: T = end.value
            return found
