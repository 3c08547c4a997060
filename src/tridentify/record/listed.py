"""Records as users hand them over: one, or several experiments on one system."""

from __future__ import annotations

import os
from collections.abc import Sequence

from tridentify.errors import SampleTypeError, shown
from tridentify.record.long_record import LongRecord
from tridentify.record.record import Record


def listed(records: Record | Sequence[Record]) -> list[Record]:
    """Records as a list.

    Raises
    ------
    SampleTypeError
        Something else is among them.
    """
    if isinstance(records, Record):
        return [records]
    if isinstance(records, LongRecord):
        iter(records)  # it says itself that it is none in memory
    if isinstance(records, str | os.PathLike):
        raise _not_read(f"the file {shown(str(records))}", "read_record(file")
    if hasattr(records, "columns"):
        raise _not_read(f"a {type(records).__name__}", "record_from_frame(frame")
    found = list(records) if isinstance(records, Sequence) else [records]
    wrong = [type(item).__name__ for item in found if not isinstance(item, Record)]
    if wrong:
        raise SampleTypeError(
            f"found {wrong[0]} in place of a record; expected a Record or a list of them; write "
            "Record(u, y, dt=...)"
        )
    return found


def _not_read(found: str, call: str) -> SampleTypeError:
    """The error about a file or a frame where a record belongs."""
    return SampleTypeError(
        f"found {found} in place of a record; expected a Record, which says what is input and what "
        f"output; write {call}, inputs=[...], outputs=[...]) and pass what it gives"
    )


def one_record(record: Record) -> Record:
    """The one record that is asked about.

    Raises
    ------
    SampleTypeError
        Something else, or several of them.
    """
    found = listed(record)
    if len(found) != 1:
        raise SampleTypeError(
            f"found {len(found)} records; expected one; ask about one after the other"
        )
    return found[0]
