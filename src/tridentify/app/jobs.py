"""Estimates under way: one at a time, each with its fraction, and a way to end it."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, Literal

from tridentify.app.workers import CancelledError, TaskError, Worker

JobState = Literal["queued", "running", "done", "failed", "cancelled"]
KEPT = 200


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
