"""Files that are either complete or absent, also after a kill or a power cut.

And signals over time as CSV: a column a channel, its unit in brackets behind its name.
"""

from __future__ import annotations

import contextlib
import csv
import errno
import functools
import io
import json
import os
import re
import secrets
import stat
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tridentify.errors import OptionError, OutputPathError
from tridentify.numerics.arrays import Array


def columns_over_time(
    t: Array, values: Array, names: Sequence[str], units: Mapping[str, str]
) -> str:
    r"""The text of a table of signals.

    Parameters
    ----------
    t : (n_samples,) array
        [s]; rounded to 12 digits: 0.3, not 0.30000000000000004.
    values : (n_samples, n_channels) array
    names : sequence of str
    units : mapping of str to str
        By name, where they are known.

    Examples
    --------
    >>> import numpy as np
    >>> columns_over_time(np.array([0.0, 0.1]), np.array([[1.0], [2.5]]), ["q"], {"q": "rad/s"})
    't [s],q [rad/s]\n0,1.0\n0.1,2.5\n'
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    heads = [f"{name} [{units[name]}]" if units.get(name) else name for name in names]
    writer.writerow(["t [s]", *heads])
    for at, row in zip(t.tolist(), values.tolist(), strict=True):
        writer.writerow([f"{at:.12g}", *map(repr, row)])
    return text.getvalue()


DRAFT_AGE = 86_400.0
"""After so long without a change a draft belongs to a run that was killed [s]: a day, longer than
any file or folder takes to write."""
PENDING = ".tridentify-publishing"
"""Folder of files that replace those of the same names beside it: a set that was complete when its
run was killed."""
_SHOWN_NAME = 40
"""Characters of a file's name in that of its draft: with its ending it stays a legal name."""


def write_atomically(path: str | os.PathLike[str], content: str | bytes) -> Path:
    """Write a file under a temporary name in its folder, then rename it.

    Parameters
    ----------
    path : path-like
        Missing folders are made; an existing file is replaced. A device or a pipe is written to.
    content : str or bytes
        Text is written as UTF-8.

    Returns
    -------
    Path
        Of a file that is on the disk, with the permissions that the umask gives.

    Raises
    ------
    OutputPathError
        The folder or the file cannot be written; nothing is left behind.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_atomically(Path(folder) / "new" / "note.txt", "done").read_text()
    'done'
    """
    target = checked_path(path)
    data = content.encode("utf-8") if isinstance(content, str) else content
    try:
        if _is_channel(target):
            target.write_bytes(data)
        else:
            target.parent.mkdir(parents=True, exist_ok=True)
            _clear_drafts_of(target)
            _replace(target, data)
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputPathError(
            f"found no way to write {target} ({reason}); expected a folder that can be written; "
            "choose another output path"
        ) from error
    return target


def checked_path(path: object) -> Path:
    """The name of a file.

    Raises
    ------
    OptionError
        It is neither a text nor a path.

    Examples
    --------
    >>> checked_path("model.json").name
    'model.json'
    """
    if isinstance(path, str | os.PathLike):
        return Path(path)
    raise OptionError.found("the path ", path, "the name of a file", 'write "model.json"')


def write_json(path: str | os.PathLike[str], document: Any) -> Path:
    """Write a document of plain values as `write_atomically` does.

    Raises
    ------
    OutputPathError
        The file cannot be written.
    """
    return write_atomically(path, json.dumps(document, indent=1, allow_nan=False) + "\n")


def _replace(target: Path, data: bytes) -> None:
    draft = target.with_name(f".{target.name[:_SHOWN_NAME]}.{draft_ending()}")
    # open() applies the umask itself; asking for the umask would change it for all threads
    number = os.open(
        draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666
    )
    try:
        with os.fdopen(number, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(draft, target)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(draft)
        raise
    with contextlib.suppress(OSError):
        os.unlink(target.parent / PENDING / target.name)  # this one is newer
    sync(target.parent)


def sync(path: Path) -> None:
    """Wait until a file, or the list of files in a folder, is on the disk.

    Raises
    ------
    OSError
        The disk failed. A system that cannot do it for this kind of file is no failure.
    """
    windows = os.name == "nt"
    if windows and path.is_dir():
        return
    try:
        number = os.open(path, os.O_RDWR if windows else os.O_RDONLY)
    except PermissionError:
        return
    try:
        os.fsync(number)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP, errno.EBADF):
            raise
    finally:
        os.close(number)


def draft_ending() -> str:
    """Eight random characters, as all drafts end with."""
    return secrets.token_hex(4)


def outdated(path: Path) -> bool:
    """Whether a draft is this user's own and has not changed for a day.

    Parameters
    ----------
    path : Path
        File or folder.

    Returns
    -------
    bool
    """
    try:
        found = os.lstat(path)
        changed = found.st_mtime
        if stat.S_ISDIR(found.st_mode):
            changed = max(changed, *(item.lstat().st_mtime for item in path.iterdir()), 0.0)
    except OSError:
        return False
    ours = not hasattr(os, "geteuid") or found.st_uid == os.geteuid()
    return ours and time.time() - changed > DRAFT_AGE


def published(path: str | os.PathLike[str]) -> Path:
    """Where the newest whole version of a file lies.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    Path
        The file itself, or its successor if a run was killed while it put a set in its place.
    """
    here = Path(path)
    waiting = here.parent / PENDING / here.name
    return waiting if waiting.is_file() else here


@functools.cache
def _clear_drafts_of(target: Path) -> None:
    """Remove what killed runs left of a file; once a process, as checkpoints are written often."""
    pattern = re.compile(re.escape(f".{target.name[:_SHOWN_NAME]}.") + "[a-z0-9_]{8}")
    with contextlib.suppress(OSError):
        for name in filter(pattern.fullmatch, os.listdir(target.parent)):
            draft = target.parent / name
            if stat.S_ISREG(draft.lstat().st_mode) and outdated(draft):
                draft.unlink()


def _is_channel(target: Path) -> bool:
    try:
        mode = target.stat().st_mode
    except OSError:
        return False
    return stat.S_ISCHR(mode) or stat.S_ISFIFO(mode)
