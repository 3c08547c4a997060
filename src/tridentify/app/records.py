"""The records of the workbench: opened, looked at, changed, taken away.

What is said of a file that was changed on disk under its record.

What every action of the workbench needs: the session, the processes, and what both show.
"""

from __future__ import annotations

import contextlib
import copy
import threading
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tridentify.app import lines
from tridentify.app.refusals import Card, check, found, refusal
from tridentify.app.safety import inside
from tridentify.app.session import Session, State
from tridentify.app.workers import Jobs, Worker
from tridentify.errors import TridentifyError

Facts = Mapping[str, Any]

ROLES = ("inputs", "outputs", "references")
FACTS = ("n_samples", "t0", "duration", "dt", "uniform", "channels", "digest")
"""Of a card, what is read from the file."""
MOST_NAMED = 6
"""Columns that a sentence names."""


def read_anew(before: Facts, now: Facts) -> dict[str, Any]:
    """The parts of a card that the new content of its file makes different.

    Parameters
    ----------
    before : mapping
        The card.
    now : mapping
        What is read from the file.

    Returns
    -------
    dict
        Facts, roles without columns that are gone, and under ``changed_file`` what is said of it,
        which is left out where the content is the same.
    """
    names = [one["name"] for one in now["channels"]]
    roles = {role: [name for name in before[role] if name in names] for role in ROLES}
    news = {name: now[name] for name in FACTS} | roles | {"unreadable": False}
    if not _same(before, now):
        return news | {"changed_file": told(before, now)}
    return news | {"changed_file": ""} if before.get("unreadable") else news


def _same(before: Facts, now: Facts) -> bool:
    if before.get("digest"):
        return bool(before["digest"] == now["digest"])
    return all(before[name] == now[name] for name in FACTS if name != "digest")


def told(before: Facts, now: Facts) -> str:
    """What changed of a file, in sentences.

    Examples
    --------
    >>> roles = {"inputs": ["u"], "outputs": ["y"], "references": [], "ranges": [], "bad": []}
    >>> before = {"n_samples": 1500, "duration": 30.0, "channels": [{"name": "u"}, {"name": "y"}]}
    >>> now = {"n_samples": 1200, "duration": 24.0, "channels": [{"name": "u"}]}
    >>> told(before | roles, now)
    'Its file was changed on disk: 1,500 samples became 1,200, 30 s became 24 s, gone: y (in use).'
    """
    parts = [*_length(before, now), *_columns(before, now)]
    seen = ", ".join(parts) or "other values in the same samples and columns"
    return f"Its file was changed on disk: {seen}. {_beyond(before, now)}".strip()


def unreadable(why: str) -> str:
    """That a changed file is no record any more, and why.

    Examples
    --------
    >>> unreadable("found no channel of numbers; expected at least two; choose another file")[:52]
    'Its file was changed on disk and is no record any mo'
    """
    found = why.partition(";")[0]
    return (
        f"Its file was changed on disk and is no record any more: {found}. Its models are kept; "
        "put the file right, and it is read again."
    )


def _length(before: Facts, now: Facts) -> list[str]:
    samples, seconds = (
        [form.format(card[name]) for card in (before, now)]
        for form, name in (("{:,}", "n_samples"), ("{:.6g}", "duration"))
    )
    said = []
    if samples[0] != samples[1]:
        said.append(f"{samples[0]} samples became {samples[1]}")
    if seconds[0] != seconds[1]:
        said.append(f"{seconds[0]} s became {seconds[1]} s")
    return said


def _columns(before: Facts, now: Facts) -> list[str]:
    old, new = ([one["name"] for one in card["channels"]] for card in (before, now))
    used = {name for role in ROLES for name in before[role]}
    gone = [f"{name} (in use)" if name in used else name for name in old if name not in new]
    came = [name for name in new if name not in old]
    return [f"{what}: {_few(names)}" for what, names in (("gone", gone), ("new", came)) if names]


def _few(names: Sequence[str]) -> str:
    rest = len(names) - MOST_NAMED
    return ", ".join([*names[:MOST_NAMED], *([f"{rest} more"] if rest > 0 else [])])


def _beyond(before: Facts, now: Facts) -> str:
    """Ranges that the new content does not reach."""
    end = now["duration"]
    late = [one for one in (*before["ranges"], *before["bad"]) if one["start"] >= end]
    if not late:
        return ""
    named = _few([f"{one['start']:.5g} to {one['end']:.5g} s" for one in late])
    return f"Beyond its end {'lies' if len(late) == 1 else 'lie'} {named}: move or remove it."


READABLE = (
    ".csv", ".txt", ".tsv", ".dat", ".asc", ".xlsx", ".parquet", ".feather", ".arrow", ".mat",
    ".ulg", ".mf4", ".mdf", ".npz", ".npy",
)  # fmt: skip
OWN = ("source", "file", "stamp", "digest", "unreadable", "findings")
"""Of a card, what the page does not need."""


FROM_DISK = "disk"
"""Who changed something, where it was no page."""


class Records:
    """The session, the processes and the file that keeps it, and what is done to records.

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
        """All that the page shows of the session, files as they are now."""
        self.look_again()
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
            news = read_anew(record, self.reader.call("opened", source=record["source"]))
        except TridentifyError as error:
            news = {"changed_file": unreadable(str(error)), "unreadable": True}
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


def stamp_of(source: Mapping[str, Any]) -> list[int] | None:
    """Time of the last change [ns] and size of a file; None of an upload, or where it is gone."""
    if source["upload"] is not None:
        return None
    try:
        found = Path(source["path"]).stat()
    except OSError:
        return None
    return [found.st_mtime_ns, found.st_size]
