"""The workbench from Python: a record in memory, opened in the browser beside the notebook."""

from __future__ import annotations

import atexit
import html
import json
import re
import secrets
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
import webbrowser
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tridentify.app.start import HOST, check_installed
from tridentify.errors import OutputPathError
from tridentify.record.formats.frames import frame_from_record
from tridentify.record.record import Record

PATIENCE = 120.0
"""Seconds that the server may take to start."""


@dataclass(frozen=True)
class Workbench:
    """A workbench that runs beside this program, until it is stopped or the program ends.

    Attributes
    ----------
    address : str
        Of the page, with its token.
    folder : Path
        Where the record and the session are kept.
    """

    address: str
    folder: Path
    _process: subprocess.Popen[bytes] = field(repr=False)

    def stop(self) -> None:
        """End the server; the session stays in its folder."""
        self._process.terminate()
        self._process.wait()

    def _repr_html_(self) -> str:
        address = html.escape(self.address, quote=True)
        return f'<a href="{address}" target="_blank" rel="noopener">Open the workbench</a>'


def explore(record: Record, *, folder: Path | None = None, open_page: bool = True) -> Workbench:
    """Open a record in the workbench; what `Record.explore` does.

    Parameters
    ----------
    record : Record
    folder : Path, optional
        Where the record and the session are written; a new temporary one where left out.
    open_page : bool
        Whether a browser is opened.

    Returns
    -------
    Workbench

    Raises
    ------
    MissingDependencyError
        The extra ``app`` is not installed.
    OutputPathError
        The server did not start.
    """
    check_installed()
    place = Path(tempfile.mkdtemp(prefix="tridentify-")) if folder is None else Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    name = re.sub(r"[^\w.-]+", "_", record.name or "record")
    file = place / f"{name}.parquet"
    frame_from_record(record).write_parquet(file)
    port, token = _free_port(), secrets.token_urlsafe(24)
    command = [sys.executable, "-m", "tridentify", "app", str(file), "--no-open"]
    process = subprocess.Popen(
        [*command, "--port", str(port), "--token", token],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    atexit.register(process.terminate)
    root = f"http://{HOST}:{port}"
    _tell_roles(root, token, record, process)
    opened = Workbench(f"{root}/?token={token}", place, process)
    if open_page:
        webbrowser.open(opened.address)
    return opened


def _free_port() -> int:
    with socket.socket() as found:
        found.bind((HOST, 0))
        return int(found.getsockname()[1])


def _tell_roles(root: str, token: str, record: Record, process: subprocess.Popen[bytes]) -> None:
    """Wait for the server, and say which channel is what: the file does not."""
    end = time.monotonic() + PATIENCE
    while True:
        try:
            session = _asked(root, token, "/session")
            break
        except (urllib.error.URLError, ConnectionError):
            if process.poll() is not None or time.monotonic() > end:
                process.terminate()
                raise OutputPathError(
                    "found that the workbench did not start; expected a server on this machine; "
                    "run `tridentify app` in a terminal to see why"
                ) from None
            time.sleep(0.05)
    roles = {
        "inputs": list(record.input_names),
        "outputs": list(record.output_names),
        "references": list(record.reference_names),
        "intersample": record.intersample,
    }
    card = session["records"][-1]
    _asked(root, token, f"/records/{card['id']}", roles)


def _asked(root: str, token: str, path: str, body: Mapping[str, Any] | None = None) -> Any:
    headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}
    request = urllib.request.Request(
        f"{root}/api{path}",
        data=None if body is None else json.dumps(body).encode(),
        headers=headers,
        method="GET" if body is None else "PATCH",
    )
    with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
        return json.load(answer)
