"""The folder of a study: its settings, and a file with a line for every draw that is done.

Lines are appended as draws are done, each batch in one write. A line that a kill or a full disk has
cut short is dropped when the study is resumed, and its draw is done again. One run at a time has
the folder: a lock that the system lets go of when the process ends, however it ends.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tridentify.errors import OptionError, OutputPathError, UnreadableFileError, shown
from tridentify.studies.declared.draw import Row
from tridentify.writing.files import write_atomically

SETTINGS = "study.json"
ROWS = "draws.jsonl"
FORM = 1
"""Version of the folder's layout: raised when it changes."""
FIELDS: Mapping[str, tuple[type, ...]] = {
    "cell": (str,),
    "method": (str,),
    "draw": (int,),
    "theta": (list, type(None)),
    "low": (list, type(None)),
    "high": (list, type(None)),
    "status": (str,),
    "ok": (bool,),
    "failure": (str,),
    "seconds": (float, int),
}
"""What a whole line holds."""

Key = tuple[str, str, int]


@dataclass(frozen=True)
class DrawStore:
    """A folder with the draws of a study.

    Attributes
    ----------
    folder : Path
    """

    folder: Path

    def begin(self, settings: Mapping[str, Any]) -> list[Row]:
        """Make sure that what is there goes with these settings, and give it.

        Parameters
        ----------
        settings : mapping
            `DeclaredStudy.settings`.

        Returns
        -------
        list of rows
            Those that are done, each once; damaged lines are dropped from the file.

        Raises
        ------
        OptionError
            Draws of other settings are there.
        UnreadableFileError
            What is there is no folder of a study.
        OutputPathError
            The folder cannot be written.
        """
        wanted = json.loads(json.dumps(settings))
        path = self.folder / SETTINGS
        if path.exists():
            self._compare(_content(path), wanted)
        elif (self.folder / ROWS).exists():
            raise UnreadableFileError(
                f"found {ROWS} without {SETTINGS} in {shown(str(self.folder))}; expected both of a "
                "study, or neither; choose another folder"
            )
        else:
            document = {"form": FORM, "settings": wanted}
            write_atomically(path, json.dumps(document, indent=1) + "\n")
        return self._whole_rows()

    def append(self, rows: Sequence[Row]) -> None:
        """Add lines in one write.

        Parameters
        ----------
        rows : sequence of mapping

        Raises
        ------
        OutputPathError
            The disk is full, or the folder cannot be written.
        """
        text = "".join(json.dumps(row, allow_nan=False) + "\n" for row in rows)
        try:
            with open(self.folder / ROWS, "ab", buffering=0) as stream:
                data = memoryview(text.encode())
                while data:
                    data = data[stream.write(data) :]
        except OSError as error:
            raise self._refusal(error) from error

    def _whole_rows(self) -> list[Row]:
        path = self.folder / ROWS
        try:
            raw = path.read_bytes() if path.exists() else b""
        except OSError as error:
            raise self._refusal(error) from error
        lines = raw.splitlines(keepends=True)
        rows = {key_of(row): row for row in map(_row, lines) if row is not None}
        if len(rows) < len(lines):
            write_atomically(path, "".join(json.dumps(row) + "\n" for row in rows.values()))
        return list(rows.values())

    def _compare(self, before: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
        changed = [name for name in {**before, **wanted} if before.get(name) != wanted.get(name)]
        if changed:
            raise OptionError(
                f"found draws of other settings in {shown(str(self.folder))} (other "
                f"{', '.join(changed)}); expected the same study to go on with; choose another "
                "folder, or remove this one to begin anew"
            )

    def _refusal(self, error: OSError) -> OutputPathError:
        return OutputPathError(
            f"found no way to write to {shown(str(self.folder))} ({error.strerror or error}); "
            "expected a folder that can be written, with room; draws that are done are kept: "
            "make room and run it again, or choose another folder"
        )


def key_of(row: Row) -> Key:
    """By what a draw is known: cell, method, number."""
    return row["cell"], row["method"], row["draw"]


def _row(line: bytes) -> Row | None:
    """A line as a row; none if it is not whole."""
    if not line.endswith(b"\n"):
        return None
    try:
        row = json.loads(line)
    except ValueError:
        return None
    if not isinstance(row, dict) or set(row) != set(FIELDS):
        return None
    return row if all(isinstance(row[name], kinds) for name, kinds in FIELDS.items()) else None


def _content(path: Path) -> Mapping[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        if found["form"] == FORM and isinstance(found["settings"], dict):
            return dict(found["settings"])
    except (OSError, ValueError, KeyError, TypeError):
        pass
    raise UnreadableFileError.found(
        "no settings of a study in ", str(path), f"those of form {FORM}", "choose another folder"
    )
