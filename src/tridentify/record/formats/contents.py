"""What a record may be read from: a path, bytes, or an open file.

The readers want a file they can name, measure and hand to a process of their own. What is no path
is therefore written into a temporary file first, under the name that an open file has.
"""

from __future__ import annotations

import io
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from tridentify.errors import SampleTypeError, UnreadableFileError, shown

Contents = str | os.PathLike[str] | bytes | bytearray | memoryview | IO[bytes] | IO[str]
"""A path, the bytes of a file, or a file open for reading (from where it stands)."""

NAMELESS = "bytes"
"""What messages call a file without a name."""

PIECE = 1 << 20
"""Bytes, or characters, that are copied at once."""

LONGEST_STEM = 100
"""Characters of a file's name that are kept, far below what file systems take."""


def called(contents: object) -> str:
    """The name of what is read; empty where it has none.

    Examples
    --------
    >>> called("data/flight.csv"), called(b"t,u,y"), called(io.BytesIO())
    ('flight.csv', '', '')
    """
    name = getattr(contents, "name", None) if _is_open(contents) else contents
    return Path(name).name if isinstance(name, str | os.PathLike) else ""


@contextmanager
def as_file(contents: Contents) -> Iterator[Path]:
    """Give the path of a file with these contents; it may be gone afterwards.

    Raises
    ------
    SampleTypeError
        It is none of these.
    UnreadableFileError
        Reading it fails, or it is closed or open for writing.

    Examples
    --------
    >>> with as_file(io.StringIO("t,u,y")) as path:
    ...     path.read_bytes()
    b't,u,y'
    """
    if isinstance(contents, str | os.PathLike):
        yield Path(contents)
        return
    if not (_is_open(contents) or isinstance(contents, bytes | bytearray | memoryview)):
        raise SampleTypeError(
            f"found {type(contents).__module__}.{type(contents).__name__}; expected a path, bytes "
            "or an open file; give a data frame to record_from_frame, arrays to Record, and "
            "several files to read_records"
        )
    with tempfile.TemporaryDirectory(prefix="tridentify-", ignore_cleanup_errors=True) as folder:
        path = Path(folder, _safe(called(contents)))
        _copy(contents, path)
        yield path


def _is_open(contents: object) -> bool:
    return callable(getattr(contents, "read", None))


def _safe(name: str) -> str:
    """A name that every file system takes."""
    stem, dot, suffix = re.sub(r"[^\w .()+=-]", "_", name).rpartition(".")
    return f"{stem[:LONGEST_STEM]}{dot}{suffix[:10]}".strip() or NAMELESS


def _copy(contents: Any, path: Path) -> None:
    try:
        source = contents if _is_open(contents) else io.BytesIO(contents)
        with path.open("wb") as target:
            while piece := source.read(PIECE):
                text = isinstance(piece, str)
                target.write(str(piece).encode("utf-8", "surrogateescape") if text else piece)
    except (OSError, ValueError, TypeError, BufferError) as error:
        raise UnreadableFileError(
            f"found no way to read {shown(called(contents) or NAMELESS)} "
            f"({shown(str(error), 80)[1:-1]}); expected bytes or a file open for reading; open it "
            "again"
        ) from error
