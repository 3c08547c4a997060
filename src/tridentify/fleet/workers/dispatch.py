"""Items to workers in batches of about a second, a few in flight, and each of them accounted for.

How many items are a second is measured as the batches come back. What a worker gives back is a
few numbers; the parent holds the items of the batches in flight and nothing else. A batch that was
lost with its worker is handed out again, in the end item by item: what is lost with every worker
that takes it gets a row that says so.
"""

from __future__ import annotations

import itertools
import secrets
import time
from collections.abc import Callable, Hashable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from tridentify.errors import TridentifyError
from tridentify.fleet.workers.engines import Engine

Item = TypeVar("Item")

LEAST_SECONDS = 1.0
"""What a batch takes, about: a thousand times what it costs to hand it out, and no more is lost
with a worker [s]."""

MOST_SECONDS = 10.0
"""What a batch takes at most in a long run, so that a million records are not a million files
[s]."""

SHARE = 0.01
"""A batch takes this share of the time that the run has taken so far, within the limits above."""

FIRST = 8
"""Items of the first batches, while nothing is measured: half a second for short records."""

MOST = 5000
"""Items of a batch, however quick they are."""

IN_FLIGHT = 4
"""Batches for each worker: one at work, and enough waiting to bridge the way to the parent."""

HANDED_OUT = 3
"""How often the same batch is given to workers that are lost with it, before it is taken apart."""

GONE = (
    "found the scheduler gone, or the way to it; expected it to stay until the end; start one and "
    "run it again: what is done is kept"
)


@dataclass
class Batches:
    """Which items make up the next batch.

    Attributes
    ----------
    kind : callable
        Item -> what its time depends on; by default all take about the same.
    rates : dict
        Kind -> seconds an item, measured.
    """

    kind: Callable[[Any], Hashable] = lambda _: None
    rates: dict[Hashable, float] = field(default_factory=dict)
    _began: float = field(default_factory=time.monotonic)

    def take(self, items: Iterator[Item]) -> tuple[Item, ...]:
        """The next batch, empty at the end.

        Parameters
        ----------
        items : iterator

        Examples
        --------
        >>> items, batches = iter(range(100)), Batches()
        >>> batches.take(items)
        (0, 1, 2, 3, 4, 5, 6, 7)
        >>> batches.measured(8, 4.0)
        >>> batches.take(items)
        (8, 9)
        """
        spent = time.monotonic() - self._began
        wanted = min(max(SHARE * spent, LEAST_SECONDS), MOST_SECONDS)
        taken: list[Item] = []
        expected = 0.0
        for item in items:
            taken.append(item)
            rate = self.rates.get(self.kind(item), wanted / FIRST)
            expected += rate
            # one more like this would be further from what is wanted
            if expected + 0.5 * rate > wanted or len(taken) == MOST:
                break
        return tuple(taken)

    def measured(self, count: int, seconds: float, kind: Hashable = None) -> None:
        """Take in what items of a kind took; the last few batches count.

        Parameters
        ----------
        count : int
        seconds : float
            Of all of them [s].
        kind : hashable, optional
        """
        if count:
            own, before = max(seconds / count, 1e-6), self.rates.get(kind)
            self.rates[kind] = own if before is None else 0.7 * before + 0.3 * own


@dataclass(frozen=True)
class Lost:
    """An item whose workers were lost with it, again and again."""

    item: Any
    reason: str


@dataclass(frozen=True)
class _Flying:
    name: str
    items: tuple[Any, ...]
    handed_out: int = 1


def dispatch(
    items: Iterator[Item],
    engine: Engine,
    function: Callable[[Any], Any],
    task: Callable[[str, tuple[Item, ...]], Any],
    batches: Batches,
) -> Iterator[tuple[tuple[Item, ...], Any]]:
    """Hand out all items; the results come as they are ready.

    Parameters
    ----------
    items : iterator
    engine : Engine
    function : callable
        What workers do, importable by its name.
    task : callable
        Makes its argument of the name of a batch and its items.
    batches : Batches
        Is told what the batches take by whoever takes the results.

    Yields
    ------
    items : tuple
        Of one batch.
    result : object
        Of ``function``; `Lost` for an item that no worker survives.

    Raises
    ------
    TridentifyError
        What ``function`` raises: the disk is full, no process can be started. The scheduler is
        gone.
    """
    run = secrets.token_hex(4)
    numbers = itertools.count()
    flying: dict[Future[Any], _Flying] = {}

    def launch(batch: _Flying) -> None:
        try:
            future = engine.executor.submit(function, task(batch.name, batch.items))
        except Exception as error:
            if type(error).__name__ != "ClosedClientError":
                raise
            raise TridentifyError(GONE) from error
        flying[future] = batch

    try:
        more = True
        while more or flying:
            while more and len(flying) < IN_FLIGHT * engine.width:
                taken = batches.take(items)
                more = bool(taken)
                if taken:
                    launch(_Flying(f"{run}-{next(numbers):07d}", taken))
            if not flying:
                return
            done = wait(flying, return_when=FIRST_COMPLETED).done
            for future in sorted(done, key=lambda one: one.cancelled()):
                if future.cancelled():  # not by us: Dask does so when it has no scheduler any more
                    raise TridentifyError(GONE)
                batch = flying.pop(future)
                error = future.exception()
                if error is None:
                    yield batch.items, future.result()
                elif isinstance(error, TridentifyError | MemoryError) or not _lost(error):
                    raise error
                elif batch.handed_out < HANDED_OUT:
                    launch(replace(batch, handed_out=batch.handed_out + 1))
                elif len(batch.items) > 1:
                    for k, item in enumerate(batch.items):
                        launch(_Flying(f"{batch.name}-{k:04d}", (item,)))
                else:
                    yield batch.items, Lost(batch.items[0], " ".join(str(error).split()))
    finally:
        for future in flying:
            future.cancel()


def _lost(error: BaseException) -> bool:
    """Whether a batch went down with its worker, or its result with the way back."""
    return isinstance(error, OSError) or type(error).__name__ in (
        *("KilledWorker", "CancelledError", "FutureCancelledError", "BrokenProcessPool"),
        *("CommClosedError", "LostRunError", "FutureLostError"),
    )
