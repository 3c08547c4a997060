"""A folder of results that is written whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path
from types import TracebackType

from tridentify.errors import OutputPathError


class ResultFolder:
    """Collects files in a temporary folder beside the target and moves them there at the end.

    Opening it is the proof that the target can be written, before any long work. Leaving the
    ``with`` block through an exception, or without `publish`, leaves the disk as it was.

    Parameters
    ----------
    target : Path
        Folder that is asked for; it is made when there is something to put into it. Files in it
        that have other names are kept.

    Raises
    ------
    OutputPathError
        On entering or publishing: the target cannot be written. Nothing is left behind.

    Examples
    --------
    >>> with tempfile.TemporaryDirectory() as place, ResultFolder(Path(place, "new")) as results:
    ...     _ = (results.draft / "note.txt").write_text("done")
    ...     [path.name for path in results.publish()]
    ['note.txt']
    """

    def __init__(self, target: Path) -> None:
        self.target = target
        self._draft: Path | None = None

    @property
    def draft(self) -> Path:
        """Where to write; the files appear in the target when they are published."""
        assert self._draft is not None, "the folder is not open"
        return self._draft

    def __enter__(self) -> ResultFolder:
        try:
            existing = self._existing_part()
            # inside an existing target, so that its parent need not be writable
            self._draft = Path(tempfile.mkdtemp(prefix=".tridentify-", dir=existing))
        except OSError as error:
            raise self._refusal(error) from error
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        draft, self._draft = self.draft, None
        shutil.rmtree(draft, ignore_errors=True)
        if isinstance(error, OSError) and str(draft) in str(error):
            raise self._refusal(error) from error

    def publish(self) -> tuple[Path, ...]:
        """Move every file into the target, or none.

        Returns
        -------
        tuple of Path
            The files in their places, in the order of their names.
        """
        names = sorted(path.name for path in self.draft.iterdir())
        moved: list[tuple[Path, Path | None]] = []
        made = self._missing_part()
        try:
            self.target.mkdir(parents=True, exist_ok=True)
            replaced = Path(tempfile.mkdtemp(prefix="replaced-", dir=self.draft))
            for name in names:
                moved.append(self._move(name, replaced))
        except BaseException as error:
            self._restore(moved, made)
            if isinstance(error, OSError):
                raise self._refusal(error) from error
            raise
        return tuple(self.target / name for name in names)

    def _move(self, name: str, replaced: Path) -> tuple[Path, Path | None]:
        place, kept = self.target / name, None
        if place.is_dir():
            raise IsADirectoryError(f"{name} is a folder there")
        if place.exists():
            kept = replaced / name
            shutil.copy2(place, kept)
        os.replace(self.draft / name, place)
        return place, kept

    def _restore(self, moved: list[tuple[Path, Path | None]], made: list[Path]) -> None:
        for place, kept in reversed(moved):
            if kept is None:
                place.unlink(missing_ok=True)
            else:
                os.replace(kept, place)
        for folder in made:
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()

    def _existing_part(self) -> Path:
        """The target, or the nearest folder above it that exists."""
        for folder in (self.target.absolute(), *self.target.absolute().parents):
            if os.path.lexists(folder):
                break
        if not folder.is_dir():
            raise NotADirectoryError(f"{folder} is no folder")
        return folder

    def _missing_part(self) -> list[Path]:
        """Folders that have to be made, the innermost first."""
        chain = (self.target.absolute(), *self.target.absolute().parents)
        return [folder for folder in chain if not folder.exists()]

    def _refusal(self, error: OSError) -> OutputPathError:
        cause = error.__cause__ if isinstance(error.__cause__, OSError) else error
        reason = cause.strerror or str(cause)
        return OutputPathError(
            f"found no way to write the folder {str(self.target)!r} ({reason}); expected a folder "
            "that can be made and written; choose another one with --out"
        )
