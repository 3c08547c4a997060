"""The workbench as a person uses it: a real server, a real browser, nothing from elsewhere."""

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
import pytest

from tridentify import Record, TransferFunction, simulate

pytest.importorskip("fastapi", reason="the extra app is not installed")
sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
expect = sync_api.expect

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


@pytest.fixture(scope="module")
def flights(tmp_path_factory):
    """A folder of records: usual ones, one of a million samples, one that stands still."""
    folder = tmp_path_factory.mktemp("flights")
    names = ("elevator", "q", "alpha")
    table(flight(1_000_000, 1), names).write_parquet(folder / "long.parquet")
    table(flight(1500, 2), names).write_csv(folder / "first.csv")
    table(flight(1200, 3), names).write_csv(folder / "second.csv")
    odd = ("elevator", "<img src=x onerror=alert(1)>", "<b>alpha</b>")
    table(flight(600, 4), odd).write_csv(folder / "odd & <i>new.csv")
    hung = flight(1500, 6)
    y = hung.y.copy()
    y[600:660, 0] = y[600, 0]
    table(hung.with_outputs(y), names).write_csv(folder / "hung.csv")
    still = flight(600, 5)
    still = Record(np.zeros(600), still.y, dt=0.02)
    table(still, names).write_csv(folder / "still.csv")
    return folder


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
    server.start()
    try:
        yield server
    finally:
        server.kill()


@pytest.fixture(scope="module")
def browser():
    program = next(filter(None, map(shutil.which, NAMES)), None)
    if program is None:
        pytest.skip("no Chromium on this machine; `make browser` installs one")
    with sync_api.sync_playwright() as play:
        opened = play.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def server(tmp_path_factory, flights):
    """Shared by the tests that leave the session in order for the next one."""
    names = ["first.csv", "second.csv", "odd & <i>new.csv", "still.csv", "hung.csv",
             "long.parquet"]  # fmt: skip
    with serving(tmp_path_factory.mktemp("shared"), flights, names) as started:
        yield started


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


@pytest.fixture(scope="module")
def first_tab(browser, server):
    opened = Tab(browser, server)
    yield opened
    opened.context.close()


@pytest.fixture
def seen(first_tab):
    """The tab that most tests share; each of them leaves it without a complaint."""
    first_tab.complaints.clear()
    if first_tab.key("mode identify").is_enabled():
        first_tab.key("mode identify").click()
    first_tab.key("keep").uncheck()
    yield first_tab
    assert first_tab.complaints == []
    assert first_tab.strangers == []


def test_a_range_of_a_million_samples_is_identified_on_release(seen):
    seen.open("long.parquet")
    expect(seen.page.locator(".card.record.current")).to_contain_text("1,000,000 samples")
    seen.key("mode zoom").click()
    for _ in range(3):
        with seen.page.expect_response(lambda answer: "/series?" in answer.url) as thinned:
            seen.drag(0.4, 0.6)
        points = len(thinned.value.json()["time"])
        assert 10 < points < 5000
    seen.key("mode identify").click()
    seen.estimated(lambda: seen.drag(0.3, 0.4))
    expect(seen.page.locator("#result .numbers dd")).to_have_count(4)
    expect(seen.page.locator("#result .sentence")).to_have_text(re.compile(r"\d"))
    expect(seen.key("start 0")).not_to_have_value("")
    seen.page.keyboard.press("0")


def test_models_are_compared_on_another_record(seen):
    seen.open("second.csv")
    seen.open("first.csv")
    first = seen.estimated(lambda: seen.drag(0.1, 0.6))
    seen.key("keep").check()
    second = seen.estimated(lambda: seen.key("run").click())
    assert first != second
    shown = seen.page.locator("#panels .beside thead th")
    expect(shown.filter(has_text=first)).to_have_count(1)
    expect(shown.filter(has_text=second)).to_have_count(1)
    expect(seen.page.locator('[data-panel="bode"] .main-svg').first).to_be_visible()
    seen.at_rest()
    seen.key("target").select_option(label="second")
    seen.key("compare").click()
    fits = seen.page.get_by_role("table", name="Fits on the other record")
    expect(fits.locator("tbody tr")).to_have_count(2)
    expect(fits.locator("tbody td").nth(1)).to_have_text(re.compile(r"^\d+\.\d\s%$"))
    for _ in range(3):  # light, dark, as it was: drawn anew each time, and still there
        seen.page.locator("#theme").click()
        seen.page.wait_for_timeout(200)
    expect(fits.locator("tbody tr")).to_have_count(2)


def test_a_record_changes_under_its_models(seen):
    seen.open("second.csv")
    name = seen.estimated(lambda: seen.drag(0.1, 0.8))
    seen.use("alpha", "unused")
    expect(seen.page.locator("#record .annotation", has_text="alpha")).to_have_count(0)
    expect(seen.page.locator("#result .named")).to_contain_text(name)
    again = seen.estimated(lambda: seen.key("run").click())
    assert again != name
    expect(seen.page.locator("#result .legend")).to_have_text(re.compile(r"fit [^,]*%$"))
    seen.page.locator("#undo").click()
    seen.use("alpha", "output")


def test_a_validation_range_and_bad_samples_are_kept_and_undone(seen):
    seen.open("first.csv")
    rows = seen.page.locator(".row.range")
    before = rows.count()
    seen.key("mode validate").click()
    seen.drag(0.65, 0.95)
    expect(rows.locator(".swatch.validate")).to_have_count(1)
    expect(seen.page.locator("#undo")).to_be_enabled()
    seen.page.keyboard.press("Control+z")
    expect(rows).to_have_count(before)
    seen.page.keyboard.press("Control+Shift+z")
    expect(rows.locator(".swatch.validate")).to_have_count(1)


def test_a_model_is_exported(seen):
    seen.open("first.csv")
    seen.estimated(lambda: seen.drag(0.1, 0.5))
    for kind, ending in (("Model (JSON)", ".json"), ("C header", ".h"), ("Report", ".html")):
        seen.page.locator("#export-button").click()
        with seen.page.expect_download() as saved:
            seen.page.locator("#kinds").get_by_role("button", name=kind).click()
        assert saved.value.suggested_filename.endswith(ending)
        assert Path(saved.value.path()).stat().st_size > 100


def test_a_reload_shows_what_was_there(seen):
    seen.open("first.csv")
    seen.estimated(lambda: seen.drag(0.2, 0.6))
    there = seen.page.locator(".card .name").all_inner_texts()
    sentence = seen.page.locator("#result .sentence").inner_text()
    seen.page.reload()
    expect(seen.page.locator("#result .sentence")).to_have_text(sentence)
    assert seen.page.locator(".card .name").all_inner_texts() == there
    expect(seen.page.locator(".card.record.current .name")).to_have_text("first")
    expect(seen.page.locator(".row.range .swatch.identify")).to_have_count(1)


@pytest.mark.slow
def test_a_killed_server_comes_back_and_a_removed_file_is_told(browser, flights, tmp_path):
    with (
        serving(tmp_path, flights, ["first.csv"]) as server,
        tab(browser, server, refused=True) as seen,
    ):
        seen.open("first.csv")
        seen.estimated(lambda: seen.drag(0.2, 0.7))
        cards = seen.page.locator(".card .name").all_inner_texts()
        server.kill()
        seen.told("server does not answer")
        expect(seen.key("run")).to_be_disabled()
        server.start()
        expect(seen.page.locator("#messages .message")).to_have_count(0)
        expect(seen.key("run")).to_be_enabled()
        assert seen.page.locator(".card .name").all_inner_texts() == cards
        seen.estimated(lambda: seen.drag(0.1, 0.6))
        (tmp_path / "first.csv").rename(tmp_path / "elsewhere.txt")
        seen.page.reload()
        seen.told("no longer where it was opened")
        expect(seen.page.locator(".card.record .bad")).to_have_text("its file is gone")
        expect(seen.page.locator("#messages .message")).to_have_count(1)
        expect(seen.page.locator("#record .main-svg")).to_have_count(0)
        (tmp_path / "elsewhere.txt").rename(tmp_path / "first.csv")
        seen.estimated(lambda: seen.key("run").click())
        expect(seen.page.locator("#messages .message")).to_have_count(0)
        expect(seen.page.locator("#record .main-svg").first).to_be_visible()


def test_a_file_that_is_changed_on_disk_is_told_as_it_happens(browser, flights, tmp_path):
    """Without a reload: what changed, which models are older, and the way on."""
    with (
        serving(tmp_path, flights, ["first.csv"]) as server,
        tab(browser, server) as seen,
    ):
        seen.open("first.csv")
        seen.use("alpha", "unused")
        first = seen.estimated(lambda: seen.drag(0.2, 0.7))
        seen.at_rest()
        table(flight(1000, 9), ("elevator", "q", "beta")).write_csv(tmp_path / "first.csv")
        seen.told("first: Its file was changed on disk: 1,500 samples became 1,000")
        card = seen.page.locator(".card.record.current")
        expect(card).to_contain_text("1,000 samples")
        expect(card.locator(".bad")).to_contain_text("gone: alpha, new: beta.")
        expect(card.locator(".channels")).to_contain_text("beta")
        models = seen.page.locator(".card.model .bad")
        expect(models).to_have_text("of older content of its file")
        expect(seen.page.locator("#result p.bad")).to_contain_text("numbers are those of the older")
        second = seen.estimated(lambda: seen.drag(0.1, 0.8))
        assert first != second
        expect(card.locator(".bad")).to_have_count(0)
        expect(models).to_have_count(1)
        expect(seen.page.locator("#messages .message")).to_have_count(0)
        expect(seen.page.locator("#result p.bad")).to_have_count(0)
        table(flight(800, 9), ("elevator", "q", "beta")).write_csv(tmp_path / "first.csv")
        seen.told("1,000 samples became 800")
        seen.page.get_by_label("It is known that the file was changed").click()
        expect(card.locator(".bad")).to_have_count(0)
        expect(seen.page.locator("#messages .message")).to_have_count(0)


def test_mistakes_lead_to_one_sentence_each(browser, server):
    with tab(browser, server, refused=True) as seen:
        seen.open("first.csv")
        seen.use("elevator", "unused")
        seen.key("run").click()
        seen.told("No channel is an input")
        seen.use("elevator", "input")
        seen.open("still.csv")
        seen.key("run").click()
        seen.told(re.compile("elevator|input|excit", re.IGNORECASE))
        expect(seen.page.locator("#messages .message")).to_have_count(1)
        seen.page.get_by_label("Close this message").click()
        expect(seen.page.locator("#messages .message")).to_have_count(0)


def test_the_same_range_again_estimates_again(seen):
    seen.open("second.csv")
    first = seen.estimated(lambda: seen.drag(0.22, 0.66))
    ranges = [seen.key(f"{end} 0").input_value() for end in ("start", "end")]
    again = seen.estimated(lambda: seen.drag(0.22, 0.66))
    assert again != first
    assert [seen.key(f"{end} 0").input_value() for end in ("start", "end")] == ranges


def test_a_refusal_goes_when_another_record_is_looked_at_or_something_succeeds(browser, server):
    with tab(browser, server, refused=True) as seen:
        seen.open("first.csv")
        seen.open("still.csv")
        messages = seen.page.locator("#messages .message")
        seen.key("run").click()
        expect(messages).to_have_count(1)
        seen.open("first.csv")
        expect(messages).to_have_count(0)
        seen.use("elevator", "unused")
        seen.key("run").click()
        seen.told("No channel is an input")
        seen.use("elevator", "input")
        expect(messages).to_have_count(0)


def test_advice_becomes_an_option_and_a_new_model(seen):
    doubt = {"code": "delay", "severity": "warning", "message": "It answers late",
             "remedy": "Have it estimated (delay='free')."}  # fmt: skip
    seen.open("first.csv")
    with seen.answered(findings=[doubt]):
        before = seen.estimated(lambda: seen.drag(0.18, 0.68))
    advised = seen.page.get_by_role("button", name="Estimate with Delay [s] = free")
    assert seen.estimated(advised.click) != before
    expect(seen.page.locator("#option-delay")).to_have_value("free")
    expect(seen.page.locator(".card.model.current")).to_contain_text("delay")
    assert seen.page.evaluate("document.activeElement.closest('#result') !== null")
    seen.key("reset").click()
    expect(seen.page.locator("#option-delay")).to_have_value("0")


def test_a_doubt_that_leaves_the_choice_has_a_button_for_each(seen):
    seen.open("first.csv")
    texts, buttons = seen.page.evaluate(CONTROLLER)
    assert texts == ["State it: How it works = sampled or continuous."]
    assert buttons == ["Estimate with How it works = sampled",
                       "Estimate with How it works = continuous"]  # fmt: skip


CONTROLLER = """async () => {
  const { findingList } = await import("/page/findings.js");
  const list = findingList([{ code: "controller", severity: "note", message: "It does not tell.",
    remedy: "State it: controller='sampled' or 'continuous' (--controller).",
    advice: "State it: How it works = sampled or continuous." }]);
  const texts = (query) => [...list.querySelectorAll(query)].map((one) => one.textContent);
  return [texts(".remedy"), texts("button")];
}"""


def test_samples_that_a_doubt_names_are_left_out_by_a_button(seen):
    doubt = {"code": "bad-samples", "severity": "warning", "message": "They lie far off.",
             "remedy": "Use a robust loss (loss='huber'), or mark them as missing.",
             "times": [9.0, 9.02, 12.0]}  # fmt: skip
    seen.open("second.csv")
    with seen.answered(findings=[doubt]):
        seen.estimated(lambda: seen.drag(0.1, 0.8))
    seen.estimated(seen.page.get_by_role("button", name="Leave them out and estimate").click)
    bad = seen.page.evaluate(BAD)
    assert [[round(end, 3) for end in one] for one in bad] == [
        [8.995, 9.005], [9.015, 9.025], [11.995, 12.005]]  # fmt: skip
    expect(seen.page.locator("#result .findings")).to_contain_text("samples are missing")


def test_what_a_sensor_clipped_is_left_out_by_a_button(seen):
    doubt = {"code": "saturation", "severity": "error", "message": "It stays there.",
             "outputs": ["q"], "remedy": "Mark as missing (nan, record.mask) where it is "
             ">= 0.02, or record again with a wider range."}  # fmt: skip
    seen.open("second.csv")
    with seen.answered(findings=[doubt]):
        seen.estimated(lambda: seen.drag(0.1, 0.7))
    before = len(seen.page.evaluate(BAD))
    button = seen.page.get_by_role("button", name="Leave out where q \u2265 0.02 and estimate")
    seen.estimated(button.click)
    assert len(seen.page.evaluate(BAD)) > before
    seen.page.locator("#undo").click()  # the model
    seen.page.locator("#undo").click()  # what is left out
    expect(seen.page.locator(".row.range .swatch.bad")).to_have_count(before)


def test_where_a_sensor_hung_is_left_out_by_a_button(seen):
    seen.open("hung.csv")
    seen.estimated(lambda: seen.drag(0.1, 0.9))
    findings = seen.page.locator("#result .findings")
    expect(findings).to_contain_text("the sensor or the recording hung")
    button = seen.page.get_by_role("button", name=re.compile("^Leave out where q hung, from 12 to"))
    seen.estimated(button.click)
    ((start, end),) = seen.page.evaluate(BAD)
    assert (start, end) == (pytest.approx(11.995), pytest.approx(13.185))
    expect(findings).not_to_contain_text("hung")
    expect(findings).to_contain_text("missing")
    seen.page.locator("#undo").click()  # the model
    seen.page.locator("#undo").click()  # what is left out
    expect(seen.page.locator(".row.range .swatch.bad")).to_have_count(0)


def test_each_of_several_sensors_that_hung_has_a_button(seen):
    doubts = [{"code": "stuck-sensor", "severity": "error", "message": f"{name} hung.",
               "outputs": [name], "times": times, "remedy": "Mark the repeats as missing (nan)."}
              for name, times in (("q", [4.0, 4.02, 6.0]), ("alpha", [5.0]))]  # fmt: skip
    seen.open("second.csv")
    with seen.answered(findings=doubts):
        seen.estimated(lambda: seen.drag(0.1, 0.72))
    found = seen.page.locator("#result .findings button").all_inner_texts()
    assert [text.replace("\u00a0", " ") for text in found] == [
        "Leave out the repeats of q, in 2 stretches, and estimate",
        "Leave out the repeats of alpha, at 5 s, and estimate"]  # fmt: skip


def test_ranges_that_overlap_are_told(seen):
    seen.open("first.csv")
    seen.estimated(lambda: seen.drag(0.1, 0.6))
    seen.key("mode validate").click()
    told = seen.page.locator("#record .ranges p.bad")
    found = seen.page.locator("#result p.bad")
    expect(found).to_have_count(0)
    seen.drag(0.5, 0.9)
    expect(told).to_contain_text("What is identified and what validates share")
    expect(found).to_contain_text("The ranges to identify and for validation share")
    seen.drag(0.7, 0.9)
    expect(told).to_have_count(0)
    expect(found).to_have_count(0)
    seen.key("remove 0").click()  # what is identified
    expect(told).to_contain_text("The whole record is identified")
    seen.page.locator("#undo").click()
    seen.page.locator('.row.range:has(.swatch.validate) [data-key^="remove"]').click()
    expect(told).to_have_count(0)


BAD = """async () => {
  const { recordOf } = await import("/page/state.js");
  return recordOf().bad.map(({ start, end }) => [start, end]);
}"""


def test_a_picture_of_another_model_says_so_until_its_own_is_there(seen):
    seen.open("first.csv")
    seen.estimated(lambda: seen.drag(0.2, 0.6))
    panels = seen.page.locator("#panels .panel[data-panel]")
    busy = seen.page.locator('#panels .panel[aria-busy="true"]')
    expect(busy).to_have_count(0)
    held: list[Any] = []
    seen.page.route("**/panel/bode*", lambda route: held.append(route))
    seen.estimated(lambda: seen.drag(0.3, 0.7))
    expect(busy).to_have_count(panels.count())
    for one in range(panels.count()):
        expect(panels.nth(one).locator(".told")).to_have_text(re.compile("Being computed"))
    for route in held:
        route.continue_()
    seen.page.unroute("**/panel/bode*")
    expect(busy).to_have_count(0)


def test_a_range_for_validation_is_tested_when_it_is_released(seen):
    seen.open("second.csv")
    seen.estimated(lambda: seen.drag(0.1, 0.5))
    title = seen.page.locator("#result h3", has_text="On the range for validation")
    expect(title).to_have_count(0)
    seen.key("mode validate").click()
    seen.drag(0.6, 0.95)
    expect(title).to_have_count(1)
    seen.page.locator("#undo").click()
    expect(title).to_have_count(0)
    seen.key("mode identify").click()


def test_files_that_are_no_records_are_each_named(browser, server):
    with tab(browser, server) as seen:
        seen.at_rest()
        before = seen.page.locator(".card.record").count()
        chosen = [{"name": name, "mimeType": "text/csv", "buffer": content}
                  for name, content in (("photo.png", b"\x89PNG\r\n\x1a\n"), ("none.csv", b""),
                                        ("letter.txt", b"Dear reader\nall is well\n"))]  # fmt: skip
        seen.page.locator("#chooser").set_input_files(chosen)
        told = seen.page.locator("#messages .message p")
        expect(told).to_have_count(len(chosen))
        for one, row in zip(chosen, told.all_inner_texts(), strict=True):
            assert row.startswith(f"{one['name']}: ")
            assert row.endswith(".")
        assert seen.page.locator(".card.record").count() == before
        seen.page.get_by_label("Close this message").click()
        assert seen.page.evaluate("document.activeElement.id") == "record"


@pytest.mark.slow
def test_the_files_of_the_folder_are_shown_where_no_record_is_open(browser, flights, tmp_path):
    with serving(tmp_path, flights, ["first.csv"]) as server, tab(browser, server) as seen:
        expect(seen.page.get_by_role("button", name="first.csv", exact=True)).to_be_visible()
        expect(seen.page.locator("#record .readout")).to_contain_text("Open a file on the left")
        seen.open("first.csv")
        seen.page.reload()
        expect(seen.page.locator("details.folder summary")).to_be_visible()
        expect(seen.page.get_by_role("button", name="first.csv", exact=True)).to_be_hidden()


def test_a_step_that_is_no_number_is_named(seen):
    seen.page.locator("#step").fill("0,0x2")
    chosen = {"name": "a.csv", "mimeType": "text/csv", "buffer": b"u,y\n1,2\n"}
    seen.page.locator("#chooser").set_input_files(chosen)
    seen.told("Found 0,0x2 as the seconds between samples")
    seen.page.locator("#step").fill("")
    seen.page.get_by_label("Close this message").click()


def test_a_comparison_on_a_record_of_other_channels_names_them(seen):
    seen.open("odd & <i>new.csv")
    seen.open("first.csv")
    seen.estimated(lambda: seen.drag(0.13, 0.63))
    seen.at_rest()
    for key, act in (("target", seen.key("compare").click), ("on record", lambda: None)):
        seen.key(key).select_option(label="odd & <i>new")
        act()
        seen.told("odd & <i>new has no channel q, alpha, which the ticked models describe")
        seen.page.get_by_label("Close this message").click()
    expect(seen.key("on record")).to_have_value("")


def test_the_current_model_is_in_sight_after_a_reload(seen):
    seen.open("first.csv")
    for start in (0.11, 0.12, 0.15, 0.17):
        seen.estimated(lambda start=start: seen.drag(start, 0.6))
    seen.page.reload()
    expect(seen.page.locator("#result .sentence")).not_to_be_empty()
    list_, card = (seen.page.locator(query).bounding_box()
                   for query in (".models", ".card.model.current"))  # fmt: skip
    assert list_["y"] <= card["y"]
    assert card["y"] + card["height"] <= list_["y"] + list_["height"] + 1


def test_only_exact_advice_becomes_an_option(seen):
    found = seen.page.evaluate(ADVICE)
    assert found == [{"intersample": "auto"}, None, {"poles": "auto", "zeros": "auto"},
                     {"noise": "ar", "loss": "squared", "method": "three-model"}, {"fixed": "a0=0"},
                     None]  # fmt: skip


ADVICE = """async () => {
  const { optionsOf } = await import("/page/remedies.js");
  return [["intersample", "State intersample='foh' (--intersample foh), or 'auto'."],
    ["intersample", "State how the controller works (controller='sampled')."],
    ["order-low", "Use poles=3 and zeros=2, or compare (select_structure; tridentify select)."],
    ["drift", "Use a noise model (noise='ar', --noise ar); a drift (drift=True) does not."],
    ["outside-the-record", "Fix the pole at zero if it integrates (--fix a0=0), or record longer."],
    ["nonlinear", "Use smaller amplitudes."]].map(([code, remedy]) => optionsOf({ code, remedy }));
}"""


def test_an_axis_has_a_unit_only_where_it_is_known(seen):
    found = seen.page.evaluate(UNITS)
    assert found == ["q", "q [K per V]", "q [K]", "q [1 per V]", "q"]


UNITS = """async () => {
  const { ratioOf } = await import("/page/numbers.js");
  return [["", ""], ["K", "V"], ["K", "-"], ["-", "V"], ["K", ""]]
    .map(([above, below]) => ratioOf("q", above, below).replaceAll("\\u00a0", " "));
}"""


def test_the_fit_of_each_of_several_outputs_has_its_name(seen):
    seen.open("first.csv")
    seen.estimated(lambda: seen.drag(0.12, 0.62))
    legend = seen.page.locator("#result .legend")
    expect(legend).to_have_text(re.compile(r"fit q \d+\.\d\s%, alpha \d+\.\d\s%$"))


def test_a_doubt_about_several_outputs_stands_once(seen):
    found = seen.page.evaluate(DOUBTS)
    assert found == [["caution: The noise of q", "The noise of alpha", "Cut it"], ["note: Else"]]


DOUBTS = """async () => {
  const { findingList } = await import("/page/findings.js");
  const noise = { code: "noise", severity: "warning", remedy: "Cut it" };
  const list = findingList([{ ...noise, message: "The noise of q" },
    { code: "other", severity: "info", message: "Else", remedy: "" },
    { ...noise, message: "The noise of alpha" }]);
  return [...list.children].map((item) => [...item.children].map((one) => one.textContent));
}"""


def test_a_comparison_of_many_outputs_is_not_cut(seen):
    seen.open("second.csv")
    seen.open("first.csv")
    seen.estimated(lambda: seen.drag(0.14, 0.64))
    answer = {"outputs": ["roll rate", "pitch rate", "yaw rate"], "fits": [[91.0, 82.0, 73.0]],
              "summary": ""}  # fmt: skip
    seen.page.route("**/api/compare", lambda route: route.fulfill(json=answer))
    seen.at_rest()
    seen.key("compare").click()
    rows = seen.page.get_by_role("table", name="Fits on the other record").locator("tbody tr")
    expect(rows).to_have_count(3)
    expect(rows.nth(1)).to_have_text(re.compile(r"pitch rate.*82\.0"))
    seen.page.unroute("**/api/compare")


def test_small_coefficients_are_not_cut(seen):
    row = {"value": -2.2412e-5, "std": 1.2e-6, "low": -2.476e-5, "high": -2.006e-5,
           "unit": "1/s^2", "status": "free"}  # fmt: skip
    seen.open("first.csv")
    with seen.answered(parameters=[{**row, "name": "b0[y_T2,u_heater1]"}]):
        seen.estimated(lambda: seen.drag(0.16, 0.66))
    scroll = seen.page.locator("#result .scroll").first
    expect(scroll).to_contain_text("e\u22125")
    assert scroll.evaluate("(node) => node.scrollWidth - node.clientWidth") <= 0


def test_a_link_of_another_page_opens_the_workbench(browser, server):
    context = browser.new_context()
    notebook = context.new_page()
    notebook.set_content(f'<a href="{server.address}/?token={TOKEN}" target="_blank">open</a>')
    with context.expect_page() as opened:
        notebook.locator("a").click()
    expect(opened.value.locator("#options .field").first).to_be_visible()
    assert "token" not in opened.value.url
    context.close()


def test_two_tabs_show_the_same(browser, server, seen):
    with tab(browser, server) as other:
        seen.open("second.csv")
        other.open("second.csv")
        other.use("alpha", "unused")
        expect(seen.page.get_by_label("alpha is used as", exact=True)).to_have_value("unused")
        expect(seen.page.locator("#told")).to_contain_text("another tab")
        other.use("alpha", "output")


def test_names_are_text_and_never_markup(seen):
    seen.open("odd & <i>new.csv")
    seen.page.get_by_label("<b>alpha</b> is used as", exact=True).select_option("output")
    expect(seen.page.locator("#tray .channels")).to_contain_text("<img src=x onerror=alert(1)>")
    expect(seen.page.locator("#record .annotation").last).to_contain_text("<b>alpha</b>")
    assert seen.page.locator("#tray img, #record img, #tray .channels b").count() == 0


def test_every_control_is_reached_by_the_tab_key(seen):
    seen.open("first.csv")
    seen.at_rest()
    wanted = set(seen.page.evaluate(CONTROLS))
    seen.page.locator("h1").click()
    reached, unseen = set(), []
    for _ in range(2 * len(wanted)):
        seen.page.keyboard.press("Tab")
        found = seen.page.evaluate(FOCUSED)
        if found["key"] in reached:
            break
        reached.add(found["key"])
        if not found["visible"]:
            unseen.append(found["key"])
    assert wanted - reached == set()
    assert unseen == []


def test_every_control_has_a_name(seen):
    seen.open("first.csv")
    seen.estimated(lambda: seen.key("run").click())
    seen.at_rest()
    assert seen.page.evaluate(NAMELESS) == []


NAMELESS = """() => [...document.querySelectorAll("button, select, input, summary, [tabindex='0']")]
  .filter((node) => node.checkVisibility() && node.tabIndex >= 0)
  .filter((node) => !(node.ariaLabel || node.textContent.trim()
    || [...(node.labels ?? [])].some((label) => label.textContent.trim())))
  .map((node) => node.outerHTML.slice(0, 80))"""


def test_an_estimate_is_made_by_the_keyboard_alone(browser, flights, tmp_path):
    """From an empty session to a model, a range for validation and other orders."""
    with serving(tmp_path, flights, ["first.csv"]) as server, tab(browser, server) as seen:
        keys = seen.page.keyboard

        def reach(query: str) -> None:
            for _ in range(200):
                keys.press("Tab")
                if seen.page.evaluate("(query) => document.activeElement.matches(query)", query):
                    return
            raise AssertionError(f"{query} is not reached by the tab key")

        reach('[data-key="file first.csv"]')
        keys.press("Enter")
        expect(seen.page.locator(".card.record")).to_have_count(1)
        seen.at_rest()
        reach(".overlay")
        keys.press("+")
        keys.press("ArrowLeft")
        seen.estimated(lambda: keys.press("Enter"))
        first = seen.key("start 0").input_value(), seen.key("end 0").input_value()
        assert float(first[1]) - float(first[0]) == pytest.approx(15.0, abs=0.1)
        reach('[data-key="end 0"]')
        keys.press("Control+a")
        keys.type("20")
        seen.estimated(lambda: keys.press("Enter"))
        seen.at_rest()
        reach('[data-key="add range"]')
        keys.press("Enter")
        expect(seen.page.locator(".row.range")).to_have_count(2)
        seen.at_rest()
        reach("#option-poles")
        keys.type("1")
        expect(seen.page.locator("#option-poles")).to_have_value("1")
        seen.page.evaluate("document.querySelector('#options h2').scrollIntoView()")
        keys.press("Shift+Tab")
        while not seen.page.evaluate("document.activeElement.matches('[data-key=\"run\"]')"):
            keys.press("Shift+Tab")
        seen.estimated(lambda: keys.press("Enter"))
        expect(seen.page.locator(".card.model.current")).to_contain_text("1 pole")


FOCUSED = """() => {
  const node = document.activeElement;
  const style = getComputedStyle(node);
  const controls = [...document.querySelectorAll("*")];
  return { key: controls.indexOf(node),
    visible: node === document.body
      || (style.outlineStyle !== "none" && parseFloat(style.outlineWidth) > 0) };
}"""

CONTROLS = """() => {
  const all = [...document.querySelectorAll("*")];
  return [...document.querySelectorAll("button, select, input, summary, .overlay")]
    .filter((node) => !node.disabled && node.tabIndex >= 0 && node.checkVisibility())
    .map((node) => all.indexOf(node));
}"""


def test_everything_is_readable(seen):
    seen.open("first.csv")
    seen.key("mode validate").click()
    seen.drag(0.05, 0.95)  # it overlaps what is identified, which is said
    seen.key("mode identify").click()
    seen.estimated(lambda: seen.key("run").click())
    expect(seen.page.locator('[data-panel="poles"] .main-svg').first).to_be_visible()
    expect(seen.page.locator("#record .ranges p.bad")).to_be_visible()
    for width, scheme in ((800, "dark"), (800, "light"), (1280, "dark"), (1280, "light")):
        seen.page.emulate_media(color_scheme=scheme)
        seen.page.set_viewport_size({"width": width, "height": 900})
        assert troubles(seen, width) == []


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
