"""Who does the work: one worker, several of this machine, or those of a Dask scheduler.

All are executors of `concurrent.futures`. A worker of this machine is a thread here with a child
process beside it, which does what takes time; one worker is the serial engine.
"""

from __future__ import annotations

import contextlib
import logging
import re
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

from tridentify.errors import OptionError, TridentifyError, shown
from tridentify.fleet.workers.children import WORKERS
from tridentify.record.formats.requirements import require

CONNECT = "30s"
"""How long a scheduler may take to answer: it and its workers may be starting at this moment."""


@dataclass(frozen=True)
class Engine:
    """Workers behind one seam.

    Attributes
    ----------
    executor : Executor
    width : int
        Workers at the moment of asking.
    """

    executor: Executor
    width: int


@contextlib.contextmanager
def engine(workers: Any = None) -> Iterator[Engine]:
    """Start workers, or find them; they end with the block.

    Parameters
    ----------
    workers : int, str or distributed.Client, optional
        How many processes of this machine, by default one; or the address of a Dask scheduler,
        ``"tcp://host:8786"``, or a client of one.

    Raises
    ------
    OptionError
        It is none of these.
    MissingDependencyError
        An address is given and Dask is not installed.
    TridentifyError
        No scheduler answers, or it has no workers.
    """
    checked = checked_workers(workers)
    with _of_this_machine(checked) if isinstance(checked, int) else _of_dask(checked) as found:
        yield found


def checked_workers(workers: Any) -> Any:
    """A number of processes, an address or a client, before anything is started or written.

    Raises
    ------
    OptionError
        As `engine`.
    """
    if workers is None:
        return 1
    if isinstance(workers, int) and not isinstance(workers, bool):
        if workers < 1:
            raise OptionError(f"found workers={workers}; expected at least 1; correct it")
    elif isinstance(workers, str):
        _check_address(workers)
    elif not hasattr(workers, "get_executor"):
        raise OptionError(
            f"found workers={shown(workers)}; expected a number of processes, or the address of a "
            "Dask scheduler such as tcp://host:8786; correct it"
        )
    return workers


@contextlib.contextmanager
def _of_this_machine(count: int) -> Iterator[Engine]:
    pool = ThreadPoolExecutor(count, thread_name_prefix="tridentify-worker")
    try:
        yield Engine(pool, count)
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        WORKERS.interrupt()
        raise
    finally:
        pool.shutdown(wait=True)


def _check_address(address: str) -> None:
    """Refuse what can be no address: the library would try it for a minute and fail aloud.

    Raises
    ------
    OptionError
    """
    if not re.fullmatch(r"\w+://\S+|[^\s:/]+:\d+", address):
        raise OptionError(
            f"found {shown(address)} for a Dask scheduler; expected an address such as "
            "'tcp://host:8786'; correct it, or give a number of processes of this machine"
        )


@contextlib.contextmanager
def _hushed(name: str) -> Iterator[None]:
    """Nothing from a logger that tells in fifty lines what is told here in one."""
    logger = logging.getLogger(name)
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)


@contextlib.contextmanager
def _of_dask(workers: Any) -> Iterator[Engine]:
    require("distributed", "tridentify[fleet]", "a Dask scheduler")
    from distributed import Client

    with contextlib.ExitStack() as stack:
        client = workers
        if isinstance(workers, str):
            stack.enter_context(_hushed("distributed.client"))
            try:
                client = Client(workers, timeout=CONNECT, set_as_default=False)
                stack.enter_context(client)
            except (OSError, ValueError, TimeoutError) as error:
                raise TridentifyError(
                    f"found no scheduler at {shown(workers)} ({shown(str(error), 80)}); expected "
                    "a Dask scheduler; start one (dask scheduler), or correct the address"
                ) from error
        width = sum(client.nthreads().values())
        if not width:
            raise TridentifyError(
                f"found no worker at {shown(str(client.scheduler.address))}; expected one at "
                "least; start some with: dask worker ADDRESS --nthreads 1"
            )
        # results depend on what is on the disks too: two equal calls are two calls
        yield Engine(client.get_executor(pure=False), width)
