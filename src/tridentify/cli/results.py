"""A folder of results that is written whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
from collections.abc import Sequence
from pathlib import Path

from tridentify.cli import publishing
from tridentify.errors import OutputPathError
from tridentify.writing.files import sync
from tridentify.writing.interruption import held_back
from tridentify.writing.lock import lock


class ResultFolder:
    """Collects files in a hidden draft of the folder and puts them in its place at the end.

    Opening it is the proof that the target can be written, before any long work. Leaving the
    ``with`` block through an exception, or without `publish`, leaves the disk as it was. A run that
    is killed leaves the old files or the new ones, and at worst a hidden draft, which the first run
    a day later removes.

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
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as place, ResultFolder(Path(place, "new")) as results:
    ...     _ = (results.draft / "note.txt").write_text("done")
    ...     [path.name for path in results.publish()]
    ['note.txt']
    """

    def __init__(self, target: Path) -> None:
        self.target = target
        self._place = Path(os.path.realpath(target))
        self._draft: Path | None = None
        self._open = contextlib.ExitStack()

    @property
    def draft(self) -> Path:
        """Where to write; the files appear in the target when they are published."""
        assert self._draft is not None, "the folder is not open"
        return self._draft

    def __enter__(self) -> ResultFolder:
        try:
            with held_back():
                self._begin()
        except BaseException:
            self._discard()
            raise
        return self

    def _begin(self) -> None:
        try:
            existing = self._existing_part()
            for folder in {existing, self._place.parent}:
                publishing.clear_drafts(folder)
            self._draft = self._draft_beside() or publishing.make_draft(existing)
            # so that no other run takes it for one that was left behind
            self._open.enter_context(lock(self._draft))
        except OSError as error:
            raise self._refusal(error) from error

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        draft = self.draft
        with held_back():
            self._discard()
        if isinstance(error, OSError) and str(draft) in str(error):
            raise self._refusal(error) from error

    def _discard(self) -> None:
        """Leave nothing behind but what was published."""
        draft, self._draft = self._draft, None
        if draft is not None:
            shutil.rmtree(draft, ignore_errors=True)
        self._open.close()

    def publish(self) -> tuple[Path, ...]:
        """Put every file into the target, or none.

        Returns
        -------
        tuple of Path
            The files in their places, in the order of their names.
        """
        names = sorted(path.name for path in self.draft.iterdir())
        made = self._missing_part()
        try:
            for path in (*(self.draft / name for name in names), self.draft):
                sync(path)
            with lock(self._folder_to_lock()):
                self._put_in_place(names)
            for folder in made:
                sync(folder.parent)
        except BaseException as error:
            for folder in made:
                with contextlib.suppress(OSError):
                    folder.rmdir()
            if isinstance(error, OSError):
                raise self._refusal(error) from error
            raise
        return tuple(self.target / name for name in names)

    def _put_in_place(self, names: Sequence[str]) -> None:
        place = self._place
        place.parent.mkdir(parents=True, exist_ok=True)
        try:
            if not place.exists():
                os.rename(self.draft, place)
                return
        except OSError as error:  # another run made it just now
            if error.errno not in (errno.EEXIST, errno.ENOTEMPTY):
                raise
        for name in names:
            if (place / name).is_dir():
                raise IsADirectoryError(f"{name} is a folder there")
        publishing.finish(place)
        if self.draft.parent == place.parent and publishing.can_swap(place):
            try:
                publishing.swap(self.draft, place, names)
                return
            except OSError:  # a file system that has no swap, or a file that takes no second name
                pass
        if self.draft.parent != place:
            self._draft = self.draft.rename(place / self.draft.name)
        publishing.move_in(self.draft, place, names)

    def _draft_beside(self) -> Path | None:
        """A draft in the parent of an existing target, if it may take the target's place."""
        if not self._place.is_dir() or not publishing.can_swap(self._place):
            return None
        draft = None
        try:
            draft = publishing.make_draft(self._place.parent)
            publishing.make_like(draft, self._place)
        except OSError:
            if draft is not None:
                draft.rmdir()
            return None
        return draft

    def _existing_part(self) -> Path:
        """The target, or the nearest folder above it that exists."""
        for folder in (self._place, *self._place.parents):
            if os.path.lexists(folder):
                break
        if not folder.is_dir():
            raise NotADirectoryError(f"{folder} is no folder")
        return folder

    def _folder_to_lock(self) -> Path:
        # the target itself may be another folder in a moment
        parent = self._place.parent
        return parent if os.access(parent, os.R_OK) else self._existing_part()

    def _missing_part(self) -> list[Path]:
        """Folders that have to be made, the innermost first."""
        return [folder for folder in (self._place, *self._place.parents) if not folder.exists()]

    def _refusal(self, error: OSError) -> OutputPathError:
        cause = error.__cause__ if isinstance(error.__cause__, OSError) else error
        reason = cause.strerror or str(cause)
        return OutputPathError(
            f"found no way to write the folder {str(self.target)!r} ({reason}); expected a folder "
            "that can be made and written; choose another one with --out"
        )
