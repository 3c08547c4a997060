"""Files that are either complete or absent."""

from __future__ import annotations

import contextlib
import os
import tempfile
from pathlib import Path

from tridentify.errors import OutputPathError


def write_atomically(path: str | os.PathLike[str], content: str | bytes) -> Path:
    """Write a file under a temporary name in its folder, then rename it.

    Parameters
    ----------
    path : path-like
        Missing folders are made; an existing file is replaced.
    content : str or bytes
        Text is written as UTF-8.

    Returns
    -------
    Path

    Raises
    ------
    OutputPathError
        The folder or the file cannot be written; nothing is left behind.

    Examples
    --------
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_atomically(Path(folder) / "new" / "note.txt", "done").read_text()
    'done'
    """
    target = Path(path)
    data = content.encode("utf-8") if isinstance(content, str) else content
    temporary: str | None = None
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(prefix=f".{target.name}.", dir=target.parent)
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
        # mkstemp makes a private file; give it what an ordinary open() would have given
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(temporary, 0o666 & ~mask)
        os.replace(temporary, target)
    except OSError as error:
        if temporary is not None:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
        reason = error.strerror or str(error)
        raise OutputPathError(
            f"found no way to write {target} ({reason}); expected a folder that can be written; "
            "choose another output path"
        ) from error
    return target
