"""The pictures of the page about the workbench, taken in headless Chromium.

Run from the root of the checkout: ``.venv/bin/python docs/workbench_pictures.py``.
"""

from __future__ import annotations

import argparse
import secrets
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
SIZE = {"width": 1280, "height": 820}
COLOURS = 160
"""Of a picture: enough for thin lines on plain ground, and a quarter of the size."""
PATIENCE = 120.0
"""Seconds that the server may take to start, and the page to show what it is asked for."""
SETTLED = 500
"""Milliseconds in which nothing is drawn any more once the page has come to rest."""


@contextmanager
def workbench(folder: Path) -> Iterator[str]:
    """The address of a server on a folder."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    token = secrets.token_urlsafe(24)
    command = [sys.executable, "-m", "tridentify", "app", str(folder), "--no-open"]
    server = subprocess.Popen([*command, "--port", str(port), "--token", token])
    address = f"http://127.0.0.1:{port}"
    try:
        wait_for(address, token)
        yield f"{address}/?token={token}"
    finally:
        server.terminate()
        server.wait()


def wait_for(address: str, token: str) -> None:
    """Return when the server answers."""
    asked = urllib.request.Request(
        f"{address}/api/session", headers={"Authorization": f"Bearer {token}"}
    )
    end = time.monotonic() + PATIENCE
    while True:
        try:
            urllib.request.urlopen(asked, timeout=2).close()
        except OSError:
            if time.monotonic() > end:
                raise
            time.sleep(0.1)
        else:
            return


def drag(page: Page, start: float, end: float) -> None:
    """Drag over the record, from one share of its width to another."""
    box = page.locator(".overlay").bounding_box()
    if box is None:
        raise RuntimeError("the record is not shown")
    page.mouse.move(box["x"] + start * box["width"], box["y"] + 40)
    page.mouse.down()
    for share in (0.5 * (start + end), end):
        page.mouse.move(box["x"] + share * box["width"], box["y"] + 45)
    page.mouse.up()


def estimated(page: Page, number: int) -> None:
    """Wait for the model of that number."""
    page.locator(".card.model").nth(number - 1).wait_for()
    page.locator("#result .sentence").wait_for()
    at_rest(page)


def at_rest(page: Page) -> None:
    """Wait until nothing is computed, read, said or drawn any more."""
    for under_way in ('[aria-busy="true"]', "#told:not(:empty)"):
        page.locator(under_way).first.wait_for(state="detached")
    before = -1
    while before != (before := page.evaluate("document.querySelectorAll('*').length")):
        page.wait_for_timeout(SETTLED)


def keep(page: Page, path: Path, query: str | None = None) -> None:
    """Take a picture of the window, or of a part of the page, in few colours."""
    at_rest(page)
    if query is None:
        page.screenshot(path=path)
    else:
        page.locator(query).screenshot(path=path)
    with Image.open(path) as picture:
        small = picture.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
    small.save(path, optimize=True)


def take(page: Page, folder: Path) -> None:
    """Walk through the workbench and take the pictures on the way."""
    page.get_by_role("button", name="short_period.csv", exact=True).click()
    page.locator(".card.record.current .channels").wait_for()
    page.locator('[data-key="mode validate"]').click()
    drag(page, 0.8, 0.98)
    page.locator('[data-key="mode identify"]').click()
    drag(page, 0.05, 0.78)
    estimated(page, 1)
    page.mouse.move(5, 5)
    keep(page, folder / "workbench.png")
    page.emulate_media(color_scheme="dark")
    keep(page, folder / "workbench-dark.png")
    page.emulate_media(color_scheme="light")
    page.locator('[data-key="keep"]').check()
    page.locator("#option-poles").select_option("1")
    page.locator('[data-key="run"]').click()
    estimated(page, 2)
    page.locator('[data-key="compare"]').click()
    page.get_by_role("table", name="Fits on the other record").wait_for()
    keep(page, folder / "workbench-panels.png", "#panels")


def main() -> None:
    """Write ``workbench.png``, ``workbench-panels.png`` and ``workbench-dark.png``."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/static"), help="folder")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    program = next(filter(None, map(shutil.which, NAMES)), None)
    if program is None:
        sys.exit("found no Chromium; expected one on the path; run: make browser")
    record = files("tridentify.data").joinpath("short_period.csv")
    with tempfile.TemporaryDirectory() as place, sync_playwright() as play:
        flights = Path(place, "flights")
        flights.mkdir()
        shutil.copy(str(record), flights)
        browser = play.chromium.launch(executable_path=program, args=["--no-sandbox"])
        with workbench(flights) as address:
            page = browser.new_page(viewport=SIZE)
            page.set_default_timeout(1000 * PATIENCE)
            page.goto(address)
            take(page, out)
        browser.close()


if __name__ == "__main__":
    main()
