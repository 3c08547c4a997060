"""A process beside this one that draws the figures of a report while the estimate is judged."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING

from tridentify.estimation.answer.estimate import Estimate
from tridentify.judgement.validation import Validation
from tridentify.record.record import Record
from tridentify.writing.interruption import held_back

if TYPE_CHECKING:
    from tridentify.report.figures import Numbers
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
        with held_back():  # the process starts with its first task
            pool.submit(_made_ready)

    def begin(self, estimate: Estimate, records: Sequence[Record]) -> None:
        """Have the figures of a model drawn: what is found about it later is not in them.

        What is simulated for them is worked out here, where the compiled functions are loaded.
        """
        from tridentify.report.figures import Numbers

        given = estimate, tuple(records), Numbers.of(estimate, records)
        self._begun = self._pool.submit(_model, *given)

    def model(self, estimate: Estimate, records: Sequence[Record]) -> list[Picture]:
        """As `Here.model`; those that were begun, if any."""
        if self._begun is None:
            self.begin(estimate, records)
        assert self._begun is not None
        try:
            return self._begun.result()
        except BrokenProcessPool:
            return _model(estimate, records)

    def tests(self, validation: Validation) -> Callable[[], list[Picture]]:
        """As `Here.tests`; they are begun at once."""
        try:
            begun = self._pool.submit(_tests, validation)
        except BrokenProcessPool:
            return partial(_tests, validation)

        def finished() -> list[Picture]:
            try:
                return begun.result()
            except BrokenProcessPool:
                return _tests(validation)

        return finished


def _model(
    estimate: Estimate, records: Sequence[Record], numbers: Numbers | None = None
) -> list[Picture]:
    from tridentify.report.figures import model_pictures

    return model_pictures(estimate, records, numbers)


def _tests(validation: Validation) -> list[Picture]:
    from tridentify.report.figures import tests_pictures

    return tests_pictures(validation)


def _made_ready() -> None:
    """Load what drawing needs, and draw once: fonts, and the reader of powers of ten."""
    from matplotlib.figure import Figure

    import tridentify.report.figures  # noqa: F401

    figure = Figure()
    axes = figure.add_subplot()
    axes.loglog([1.0, 10.0], [1.0, 10.0])
    figure.savefig(io.StringIO(), format="svg")


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
