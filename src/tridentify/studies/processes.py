"""Processes of their own for the same function over many things.

Every one computes with one thread, because sums over several threads round differently: so results
do not depend on how many there are.

Processes are spawned, not forked: it is the one way that works on every system and beside threads.
A script that calls this therefore needs ``if __name__ == "__main__":`` around the call.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager

from tridentify.errors import TridentifyError
from tridentify.numerics.threads import THREADS


@contextmanager
def process_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Processes for several rounds of work.

    Parameters
    ----------
    workers : int
        Most processes at a time.

    Yields
    ------
    ProcessPoolExecutor
        Shut down at the end; what has not begun by then is dropped. No process outlives this one.

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
