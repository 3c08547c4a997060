"""The child processes of this process, which outlive one batch.

A worker is a thread with a child process of its own (`keeper`): of this program, or of a Dask
worker anywhere.
"""

from __future__ import annotations

import atexit
import contextlib
import threading
from collections.abc import Iterator

from tridentify.fleet.workers.job import Limits
from tridentify.fleet.workers.keeper import Keeper


class Workers:
    """The children of this process: one for each thread that has work, others at rest."""

    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._busy: list[Keeper] = []
        self._resting: list[Keeper] = []

    @contextlib.contextmanager
    def keeper(self, limits: Limits) -> Iterator[Keeper]:
        """A child for the calling thread; one that rests, if it has the same memory."""
        with self._guard:
            fits = [one for one in self._resting if one.limits.memory == limits.memory]
            found = fits[0] if fits else Keeper(limits)
            self._resting = [one for one in self._resting if one is not found]
            self._busy.append(found)
        found.limits = limits
        try:
            yield found
        finally:
            with self._guard:
                self._busy.remove(found)
                if not found.closed:
                    found.rest()
                    self._resting.append(found)

    def interrupt(self) -> None:
        """End the children at work; the threads that wait for them are told."""
        with self._guard:
            for keeper in self._busy:
                keeper.close()

    def close(self) -> None:
        """End all children."""
        self.interrupt()
        with self._guard:
            for keeper in self._resting:
                keeper.close()
            self._resting = []


WORKERS = Workers()
"""Of this process; a Dask worker has no other place to keep them between two tasks."""
atexit.register(WORKERS.close)
