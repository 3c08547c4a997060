"""The folder of a fleet's results: a manifest, and parts that are there whole or not at all.

A part is a Parquet file with the rows of one batch. A worker writes it under another name and
renames it, so that a part with its own name is complete; one that a failing disk has cut short is
set aside when the run is resumed, and its records are done again. One run at a time has the folder:
a lock that the system lets go of when the process ends, however it ends.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tridentify.errors import OptionError, UnreadableFileError, shown
from tridentify.fleet.rows import schema, to_frame
from tridentify.writing.files import outdated, write_atomically
from tridentify.writing.lock import make_folder

MANIFEST = "manifest.json"
PARTS = "parts"
DAMAGED = ".damaged"
FORM = 1
"""Version of the folder's layout: raised when it changes."""


@dataclass(frozen=True)
class Store:
    """A folder of results.

    Attributes
    ----------
    folder : Path
    """

    folder: Path

    @property
    def parts(self) -> Path:
        """Where the parts are."""
        return self.folder / PARTS

    def begin(self, settings: Mapping[str, Any], *, resume: bool) -> tuple[str, ...]:
        """Make sure that what is there goes with these settings.

        Parameters
        ----------
        settings : mapping
            What decides about the numbers, as JSON holds it.
        resume : bool
            Whether rows that are there are kept; otherwise they are removed.

        Returns
        -------
        tuple of str
            Notes on damaged parts that were set aside.

        Raises
        ------
        OptionError
            Rows of other settings are there.
        OutputPathError
            The folder cannot be written.
        """
        make_folder(self.parts)
        digest = digest_of(settings)
        before = self.manifest()
        if not resume:
            for path in (*self.parts.glob("*.parquet"), *self.parts.glob(f"*{DAMAGED}")):
                path.unlink()
        elif before and before["settings"] != digest:
            changed = ", ".join(
                f"{name} {shown(before['options'].get(name), 60)}"
                for name in settings
                if before["options"].get(name) != settings[name]
            )
            raise OptionError(
                f"found results of other settings in {shown(str(self.folder))} ({changed}); "
                "expected the same to go on with; choose another folder, or begin anew with "
                "resume=False (--no-resume), which removes them"
            )
        if not before or not resume:
            content = {"form": FORM, "settings": digest, "options": dict(settings)}
            write_atomically(self.folder / MANIFEST, json.dumps(content, indent=1) + "\n")
        for draft in filter(outdated, self.parts.glob(".part-*")):
            draft.unlink(missing_ok=True)
        return self.set_aside()

    def manifest(self) -> dict[str, Any]:
        """What the run was asked; empty if there is none.

        Raises
        ------
        UnreadableFileError
            It is no manifest.
        """
        path = self.folder / MANIFEST
        if not path.exists():
            return {}
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
            if found["form"] == FORM and isinstance(found["options"], dict):
                return dict(found)
        except (OSError, ValueError, KeyError, TypeError):
            pass
        raise UnreadableFileError.found(
            "no manifest of a fleet in ", str(path), f"one of form {FORM}", "choose another folder"
        )

    def set_aside(self) -> tuple[str, ...]:
        """Rename parts that are not whole; their records count as not done."""
        import polars as pl

        notes = []
        for path in self.files():
            try:
                whole = pl.scan_parquet(path, glob=False).collect_schema() == pl.Schema(schema())
                whole &= pl.scan_parquet(path, glob=False).select("key").collect().height > 0
            except Exception:
                whole = False
            if not whole:
                os.replace(path, path.with_name(path.name + DAMAGED))
                notes.append(
                    f"found the part {path.name} damaged; it is set aside as {path.name}{DAMAGED} "
                    "and its records are done again"
                )
        return tuple(notes)

    def files(self) -> list[Path]:
        """Complete parts in the order of their names."""
        return sorted(self.parts.glob("*.parquet"))

    def keys(self) -> set[str]:
        """Keys of all rows."""
        import polars as pl

        found: set[str] = set()
        for path in self.files():
            column = pl.scan_parquet(path, glob=False).select("key").collect()["key"]
            found.update(column.to_list())
        return found

    def rows(self, columns: Sequence[str] | None = None) -> Any:
        """All rows as a frame of polars: every key once, the last attempt, sorted by key.

        Parameters
        ----------
        columns : sequence of str, optional
            Those that are wanted.

        Raises
        ------
        UnreadableFileError
            A part is damaged.
        """
        import polars as pl

        files = self.files()
        if not files:
            found = to_frame([])
            return found if columns is None else found.select(columns)
        lazy = pl.scan_parquet(files, glob=False)
        if columns is not None:
            lazy = lazy.select(list(dict.fromkeys((*columns, "key", "attempt"))))
        # a batch that was handed out twice, since its worker was lost, has its rows once
        lazy = lazy.sort("key", "attempt", maintain_order=True).unique(
            "key", keep="last", maintain_order=True
        )
        try:
            return lazy.collect() if columns is None else lazy.select(columns).collect()
        except (pl.exceptions.PolarsError, OSError) as error:
            raise UnreadableFileError(
                f"found a damaged part in {shown(str(files[0].parent))}; expected whole Parquet "
                "files; call fleet.fit again with the same settings, which does its records again"
            ) from error


def digest_of(settings: Mapping[str, Any]) -> str:
    """A hash of settings.

    Examples
    --------
    >>> digest_of({"a": 1}) == digest_of({"a": 1}) != digest_of({"a": 2})
    True
    """
    text = json.dumps(settings, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def write_part(path: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows under another name, then rename.

    Raises
    ------
    OutputPathError
        The disk is full, or the folder cannot be written.
    """
    content = io.BytesIO()
    to_frame(rows).write_parquet(content)
    write_atomically(path, content.getvalue())
