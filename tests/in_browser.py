"""The page of the workbench in a browser: a server of its own, a tab, what is readable there."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import expect

from tridentify import Record, TransferFunction, simulate

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
COMMAND = [sys.executable, "-m", "tridentify", "app"]
TOKEN = "token-of-the-tests-of-the-page-0123456789"
PATIENCE = 120.0
"""Seconds a server may take to start, and a page to show what it is asked for: on a machine that
has ten times its work to do, no less."""
expect.set_options(timeout=1000 * PATIENCE)
SETTLING = 250
"""Milliseconds between two looks at a page that is to have come to rest."""
LOOPBACK = re.compile(r"^(http://127\.0\.0\.1:\d+/|data:|blob:)")
OF_A_MODEL = re.compile(r"/api/(jobs|models)/\w+(\?.*)?$")
SMALLEST = 11
"""Pixels of a letter that is still read without effort."""
PLANT = TransferFunction([[[-12.0, -12.0]], [[-12.0]]], [1.0, 2.0, 12.0])


def flight(n_samples: int, seed: int) -> Record:
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-0.02, 0.02], n_samples // 25 + 1), 25)[:n_samples]
    record = Record(u, np.zeros((n_samples, 2)), dt=0.02)
    y = simulate(PLANT, record)
    return Record(u, y + 0.002 * rng.standard_normal(y.shape), dt=0.02)


def table(record: Record, names: tuple[str, str, str]) -> Any:
    import polars as pl

    columns = np.column_stack([record.t, record.u, record.y]).T
    return pl.DataFrame(dict(zip(("t", *names), columns, strict=True)))


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


class Server:
    """One `tridentify app` on a folder of its own, which can be killed and started again."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.port = free_port()
        self.address = f"http://127.0.0.1:{self.port}"
        self.process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        settings = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        self.process = subprocess.Popen(
            [*COMMAND, str(self.folder), "--no-open", "--port", str(self.port), "--token", TOKEN],
            env=settings, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        end = time.monotonic() + PATIENCE
        while not self.answers():
            assert self.process.poll() is None, "the server ended at once"
            assert time.monotonic() < end, "the server does not answer"
            time.sleep(0.05)

    def answers(self) -> bool:
        try:
            self.ask("/session")
        except (urllib.error.URLError, ConnectionError):
            return False
        return True

    def ask(self, path: str) -> Any:
        request = urllib.request.Request(
            f"{self.address}/api{path}", headers={"Authorization": f"Bearer {TOKEN}"}
        )
        with urllib.request.urlopen(request, timeout=5) as answer:
            return json.load(answer)

    def kill(self) -> None:
        if self.process is not None:
            self.process.send_signal(signal.SIGKILL)
            self.process.wait()
            self.process = None


@contextlib.contextmanager
def serving(folder: Path, flights: Path, names: list[str]) -> Iterator[Server]:
    for name in names:
        shutil.copy(flights / name, folder / name)
    server = Server(folder)
    try:
        server.start()
        yield server
    finally:
        server.kill()


class Tab:
    """A page that asks nobody but its server, and what it complained of."""

    def __init__(self, browser: Any, server: Server, **settings: Any) -> None:
        settings = {"viewport": {"width": 1280, "height": 900}, **settings}
        self.context = browser.new_context(accept_downloads=True, **settings)
        self.context.set_default_timeout(PATIENCE * 1000)
        self.page = self.context.new_page()
        self.complaints: list[str] = []
        self.strangers: list[str] = []
        self.context.route("**/*", self.guard)
        self.page.on("console", lambda message: self.complaints.append(message.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.goto(f"{server.address}/?token={TOKEN}")
        expect(self.page.locator("#options .field").first).to_be_visible(timeout=PATIENCE * 1000)

    def guard(self, route: Any) -> None:
        if LOOPBACK.match(route.request.url):
            route.continue_()
        else:
            self.strangers.append(route.request.url)
            route.abort()

    def key(self, name: str) -> Any:
        return self.page.locator(f'[data-key="{name}"]')

    def open(self, name: str) -> None:
        """Opens a file of the folder, or looks at it where it is open already."""
        stem = name.rsplit(".", 1)[0]
        card = self.page.locator(".card.record .name", has_text=stem)
        if card.count():
            card.first.click()
        else:
            folder = self.page.locator("details.folder")
            expect(folder).to_be_visible()
            if folder.get_attribute("open") is None:
                folder.locator("summary").click()
            self.page.get_by_role("button", name=name, exact=True).click()
        expect(self.page.locator(".card.record.current .name")).to_contain_text(stem)
        expect(self.page.locator("#record .plot .main-svg").first).to_be_visible()
        for channel, role in (("elevator", "input"), ("q", "output"), ("alpha", "output")):
            self.use(channel, role)

    def use(self, channel: str, role: str) -> None:
        select = self.page.get_by_label(f"{channel} is used as", exact=True)
        if select.count() and select.input_value() != role:
            with self.page.expect_response(lambda answer: answer.request.method == "PATCH"):
                select.select_option(role)

    def drag(self, start: float, end: float) -> None:
        """Over the record, from one share of its width to another."""
        box = self.page.locator(".overlay").bounding_box()
        assert box is not None
        across = [box["x"] + share * box["width"] for share in (start, (start + end) / 2, end)]
        self.page.mouse.move(across[0], box["y"] + 40)
        self.page.mouse.down()
        self.page.mouse.move(across[1], box["y"] + 45)
        self.page.mouse.move(across[2], box["y"] + 45)
        self.page.mouse.up()

    def estimated(self, act: Any) -> str:
        """Does `act`, waits for the model it makes and gives the name of it."""
        cards = self.page.locator(".card.model")
        before = cards.count()
        act()
        expect(cards).to_have_count(before + 1, timeout=PATIENCE * 1000)
        name = self.page.locator(".card.model.current .name").inner_text()
        expect(self.page.locator("#result .named")).to_contain_text(name)
        expect(self.page.locator("#result .sentence")).not_to_be_empty()
        return name

    def at_rest(self) -> None:
        """Waits until nothing is computed or drawn any more: nodes keep their places then."""
        expect(self.page.locator('[aria-busy="true"]')).to_have_count(0, timeout=PATIENCE * 1000)
        before = -1
        while before != (before := self.page.evaluate("document.querySelectorAll('*').length")):
            self.page.wait_for_timeout(SETTLING)

    def told(self, text: str | re.Pattern[str]) -> None:
        expect(self.page.locator("#messages")).to_contain_text(text)

    @contextlib.contextmanager
    def answered(self, **parts: Any) -> Iterator[None]:
        """What the server says of a model has these parts instead of its own."""

        def other(route: Any) -> None:
            answer = route.fetch()
            body = answer.json()
            detail = body.get("detail", body)
            if "sentence" in detail:
                detail.update(parts)
            route.fulfill(response=answer, json=body)

        self.page.route(OF_A_MODEL, other)
        yield
        self.page.unroute_all(behavior="wait")  # an answer under way is not answered twice

    def close(self, refused: bool = False) -> None:
        """Ends the tab; nothing may have been complained of but answers that were refusals."""
        complaints = [one for one in self.complaints
                      if not (refused and one.startswith("Failed to load resource"))]  # fmt: skip
        self.context.close()
        assert complaints == []
        assert self.strangers == []


@contextlib.contextmanager
def tab(browser: Any, server: Server, refused: bool = False) -> Iterator[Tab]:
    opened = Tab(browser, server)
    try:
        yield opened
    except BaseException:
        opened.context.close()
        raise
    opened.close(refused)


def troubles(seen, width):
    """What is cut, small or faint once the pictures have followed the window."""
    end = time.monotonic() + PATIENCE
    while found := seen.page.evaluate(READABLE, {"width": width, "smallest": SMALLEST}):
        if time.monotonic() > end:
            break
        seen.page.wait_for_timeout(100)
    return found


READABLE = """({ width, smallest }) => {
  const parts = (text) => (text.match(/[\\d.]+/g) ?? []).map(Number);
  const light = ([r, g, b]) => [r, g, b].map((one) => one / 255)
    .map((one) => (one <= 0.04045 ? one / 12.92 : ((one + 0.055) / 1.055) ** 2.4))
    .reduce((sum, one, at) => sum + one * [0.2126, 0.7152, 0.0722][at], 0);
  const ground = (node) => {
    for (; node; node = node.parentElement) {
      const found = parts(getComputedStyle(node).backgroundColor);
      if (found.length && found[3] !== 0) return found;
    }
    return [255, 255, 255];
  };
  const shown = (query) => [...document.querySelectorAll(query)]
    .filter((node) => node.checkVisibility() && !node.closest(".offscreen, .skip"));
  const texts = shown("p, td, th, li, dt, dd, label, button, summary, h1, h2, h3, strong, svg text")
    .filter((node) => node.textContent.trim());
  const contrast = (node) => {
    const style = getComputedStyle(node);
    const ink = node.tagName === "text" ? style.fill : style.color;
    const pair = [light(parts(ink)), light(ground(node))].sort((a, b) => b - a);
    return (pair[0] + 0.05) / (pair[1] + 0.05);
  };
  const beyond = (node) => {
    const box = node.getBoundingClientRect();
    return box.right > innerWidth + 1 || box.left < -1;
  };
  const told = (what) => (node) => `${what}: ${node.tagName} ${node.textContent.slice(0, 60)}`;
  const flat = (node) => node.querySelector(".main-svg") && node.clientHeight < 100;
  const size = (node) => parseFloat(getComputedStyle(node).fontSize);
  const { scrollWidth } = document.documentElement;
  return [
    ...(scrollWidth > width ? [`the page is ${scrollWidth} pixels wide`] : []),
    ...shown("button, select, input, h2, h3, .plot, .panel, .scroll").filter(beyond)
      .map(told("beyond the window")),
    ...shown(".panel .plot").filter(flat).map((node) => `flat: ${node.ariaLabel}`),
    ...texts.filter((node) => size(node) < smallest).map(told("small")),
    ...texts.filter((node) => !node.disabled && contrast(node) < 4.5).map(told("faint")),
  ];
}"""
