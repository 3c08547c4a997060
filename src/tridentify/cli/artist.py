"""A process beside this one that draws the figures of a report while the estimate is judged."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager

from tridentify.estimation.answer.estimate import Estimate
from tridentify.judgement.validation import Validation
from tridentify.record.record import Record
from tridentify.report.figures import Here, model_pictures, tests_pictures
from tridentify.report.pictures import Picture

PROCESSORS = 2
"""Fewer than these would only take turns."""


class Beside:
    """Draws in another process; in this one where that process cannot.

    Parameters
    ----------
    pool : executor
        Of one process.
    """

    def __init__(self, pool: ProcessPoolExecutor) -> None:
        self._pool = pool
        self._begun: Future[list[Picture]] | None = None
        pool.submit(_made_ready)

    def begin(self, estimate: Estimate, records: Sequence[Record]) -> None:
        """Have the figures of a model drawn: what is found about it later is not in them."""
        self._begun = self._pool.submit(model_pictures, estimate, tuple(records))

    def model(self, estimate: Estimate, records: Sequence[Record]) -> list[Picture]:
        """As `Here.model`; those that were begun, if any."""
        if self._begun is None:
            self.begin(estimate, records)
        assert self._begun is not None
        try:
            return self._begun.result()
        except BrokenProcessPool:
            return Here().model(estimate, records)

    def tests(self, validation: Validation) -> Callable[[], list[Picture]]:
        """As `Here.tests`; they are begun at once."""
        try:
            begun = self._pool.submit(tests_pictures, validation)
        except BrokenProcessPool:
            return Here().tests(validation)

        def finished() -> list[Picture]:
            try:
                return begun.result()
            except BrokenProcessPool:
                return Here().tests(validation)()

        return finished


def _made_ready() -> None:
    """Load what drawing needs."""
    import matplotlib.backends.backend_agg
    import matplotlib.backends.backend_svg  # noqa: F401


@contextmanager
def hired() -> Iterator[Beside | None]:
    """Who draws beside this process; None where there is no processor for it."""
    if not worth_it():
        yield None
        return
    from tridentify.studies.processes import process_pool

    with process_pool(1) as pool:
        yield Beside(pool)


def worth_it() -> bool:
    """Whether there is a processor for another process."""
    usable = getattr(os, "sched_getaffinity", None)
    count = len(usable(0)) if usable is not None else os.cpu_count() or 1
    return count >= PROCESSORS
