"""``tridentify app``: the server on a free port of this machine, and the browser on its page."""

from __future__ import annotations

import contextlib
import socket
import threading
import webbrowser
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tridentify.errors import MissingDependencyError, OptionError, UnreadableFileError, shown
from tridentify.writing.lock import lock

if TYPE_CHECKING:
    from tridentify.app.session import Session

SESSION = ".tridentify-session.sqlite"
HOST = "127.0.0.1"
MOST_UPLOADED = 512_000_000
"""Bytes: an hour of eight channels at 1 kHz as text is half of it."""
GRACE = 1
"""Seconds that open pages are given when the server ends."""
PATIENCE = 2.0 * GRACE
"""Seconds that another workbench on the same session is given to end."""


def check_installed() -> None:
    """Refuse in one line where the extra is missing.

    Raises
    ------
    MissingDependencyError
    """
    from importlib.util import find_spec

    missing = [
        name for name in ("fastapi", "uvicorn", "plotly", "python_multipart") if not find_spec(name)
    ]
    if missing:
        raise MissingDependencyError(
            f"found no {', '.join(missing)}; expected what the workbench is built on; "
            "pip install tridentify[app]"
        )


def start(
    files: Sequence[Path] = (),
    *,
    port: int = 0,
    token: str | None = None,
    session: Path | None = None,
    most_uploaded: int = MOST_UPLOADED,
    open_page: bool = True,
    tell: Callable[[str], None] = lambda address: None,
) -> None:
    """Serve the workbench until it is interrupted.

    Parameters
    ----------
    files : sequence of Path
        A folder whose files are offered, or files that are opened at once, which offers their
        folder; the present folder where there are none.
    port : int
        Zero for any that is free.
    token : str, optional
        What the page has to show; kept with the session where left out.
    session : Path, optional
        Where the session is kept; beside the files by default.
    most_uploaded : int
        Bytes.
    open_page : bool
        Whether a browser is opened.
    tell : callable
        Told the address with its token.

    Raises
    ------
    MissingDependencyError
        The extra ``app`` is not installed.
    OptionError
        The port is taken, files lie in several folders, or another workbench has the session.
    UnreadableFileError
        A file does not exist.
    """
    check_installed()
    import uvicorn

    from tridentify.app.bench import Bench
    from tridentify.app.safety import Guard
    from tridentify.app.server import create
    from tridentify.app.session import Session

    folder, named = _folder_and_files(files)
    place = _bound(port)
    with _alone(Session(folder / SESSION if session is None else session)) as kept:
        secret = token or kept.token
        bench = Bench(kept, folder)
        number = int(place.getsockname()[1])
        server = uvicorn.Server(
            uvicorn.Config(
                create(bench, Guard(secret, number, most_uploaded)),
                log_level="critical",
                timeout_graceful_shutdown=GRACE,
            )
        )
        address = f"http://{HOST}:{number}/?token={secret}"
        bench.start()
        try:
            opened = {one["file"] for one in kept.state["records"]}
            for name in named:
                if name not in opened:
                    bench.open_file(name)
            tell(address)
            if open_page:
                threading.Timer(0.3, webbrowser.open, [address]).start()
            server.run(sockets=[place])
        finally:
            bench.stop()


@contextlib.contextmanager
def _alone(session: Session) -> Iterator[Session]:
    """A session that no other process has open: each would write over the other."""
    with lock(session.path, PATIENCE) as held:
        if not held:
            session.close()
            raise OptionError(
                f"found the session {shown(str(session.path))} open in another workbench; expected "
                "one at a time; go on in its page, end it, or give another file with --session"
            )
        yield session


def _folder_and_files(given: Sequence[Path]) -> tuple[Path, list[str]]:
    """The folder that is opened, and the names of files in it."""
    if not given:
        return Path.cwd(), []
    for path in given:
        if not path.exists():
            raise UnreadableFileError(
                f"found no file {shown(str(path))}; expected a file or folder; correct the path"
            )
    folders = {path.resolve() if path.is_dir() else path.resolve().parent for path in given}
    if len(folders) > 1:
        listed = ", ".join(sorted(map(str, folders)))
        raise OptionError(
            f"found files of several folders ({listed}); expected those of one; give the folder "
            "above them, or upload the others on the page"
        )
    return folders.pop(), [path.resolve().name for path in given if path.is_file()]


def _bound(port: int) -> socket.socket:
    place = socket.socket()
    place.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        place.bind((HOST, port))
    except OSError:
        raise OptionError(
            f"found the port {port} in use; expected a free one; leave --port out to get one"
        ) from None
    return place
