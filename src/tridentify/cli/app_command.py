"""``tridentify app``: the workbench in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tridentify.cli.terminal import say

MEGABYTE = 1_000_000


def workbench(
    files: Annotated[list[Path] | None, typer.Argument(metavar="FILES")] = None,
    port: Annotated[int, typer.Option(metavar="N", min=0, max=65535)] = 0,
    token: Annotated[str | None, typer.Option(metavar="TEXT")] = None,
    session: Annotated[Path | None, typer.Option(metavar="FILE")] = None,
    most_uploaded: Annotated[int, typer.Option("--max-upload", metavar="MB", min=1)] = 512,
    no_open: Annotated[bool, typer.Option("--no-open")] = False,
) -> None:
    """Open the workbench: records, estimates and models in the browser.

    It answers this machine alone. Example: tridentify app flights/

    Parameters
    ----------
    files
        A folder whose files are offered, or files that are opened at once.
    port
        0 for any that is free.
    token
        What the page has to show; by default one of its own.
    session
        Where the session is kept; beside the files.
    most_uploaded
        Of an upload.
    no_open
        Do not open the browser; the address is printed.
    """
    from tridentify.app.start import start

    start(
        files or (),
        port=port,
        token=token,
        session=session,
        most_uploaded=most_uploaded * MEGABYTE,
        open_page=not no_open,
        tell=lambda address: say(f"The workbench is at {address}  (Ctrl-C ends it)"),
    )
