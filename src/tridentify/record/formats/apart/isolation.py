"""Binary files are decoded in a process of their own, which may fail, hang or grow without harm.

The libraries that decode HDF5, MDF4, Parquet or MATLAB files are large, mostly compiled, and not
made for files that somebody has damaged or forged: a wrong length can make them crash, loop or ask
for terabytes. So they run in a child process that has a time limit and, where the system can set
one, a memory limit; its standard output and error lead nowhere. What comes back is read as text and
plain numbers, nothing of it is executed. If the child dies, that is one clear error in the parent.

The conversation: the parent sends a line of JSON for every request; the child answers with a line
of JSON and, for samples, with as many bytes of float64 as the line announces.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np

from tridentify import errors
from tridentify.errors import (
    DataWarning,
    FileTooLargeError,
    MissingDependencyError,
    TridentifyError,
    UnreadableFileError,
    shown,
)
from tridentify.numerics.arrays import Array
from tridentify.record.formats.apart.child_process import ChildProcess
from tridentify.record.formats.channels import CALLER, Channel, SampledFile

PATIENCE = 30.0
"""Time that a file of no length may take [s]."""

PACE = 2e6
"""Bytes of the file for each further second."""

BOOT = (
    "import json, sys; sys.path[:] = json.loads(sys.stdin.buffer.readline()); "
    "from tridentify.record.formats.apart.isolated import serve; serve()"
)

LONGEST_LINE = 1 << 28
"""Bytes of one message of the reading process: a header of 80,000 channels has a tenth of it."""

ENVIRONMENT = {"HDF5_PLUGIN_PRELOAD": "::", "OPENBLAS_NUM_THREADS": "1"}
"""No plugin of HDF5 is loaded on the word of a file; nothing is computed that wants threads."""


SHARE = 8
"""The samples of a file may take one part in so many of the memory: for a moment the reader, this
process and the record hold them, and the estimation needs several times as much again."""

LEAST = 1 << 28
"""Samples are never limited to fewer bytes than this."""

LIBRARIES = 1 << 30
"""Memory that a reader may take beside the samples, mostly for its libraries [bytes]."""


def machine_memory() -> int:
    """Bytes of memory: what is installed, or what the container or `ulimit` leaves of it.

    Examples
    --------
    >>> machine_memory() > 2**20
    True
    """
    known = [_installed(), *_allowed()]
    return min(size for size in known if size > 0)


def _installed() -> int:
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return SHARE << 30


def _allowed() -> Iterator[int]:
    """Limits of the control group (versions 2 and 1) and of the process, where there are any."""
    for name in ("memory.max", "memory/memory.limit_in_bytes"):
        with contextlib.suppress(OSError, ValueError):
            yield int(Path("/sys/fs/cgroup", name).read_text())
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        yield resource.getrlimit(resource.RLIMIT_AS)[0]


def memory_limit() -> int:
    """Bytes that the samples of one file may take: an eighth of the memory.

    Examples
    --------
    >>> memory_limit() >= LEAST
    True
    """
    return max(machine_memory() // SHARE, LEAST)


class IsolatedFile(SampledFile):
    """An `OpenFile` whose reader runs in a child process; a context manager.

    Parameters
    ----------
    path : Path
    module : str
        Module of the reader, with a function ``open_file(path)``.
    kind : str
        What to call the format.

    Raises
    ------
    UnreadableFileError
        The reader crashed, took too long, or says that the file is damaged.
    FileTooLargeError
        Memory does not suffice.
    """

    def __init__(self, path: Path, module: str, kind: str) -> None:
        self.path = path
        self.kind = kind
        self._late = False
        try:
            self._process = ChildProcess(BOOT, ENVIRONMENT)
        except OSError as error:
            raise self._unreadable(f"no way to start a reader ({error.strerror})") from error
        try:
            self._send([entry for entry in sys.path if isinstance(entry, str)])
            answer, _ = self._ask(
                {
                    "module": module,
                    # the child may decode names otherwise
                    "path": os.fsencode(path.absolute()).decode("latin-1"),
                    "memory": 2 * memory_limit() + LIBRARIES,
                }
            )
            self.channels = tuple(Channel(**entry) for entry in answer["channels"])
            for text in answer["said"]:
                warnings.warn(str(text), DataWarning, stacklevel=CALLER)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> IsolatedFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the child."""
        self._process.end()

    def read(self, indices: Sequence[int]) -> list[Array]:
        """Give channels as numbers."""
        counts = [self.channels[index].samples or 0 for index in indices]
        check_size(8 * sum(counts), self.path)
        answer, arrays = self._ask({"read": list(indices)})
        for text in answer.get("said", ()):
            warnings.warn(str(text), DataWarning, stacklevel=CALLER)
        return arrays

    def instants(self, clock: str) -> Array | None:
        """Give the sampling instants of a clock [s], if the file knows them."""
        found = self._ask({"instants": clock})[1]
        return found[0] if found else None

    def _send(self, message: object) -> None:
        stream = self._process.stdin
        with contextlib.suppress(OSError):  # a child that is gone is noticed when it should answer
            if stream is not None:
                stream.write(json.dumps(message).encode() + b"\n")
                stream.flush()

    def _expire(self) -> None:
        self._late = True
        self._process.kill()

    def _ask(self, message: object) -> tuple[dict[str, Any], list[Array]]:
        seconds = PATIENCE + self.path.stat().st_size / PACE
        timer = threading.Timer(seconds, self._expire)
        timer.start()
        try:
            self._send(message)
            stream = self._process.stdout
            if stream is None:
                raise self._unreadable("no answer")
            line = stream.readline(LONGEST_LINE)
            if not line.endswith(b"\n"):
                raise self._gone(seconds)
            answer: dict[str, Any] = json.loads(line)
            if "error" in answer:
                raise self._refusal(answer)
            return answer, [self._array(stream, n, seconds) for n in answer.get("arrays", ())]
        finally:
            timer.cancel()

    def _array(self, stream: IO[bytes], count: int, seconds: float) -> Array:
        check_size(8 * count, self.path)
        data = bytearray(8 * count)
        view, filled = memoryview(data), 0
        while filled < len(data):
            piece = stream.readinto(view[filled:])  # type: ignore[attr-defined]
            if not piece:
                raise self._gone(seconds)
            filled += piece
        return np.frombuffer(data, dtype=np.float64)

    def _gone(self, seconds: float) -> TridentifyError:
        self._process.kill()
        self._process.wait()
        if self._late:
            return self._unreadable(f"content that is not read within {seconds:.0f} s")
        return self._unreadable("damaged content that makes its reader fail")

    def _refusal(self, answer: dict[str, Any]) -> TridentifyError:
        kind = getattr(errors, str(answer["error"]), None)
        if isinstance(kind, type) and issubclass(kind, TridentifyError):
            return kind(str(answer["message"]))
        if answer["error"] == "MemoryError":
            return too_large(self.path, "more")
        if answer["error"] == "ImportError":
            return MissingDependencyError(
                f"found a reader of {self.kind} files that cannot be loaded "
                f"({shown(answer['message'], 80)}); expected its packages; install them anew"
            )
        return self._unreadable(f"damaged content ({shown(answer['message'], 80)})")

    def _unreadable(self, what: str) -> UnreadableFileError:
        return UnreadableFileError(
            f"found {what} in {shown(self.path.name)}; expected a sound {self.kind} file; check "
            "that it was written and copied completely"
        )


def check_size(size: int, path: Path) -> None:
    """Refuse more samples than memory should hold.

    Raises
    ------
    FileTooLargeError
    """
    if size > memory_limit():
        # a forged size may be larger than any float
        raise too_large(path, f"{min(size, 1 << 100) / 2**30:.3g} GiB")


def too_large(path: Path, size: str) -> FileTooLargeError:
    """Make the error about a file that unpacks to more than memory should hold."""
    return FileTooLargeError(
        f"found {size} of samples in {shown(path.name)}; expected at most "
        f"{memory_limit() / 2**30:.3g} GiB (an eighth of this machine's memory); name fewer "
        "channels or cut the file"
    )
