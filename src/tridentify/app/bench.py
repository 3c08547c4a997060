"""The workbench without its server: what every action does to the session."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from tridentify.app import lines
from tridentify.app.records import Records, is_gone, plain_card, shown_of
from tridentify.app.refusals import Card, MissingError, found
from tridentify.app.session import State
from tridentify.app.workers import Job, Worker
from tridentify.errors import DataError, OptionError, shown
from tridentify.options import checked, method_of, structure_of, words_of
from tridentify.structure import AutoStructure

COLOURS = 28
"""Looks of a line, seven colours in four kinds of dashes: as many before one comes again."""

UNTESTED: Mapping[str, Any] = MappingProxyType(
    {"validation_fit": None, "validation_findings": None, "validation_note": ""}
)
"""In place of the test on a range for validation that is not there any more."""
OF_OLDER = (
    "The file of {name} was changed after this model was estimated: the numbers are those of the "
    "older content, and {pictures}. Estimate again for the new one."
)
ON_RECORD = ("report", "figure")
"""Files of a model that show what it was estimated from."""


class Bench(Records):
    """What is done to models, beside what `Records` does.

    Parameters
    ----------
    session : Session
    folder : Path or None
        Whose files are offered.
    """

    def add_model(
        self, name: str, options: Mapping[str, Any], called: str | None, alone: bool = False
    ) -> Job:
        """Begin an estimate, which is shown beside the others or alone.

        Raises
        ------
        OptionError
            An option is none, or the record lacks an input or an output.
        """
        self.look_again(name)
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
            "digest": record.get("digest", ""),
            "options": dict(options),
            "structure": asked,
            "fit": [],
            "state": "done",
            "colour_index": (int(number) - 1) % COLOURS,
            "shown": True,
        }

        def work(worker: Worker, say: Callable[[float, str], None]) -> Callable[[], None]:
            told = worker.call(
                "estimated", say, source=record["source"], card=plain_card(record), options=chosen
            )
            done = {**card, "structure": told["structure"], "fit": told["fit"]}

            def add(state: State) -> None:
                for other in state["models"] if alone else ():
                    other["shown"] = False
                state["models"].append(done)
                for one in state["records"]:
                    if one["id"] == name and one.get("digest") == card["digest"]:
                        one["changed_file"] = ""

            def keep() -> None:
                kept = {"estimate": told["document"], "record": record, "card": done,
                        "described": told["described"]}  # fmt: skip
                self.session.keep_estimate(model, kept)
                self._described[_key(model, self._own(done, kept))] = told["described"]
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
        told = job.document()
        if job.state != "done":
            return told
        return {**told, "session": self.document(), "detail": self.describe(job.model)}

    def model(self, name: str) -> Card:
        """A model of the session.

        Raises
        ------
        MissingError
        """
        return found(self.session.state["models"], name, "model")

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
        now = self.now(card)
        if now is not None:
            ranges = [one for one in record["ranges"] if one["use"] == "identify"]
            ranges += [one for one in now["ranges"] if one["use"] == "validate"]
            record |= {"ranges": ranges, "name": now["name"]}
        return record

    def describe(self, name: str) -> dict[str, Any]:
        """All that is shown of a model but its pictures."""
        card, kept = self._kept(name)
        record = self._own(card, kept)
        older, lost = self.is_older(card), is_gone(record["source"])
        key = _key(name, record, older, lost)
        if (older or lost) and "described" in kept:
            self._described[key] = kept["described"] | UNTESTED
        if key not in self._described:
            self._described[key] = self.describer.call(
                "model", source=record["source"], card=plain_card(record),
                options=checked(card["options"]), document=kept["estimate"],
            )  # fmt: skip
        exported = {
            "python": lines.export_in_python(card["name"], record, record["dt"]),
            "command_line": lines.export_in_shell(card["name"], record["dt"]),
        }
        gone = self._gone(card, record) if older else []
        said = OF_OLDER.format(name=record["name"], pictures=_pictures(gone)) if older else ""
        own = {"export": exported, "older_file": said, "pictures": not gone}
        return {**shown_of(card), **self._described[key], **own}

    def _gone(self, card: Card, record: Card) -> list[str]:
        """Channels of a model that its record's file does not have any more."""
        there = {one["name"] for one in (self.now(card) or record)["channels"]}
        return [name for name in (*record["inputs"], *record["outputs"]) if name not in there]

    def panel(self, name: str, kind: str, record: str | None, pixels: int) -> dict[str, Any]:
        """One picture of a model, on its own record or on another."""
        card, kept = self._kept(name)
        other = record is not None and record != card["record"]
        on = self.record(str(record)) if other else self._own(card, kept)
        now = self.now({"record": on["id"]}) or on
        on = {**on, "t0": now["t0"]}  # of the file as it is now: that is what is drawn
        key = repr((name, kind, pixels, on["id"], on["ranges"], on["bad"], now.get("digest")))
        if key not in self._described:
            self._described[key] = self.describer.call(
                "panel", source=on["source"], card=plain_card(on), kind=kind,
                document=kept["estimate"], pixels=pixels,
            )  # fmt: skip
        return self._described[key]

    def compare(self, models: Sequence[str], record: str) -> dict[str, Any]:
        """Models on one record."""
        cards = [self.model(name) for name in models]
        on = self.record(record)
        told = self.describer.call(
            "compared", source=on["source"], card=plain_card(on),
            documents=[self._kept(name)[1]["estimate"] for name in models],
            names=[card["name"] for card in cards],
        )  # fmt: skip
        same = lines.compared_card(on, told.pop("inputs"), told["outputs"])
        return {
            **told,
            "python": lines.compare_in_python(cards, same),
            "command_line": lines.compare_in_shell(cards, same),
        }

    def change_model(self, name: str, changes: Mapping[str, Any]) -> Card:
        """Rename a model, or tick it."""
        card = {**self.model(name), **changes}
        self._put("models", name, [card], quietly="name" not in changes)
        return shown_of(card)

    def drop_model(self, name: str) -> None:
        """Take a model out of the session."""
        self.model(name)
        self._put("models", name, [])

    def export(self, name: str, kind: str) -> tuple[str, str, bytes]:
        """A file of a model: name, media type, bytes."""
        card, kept = self._kept(name)
        record = self._own(card, kept)
        if kind in ON_RECORD and self.is_older(card):
            raise DataError(
                f"found that the file of {shown(record['name'])} was changed after {card['name']} "
                f"was estimated; expected what it was estimated from, which a {kind} shows; "
                "estimate again"
            )
        file: tuple[str, str, bytes] = self.describer.call(
            "export", source=record["source"], card=plain_card(record),
            options=checked(card["options"]), document=kept["estimate"], kind=kind,
            name=card["name"],
        )  # fmt: skip
        return file


def _pictures(gone: Sequence[str]) -> str:
    """What is drawn of a model of older content."""
    if gone:
        return f"there are no pictures, since {', '.join(gone)} is not in the file any more"
    return "the pictures show the file as it is now"


def _key(model: str, record: Card, older: bool = False, lost: bool = False) -> str:
    """Under which the description of a model is remembered."""
    return repr((model, record["ranges"], record["name"], older, lost))
