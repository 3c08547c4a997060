"""Where the records of a unit lie: in a file, in rows of a Parquet file, or in hand."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from tridentify import errors
from tridentify.errors import SampleTypeError, TridentifyError, UnreadableFileError, shown
from tridentify.record.formats.assemble import Wanted, record_from
from tridentify.record.formats.frames import record_from_frame
from tridentify.record.formats.read import opened
from tridentify.record.record import Record
from tridentify.writing.layout import printable

MOST_HASHED = 1 << 26
"""Bytes of an unreadable file that its fingerprint is made of; of a larger one the first of them
and its size."""

WINDOW = 1 << 17
"""Rows of a Parquet file that are decoded at once: some hundred short records, a few megabytes, so
that neighbours in one batch share the work."""


@contextmanager
def sound(path: Path) -> Iterator[None]:
    """Say in one line what a decoder says of a damaged file.

    Raises
    ------
    UnreadableFileError
    """
    try:
        yield
    except (TridentifyError, MemoryError):
        raise
    except Exception as error:  # of the library that reads it, of whatever kind
        raise UnreadableFileError(
            f"found damaged content ({shown(str(error), 80)}) in {shown(path.name)}; expected a "
            "sound file; check that it was written and copied completely"
        ) from error


@dataclass(frozen=True)
class File:
    """A file, one experiment.

    Attributes
    ----------
    path : str
    """

    path: str

    @property
    def label(self) -> str:
        """The file."""
        return self.path

    def records(self, wanted: Wanted) -> tuple[Record, ...]:
        """Read it in this process, which may crash.

        Raises
        ------
        TridentifyError
            As `read_record`.
        """
        path = Path(self.path)
        with sound(path), opened(path, isolated=False) as source:
            return (record_from(source, wanted, printable(path.stem)),)

    def trace(self) -> str:
        """SHA-256 of its content, as far as `MOST_HASHED` and its size say."""
        return fingerprint_of_file(Path(self.path))


@dataclass(frozen=True)
class Rows:
    """Some rows of Parquet files, one experiment.

    Attributes
    ----------
    spans : tuple of (path, start, count)
    """

    spans: tuple[tuple[str, int, int], ...]

    @property
    def label(self) -> str:
        """The first of the files."""
        return self.spans[0][0]

    def records(self, wanted: Wanted) -> tuple[Record, ...]:
        """Read them.

        Raises
        ------
        TridentifyError
            As `record_from_frame`.
        """
        import polars as pl

        columns = columns_of(wanted)
        with sound(Path(self.label)):
            parts = [rows_of(path, columns, *span) for path, *span in self.spans]
        return (record_of_frame(pl.concat(parts), wanted),)

    def trace(self) -> str:
        """Nothing: other units lie in the same file."""
        return ""


@dataclass(frozen=True)
class FrameRows:
    """Rows of a data frame, one experiment, as bytes of Arrow.

    Attributes
    ----------
    content : bytes
    """

    content: bytes = field(repr=False)
    label: ClassVar[str] = ""

    def records(self, wanted: Wanted) -> tuple[Record, ...]:
        """The rows as a record.

        Raises
        ------
        TridentifyError
            As `record_from_frame`.
        """
        import polars as pl

        return (record_of_frame(pl.read_ipc(io.BytesIO(self.content)), wanted),)

    def trace(self) -> str:
        """SHA-256 of the bytes."""
        return hashlib.sha256(self.content).hexdigest()


@dataclass(frozen=True)
class Given:
    """Records in hand.

    Attributes
    ----------
    given : tuple of Record
    """

    given: tuple[Record, ...] = field(repr=False)
    label: ClassVar[str] = ""

    def records(self, wanted: Wanted) -> tuple[Record, ...]:
        """They."""
        return self.given

    def trace(self) -> str:
        """Nothing: they have been read."""
        return ""


@dataclass(frozen=True)
class Unusable:
    """Nothing that could be read, and why.

    Attributes
    ----------
    message, exception : str
    label : str
    """

    message: str
    exception: str = "SampleTypeError"
    label: str = ""

    def records(self, wanted: Wanted) -> tuple[Record, ...]:
        """Say why there is none.

        Raises
        ------
        TridentifyError
        """
        kind = getattr(errors, self.exception, SampleTypeError)
        raise kind(self.message)

    def trace(self) -> str:
        """Of the file, if it is one."""
        return fingerprint_of_file(Path(self.label)) if self.label else ""


def place_of(thing: object) -> File | Given | Unusable:
    """Where an element of an iterable lies.

    Parameters
    ----------
    thing : Record, sequence of Record, or path-like
    """
    if isinstance(thing, Record):
        return Given((thing,))
    if isinstance(thing, str | Path):
        return File(str(thing))
    if isinstance(thing, Sequence) and thing and all(isinstance(one, Record) for one in thing):
        return Given(tuple(thing))
    return Unusable(
        f"found {type(thing).__name__} in place of a record; expected a Record, a list of them, or "
        "a file; write Record(u, y, dt=...)"
    )


def columns_of(wanted: Wanted) -> tuple[str, ...] | None:
    """Columns that are needed; None for all, where time has to be found by its name."""
    if wanted.time is None and wanted.dt is None:
        return None
    clock = () if wanted.time is None else (wanted.time,)
    return (*clock, *wanted.inputs, *wanted.references, *wanted.outputs)


def record_of_frame(frame: Any, wanted: Wanted) -> Record:
    """One experiment from a frame."""
    # a frame has one clock
    asked = {one.name: getattr(wanted, one.name) for one in fields(wanted)}
    del asked["instants"]
    return record_from_frame(frame, **asked)


def rows_of(path: str, columns: tuple[str, ...] | None, start: int, count: int) -> Any:
    """Rows of a Parquet file, by way of the windows that hold them."""
    import polars as pl

    parts, at, end = [], start, start + count
    while at < end:
        first = at - at % WINDOW
        frame = window_of(path, columns, first)
        parts.append(frame.slice(at - first, min(end - first, WINDOW) - (at - first)))
        at = first + WINDOW
    return pl.concat(parts)


@lru_cache(maxsize=2)
def window_of(path: str, columns: tuple[str, ...] | None, first: int) -> Any:
    """Rows from ``first``, `WINDOW` of them."""
    import polars as pl

    lazy = pl.scan_parquet(path, glob=False, hive_partitioning=False)
    known = lazy.collect_schema().names()
    if columns is not None:
        # a channel may be called by its name without the unit: then all columns are read
        kept = [name for name in dict.fromkeys(columns) if name in known]
        lazy = lazy.select(kept) if len(kept) == len(set(columns)) else lazy
    return lazy.slice(first, WINDOW).collect()


def fingerprint_of_file(path: Path) -> str:
    """SHA-256 of a file's content; empty if there is none to be read."""
    digest = hashlib.sha256()
    try:
        size, left = path.stat().st_size, MOST_HASHED
        if size > MOST_HASHED:
            digest.update(np.int64(size).tobytes())
        with path.open("rb") as stream:
            while left > 0 and (piece := stream.read(min(left, 1 << 20))):
                digest.update(piece)
                left -= len(piece)
    except OSError:
        return ""
    return digest.hexdigest()
