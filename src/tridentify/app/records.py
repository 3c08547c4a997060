"""The records of the workbench: opened, looked at, changed, taken away."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tridentify.app import changes
from tridentify.app.desk import Desk, plain_card
from tridentify.app.refusals import Card, check, found
from tridentify.app.safety import inside
from tridentify.app.session import State
from tridentify.errors import TridentifyError

FROM_DISK = "disk"
"""Who changed something, where it was no page."""


class Records(Desk):
    """What is done to records."""

    def document(self) -> dict[str, Any]:
        """All that the page shows of the session, files as they are now."""
        self.look_again()
        return super().document()

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
        stamp = stamp_of(source)
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
            "stamp": stamp,
            "changed_file": "",
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

    def change_record(self, name: str, news: Mapping[str, Any]) -> Card:
        """Change roles, ranges, bad samples, name.

        Raises
        ------
        OptionError
            A channel does not exist, or has two roles; a range ends before it begins.
        """
        record = {**self.record(name), **news}
        check(record)
        self._put("records", name, [record], quietly=set(news) == {"changed_file"})
        if {"inputs", "outputs", "references", "bad", "intersample"} & set(news):
            self._warm(record)
        return self.card(record)

    def drop_record(self, name: str) -> None:
        """Take a record out of the session; its models stay."""
        self.record(name)
        self._put("records", name, [])

    def look_again(self, *names: str) -> None:
        """Read anew what was changed on disk since it was read: all records, or those named."""
        for record in self.session.state["records"]:
            if names and record["id"] not in names:
                continue
            with self._looking:
                self._look_at(record["id"])

    def _look_at(self, name: str) -> None:
        record = next((one for one in self.session.state["records"] if one["id"] == name), None)
        stamp = None if record is None else stamp_of(record["source"])
        if record is None or stamp is None or stamp == record.get("stamp"):
            return
        try:
            news = changes.read_anew(record, self.reader.call("opened", source=record["source"]))
        except TridentifyError as error:
            news = {"changed_file": changes.unreadable(str(error)), "unreadable": True}
        digest = news.get("digest", "")
        if digest and self._told.get(name) == digest:
            news.pop("changed_file", None)  # told before what was undone since
        self._told[name] = digest

        def put(state: State) -> None:
            for one in state["records"]:
                if one["id"] == name:
                    one.update(news, stamp=stamp)

        self.client = FROM_DISK
        self._changed(put, quietly=True)
        self._warm(self.record(name))

    def stamps(self) -> tuple[object, ...]:
        """What changes when a file of the session does: cheap, to be asked again and again."""
        return tuple(
            (one["id"], *(stamp_of(one["source"]) or ())) for one in self.session.state["records"]
        )

    def read(self, task: str, name: str, **arguments: Any) -> Any:
        """Ask the reader about a record."""
        record = self.record(name)
        return self.reader.call(task, source=record["source"], **arguments)


def stamp_of(source: Mapping[str, Any]) -> list[int] | None:
    """Time of the last change [ns] and size of a file; None of an upload, or where it is gone."""
    if source["upload"] is not None:
        return None
    try:
        found = Path(source["path"]).stat()
    except OSError:
        return None
    return [found.st_mtime_ns, found.st_size]
