"""Time from the end of a drag to the result on the screen of the workbench, in headless Chromium.

A server and a page of their own, as a person starts them: a file is opened, a range is dragged over
it, and the clock of the page runs from the release of the mouse to the frame in which sentence and
numbers of the new model stand. Without a browser it says so and leaves.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from machine import keep

HERE = Path(__file__).resolve().parent
COLUMNS = ("elevator", "q", "alpha")
SIZES = {"short.csv": 1_500, "long.parquet": 1_000_000}
"""Samples of each file."""


@dataclass(frozen=True)
class Drag:
    """What is dragged over.

    Attributes
    ----------
    file : str
    share : float
        Of what is shown.
    aim : float
        [s].
    zooms : int
        How often the middle fifth is zoomed into before.
    """

    file: str
    share: float
    aim: float
    zooms: int = 0

    @property
    def samples(self) -> int:
        """How many are identified."""
        return round(SIZES[self.file] * self.share * 0.2**self.zooms)


DRAGS = (
    Drag("short.csv", 250 / SIZES["short.csv"], 0.3),
    Drag("short.csv", 0.8, 1.0),
    Drag("long.parquet", 0.25, 1.0, zooms=3),
    Drag("long.parquet", 0.1, 1.0),
    Drag("long.parquet", 0.98, 1.0),
)
REPEATS = 9
APART = 0.001
"""Of the width, by which two drags differ: nothing is measured that was remembered."""
CLOCK = """() => {
  const named = () => document.querySelector("#result .named")?.textContent ?? "";
  const found = window.measured = { from: 0, before: "", seconds: null };
  addEventListener("pointerup", () => {
    Object.assign(found, { from: performance.now(), before: named(), seconds: null });
  }, true);
  let seen = "";
  new MutationObserver(() => {
    const now = named();
    if (!found.from || now === found.before || now === seen) return;
    seen = now;
    requestAnimationFrame(() => setTimeout(() => {
      found.seconds = (performance.now() - found.from) / 1000;
    }));
  }).observe(document.querySelector("#result"), { childList: true, subtree: true });
}"""


def processor_time(root: int) -> float:
    """Of a process and of all that it started [s]; nan where the system does not say."""
    parents: dict[int, int] = {}
    spent: dict[int, float] = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            row = path.read_text().rpartition(")")[2].split()
        except OSError:  # it ended meanwhile
            continue
        number = int(path.parent.name)
        parents[number] = int(row[1])
        spent[number] = (int(row[11]) + int(row[12])) / os.sysconf("SC_CLK_TCK")
    if root not in spent:
        return float("nan")
    family = {root}
    while grown := {one for one, parent in parents.items() if parent in family} - family:
        family |= grown
    return sum(spent[one] for one in family)


def measured(tab: Any, root: int, drag: Drag, repeats: int) -> dict[str, Any]:
    """Seconds on the clock, and of the processors of the server, of one drag after the other.

    The first, which reads the file for the estimator, is told by itself.
    """
    tab.open(drag.file)
    tab.key("whole").click()
    tab.key("mode zoom").click()
    for _ in range(drag.zooms):
        tab.drag(0.4, 0.6)
        tab.at_rest()
    tab.key("mode identify").click()
    tab.at_rest()
    wall, processor = [], []
    for number in range(repeats + 1):
        before = processor_time(root)
        start = 0.5 * (1.0 - drag.share) + APART * (number - repeats // 2)
        start = min(max(start, 0.0), 1.0 - drag.share)
        end = min(start + drag.share + APART * (number % 3), 1.0)
        tab.estimated(lambda a=start, b=end: tab.drag(a, b))
        tab.page.wait_for_function("() => window.measured.seconds !== null")
        wall.append(float(tab.page.evaluate("window.measured.seconds")))
        processor.append(processor_time(root) - before)
        tab.at_rest()
    return {
        "samples": drag.samples, "of": SIZES[drag.file], "aim": drag.aim,
        "first": wall[0], "wall": wall[1:], "processor": processor[1:],
    }  # fmt: skip


def without_browser() -> str:
    """Why nothing can be measured; empty where it can."""
    missing = [name for name in ("fastapi", "uvicorn", "playwright") if not find_spec(name)]
    if missing:
        return f"found no {', '.join(missing)}; expected the extras app and dev"
    from in_browser import NAMES

    if not any(map(shutil.which, NAMES)):
        return f"found none of {', '.join(NAMES)}; make browser installs one"
    return ""


def run(repeats: int) -> list[dict[str, Any]]:
    """All drags in one page of one server."""
    from playwright.sync_api import sync_playwright

    from in_browser import NAMES, Tab, flight, serving, table

    program = next(filter(None, map(shutil.which, NAMES)))
    with tempfile.TemporaryDirectory() as place:
        files, own = Path(place, "files"), Path(place, "own")
        for folder in (files, own):
            folder.mkdir()
        for number, (name, size) in enumerate(SIZES.items()):
            frame = table(flight(size, number), COLUMNS)
            write = frame.write_csv if name.endswith(".csv") else frame.write_parquet
            write(files / name)
        with serving(own, files, list(SIZES)) as server, sync_playwright() as play:
            browser = play.chromium.launch(executable_path=program, args=["--no-sandbox"])
            tab = Tab(browser, server)
            tab.page.evaluate(CLOCK)
            root = server.process.pid if server.process is not None else 0
            found = []
            for drag in DRAGS:
                found.append(measured(tab, root, drag, repeats))
                print(line(found[-1]), file=sys.stderr, flush=True)
            tab.context.close()
            browser.close()
    return found


def line(one: Mapping[str, Any]) -> str:
    """A row of the report."""
    wall = sorted(one["wall"])
    met = "met" if statistics.median(wall) < one["aim"] else "missed"
    return (
        f"{one['samples']:>9,d} of {one['of']:>9,d}{statistics.median(wall):>9.3f}{wall[0]:>8.3f}"
        f"{wall[-1]:>8.3f}{one['first']:>8.3f}{statistics.median(one['processor']):>12.3f}"
        f"{one['aim']:>7.1f} {met}"
    )


def report(found: Sequence[Mapping[str, Any]], repeats: int) -> str:
    """All rows, with what they are."""
    return "\n".join(
        [
            f"seconds from the release of the mouse to the result on the screen, {repeats} drags; "
            "two outputs, 2 poles",
            f"{'samples of the record':>22s}{'median':>9s}{'least':>8s}{'most':>8s}{'first':>8s}"
            f"{'server CPU':>12s}{'aim':>7s}",
            *map(line, found),
            "server CPU: processor time of all its processes until the panels stand, too",
        ]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=REPEATS)
    parser.add_argument("--save", action="store_true", help="store the result and fill README.md")
    options = parser.parse_args()
    sys.path.insert(0, str(HERE.parent / "tests"))
    why = without_browser()
    if why:
        print(f"skipped: {why}")
        return
    found = run(options.repeats)
    told = report(found, options.repeats)
    print(told)
    if options.save:
        keep("workbench_time", told, found)


if __name__ == "__main__":
    main()
