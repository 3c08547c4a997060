"""The records of the workbench: opened, looked at, changed, taken away."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tridentify.app.desk import Desk, plain_card
from tridentify.app.refusals import Card, check, found
from tridentify.app.safety import inside
from tridentify.app.session import State
from tridentify.errors import TridentifyError


class Records(Desk):
    """What is done to records."""

    def open_file(self, name: str, dt: float | None = None) -> Card:
        """Open a file of the folder; ``dt`` [s] where it has no time of its own."""
        path = inside(self.folder, name)
        source = {"path": str(path), "upload": None, "session": str(self.session.path), "dt": dt}
        return self._opened(source, name)

    def open_upload(self, name: str, content: bytes, dt: float | None = None) -> Card:
        """Open what was uploaded; its bytes stay in the session."""
        bare = name.replace("\\", "/").rsplit("/", 1)[-1] or "upload"
        number = self.session.keep_upload(bare, content)
        kept = str(self.session.path)
        source = {"path": None, "upload": number, "name": bare, "session": kept, "dt": dt}
        return self._opened(source, bare)

    def _opened(self, source: dict[str, Any], name: str) -> Card:
        seen = self.reader.call("opened", source=source)
        record = {
            "id": self.session.next_id("r"),
            "name": Path(name).stem,
            "file": name,
            "path": source["path"],
            "source": source,
            "given_dt": source["dt"],
            "intersample": "auto",
            "ranges": [],
            "bad": [],
            "findings": [],
            **seen,
        }
        self._changed(lambda state: state["records"].append(record))
        self._warm(record)
        return self.card(record)

    def _warm(self, record: Card) -> None:
        """Let the estimator read the record while the user looks at it."""
        if not (record["inputs"] and record["outputs"]):
            return

        def read() -> None:
            try:
                self.jobs.worker.call("warm", source=record["source"], card=plain_card(record))
            except TridentifyError:
                return  # the estimate will say it

        threading.Thread(target=read, daemon=True).start()

    def record(self, name: str) -> Card:
        """A record of the session.

        Raises
        ------
        MissingError
        """
        return found(self.session.state["records"], name, "record")

    def change_record(self, name: str, changes: Mapping[str, Any]) -> Card:
        """Change roles, ranges, bad samples, name.

        Raises
        ------
        OptionError
            A channel does not exist, or has two roles; a range ends before it begins.
        """
        record = {**self.record(name), **changes}
        check(record)

        def put(state: State) -> None:
            state["records"] = [record if one["id"] == name else one for one in state["records"]]

        self._changed(put)
        if {"inputs", "outputs", "references", "bad", "intersample"} & set(changes):
            self._warm(record)
        return self.card(record)

    def drop_record(self, name: str) -> None:
        """Take a record out of the session; its models stay."""
        self.record(name)

        def drop(state: State) -> None:
            state["records"] = [one for one in state["records"] if one["id"] != name]

        self._changed(drop)

    def read(self, task: str, name: str, **arguments: Any) -> Any:
        """Ask the reader about a record."""
        record = self.record(name)
        return self.reader.call(task, source=record["source"], **arguments)
