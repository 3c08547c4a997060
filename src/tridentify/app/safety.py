"""Who may ask: this machine, with the token, from the page that this server gave out.

The server listens on the loopback only. A page of another site that runs in the same browser could
still send requests there (cross-site forgery) or give its own name an address of this machine (DNS
rebinding); the token, the checks of Host and Origin, and a cookie that no other site can send
close both.
"""

from __future__ import annotations

import secrets
from collections.abc import Awaitable, Callable
from pathlib import Path

from fastapi import Request
from fastapi.responses import HTMLResponse, JSONResponse, Response

from tridentify.errors import OptionError, UnreadableFileError, shown

COOKIE = "tridentify-{port}"
"""Cookies are told apart by their names and not by the port: two workbenches have one each."""
NAMES = ("127.0.0.1", "localhost", "[::1]")
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'self'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
        "img-src 'self' data: blob:; object-src 'none'; base-uri 'none'; form-action 'self'; "
        "frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}
"""Of every answer. plotly.js writes styles into the page, so inline styles are allowed; scripts
are not."""
ENTRANCE = """<!doctype html>
<meta http-equiv="refresh" content="0; url=/">
<title>tridentify workbench</title>
<p><a href="/">Open the workbench</a></p>
"""
"""Leads from the address with the token to the page. It is a page of this server that does so and
no redirection: on the way from a link of another page, such as a notebook, browsers send no cookie
that is for this site alone."""
SMALL = 1_000_000
"""Bytes of a request that uploads nothing."""

Next = Callable[[Request], Awaitable[Response]]


def problem(status: int, code: str, message: str, remedy: str = "") -> JSONResponse:
    """A refusal as one line and what to do."""
    error = {"code": code, "message": message, "remedy": remedy}
    return JSONResponse({"error": error}, status)


class Guard:
    """Lets through what may be asked, and puts `HEADERS` on every answer.

    Parameters
    ----------
    token : str
    port : int
    most_uploaded : int
        Bytes.
    """

    def __init__(self, token: str, port: int, most_uploaded: int = 512_000_000) -> None:
        self.token = token
        self.hosts = {f"{name}:{port}" for name in NAMES}
        self.origins = {f"http://{host}" for host in self.hosts}
        self.cookie = COOKIE.format(port=port)
        self.most_uploaded = most_uploaded

    async def __call__(self, request: Request, follow: Next) -> Response:
        """Answer a request, or refuse it."""
        answer = self._refused(request) or self._entered(request)
        if answer is None:
            answer = await follow(request)
        for name, value in HEADERS.items():
            answer.headers[name] = value
        return answer

    def _refused(self, request: Request) -> Response | None:
        """Why this is not let in; None where it is."""
        host = request.headers.get("host", "")
        origin = request.headers.get("origin")
        if host not in self.hosts:
            return problem(403, "host", "this server answers to its own address only")
        if origin is not None and origin not in self.origins:
            return problem(403, "origin", "another page asks; only the workbench's own may")
        if "transfer-encoding" in request.headers:  # its end is not known before it is there
            return problem(411, "length", "found a request without its length; expected one")
        length = request.headers.get("content-length", "0")
        most = self.most_uploaded if request.url.path.endswith("/upload") else SMALL
        if not length.isdigit() or int(length) > most:
            return problem(
                413,
                "too-large",
                f"found an upload of {shown(length)} bytes; expected at most {most:,}",
                "open large files from the folder of the workbench, which copies nothing",
            )
        return None

    def _entered(self, request: Request) -> Response | None:
        """The page with the token in its address gets a cookie; others need it, or the header."""
        asked = request.query_params.get("token")
        if request.url.path == "/" and asked is not None and self._fits(asked):
            answer = HTMLResponse(ENTRANCE)
            answer.set_cookie(self.cookie, self.token, httponly=True, samesite="strict", path="/")
            return answer
        given = request.cookies.get(self.cookie, "")
        header = request.headers.get("authorization", "").removeprefix("Bearer ")
        if self._fits(given) or self._fits(header):
            return None
        return problem(
            403, "token", "this address lacks the token", "open the one that the server printed"
        )

    def _fits(self, given: str) -> bool:
        return secrets.compare_digest(given.encode(), self.token.encode())


def inside(folder: Path | None, name: str) -> Path:
    """A file of the opened folder, and of no other.

    Parameters
    ----------
    folder : Path or None
        As it was opened, resolved.
    name : str
        As the page gives it.

    Raises
    ------
    OptionError
        It leads out of the folder, by its name or by a link.
    UnreadableFileError
        There is no such file.
    """
    if folder is None:
        raise UnreadableFileError(
            f"found no folder to look for {shown(name)} in; expected a workbench that was started "
            "on one; upload the file"
        )
    path = folder if "\0" in name else (folder / name).resolve()
    if path == folder or not path.is_relative_to(folder):
        raise OptionError(
            f"found {shown(name)}, which leads out of the opened folder; expected a file in it; "
            "start the workbench on the other folder, or upload the file"
        )
    if not path.is_file():
        raise UnreadableFileError(
            f"found no file {shown(name)} in the opened folder; expected one of those listed; "
            "reload the list"
        )
    return path
