"""The same function over many batches, in processes of their own.

What makes the results independent of the number of processes: a batch carries all that its result
depends on (no shared random numbers), results come back in the order of the batches, and every
process computes with one thread, because sums over several threads round differently. For the last
reason one worker is a process of its own, too.

Processes are spawned, not forked: it is the one way that works on every system and beside threads.
A script that calls this therefore needs ``if __name__ == "__main__":`` around the call.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TypeVar

from tridentify.errors import TridentifyError
from tridentify.numerics.threads import THREADS
from tridentify.writing.interruption import held_back

Batch = TypeVar("Batch")
Result = TypeVar("Result")


def run_batches(
    function: Callable[[Batch], Result],
    batches: Sequence[Batch],
    *,
    workers: int,
    finished: Callable[[int], None] | None = None,
) -> list[Result]:
    """Call ``function`` on every batch.

    Parameters
    ----------
    function : callable
        Importable by its name, as are its argument and its result.
    batches : sequence
    workers : int
        Most processes at a time.
    finished : callable, optional
        Told the number of a batch when it is done, in whatever order that happens.

    Returns
    -------
    list
        In the order of the batches.

    Raises
    ------
    TridentifyError
        A process died.

    Notes
    -----
    What ends the call early, such as Ctrl-C or an exception in a batch, waits for the batches that
    are being computed and drops the others. No process outlives the calling one.

    Examples
    --------
    >>> run_batches(abs, [], workers=2)
    []
    """
    if not batches:
        return []
    results: dict[int, Result] = {}
    with process_pool(min(workers, len(batches))) as pool:
        with held_back():  # processes start with the first tasks
            numbers = {pool.submit(function, batch): k for k, batch in enumerate(batches)}
        for future in as_completed(numbers):
            results[numbers[future]] = future.result()
            if finished is not None:
                finished(numbers[future])
    return [results[k] for k in range(len(batches))]


@contextmanager
def process_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Processes as `run_batches` has them, for several rounds of work.

    Parameters
    ----------
    workers : int
        Most processes at a time.

    Yields
    ------
    ProcessPoolExecutor
        Shut down at the end; what has not begun by then is dropped.

    Raises
    ------
    TridentifyError
        A process died.
    """
    with _one_thread_each():
        pool = ProcessPoolExecutor(
            workers,
            mp_context=multiprocessing.get_context("spawn"),
            initializer=_obey_the_caller,
        )
        try:
            yield pool
        except BrokenProcessPool as error:
            raise TridentifyError(
                "found a worker process that died; expected it to finish its work; use fewer "
                "workers if memory is short, and in a script make the call below "
                'if __name__ == "__main__":'
            ) from error
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes started meanwhile have single-threaded linear algebra.

    The libraries read these variables once, when they are loaded, so that they must stand before
    the process starts; the calling process, where they are loaded already, does not notice.
    """
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _obey_the_caller() -> None:
    """Leave Ctrl-C to the calling process, and end with it even if it is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    caller = multiprocessing.parent_process()

    def follow() -> None:
        assert caller is not None
        caller.join()
        os.kill(os.getpid(), signal.SIGTERM)

    if caller is not None:
        threading.Thread(target=follow, daemon=True).start()
