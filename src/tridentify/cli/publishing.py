"""Putting a set of files in its place at once: whoever looks finds the old set or the new one.

Where the system can swap two folders in one step, the new set is completed with the user's own
files beside the old folder and swapped with it. Elsewhere the set is first marked complete
(`PENDING`) and then moved file by file; a kill in between leaves it to the next run to finish, and
those who read a model take it from there.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import shutil
import stat
from collections.abc import Callable, Sequence
from pathlib import Path

from tridentify.writing.files import PENDING, draft_ending, outdated, sync
from tridentify.writing.lock import lock

PREFIX = ".tridentify-"
_DRAFT = re.compile(re.escape(PREFIX) + "[a-z0-9_]{8}")
_AT_FDCWD = -100
_RENAME_EXCHANGE = 2


# ------------------------------------------------------------------------------------------ drafts
def make_draft(folder: Path) -> Path:
    """Make an empty hidden folder, with the permissions that the umask gives.

    Raises
    ------
    OSError
    """
    draft = folder / f"{PREFIX}{draft_ending()}"
    draft.mkdir()
    return draft


def clear_drafts(folder: Path) -> None:
    """Remove what runs that were killed more than a day ago left in a folder.

    Parameters
    ----------
    folder : Path
        Drafts of others, of runs that still go on, and what only looks like a draft are left alone.
    """
    with contextlib.suppress(OSError):
        for draft in (folder / name for name in os.listdir(folder) if _DRAFT.fullmatch(name)):
            if stat.S_ISDIR(draft.lstat().st_mode) and outdated(draft):
                with lock(draft, patience=0.0) as alone:
                    if alone:
                        shutil.rmtree(draft, ignore_errors=True)


# ------------------------------------------------------------------------------------------- swap
def can_swap(target: Path) -> bool:
    """Whether an existing folder may be replaced as a whole by one that was made beside it.

    Parameters
    ----------
    target : Path
        Absolute, without symbolic links.

    Returns
    -------
    bool
        False where the system cannot, and for a folder that must stay what it is: the one this
        process stands in, one with folders in it, another user's, a mounted or a read-only one.
    """
    if _exchange_of_system() is None or not os.access(target, os.W_OK | os.X_OK):
        return False
    found = target.stat()
    if found.st_uid != os.geteuid() or os.path.ismount(target):
        return False
    try:
        if os.path.samefile(target, os.curdir):
            return False
        return not any(stat.S_ISDIR((target / name).lstat().st_mode) for name in os.listdir(target))
    except OSError:
        return False


def make_like(draft: Path, target: Path) -> None:
    """Give a draft the group, permissions and attributes of the folder that it is to replace.

    Raises
    ------
    OSError
        This user may not.
    """
    if draft.stat().st_gid != target.stat().st_gid:
        os.chown(draft, -1, target.stat().st_gid)
    shutil.copystat(target, draft)
    os.utime(draft)  # its age is its own


def swap(draft: Path, target: Path, names: Sequence[str]) -> None:
    """Let a folder that was made beside the target take its place; the old one becomes the draft.

    Parameters
    ----------
    draft, target : Path
        In the same folder.
    names : sequence of str
        Files of the draft. All others of the target are kept, the same files as before.

    Raises
    ------
    OSError
        It cannot be done; nothing has changed.
    """
    exchange = _exchange_of_system()
    assert exchange is not None
    linked = []
    try:
        for name in sorted(set(os.listdir(target)) - set(names)):
            os.link(target / name, draft / name, follow_symlinks=False)
            linked.append(draft / name)
        sync(draft)
        exchange(draft, target)
    except OSError:
        for path in linked:
            path.unlink()
        raise
    sync(target.parent)
    _take_along(draft, target, names)


def _take_along(old: Path, target: Path, names: Sequence[str]) -> None:
    """Keep what was written into the old folder after its files had been listed."""
    for name in set(os.listdir(old)) - set(names):
        late, place = old / name, target / name
        if not os.path.lexists(place) or not os.path.samestat(late.lstat(), place.lstat()):
            os.replace(late, place)


def _exchange_of_system() -> Callable[[Path, Path], None] | None:
    """The system's way to swap two names, if it has one."""
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):
        return None
    renameat2.argtypes = (*(ctypes.c_int, ctypes.c_char_p) * 2, ctypes.c_uint)

    def exchange(one: Path, other: Path) -> None:
        ends = _AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other)
        if renameat2(*ends, _RENAME_EXCHANGE):
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number), str(other))

    return exchange


# ---------------------------------------------------------------------------------- file by file
def move_in(draft: Path, target: Path, names: Sequence[str]) -> None:
    """Move the files of a draft that lies in the target to their places: all of them, or none.

    Parameters
    ----------
    draft : Path
        A folder in `target`.
    target : Path
    names : sequence of str

    Raises
    ------
    OSError
        It cannot be done; the target is as it was.
    """
    before = draft / "replaced"
    before.mkdir()
    for name in names:
        if os.path.lexists(target / name):
            _second_name(target / name, before / name)
    sync(draft)
    finish(target)
    pending = target / PENDING
    moved: list[str] = []
    try:
        os.rename(draft, pending)
        sync(target)
        for name in names:
            os.replace(pending / name, target / name)
            moved.append(name)
    except BaseException:
        _take_back(pending, target, moved)
        raise
    sync(target)
    shutil.rmtree(pending, ignore_errors=True)


def finish(target: Path) -> None:
    """Move what a killed run had marked complete to its place.

    Parameters
    ----------
    target : Path
        Without such a mark nothing happens.

    Raises
    ------
    OSError
        A file cannot be moved.
    """
    pending = target / PENDING
    try:
        found = pending.lstat()
    except OSError:
        return
    ours = not hasattr(os, "geteuid") or found.st_uid in (os.geteuid(), target.stat().st_uid)
    if not stat.S_ISDIR(found.st_mode) or not ours:
        return
    for name in os.listdir(pending):
        with contextlib.suppress(FileNotFoundError):  # another run finishes it too
            if stat.S_ISREG((pending / name).lstat().st_mode) and not name.startswith("."):
                os.replace(pending / name, target / name)
    sync(target)
    shutil.rmtree(pending, ignore_errors=True)


def _take_back(pending: Path, target: Path, moved: Sequence[str]) -> None:
    draft = target / f"{PREFIX}{draft_ending()}"
    try:
        os.rename(pending, draft)  # no longer complete
    except FileNotFoundError:  # not even begun
        return
    for name in moved:
        before = draft / "replaced" / name
        if os.path.lexists(before):
            os.replace(before, target / name)
        else:
            (target / name).unlink(missing_ok=True)
    shutil.rmtree(draft, ignore_errors=True)


def _second_name(path: Path, other: Path) -> None:
    try:
        os.link(path, other, follow_symlinks=False)
    except OSError:
        shutil.copy2(path, other, follow_symlinks=False)
