"""Where bytes come from: standard input, a file that may grow, datagrams on the loopback address.

Every source gives `Chunk` after `Chunk`, and None when nothing came for a while, so that whoever
reads can look after other things. A source that has `positioned` knows where in a file it is, and
goes on from such a place.

A file that grows is followed by its name, as log files are: when the name stands for another file
(rotation) the old one is read to its end and the new one from its beginning; when the file got
shorter (truncation), or no longer holds what was read last (truncation, and filled again beyond
its old length), it is read from its beginning.
"""

from __future__ import annotations

import os
import queue
import stat
import threading
import time
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, Protocol

from tridentify.errors import UnreadableFileError, shown

PIECE = 1 << 20
"""Most bytes that are read from a file at once."""
WAIT = 0.1
"""How long to wait before None is given [s]."""
WINDOW = 4096
"""Bytes at the beginning and before a position by which a file is known again."""

Tell = Callable[[str], None]


@dataclass(frozen=True)
class Chunk:
    """Bytes that follow those before.

    Attributes
    ----------
    data : bytes
    position : int
        Of the first of them in the file; from the beginning of the stream elsewhere.
    fresh : bool
        Whether another file begins here, so that half a line before is lost; without bytes.
    """

    data: bytes
    position: int
    fresh: bool = False


@dataclass(frozen=True)
class Mark:
    """A position in a file, and what the file has to hold to be the same one.

    Attributes
    ----------
    position : int
    head, tail : int
        Checksums of the first `WINDOW` bytes, and of those before the position.
    """

    position: int
    head: int
    tail: int


class ByteSource(Protocol):
    """Where bytes come from."""

    @property
    def name(self) -> str:
        """What to call it in messages."""

    @property
    def positioned(self) -> bool:
        """Whether it can go on from a place in a file."""

    def pieces(self) -> Iterator[Chunk | None]:
        """Give what comes, None when nothing came for a while; ends where the source ends."""

    @property
    def dropped(self) -> int | None:
        """How many pieces were lost before they could be read; None where nobody knows."""

    def mark(self, position: int) -> Mark | None:
        """Remember a place that was passed; None where there are none."""

    def seek(self, mark: Mark | None) -> None:
        """Go on from a place, before anything was read."""

    def close(self) -> None:
        """Let go of it."""


# ------------------------------------------------------------------------------------------- pipes
class PipeSource:
    """Standard input, a named pipe, or any stream that is read once.

    A thread reads, since not every system can wait for a pipe and for the clock at a time. What it
    has read ahead is bounded.

    Parameters
    ----------
    name : str
    open_it : callable
        Gives the stream; called by the thread, since a named pipe opens when its writer does.
    ours : bool
        Whether to close the stream at its end.
    """

    positioned = False
    dropped = None

    def __init__(self, name: str, open_it: Callable[[], BinaryIO], *, ours: bool = False) -> None:
        self.name = name
        self._open_it, self._ours = open_it, ours
        self._read: queue.Queue[bytes | OSError] = queue.Queue(maxsize=4)

    def pieces(self) -> Iterator[Chunk | None]:
        """Give what comes, until the writer closes it."""
        threading.Thread(target=self._work, daemon=True).start()
        position = 0
        while True:
            try:
                data = self._read.get(timeout=WAIT)
            except queue.Empty:
                yield None
                continue
            if isinstance(data, OSError):
                raise _unreadable(self.name, data) from data
            if not data:
                return
            yield Chunk(data, position)
            position += len(data)

    def mark(self, position: int) -> Mark | None:
        """Give nothing: what was read is gone."""
        return None

    def seek(self, mark: Mark | None) -> None:
        """Go on with what comes."""

    def close(self) -> None:
        """Leave the stream to its owner; the thread ends with the process."""

    def _work(self) -> None:
        try:
            stream = self._open_it()
            try:
                number = stream.fileno()
            except (OSError, AttributeError):
                number = -1
            data = b"more"
            while data:
                # no lock of the stream may be held when the process ends
                data = stream.read(PIECE) if number < 0 else os.read(number, PIECE)
                self._read.put(data)
            if self._ours:
                stream.close()
        except Exception as error:  # whoever waits has to know
            self._read.put(error if isinstance(error, OSError) else OSError(str(error)))


# ------------------------------------------------------------------------------------------- files
@dataclass
class FileSource:
    """A file, to its end or for as long as it grows.

    Parameters
    ----------
    path : Path
    follow : bool
        Whether to wait for more at the end.
    tell : callable
        Takes a line about what happens to the file.
    """

    path: Path
    follow: bool = False
    tell: Tell = field(default=lambda _: None)
    positioned = True
    dropped = None
    _stream: BinaryIO | None = None
    _position: int = 0
    _last: bytes = b""  # what was read last, by which the file is known again

    @property
    def name(self) -> str:
        """The name of the file."""
        return self.path.name or str(self.path)

    def pieces(self) -> Iterator[Chunk | None]:
        """Give the bytes of the file, and of those that take its place."""
        if self.follow:
            yield from self._wait_for_it()
        stream = self._opened()
        while True:
            # looked at before reading, so that the end of a file that was replaced is its end
            replaced = self.follow and self._replaced(stream)
            data = self._next(stream)
            if data is None:
                self.tell(f"{self.name} {self._cut(stream)}; reading it from its beginning")
                yield Chunk(b"", 0, fresh=True)
            elif data:
                yield Chunk(data, self._position - len(data))
            elif not self.follow:
                return
            elif replaced:
                self.tell(f"{self.name} is another file now; reading it from its beginning")
                stream = self._reopened()
                yield Chunk(b"", 0, fresh=True)
            else:
                yield None
                time.sleep(WAIT)

    def mark(self, position: int) -> Mark | None:
        """Remember a place in the file that is read now.

        If the file was cut meanwhile, that is its beginning.
        """
        stream = self._opened()
        # first the mark: a file that is still the same afterwards was the same then
        mark = self._mark(stream, position)
        return mark if not self._last or self._holds_last(stream) else self._mark(stream, 0)

    def seek(self, mark: Mark | None) -> None:
        """Go on from a place.

        Raises
        ------
        UnreadableFileError
            The file is shorter, or holds something else before that place.
        """
        if mark is None:
            return
        stream = self._opened()
        size = os.fstat(stream.fileno()).st_size
        advice = "go on with the file that was read then, or begin anew without --resume"
        if size < mark.position:
            raise UnreadableFileError(
                f"found {size} bytes in {shown(str(self.path), 200)}; expected at least the "
                f"{mark.position} that were read when the checkpoint was written; {advice}"
            )
        if self._mark(stream, mark.position) != mark:
            raise UnreadableFileError(
                f"found other content in {shown(str(self.path), 200)} than was read when the "
                f"checkpoint was written; expected the same {mark.position} bytes; {advice}"
            )
        self._position = mark.position
        stream.seek(max(mark.position - WINDOW, 0))
        self._last = stream.read(min(WINDOW, mark.position))

    def close(self) -> None:
        """Close the file."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None

    def _opened(self) -> BinaryIO:
        if self._stream is None:
            try:
                # unbuffered, so that what is appended later is seen
                self._stream = self.path.open("rb", buffering=0)
            except (OSError, ValueError) as error:
                raise _unreadable(str(self.path), error) from error
        return self._stream

    def _reopened(self) -> BinaryIO:
        self.close()
        self._position, self._last = 0, b""
        return self._opened()

    def _next(self, stream: BinaryIO) -> bytes | None:
        """Read on; None if what was read last is no longer there."""
        known = len(self._last)
        try:
            stream.seek(self._position - known)
            # in one go, so that nothing can happen to the file between the known and the new
            data = stream.read(known + PIECE)
        except OSError as error:
            raise _unreadable(str(self.path), error) from error
        if self.follow and data[:known] != self._last:
            return None
        self._last = data[-WINDOW:]
        self._position += len(data) - known
        return data[known:]

    def _holds_last(self, stream: BinaryIO) -> bool:
        stream.seek(self._position - len(self._last))
        return stream.read(len(self._last)) == self._last

    def _cut(self, stream: BinaryIO) -> str:
        """Go back to the beginning, and say why."""
        shorter = os.fstat(stream.fileno()).st_size < self._position
        self._position, self._last = 0, b""
        return "was cut to a shorter length" if shorter else "was cut and filled again"

    def _replaced(self, stream: BinaryIO) -> bool:
        try:
            there = os.stat(self.path)
        except OSError:
            return False  # the next one is still to come
        here = os.fstat(stream.fileno())
        return (there.st_dev, there.st_ino) != (here.st_dev, here.st_ino)

    def _wait_for_it(self) -> Iterator[None]:
        if self._stream is None and not self.path.exists():
            self.tell(f"waiting for {self.path}, which is not there yet")
            while not self.path.exists():
                yield None
                time.sleep(WAIT)

    @staticmethod
    def _mark(stream: BinaryIO, position: int) -> Mark:
        stream.seek(0)
        head = zlib.crc32(stream.read(min(WINDOW, position)))
        stream.seek(max(position - WINDOW, 0))
        return Mark(position, head, zlib.crc32(stream.read(min(WINDOW, position))))


def source_of_file(path: Path, follow: bool, tell: Tell) -> ByteSource:
    """Give the source of a path: a file, or a pipe that has a name.

    Raises
    ------
    UnreadableFileError
        There is nothing to read.
    OptionError
        A pipe is to be followed.
    """
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError) as error:
        if follow and isinstance(error, FileNotFoundError) and path.parent.is_dir():
            return FileSource(path, follow, tell)
        raise _unreadable(str(path), error) from error
    if stat.S_ISDIR(mode):
        raise _unreadable(str(path), IsADirectoryError(0, "a directory"))
    if stat.S_ISREG(mode):
        return FileSource(path, follow, tell)
    return PipeSource(path.name, lambda: path.open("rb", buffering=0), ours=True)


def _unreadable(name: str, error: OSError | ValueError) -> UnreadableFileError:
    reason = getattr(error, "strerror", None) or str(error)
    return UnreadableFileError(
        f"found no way to read {shown(name, 200)} ({reason}); expected a file or stream that can "
        "be read; check the path and the permission"
    )
