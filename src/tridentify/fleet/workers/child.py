"""The child side of `workers.keeper`: do a job on one record after the other until the pipe ends.

Requests are pickles, since they come from the program itself. Answers are lines of JSON: this
process decodes files that somebody may have forged, so that nothing it says is executed.
"""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import shutil
import signal
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

from tridentify.fleet.workers.job import Item, Job, Limits
from tridentify.numerics.threads import one_blas_thread
from tridentify.record.formats.apart.isolated import limit_memory, silenced

SPARE_SECONDS = 60.0
"""Processor time beyond four times the limit after which the system itself ends this process [s].
The keeper ends it long before; if the keeper was killed, nobody else does."""

PARENT_PATIENCE = 1.0
"""How often this process looks whether its keeper is there [s]."""


def serve() -> None:
    """Answer on what was standard output; what libraries print goes to the null device."""
    requests = sys.stdin.buffer
    answers = silenced()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the keeper decides
    threading.Thread(target=_follow, args=(os.getppid(),), daemon=True).start()
    warnings.simplefilter("ignore")
    memory = pickle.load(requests)
    if memory:
        limit_memory(memory)
    begun: bytes = b""
    job: Job | None = None
    with contextlib.suppress(EOFError, BrokenPipeError):
        while True:
            paths, limits, raw, items = pickle.load(requests)
            if job is None or raw != begun:
                sys.path[:] = paths
                job, begun = pickle.loads(raw), raw
                job.begin()
            _say(answers, {"ready": True})
            with one_blas_thread():
                _work(answers, job, items, limits)


def _work(answers: BinaryIO, job: Job, items: Sequence[Item], limits: Limits) -> None:
    def read(mark: str) -> None:
        _say(answers, {"fingerprint": mark})

    for item in items:
        _limit_processor(4.0 * limits.seconds + SPARE_SECONDS)
        done = job.attempt(item, read)
        _sweep()
        _say(answers, {"done": done})


def _say(stream: BinaryIO, message: dict[str, Any]) -> None:
    stream.write(json.dumps(message).encode() + b"\n")
    stream.flush()


def _limit_processor(seconds: float) -> None:
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        _, hard = resource.getrlimit(resource.RLIMIT_CPU)
        used = resource.getrusage(resource.RUSAGE_SELF)
        soft = int(used.ru_utime + used.ru_stime + seconds) + 1
        resource.setrlimit(resource.RLIMIT_CPU, (soft, hard))


def _sweep() -> None:
    """Remove what readers left in the folder of this process."""
    for path in Path(tempfile.gettempdir()).iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def _follow(keeper: int) -> None:
    """End with the keeper, even if it was killed while a record goes on for ever."""
    while os.getppid() == keeper:
        time.sleep(PARENT_PATIENCE)
    os.kill(os.getpid(), signal.SIGTERM)
