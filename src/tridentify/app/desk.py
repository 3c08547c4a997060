"""What every action of the workbench needs: the session, the processes, and what both show."""

from __future__ import annotations

import contextlib
import copy
import threading
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tridentify.app import lines
from tridentify.app.jobs import Jobs
from tridentify.app.refusals import Card, refusal
from tridentify.app.session import Session, State
from tridentify.app.workers import Worker

READABLE = (
    ".csv", ".txt", ".tsv", ".dat", ".asc", ".xlsx", ".parquet", ".feather", ".arrow", ".mat",
    ".ulg", ".mf4", ".mdf", ".npz", ".npy",
)  # fmt: skip
OWN = ("source", "file", "stamp", "digest", "unreadable", "findings")
"""Of a card, what the page does not need."""


class Desk:
    """The session, the processes that work for it, and the file that keeps it.

    Parameters
    ----------
    session : Session
    folder : Path or None
        Whose files are offered.
    """

    def __init__(self, session: Session, folder: Path | None) -> None:
        self.session = session
        self.folder = None if folder is None else folder.resolve()
        self.reader, self.describer = Worker(), Worker(warm=True)
        self.jobs = Jobs(refusal)
        self.client = ""
        self._change, self._looking = threading.RLock(), threading.Lock()
        self._described: dict[str, dict[str, Any]] = {}
        self._told: dict[str, str] = {}

    def start(self) -> None:
        """Start the processes, without waiting for them: what is needed first comes first."""
        first, *spare = self.jobs.workers

        def one_by_one() -> None:
            for worker in (first, self.describer, *spare):
                worker.start()

        for begin in (self.reader.start, one_by_one):
            threading.Thread(target=begin, daemon=True).start()

    def stop(self) -> None:
        """End the processes and close the file."""
        self.jobs.stop()
        for worker in (self.reader, self.describer):
            worker.stop()
        self.session.close()

    def document(self) -> dict[str, Any]:
        """All that the page shows of the session."""
        state = self.session.state
        return {
            "version": version("tridentify"),
            "revision": self.session.revision,
            "folder": None if self.folder is None else str(self.folder),
            "records": [self.card(one) for one in state["records"]],
            "models": [
                shown_of(one) | {"older_file": self.is_older(one)} for one in state["models"]
            ],
            "can_undo": self.session.can_undo,
            "can_redo": self.session.can_redo,
        }

    def card(self, record: Card) -> Card:
        """A record as the page takes it."""
        source = record["source"]
        return {
            "changed_file": "",
            **shown_of(record),
            "content": str(record.get("digest") or ""),
            "missing_file": is_gone(source),
            "python": lines.look_in_python(record) if record["inputs"] else "",
            "command_line": lines.record_in_shell(record) if record["inputs"] else "",
            "revision": self.session.revision,
        }

    def now(self, model: Card) -> Card | None:
        """The record of a model as it is now; None where it was taken away."""
        records = self.session.state["records"]
        return next((one for one in records if one["id"] == model["record"]), None)

    def is_older(self, model: Card) -> bool:
        """Whether a model was estimated before its record's file was changed."""
        record = self.now(model)
        made_of = model.get("digest")
        return bool(made_of and record and record.get("digest") != made_of)

    def files(self) -> list[dict[str, Any]]:
        """Files of the opened folder."""
        if self.folder is None or not self.folder.is_dir():
            return []
        found = []
        for path in sorted(self.folder.iterdir()):
            with contextlib.suppress(OSError):  # removed while it was looked at
                if path.is_file() and not path.name.startswith("."):
                    readable = path.suffix.lower() in READABLE
                    size = path.stat().st_size
                    found.append({"name": path.name, "bytes": size, "readable": readable})
        return found

    def move(self, by: int) -> dict[str, Any]:
        """Undo or do again."""
        self.session.move(by)
        self._described.clear()
        return self.document()

    def _put(self, kind: str, name: str, cards: Sequence[Card], quietly: bool = False) -> None:
        """In place of the card of a name others, or none."""

        def put(state: State) -> None:
            state[kind] = [
                new for one in state[kind] for new in (cards if one["id"] == name else [one])
            ]

        self._changed(put, quietly)

    def _changed(self, change: Callable[[State], None], quietly: bool = False) -> None:
        with self._change:
            state = copy.deepcopy(self.session.state)
            change(state)
            (self.session.overwrite if quietly else self.session.write)(state)


def shown_of(card: Card) -> Card:
    """A card without what the page does not need."""
    return {name: value for name, value in card.items() if name not in OWN}


def is_gone(source: Mapping[str, Any]) -> bool:
    """Whether the file of a record is not where it was opened."""
    return source["upload"] is None and not Path(source["path"]).is_file()


def plain_card(record: Card) -> Card:
    """What tasks need of a card."""
    names = (
        "name", "path", "file", "t0", "inputs", "outputs", "references", "intersample", "ranges",
        "bad",
    )  # fmt: skip
    return {name: record[name] for name in names} | {"given_dt": record.get("given_dt")}
