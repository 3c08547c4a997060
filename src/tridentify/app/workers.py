"""Processes that read and estimate beside the server, warm from the start.

Each worker is one process at the end of a pipe. It takes one task at a time: a name of
`tasks` and plain arguments. What a task raises comes back as its one line; a worker that dies, or
is ended because its task was cancelled, is replaced by a new one.

Estimates under way: one at a time, each with its fraction, and a way to end it.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import multiprocessing
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from types import MappingProxyType
from typing import Any, Literal

from tridentify.errors import TridentifyError

Say = Callable[[float, str], None]
PATIENCE = 5.0
"""Seconds that a process is given to end by itself."""
TICK = 0.1
"""Seconds between two words to whoever waits for a turn: less than a person sees as a stop."""
USUAL_WAIT, WAITED = 4.0, 0.2
"""Seconds in which a process is usually prepared, and the fraction of a task that this is told as:
no more than the first step of an estimate, so that the fraction never falls."""
WAITS_FOR: Mapping[str, str] = MappingProxyType(
    {
        "prepare": "preparing: libraries and compiled loops are loaded",
        "warm": "preparing: the record is read",
    }
)
"""What a task waits for, by what is done before it."""


class TaskError(TridentifyError):
    """A task was refused, or ended with its worker; the one line of why."""

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


class CancelledError(TaskError):
    """A task was cancelled by whoever asked for it."""


@cache
def _context() -> Any:
    """How processes begin: as copies of one that has loaded what all need, where there are copies.

    Compiled loops are not loaded there: the first time they are compiled, and a copy that only
    reads would wait for them.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tridentify.app.loaded"])
    return context


def _silent(fraction: float, words: str) -> None:
    """Say nothing."""


def serve(end: Connection) -> None:
    """What a worker does: take a task, answer, until the pipe closes."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    from tridentify.app.loaded import tasks

    with contextlib.suppress(EOFError, OSError):
        while True:
            name, arguments = end.recv()
            end.send(_done(getattr(tasks, name), arguments, end))


def _done(task: Callable[..., Any], arguments: dict[str, Any], end: Connection) -> Any:
    def say(fraction: float, words: str) -> None:
        end.send(("progress", fraction, words))

    try:
        return ("result", task(say, **arguments))
    except TridentifyError as error:
        return ("refused", type(error).__name__, str(error))
    except MemoryError:
        return ("refused", "MemoryError", "the memory of this machine does not hold this record")
    except BrokenPipeError:
        raise
    except Exception as error:
        words = f"a fault of this program: {type(error).__name__}: {error}"
        return ("refused", "Fault", words)


class Worker:
    """One process, and a task at a time for it.

    Parameters
    ----------
    warm : bool
        Whether it compiles what an estimate needs before the first one is asked for.
    """

    def __init__(self, warm: bool = False) -> None:
        self._turn = threading.Lock()
        self._change = threading.Lock()
        self._warm = warm
        self._process: BaseProcess | None = None
        self._pipe: Connection | None = None
        self._cancelled = False
        self._cancellations = 0
        self._doing = ""

    def start(self) -> None:
        """Start the process ahead of the first task."""
        with self._turn:
            self._ready()
            if self._warm:
                with contextlib.suppress(TridentifyError):
                    self._asked("prepare", {}, _silent)

    def call(self, task: str, say: Say | None = None, /, **arguments: Any) -> Any:
        """Do a task and give what it returns.

        Parameters
        ----------
        task : str
            Name of a function in `tasks`.
        say : callable, optional
            Told the fraction done, and words.
        **arguments
            Plain values.

        Raises
        ------
        TaskError
            It was refused, or its process died.
        CancelledError
            It was cancelled.
        """
        say = say or _silent
        with self._waited(say):
            self._ready()
            return self._asked(task, arguments, say)

    @contextlib.contextmanager
    def _waited(self, say: Say) -> Iterator[None]:
        """The turn of a task, and what it waits for until then."""
        before, began = self._cancellations, time.monotonic()
        while not self._turn.acquire(timeout=TICK):
            share = 1.0 - math.exp((began - time.monotonic()) / USUAL_WAIT)
            say(WAITED * share, WAITS_FOR.get(self._doing, "waiting for what is done before"))
        try:
            if self._cancellations != before:
                raise CancelledError("Cancelled", "cancelled")
            yield
        finally:
            self._turn.release()

    def cancel(self) -> None:
        """End the task that is done now, and its process with it."""
        with self._change:
            self._cancelled = True
            self._cancellations += 1
            if self._process is not None:
                self._process.kill()

    def stop(self) -> None:
        """End the process."""
        with self._change:
            process, pipe = self._process, self._pipe
            self._process = self._pipe = None
        if pipe is not None:
            pipe.close()
        if process is not None:
            process.join(PATIENCE)
            process.kill()

    def _ready(self) -> None:
        with self._change:
            self._cancelled = False
            if self._process is not None and self._process.is_alive():
                return
            context = _context()
            here, there = context.Pipe()
            self._process = context.Process(target=serve, args=(there,), daemon=True)
            self._process.start()
            there.close()
            self._pipe = here

    def _asked(self, name: str, arguments: dict[str, Any], say: Say) -> Any:
        pipe = self._pipe
        assert pipe is not None
        self._doing = name
        try:
            pipe.send((name, arguments))
            while True:
                answer = pipe.recv()
                if answer[0] != "progress":
                    break
                say(answer[1], answer[2])
        except (EOFError, OSError, TypeError):  # the last of a pipe that is closed meanwhile
            if self._cancelled:
                raise CancelledError("Cancelled", "cancelled") from None
            raise TaskError(
                "WorkerDied",
                "the process that read or estimated this ended without an answer, perhaps for "
                "want of memory; expected it to go on; choose a shorter range or another file",
            ) from None
        if answer[0] == "result":
            return answer[1]
        raise TaskError(answer[1], answer[2])


JobState = Literal["queued", "running", "done", "failed", "cancelled"]
KEPT = 200
"""Jobs that are over, whose answers can still be asked for."""


@dataclass
class Job:
    """One estimate.

    Attributes
    ----------
    id, model : str
    state : {"queued", "running", "done", "failed", "cancelled"}
    fraction : float
    message : str
        What is going on.
    error : dict or None
        Why it failed.
    """

    id: str
    model: str
    state: JobState = "queued"
    fraction: float = 0.0
    message: str = ""
    error: dict[str, str] | None = None
    worker: Worker | None = field(default=None, repr=False)
    ended: threading.Event = field(default_factory=threading.Event, repr=False)

    def document(self) -> dict[str, Any]:
        """As the page takes it."""
        found = {name: getattr(self, name) for name in ("id", "model", "state", "message")}
        return {**found, "fraction": round(self.fraction, 3), "error": self.error}


Keep = Callable[[], None]
Work = Callable[[Worker, Callable[[float, str], None]], Keep]
"""What an estimate does, and then what keeps it: not done where it was cancelled meanwhile."""


class Jobs:
    """Estimates in their turn, on one worker, with another that waits behind it.

    A task is cancelled by ending its process. The spare one takes over at once, so that the next
    estimate does not wait for libraries to load.

    Parameters
    ----------
    explain : callable
        Makes the refusal that the page shows from a task's one line.
    """

    def __init__(self, explain: Callable[[TaskError], dict[str, str]]) -> None:
        self._explain = explain
        self._jobs: dict[str, Job] = {}
        self._numbers = itertools.count(1)
        self._change = threading.Lock()
        self._threads = ThreadPoolExecutor(1)
        self._workers = [Worker(warm=True), Worker(warm=True)]

    @property
    def workers(self) -> tuple[Worker, ...]:
        """All of them, the one that makes the next estimate first."""
        return tuple(self._workers)

    @property
    def worker(self) -> Worker:
        """Where the next estimate is made."""
        return self._workers[0]

    def add(self, model: str, work: Work) -> Job:
        """Queue an estimate."""
        job = Job(f"j{next(self._numbers)}", model)
        with self._change:
            self._jobs[job.id] = job
            for old in list(self._jobs)[:-KEPT]:
                del self._jobs[old]
        self._threads.submit(self._run, job, work)
        return job

    def get(self, name: str, wait: float = 0.0) -> Job | None:
        """An estimate by its id, as soon as it has ended and after ``wait`` [s] at the latest."""
        job = self._jobs.get(name)
        if job is not None and wait > 0.0:
            job.ended.wait(wait)
        return job

    def cancel(self, job: Job) -> None:
        """End an estimate, wherever it is."""
        with self._change:
            running = job.state == "running"
            if job.state in ("queued", "running"):
                job.state = "cancelled"
                job.ended.set()
            if not running or job.worker is None:
                return
            worker = job.worker
            self._workers = [one for one in self._workers if one is not worker] + [worker]
        worker.cancel()
        threading.Thread(target=worker.start, daemon=True).start()

    def stop(self) -> None:
        """End all of them."""
        for job in list(self._jobs.values()):
            self.cancel(job)
        self._threads.shutdown(wait=False, cancel_futures=True)
        for worker in self._workers:
            worker.stop()

    def _run(self, job: Job, work: Work) -> None:
        with self._change:
            if job.state != "queued":
                return
            job.state, job.worker = "running", self.worker
            worker = job.worker

        def say(fraction: float, words: str) -> None:
            job.fraction, job.message = fraction, words

        try:
            self._do(job, work, worker, say)
        finally:
            job.ended.set()

    def _do(self, job: Job, work: Work, worker: Worker, say: Callable[[float, str], None]) -> None:
        try:
            keep = work(worker, say)
            with self._change:
                if job.state == "running":
                    keep()
                    job.state, job.fraction = "done", 1.0
        except CancelledError:
            job.state = "cancelled"
        except TaskError as error:
            self._fail(job, error)
        except Exception as error:
            fault = f"a fault of this program: {type(error).__name__}: {error}"
            self._fail(job, TaskError("Fault", fault))

    def _fail(self, job: Job, error: TaskError) -> None:
        with self._change:
            if job.state != "cancelled":
                job.state, job.error = "failed", self._explain(error)
