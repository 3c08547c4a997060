"""One process at a time in a folder."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from pathlib import Path

from tridentify.errors import OutputPathError, shown

PATIENCE = 10.0
"""How long another run may take to put its files in their places [s]: a thousand times what it
needs, so that one that was stopped holds up nobody for good."""


@contextlib.contextmanager
def lock(folder: Path, patience: float = PATIENCE) -> Iterator[bool]:
    """Hold a folder for this process; the system lets go of it when the process ends.

    Parameters
    ----------
    folder : Path
    patience : float
        How long to wait for another process [s].

    Yields
    ------
    bool
        False if another process still holds it; True also where the system has no such locks.
    """
    try:
        import fcntl

        number = os.open(folder, os.O_RDONLY)
    except (ImportError, OSError):
        yield True
        return
    end = time.monotonic() + patience
    try:
        held = False
        while True:
            try:
                fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
                held = True
                break
            except BlockingIOError:
                if time.monotonic() >= end:
                    break
                time.sleep(0.01)
            except OSError:  # a file system without locks
                held = True
                break
        yield held
    finally:
        os.close(number)


def make_folder(folder: Path) -> None:
    """Make a folder of results, if it is not there.

    Raises
    ------
    OutputPathError
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputPathError(
            f"found no way to make the folder {shown(str(folder))} ({error.strerror or error}); "
            "expected one that can be written; choose another folder"
        ) from error


@contextlib.contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Hold a folder of results for a run that goes on where another ended; it is made if need be.

    Raises
    ------
    OutputPathError
        It cannot be made, or another run is at work there.
    """
    make_folder(folder)
    with lock(folder, patience=0.0) as held:
        if not held:
            raise OutputPathError(
                f"found another run at work in {shown(str(folder))}; expected one at a time; wait "
                "for it, or choose another folder"
            )
        yield
