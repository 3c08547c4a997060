"""Where a record comes from, and what a worker remembers of it."""

from __future__ import annotations

import hashlib
import io
import sqlite3
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from tridentify.errors import EmptyChannelError, EmptyRangeError, UnreadableFileError
from tridentify.record.formats.read import read_record
from tridentify.record.formats.series import Series, read_series
from tridentify.record.record import Record

Found = TypeVar("Found")
DIGITS = 32
"""Hexadecimal ones of a digest: two contents in 10^19 would be taken for one."""
KEPT = 6
"""Files or records that a worker remembers."""

_remembered: dict[tuple[str, object], Any] = {}


def remembered(kind: str, key: object, make: Callable[[], Found]) -> Found:
    """What was made before under a key, or what is made now; the oldest is forgotten."""
    own = (kind, key)
    if own not in _remembered:
        alike = [one for one in _remembered if one[0] == kind]
        if len(alike) >= KEPT:
            del _remembered[alike[0]]
        _remembered[own] = make()
    found: Found = _remembered[own]
    return found


def stamp(source: Mapping[str, Any]) -> tuple[object, ...]:
    """What changes when the content of a source does.

    Raises
    ------
    UnreadableFileError
        The file is gone.
    """
    if source["upload"] is not None:
        return ("upload", source["session"], source["upload"], source.get("dt"))
    path = Path(source["path"])
    try:
        seen = path.stat()
    except OSError:
        raise UnreadableFileError.found(
            "no file ", path.name, "it where it was opened", "put it back or open it again"
        ) from None
    return ("file", str(path), seen.st_mtime_ns, seen.st_size, source.get("dt"))


def digest(source: Mapping[str, Any]) -> str:
    """What tells the content of a file from another one; an upload is never another."""
    if source["upload"] is not None:
        return ""
    with open(source["path"], "rb") as file:
        return hashlib.file_digest(file, "blake2b").hexdigest()[:DIGITS]


class _Upload(io.BytesIO):
    """Uploaded bytes under the name that their file had, for what is said of them."""

    def __init__(self, bytes_: bytes, name: str) -> None:
        super().__init__(bytes_)
        self.name = name


def content(source: Mapping[str, Any]) -> str | io.BytesIO:
    """What a reader takes: the path of a file, or what was uploaded, open for reading."""
    if source["upload"] is None:
        return str(source["path"])
    with sqlite3.connect(f"file:{source['session']}?mode=ro", uri=True) as session:
        row = session.execute(
            "select content from uploads where id = ?", (source["upload"],)
        ).fetchone()
    if row is None:
        raise UnreadableFileError(
            "found nothing of that upload in the session; expected its bytes; upload it again"
        )
    return _Upload(bytes(row[0]), str(source.get("name") or ""))


def series(source: Mapping[str, Any]) -> tuple[Series, ...]:
    """All channels of a source over time."""
    return remembered(
        "series", stamp(source), lambda: read_series(content(source), dt=source.get("dt"))
    )


def whole(source: Mapping[str, Any], card: Mapping[str, Any]) -> Record:
    """The record that a card describes, all of its length, its bad samples left out."""
    bad = tuple((one["start"], one["end"]) for one in card["bad"])
    roles = tuple(tuple(card[role]) for role in ("inputs", "outputs", "references"))
    key = (stamp(source), roles, card["intersample"], bad)
    return remembered("record", key, lambda: _read(source, card, bad))


def _read(
    source: Mapping[str, Any], card: Mapping[str, Any], bad: Sequence[tuple[float, float]]
) -> Record:
    record = read_record(
        content(source),
        inputs=tuple(card["inputs"]),
        outputs=tuple(card["outputs"]),
        references=tuple(card["references"]),
        intersample=card["intersample"],
        dt=source.get("dt"),
    )
    since = record.t - card["t0"]
    left_out = np.zeros(record.n_samples, dtype=bool)
    for start, end in bad:
        left_out |= (since >= start) & (since <= end)
    return _counted(lambda: record.mask(left_out)) if left_out.any() else record


def _counted(make: Callable[[], Record]) -> Record:
    """A record in which samples count; where all were marked, that is what is said."""
    try:
        return make()
    except EmptyChannelError:
        raise EmptyRangeError(
            "found no sample that counts in this range; expected some that are not marked as bad "
            "samples; remove such a range, or take another stretch"
        ) from None


def pieces(record: Record, card: Mapping[str, Any], use: str) -> list[Record]:
    """The ranges of a use as experiments; all of the record where none identifies."""
    chosen = [one for one in card["ranges"] if one["use"] == use]
    if not chosen:
        return [record] if use == "identify" else []
    t0 = card["t0"]
    return [_counted(partial(record.slice, t0 + one["start"], t0 + one["end"])) for one in chosen]
