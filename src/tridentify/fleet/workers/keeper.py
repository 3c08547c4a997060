"""A worker's child process: records go in, one outcome a record comes out, whatever happens to it.

The child reads and identifies. It may crash, loop for ever or ask for all memory: then it is ended
and started anew, the record gets a row that says so, and the next one has its turn. A child that
was ended from outside, by `kill -9` or for want of memory on the machine, says nothing of its
record; so a record that went down with its child is tried once more before it is blamed.
"""

from __future__ import annotations

import contextlib
import json
import math
import pickle
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from typing import Any

from tridentify.errors import TridentifyError, shown
from tridentify.fleet.workers.job import CRASHED, OVER_TIME, Item, Job, Limits, Outcome
from tridentify.numerics.threads import THREADS
from tridentify.record.formats.apart.child_process import ChildProcess
from tridentify.record.formats.apart.isolation import ENVIRONMENT

ONE_THREAD = dict.fromkeys((*THREADS, "NUMBA_NUM_THREADS", "POLARS_MAX_THREADS"), "1")
"""There is one worker a core; a second thread in it would only fight for another worker's core, and
sums over several threads round differently."""

BOOT = (
    "import pickle, sys; sys.path[:] = pickle.load(sys.stdin.buffer); "
    "from tridentify.fleet.workers.child import serve; serve()"
)

STARTING = 300.0
"""Time that a child may take to load, and to compile what a new machine has not compiled
yet [s]."""

LOOK = 0.05
"""How often the clock is compared with the limit [s]."""

STARTS = 3
"""How often a child is started for the same batch, if it ends by itself before its first record."""

KILLED = -9
"""How a child ends that somebody killed, or the kernel for want of memory."""

KILLS = 8
"""How often one is killed before its first record until the run is: what kills it mostly passes."""

PAUSE = 0.5
"""After the first kill [s], twice as long after each further one: a minute in all."""

PATIENCE = 30.0
"""How long a child that has nothing to do is kept [s]: to start another one takes a second."""

TRIES = 2
"""How often a record's child may end before the record is blamed: once may be anybody's doing."""


class Keeper:
    """A child process and its clock; a context manager.

    Parameters
    ----------
    limits : Limits
        Of every record. The seconds may be changed between two batches.

    Examples
    --------
    >>> with Keeper(Limits(60.0, 2**31)) as keeper:
    ...     list(keeper.outcomes(None, []))
    []
    """

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self._process: ChildProcess | None = None
        self._deadline = self._resting = math.inf
        self._late = False
        self._since, self._mark = 0.0, ""
        self._closed = threading.Event()
        self._guard = threading.RLock()  # `close` comes from another thread
        self._clock = threading.Thread(target=self._watch, daemon=True)
        self._clock.start()

    def __enter__(self) -> Keeper:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def closed(self) -> bool:
        """Whether it was ended."""
        return self._closed.is_set()

    def close(self) -> None:
        """End the child; a thread that waits for its answer is told."""
        self._closed.set()
        self._end()

    def outcomes(self, job: Job | None, items: Sequence[Item]) -> Iterator[Outcome]:
        """One for each item, in their order.

        Parameters
        ----------
        job : Job
        items : sequence of Item

        Yields
        ------
        Outcome

        Raises
        ------
        TridentifyError
            No child can be started.
        """
        raw = pickle.dumps(job)
        waiting, fallen = list(items), 0
        try:
            while waiting:
                self._ask(raw, waiting)
                answered = 0
                for outcome in self._answers(waiting):
                    yield outcome
                    answered += 1
                waiting = waiting[answered:]
                fallen = fallen if not answered else 0
                if not waiting:
                    return
                # the first that waits went down with the child
                since, mark = self._since, self._mark
                late = self._late and time.monotonic() - since >= self.limits.seconds
                self._end()
                fallen += 1
                if late or fallen >= TRIES:
                    yield self._blamed(waiting.pop(0), late, time.monotonic() - since, mark)
                    fallen = 0
        finally:
            if waiting:  # nobody listens any more to what it still has to say
                self._end()

    def rest(self) -> None:
        """Keep the child for a while: whoever asks next need not wait for another one."""
        self._resting = time.monotonic() + PATIENCE

    def _ask(self, raw: bytes, items: Sequence[Item]) -> None:
        """Hand over a batch; a child that somebody ended meanwhile is started anew."""
        paths = [entry for entry in sys.path if isinstance(entry, str)]
        fallen = killed = 0
        while True:
            with self._guard:
                self._resting = math.inf
                if self._process is None or self._process.poll() is not None:
                    self._start()
            self._late, self._deadline = False, time.monotonic() + STARTING
            with contextlib.suppress(BrokenPipeError):
                self._send((paths, self.limits, raw, list(items)))
                if "ready" in (self._line() or {}):
                    return
            process, late = self._process, self._late
            code = None if process is None else process.wait()
            self._end()
            self._refuse_closed()
            if late:
                what = f"is not ready after {STARTING:.0f} s"
                break
            killed, fallen = killed + (code == KILLED), fallen + (code != KILLED)
            if fallen >= STARTS:
                what = f"ended with code {code}"
                break
            if killed >= KILLS:
                what = f"was killed {KILLS} times"
                break
            if code == KILLED:
                self._closed.wait(PAUSE * 2.0 ** (killed - 1))
        raise TridentifyError(
            f"found a worker's child process that {what} before its first record; expected "
            "Python with this package and memory to load it; raise memory_limit, or use fewer "
            "workers"
        )

    def _answers(self, items: Sequence[Item]) -> Iterator[Outcome]:
        """Outcomes until all are there or the child is gone."""
        self._since, self._mark = time.monotonic(), ""
        for item in items:
            self._since, self._mark = time.monotonic(), ""
            self._deadline = self._since + self.limits.seconds
            while True:
                line = self._line()
                if line is None:
                    self._deadline = math.inf
                    self._refuse_closed()
                    return
                self._mark = line.get("fingerprint", self._mark)
                if "done" in line:
                    break
            self._deadline = math.inf
            yield Outcome(item, **line["done"])

    def _blamed(self, item: Item, late: bool, seconds: float, mark: str) -> Outcome:
        """The outcome of a record whose child ended."""
        # how far it came before it was ended is chance: of a file, what stands there
        mark = item.trace() or mark
        if late:
            text = (
                f"found no answer within {self.limits.seconds:g} s; expected one; raise the time "
                "limit, shorten the record, or look at it on its own"
            )
            return Outcome(item, {}, OVER_TIME, text, "TimeoutError", seconds, mark)
        text = (
            f"found a process that ended {TRIES} times while it had this record; expected an "
            "answer; a damaged file or too little memory may do this: look at the record on its own"
        )
        return Outcome(item, {}, CRASHED, text, "ProcessError", seconds, mark)

    # ------------------------------------------------------------------------------- the process
    def _refuse_closed(self) -> None:
        if self.closed:
            raise TridentifyError("found a run that was ended; expected it to go on; resume it")

    def _start(self) -> None:
        self._end()
        with self._guard:
            self._refuse_closed()
            try:
                self._process = ChildProcess(BOOT, {**ENVIRONMENT, **ONE_THREAD})
            except OSError as error:
                raise TridentifyError(
                    f"found no way to start a process ({shown(error.strerror or str(error), 80)}); "
                    "expected one beside each worker; use fewer workers"
                ) from error
        with contextlib.suppress(BrokenPipeError):
            self._send([entry for entry in sys.path if isinstance(entry, str)])
            self._send(self.limits.memory)

    def _send(self, message: object) -> None:
        process = self._process
        if process is None or process.stdin is None:
            raise BrokenPipeError
        try:
            pickle.dump(message, process.stdin)
            process.stdin.flush()
        except ValueError as error:  # closed meanwhile
            raise BrokenPipeError from error

    def _line(self) -> dict[str, Any] | None:
        """What the child says next; None once it is gone."""
        process = self._process
        if process is None or process.stdout is None:
            return None
        try:
            line = process.stdout.readline()
            return json.loads(line) if line.endswith(b"\n") else None
        except ValueError:  # closed meanwhile, or half a line
            return None

    def _end(self) -> None:
        with self._guard:
            process, self._process = self._process, None
        self._deadline = math.inf
        if process is not None:
            process.end()

    def _watch(self) -> None:
        while not self._closed.wait(LOOK):
            process = self._process
            if time.monotonic() > self._deadline and process is not None:
                self._late = True
                process.kill()
                self._deadline = math.inf
            with self._guard:
                if time.monotonic() > self._resting:
                    self._resting = math.inf
                    self._end()
