"""The report in a real browser: it runs without complaint, fits its window, zooms and copies."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import tempfile

import numpy as np
import pytest

from tridentify import Estimate, Record, Structure, TransferFunction, identify, simulate
from tridentify.report import write_report

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--hide-scrollbars", "--enable-logging=stderr", "--virtual-time-budget=4000",
)  # fmt: skip
POLICY = re.compile(r'<meta http-equiv="Content-Security-Policy"[^>]*>')

ASK = """
<script>
(async () => {
  const wait = () => new Promise((done) => setTimeout(done, 50));
  const found = { width: innerWidth, scroll: document.documentElement.scrollWidth };
  const sizes = (query) => [...document.querySelectorAll(query)]
    .filter((node) => node.getClientRects().length)
    .map((node) => parseFloat(getComputedStyle(node).fontSize));
  found.text = Math.min(...sizes("p, td, th, li, pre, figcaption"));
  found.drawn = Math.min(...[...document.querySelectorAll("figure svg text")]
    .filter((node) => node.textContent.trim())
    .map((node) => node.getBoundingClientRect().height));
  const cut = (node) => {
    const box = node.getBoundingClientRect();
    return box.right > innerWidth + 1 || box.left < -1;
  };
  found.beyond = [...document.querySelectorAll("h1, h2, h3, p, figure, button, .scroll, nav a")]
    .filter((node) => node.getClientRects().length && cut(node)).map((node) => node.outerHTML);

  let text = "";
  Object.defineProperty(navigator, "clipboard", {
    configurable: true, value: { writeText: async (given) => { text = given; } },
  });
  const heading = [...document.querySelectorAll("h3")]
    .find((node) => node.textContent === "Coefficients");
  heading.nextElementSibling.querySelector("button.copy").click();
  await wait();
  found.copied = text;
  found.told = document.getElementById("told").textContent;
  Object.defineProperty(navigator, "clipboard", {
    configurable: true, value: { writeText: async () => { throw new Error("no"); } },
  });
  heading.nextElementSibling.querySelector("button.copy").click();
  await wait();
  found.fallback = document.getElementById("told").textContent;

  const figure = document.querySelector("figure");
  const svg = figure.querySelector("svg");
  const whole = svg.getAttribute("viewBox");
  const width = () => +svg.getAttribute("viewBox").split(" ")[2];
  figure.querySelector("button.enlarge").click();
  await wait();
  const dialog = document.getElementById("viewer");
  const stage = dialog.querySelector(".stage");
  const box = stage.getBoundingClientRect();
  found.opened = dialog.open && stage.contains(svg);
  found.stage = [box.width, box.height];
  const middle = { clientX: box.x + box.width / 2, clientY: box.y + box.height / 2 };
  found.before = width();
  stage.dispatchEvent(new WheelEvent("wheel", { ...middle, deltaY: -100, cancelable: true }));
  found.nearer = width();
  dialog.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight", bubbles: true }));
  found.moved = svg.getAttribute("viewBox");
  for (let k = 0; k < 40; k++) {
    stage.dispatchEvent(new WheelEvent("wheel", { ...middle, deltaY: 100, cancelable: true }));
  }
  found.farthest = width();
  dialog.dispatchEvent(new KeyboardEvent("keydown", { key: "+", bubbles: true }));
  dialog.close();
  // the close event comes when the browser has time for it
  for (let k = 0; k < 40 && !figure.contains(svg); k++) await wait();
  found.back = figure.contains(svg) && svg.getAttribute("viewBox") === whole;
  found.kept = JSON.parse(document.getElementById("estimate").textContent);
  document.body.innerHTML = "";
  const answer = document.createElement("pre");
  answer.id = "answer";
  answer.textContent = JSON.stringify(found);
  document.body.append(answer);
})();
</script>
"""


@pytest.fixture(scope="module")
def browser():
    """What a browser prints for a page: its document after the scripts, and its messages."""
    program = next(filter(None, map(shutil.which, NAMES)), None)
    if program is None:
        pytest.skip("no Chromium on this machine; `make browser` installs one")

    def load(page, width, height=900):
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
            done = subprocess.run(
                [program, *FLAGS, f"--user-data-dir={profile}", f"--window-size={width},{height}",
                 "--dump-dom", page.as_uri()],
                capture_output=True, text=True, timeout=120, check=True,
            )  # fmt: skip
        return done.stdout, [row for row in done.stderr.splitlines() if "CONSOLE" in row]

    return load


@pytest.fixture(scope="module")
def estimated():
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([-1.0, 1.0], 40), 10)
    plant = TransferFunction([[[2.0, 3.0]], [[-4.0]]], [1.0, 1.4, 9.0])
    y = simulate(plant, Record(u, np.zeros((400, 2)), dt=0.04))
    record = Record(
        u, y + 0.05 * rng.standard_normal(y.shape), dt=0.04, input_names=["elevator deflection"],
        output_names=["pitch rate <q>", "angle of attack"],
        units={"elevator deflection": "deg", "pitch rate <q>": "deg/s", "angle of attack": "deg"},
        name="climb & turn",
    )  # fmt: skip
    return record, identify(record, Structure(2, 1))


@pytest.fixture(scope="module")
def page(estimated, tmp_path_factory):
    record, estimate = estimated
    return write_report(estimate, record, tmp_path_factory.mktemp("page") / "report.html")


@pytest.fixture(scope="module", params=[pytest.param(1280, marks=pytest.mark.slow), 400])
def seen(request, browser, page):
    """What a script finds in the page at a width of the window."""
    asking = page.with_name(f"asking-{request.param}.html")
    text = POLICY.sub("", page.read_text(encoding="utf-8"))
    asking.write_text(text.replace("</body>", ASK + "</body>"), encoding="utf-8")
    document, messages = browser(asking, request.param)
    assert messages == []
    answer = re.search(r'<pre id="answer">(.*?)</pre>', document, re.DOTALL)
    return json.loads(answer[1].replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&"))


def test_the_browser_has_nothing_to_complain_about(browser, page):
    document, messages = browser(page, 1280)
    assert messages == []
    # the policy of the page lets its own script run
    assert document.count('class="enlarge"') == document.count("<figure") > 3


@pytest.mark.slow
def test_nothing_is_wider_than_the_window(seen):
    assert seen["scroll"] <= seen["width"]
    assert seen["beyond"] == []


def test_text_can_be_read(seen):
    assert seen["text"] >= 13.0
    assert seen["drawn"] >= 8.0


def test_a_table_is_copied_with_its_titles(seen, estimated):
    rows = [row.split("\t") for row in seen["copied"].splitlines()]
    assert rows[0][1:3] == ["value", "std error"]
    assert [row[0] for row in rows[1:]] == list(estimated[1].names)
    assert len({len(row) for row in rows}) == 1
    assert seen["told"] == "table copied"
    assert seen["fallback"] in ("table copied", "the browser refused to copy")


def test_a_figure_is_enlarged_zoomed_and_put_back(seen):
    assert seen["opened"]
    assert seen["stage"][0] > 0.8 * seen["width"]
    assert seen["nearer"] < 0.9 * seen["before"]
    assert float(seen["moved"].split()[0]) > 0.0
    assert seen["farthest"] == pytest.approx(seen["before"], rel=1e-3)
    assert seen["back"]


def test_the_estimate_is_in_the_page(seen, estimated, tmp_path):
    file = tmp_path / "model.json"
    file.write_text(json.dumps(seen["kept"]), encoding="utf-8")
    again = Estimate.load(file)
    assert np.array_equal(again.theta, estimated[1].theta)
    assert again.call == "ThreeModel()"
