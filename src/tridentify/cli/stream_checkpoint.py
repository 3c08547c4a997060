"""Checkpoints of a stream: where it was, and the state of the estimator, in one file.

A checkpoint covers whole lines only. What stands after them is read again, so that a run that was
stopped at any point and resumed ends with the numbers of one that was not.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tridentify.errors import (
    DataError,
    OptionError,
    OutputPathError,
    TridentifyError,
    UnreadableFileError,
    shown,
)
from tridentify.estimation.answer.encoding import read_json
from tridentify.record.checks.values import check_keys, checked, whole_number
from tridentify.record.formats.streams.sources import Mark
from tridentify.writing.files import write_atomically

if TYPE_CHECKING:
    from tridentify.online import State

KEY = "stream_checkpoint"
SCHEMA = 1
CHECKSUMS = (1 << 32) - 1
"""The largest there is."""
PARTS = (KEY, "question", "reader", "timeline", "counts", "mark", "state")


@dataclass(frozen=True)
class Snapshot:
    """A stream between two lines.

    Attributes
    ----------
    question : mapping
        What is asked, as plain values.
    reader, timeline, counts : mapping
        Where reading is, as plain values.
    mark : Mark or None
        Place in the file.
    state : State
        Of the estimator.
    """

    question: Mapping[str, Any]
    reader: Mapping[str, Any]
    timeline: Mapping[str, Any]
    counts: Mapping[str, Any]
    mark: Mark | None
    state: State


def prove_writable(path: Path) -> None:
    """Refuse a checkpoint that could not be written, before any work.

    Raises
    ------
    OutputPathError
    """
    try:
        if path.is_dir():
            raise IsADirectoryError(0, "it is a folder")
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise OutputPathError(
            f"found no way to write {path} ({error.strerror or error}); expected a folder that can "
            "be written; choose another --checkpoint"
        ) from error


def write_checkpoint(path: Path, snapshot: Snapshot) -> None:
    """Write a checkpoint, whole or not at all.

    Raises
    ------
    OutputPathError
        It cannot be written.
    """
    mark = snapshot.mark
    document = {
        KEY: SCHEMA,
        "question": snapshot.question,
        "reader": snapshot.reader,
        "timeline": snapshot.timeline,
        "counts": snapshot.counts,
        "mark": None if mark is None else [mark.position, mark.head, mark.tail],
        "state": snapshot.state.to_dict(),
    }
    write_atomically(path, json.dumps(document, allow_nan=False) + "\n")


def read_checkpoint(path: Path, question: Mapping[str, Any]) -> Snapshot:
    """Read a checkpoint, and see that it belongs to the question.

    Parameters
    ----------
    path : Path
    question : mapping
        What is asked now.

    Raises
    ------
    UnreadableFileError
        It is no JSON.
    DataError
        It is damaged, or of another version.
    OptionError
        Something else was asked then.
    """
    try:
        document = read_json(path)
    except (OSError, ValueError) as error:
        raise UnreadableFileError(
            f"found no readable checkpoint in {path} ({error}); expected a file written by "
            "tridentify stream --checkpoint; check the path"
        ) from error
    if not isinstance(document, dict) or document.get(KEY) != SCHEMA:
        raise DataError(
            f"found no checkpoint of version {SCHEMA} in {path}; expected a file written by this "
            "version of tridentify stream; begin anew with another --checkpoint"
        )
    from tridentify.online import State

    with undamaged(path):
        check_keys(document, PARTS)
        _compare(path, question, document["question"])
        return Snapshot(
            question,
            document["reader"],
            document["timeline"],
            document["counts"],
            None if document["mark"] is None else _mark_of(document["mark"]),
            State.from_dict(document["state"]),
        )


@contextmanager
def undamaged(path: Path) -> Iterator[None]:
    """Turn what a damaged checkpoint leads to into one line.

    Raises
    ------
    DataError
    """
    try:
        yield
    except TridentifyError:
        raise
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise DataError(
            f"found a damaged checkpoint in {path} ({shown(error, 300)}); expected the fields that "
            "tridentify stream wrote; begin anew with another --checkpoint"
        ) from error


def _compare(path: Path, question: Mapping[str, Any], before: Mapping[str, Any]) -> None:
    asked = json.loads(json.dumps(question))
    check_keys(before, asked)
    for key, value in asked.items():
        if value != before[key]:
            raise OptionError(
                f"found {key} {shown(value, 80)} where {path} has {shown(before[key], 80)}; "
                "expected the question of the checkpoint; ask the same, or begin anew without "
                "--resume"
            )


def _mark_of(document: object) -> Mark:
    position, head, tail = checked(document, list)
    return Mark(
        whole_number(position), whole_number(head, CHECKSUMS), whole_number(tail, CHECKSUMS)
    )
