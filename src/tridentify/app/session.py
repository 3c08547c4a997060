"""What the workbench keeps: records, ranges and models, written at every action.

A session is a SQLite file. Each action appends a snapshot of the cards (a few kB), so that undo and
redo are a pointer that moves, and a process that is killed loses nothing it had answered. Estimates
and uploaded bytes stand beside the snapshots and are never changed.
"""

from __future__ import annotations

import json
import secrets
import sqlite3
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tridentify.errors import OutputPathError, UnreadableFileError, shown

SCHEMA = """
create table if not exists facts (name text primary key, value text not null);
create table if not exists snapshots (position integer primary key, document text not null);
create table if not exists estimates (id text primary key, document text not null);
create table if not exists uploads (
    id integer primary key, name text not null, content blob not null);
"""
FORMAT = "1"
KEPT = 300
"""Snapshots, and so actions that can be undone."""

State = dict[str, list[dict[str, Any]]]


def nothing() -> State:
    """A session in which nothing was done."""
    return {"records": [], "models": []}


class Session:
    """A session in its file.

    Parameters
    ----------
    path : path-like
        Made where there is none.

    Raises
    ------
    UnreadableFileError
        There is another file of that name.
    OutputPathError
        It cannot be written there.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path).resolve()
        self._lock = threading.RLock()
        try:
            self._base = sqlite3.connect(self.path, check_same_thread=False, isolation_level=None)
            self._base.execute("pragma journal_mode = wal")
            self._base.execute("pragma synchronous = full")
            self._base.executescript(SCHEMA)
        except sqlite3.DatabaseError as error:
            if isinstance(error, sqlite3.OperationalError):
                raise OutputPathError(
                    f"found that {shown(str(self.path))} cannot be written ({error}); expected a "
                    "place for the session; give one with --session"
                ) from None
            raise UnreadableFileError(
                f"found a file that is no session at {shown(str(self.path))}; expected one that "
                "the workbench wrote, or none; move it away or give another with --session"
            ) from None
        if self._fact("format", FORMAT) != FORMAT:
            raise UnreadableFileError(
                f"found a session of another version at {shown(str(self.path))}; expected version "
                f"{FORMAT}; give another file with --session"
            )
        self._position = int(self._fact("position", "0"))
        self.state = self._read(self._position)

    # ------------------------------------------------------------------------------ what stands
    @property
    def token(self) -> str:
        """What the page has to show; the same as long as the file is there."""
        return self._fact("token", secrets.token_urlsafe(24))

    @property
    def revision(self) -> int:
        """Grows with every action, undo included."""
        return int(self._fact("revision", "0"))

    @property
    def can_undo(self) -> bool:
        """Whether an action is left to undo."""
        return self._has(self._position - 1)

    @property
    def can_redo(self) -> bool:
        """Whether an action was undone."""
        return self._has(self._position + 1)

    def next_id(self, kind: str) -> str:
        """A name that no record or model of this session had before."""
        with self._lock:
            number = int(self._fact(f"last {kind}", "0")) + 1
            self._set(f"last {kind}", str(number))
            return f"{kind}{number}"

    def estimate(self, model: str) -> dict[str, Any] | None:
        """The estimate of a model."""
        row = self._one("select document from estimates where id = ?", model)
        return None if row is None else json.loads(row[0])

    # ----------------------------------------------------------------------------- what changes
    def keep_estimate(self, model: str, document: Mapping[str, Any]) -> None:
        """Write the estimate of a model; it is never changed."""
        with self._lock:
            self._base.execute(
                "insert or replace into estimates values (?, ?)", (model, json.dumps(document))
            )

    def keep_upload(self, name: str, content: bytes) -> int:
        """Write the bytes of an uploaded file and give their number."""
        with self._lock:
            done = self._base.execute(
                "insert into uploads (name, content) values (?, ?)", (name, content)
            )
            return int(done.lastrowid or 0)

    def write(self, state: State) -> int:
        """Make a state the present one, and give its revision."""
        with self._lock:
            revision = self.revision + 1
            position = self._position + 1
            self._base.execute("begin immediate")
            try:
                self._base.execute("delete from snapshots where position >= ?", (position,))
                self._base.execute(
                    "insert into snapshots values (?, ?)", (position, json.dumps(state))
                )
                self._base.execute("delete from snapshots where position < ?", (position - KEPT,))
                self._set("position", str(position))
                self._set("revision", str(revision))
                self._base.execute("commit")
            except BaseException:
                self._base.execute("rollback")
                raise
            self._position, self.state = position, state
            return revision

    def overwrite(self, state: State) -> int:
        """Change the present state without an action that could be undone: what is ticked."""
        with self._lock:
            revision = self.revision + 1
            if self._position:
                self._base.execute(
                    "update snapshots set document = ? where position = ?",
                    (json.dumps(state), self._position),
                )
            self._set("revision", str(revision))
            self.state = state
            return revision

    def move(self, by: int) -> bool:
        """Undo (-1) or do again (+1); false where there is nothing."""
        with self._lock:
            position = self._position + by
            if not self._has(position):
                return False
            self._position, self.state = position, self._read(position)
            self._set("position", str(position))
            self._set("revision", str(self.revision + 1))
            return True

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            self._base.close()

    # -------------------------------------------------------------------------------- the tables
    def _one(self, question: str, *values: object) -> Any:
        """The first row that answers, or None."""
        with self._lock:
            return self._base.execute(question, values).fetchone()

    def _fact(self, name: str, default: str) -> str:
        with self._lock:
            row = self._one("select value from facts where name = ?", name)
            if row is None:
                self._set(name, default)
                return default
            return str(row[0])

    def _set(self, name: str, value: str) -> None:
        self._base.execute("insert or replace into facts values (?, ?)", (name, value))

    def _has(self, position: int) -> bool:
        if position == 0:
            return int(self._one("select min(position) from snapshots")[0] or 1) <= 1
        return self._one("select 1 from snapshots where position = ?", position) is not None

    def _read(self, position: int) -> State:
        if position <= 0:
            return nothing()
        row = self._one("select document from snapshots where position = ?", position)
        if row is None:
            return nothing()
        try:
            state: State = json.loads(row[0])
        except ValueError:
            raise UnreadableFileError(
                f"found a session that is damaged at {shown(str(self.path))}; expected what the "
                "workbench wrote; move it away or give another file with --session"
            ) from None
        return state
