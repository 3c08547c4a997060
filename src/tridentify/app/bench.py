"""The workbench without its server: what every action does to the session."""

from __future__ import annotations

import copy
import threading
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tridentify.app import lines
from tridentify.app.jobs import Job, Jobs
from tridentify.app.safety import inside
from tridentify.app.session import Session, State
from tridentify.app.workers import TaskError, Worker
from tridentify.errors import DataError, OptionError, TridentifyError, shown
from tridentify.options import checked, method_of, structure_of, words_of
from tridentify.structure import AutoStructure

Card = dict[str, Any]
READABLE = (
    ".csv", ".txt", ".tsv", ".dat", ".asc", ".xlsx", ".parquet", ".feather", ".arrow", ".mat",
    ".ulg", ".mf4", ".mdf", ".npz", ".npy",
)  # fmt: skip
COLOURS = 28
"""Looks of a line, seven colours in four kinds of dashes: as many before one comes again."""
OWN = ("source", "file")
"""Of a card, what the page does not need."""


class MissingError(DataError):
    """There is no record, model or job of that name."""


def refusal(error: Exception, code: str = "") -> dict[str, str]:
    """One line of an exception, as a sentence and what to do.

    Examples
    --------
    >>> refusal(DataError("found a; expected b; do c"))
    {'code': 'DataError', 'message': 'Found a; expected b', 'remedy': 'Do c'}
    """
    parts = [part.strip() for part in str(error).split("; ")]
    remedy = parts.pop() if len(parts) > 2 else ""
    code = code or (error.code if isinstance(error, TaskError) else type(error).__name__)
    return {"code": code, "message": _capital("; ".join(parts)), "remedy": _capital(remedy)}


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


class Bench:
    """Records and models, the processes that work for them, and the file that keeps them.

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
        self._change = threading.RLock()
        self._described: dict[str, dict[str, Any]] = {}

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

    # -------------------------------------------------------------------------------- the session
    def document(self) -> dict[str, Any]:
        """All that the page shows of the session."""
        state = self.session.state
        return {
            "version": version("tridentify"),
            "revision": self.session.revision,
            "folder": None if self.folder is None else str(self.folder),
            "records": [self.card(one) for one in state["records"]],
            "models": [dict(one) for one in state["models"]],
            "can_undo": self.session.can_undo,
            "can_redo": self.session.can_redo,
        }

    def card(self, record: Card) -> Card:
        """A record as the page takes it."""
        source = record["source"]
        gone = source["upload"] is None and not Path(source["path"]).is_file()
        return {
            **{name: value for name, value in record.items() if name not in OWN},
            "missing_file": gone,
            "python": lines.look_in_python(record) if record["inputs"] else "",
            "command_line": lines.record_in_shell(record) if record["inputs"] else "",
            "revision": self.session.revision,
        }

    def files(self) -> list[dict[str, Any]]:
        """Files of the opened folder."""
        if self.folder is None:
            return []
        return [
            {
                "name": path.name,
                "bytes": path.stat().st_size,
                "readable": path.suffix.lower() in READABLE,
            }
            for path in sorted(self.folder.iterdir())
            if path.is_file() and not path.name.startswith(".")
        ]

    def move(self, by: int) -> dict[str, Any]:
        """Undo or do again."""
        self.session.move(by)
        self._described.clear()
        return self.document()

    def _changed(self, change: Callable[[State], None], quietly: bool = False) -> None:
        with self._change:
            state = copy.deepcopy(self.session.state)
            change(state)
            (self.session.overwrite if quietly else self.session.write)(state)

    # -------------------------------------------------------------------------------- the records
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
        found = self.reader.call("opened", source=source)
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
            **found,
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
                self.jobs.worker.call("warm", source=record["source"], card=_plain(record))
            except TridentifyError:
                return  # the estimate will say it

        threading.Thread(target=read, daemon=True).start()

    def record(self, name: str) -> Card:
        """A record of the session.

        Raises
        ------
        MissingError
        """
        return _found(self.session.state["records"], name, "record")

    def change_record(self, name: str, changes: Mapping[str, Any]) -> Card:
        """Change roles, ranges, bad samples, name.

        Raises
        ------
        OptionError
            A channel does not exist, or has two roles; a range ends before it begins.
        """
        record = {**self.record(name), **changes}
        _check(record)

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

    # --------------------------------------------------------------------------------- the models
    def add_model(
        self, name: str, options: Mapping[str, Any], called: str | None, alone: bool = False
    ) -> Job:
        """Begin an estimate, which is shown beside the others or alone.

        Raises
        ------
        OptionError
            An option is none, or the record lacks an input or an output.
        """
        record = copy.deepcopy(self.record(name))
        chosen = checked(options)
        structure = structure_of(chosen)
        method_of(chosen)
        if not (record["inputs"] or record["references"]) or not record["outputs"]:
            missing = "output" if record["inputs"] else "input"
            raise OptionError(
                f"found no {missing} among the channels of {shown(record['name'])}; expected at "
                f"least one; mark the channel that is the {missing}"
            )
        model = self.session.next_id("m")
        number = model.removeprefix("m")
        asked = "orders chosen" if isinstance(structure, AutoStructure) else words_of(structure)
        card = {
            "id": model,
            "name": called or f"Model {number}",
            "record": name,
            "options": dict(options),
            "structure": asked,
            "fit": [],
            "state": "done",
            "colour_index": (int(number) - 1) % COLOURS,
            "shown": True,
        }

        def work(worker: Worker, say: Callable[[float, str], None]) -> Callable[[], None]:
            found = worker.call(
                "estimated", say, source=record["source"], card=_plain(record), options=chosen
            )
            done = {**card, "structure": found["structure"], "fit": found["fit"]}

            def add(state: State) -> None:
                for other in state["models"] if alone else ():
                    other["shown"] = False
                state["models"].append(done)

            def keep() -> None:
                kept = {"estimate": found["document"], "record": record, "card": done}
                self.session.keep_estimate(model, kept)
                self._described[_key(model, self._own(done, kept))] = found["described"]
                self._changed(add)

            return keep

        return self.jobs.add(model, work)

    def job(self, name: str, wait: float = 0.0) -> dict[str, Any]:
        """How far an estimate is; of one that is done also the session and what was found.

        Raises
        ------
        MissingError
        """
        job = self.jobs.get(name, wait)
        if job is None:
            raise MissingError("found no estimate of that name under way; expected one; start one")
        found = job.document()
        if job.state != "done":
            return found
        return {**found, "session": self.document(), "detail": self.describe(job.model)}

    def model(self, name: str) -> Card:
        """A model of the session.

        Raises
        ------
        MissingError
        """
        return _found(self.session.state["models"], name, "model")

    def _kept(self, name: str) -> tuple[Card, dict[str, Any]]:
        """A model and its estimate, though it was undone meanwhile: a page may still draw it."""
        kept = self.session.estimate(name)
        if kept is None:
            self.model(name)
            raise MissingError(f"found no estimate of {shown(name)}; expected one; estimate again")
        cards = self.session.state["models"]
        return next((one for one in cards if one["id"] == name), kept["card"]), kept

    def _own(self, card: Card, kept: Mapping[str, Any]) -> Card:
        """The record of a model as it was, with the ranges for validation that there are now."""
        record = dict(kept["record"])
        now = next(
            (one for one in self.session.state["records"] if one["id"] == card["record"]), None
        )
        if now is not None:
            ranges = [one for one in record["ranges"] if one["use"] == "identify"]
            ranges += [one for one in now["ranges"] if one["use"] == "validate"]
            record |= {"ranges": ranges, "name": now["name"]}
        return record

    def describe(self, name: str) -> dict[str, Any]:
        """All that is shown of a model but its pictures."""
        card, kept = self._kept(name)
        record = self._own(card, kept)
        key = _key(name, record)
        if key not in self._described:
            self._described[key] = self.describer.call(
                "model", source=record["source"], card=_plain(record),
                options=checked(card["options"]), document=kept["estimate"],
            )  # fmt: skip
        exported = {
            "python": lines.export_in_python(card["name"], record, record["dt"]),
            "command_line": lines.export_in_shell(card["name"], record["dt"]),
        }
        return {**card, **self._described[key], "export": exported}

    def panel(self, name: str, kind: str, record: str | None, pixels: int) -> dict[str, Any]:
        """One picture of a model, on its own record or on another."""
        card, kept = self._kept(name)
        other = record is not None and record != card["record"]
        on = self.record(str(record)) if other else self._own(card, kept)
        key = repr((name, kind, pixels, on["id"], on["ranges"], on["bad"]))
        if key not in self._described:
            self._described[key] = self.describer.call(
                "panel", source=on["source"], card=_plain(on), kind=kind,
                document=kept["estimate"], pixels=pixels,
            )  # fmt: skip
        return self._described[key]

    def compare(self, models: Sequence[str], record: str) -> dict[str, Any]:
        """Models on one record."""
        cards = [self.model(name) for name in models]
        on = self.record(record)
        found = self.describer.call(
            "compared", source=on["source"], card=_plain(on),
            documents=[self._kept(name)[1]["estimate"] for name in models],
            names=[card["name"] for card in cards],
        )  # fmt: skip
        same = lines.compared_card(on, found.pop("inputs"), found["outputs"])
        return {
            **found,
            "python": lines.compare_in_python(cards, same),
            "command_line": lines.compare_in_shell(cards, same),
        }

    def change_model(self, name: str, changes: Mapping[str, Any]) -> Card:
        """Rename a model, or tick it."""
        card = {**self.model(name), **changes}

        def put(state: State) -> None:
            state["models"] = [card if one["id"] == name else one for one in state["models"]]

        self._changed(put, quietly="name" not in changes)
        return card

    def drop_model(self, name: str) -> None:
        """Take a model out of the session."""
        self.model(name)

        def drop(state: State) -> None:
            state["models"] = [one for one in state["models"] if one["id"] != name]

        self._changed(drop)

    def export(self, name: str, kind: str) -> tuple[str, str, bytes]:
        """A file of a model: name, media type, bytes."""
        card, kept = self._kept(name)
        record = self._own(card, kept)
        found: tuple[str, str, bytes] = self.describer.call(
            "export", source=record["source"], card=_plain(record),
            options=checked(card["options"]), document=kept["estimate"], kind=kind,
            name=card["name"],
        )  # fmt: skip
        return found


def _key(model: str, record: Card) -> str:
    """Under which the description of a model is remembered."""
    return repr((model, record["ranges"], record["name"]))


def _plain(record: Card) -> Card:
    """What tasks need of a card."""
    names = (
        "name", "path", "file", "t0", "inputs", "outputs", "references", "intersample", "ranges",
        "bad",
    )  # fmt: skip
    return {name: record[name] for name in names} | {"given_dt": record.get("given_dt")}


def _found(cards: Sequence[Card], name: str, kind: str) -> Card:
    for one in cards:
        if one["id"] == name:
            return one
    raise MissingError(
        f"found no {kind} {shown(name)}; expected one of this session; it was removed, perhaps in "
        "another tab: reload the page"
    )


def known(record: Card, names: Sequence[str]) -> None:
    """Refuse a channel that a record does not have.

    Raises
    ------
    OptionError
    """
    there = [one["name"] for one in record["channels"]]
    for name in names:
        if name not in there:
            raise OptionError(
                f"found no channel {shown(name)}; expected one of {', '.join(there)}; choose one"
            )


def _check(record: Card) -> None:
    roles = [*record["inputs"], *record["outputs"], *record["references"]]
    known(record, roles)
    for name in roles:
        if roles.count(name) > 1:
            raise OptionError(
                f"found {shown(name)} in two roles; expected each channel in one; free the other"
            )
    for one in (*record["ranges"], *record["bad"]):
        if not one["start"] < one["end"]:
            raise OptionError(
                f"found a range from {one['start']:g} to {one['end']:g} s; expected its end after "
                "its start; give a later end"
            )
