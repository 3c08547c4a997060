"""Records, a server, a browser and a tab for the tests of the page, shared by its files."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from tridentify import Record


@pytest.fixture(scope="package")
def flights(tmp_path_factory):
    """A folder of records: usual ones, one of a million samples, one that stands still."""
    from in_browser import flight, table

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
    y = flight(1500, 6).y.copy()
    y[:, 1] = np.clip(y[:, 1], -0.03, 0.03)
    table(hung.with_outputs(y), names).write_csv(folder / "clipped.csv")
    still = flight(600, 5)
    still = Record(np.zeros(600), still.y, dt=0.02)
    table(still, names).write_csv(folder / "still.csv")
    return folder


@pytest.fixture(scope="package")
def browser():
    from playwright.sync_api import sync_playwright

    from in_browser import NAMES

    program = next(filter(None, map(shutil.which, NAMES)), None)
    if program is None:
        pytest.skip("no Chromium on this machine; `make browser` installs one")
    with sync_playwright() as play:
        opened = play.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield opened
        opened.close()


@pytest.fixture(scope="package")
def server(tmp_path_factory, flights):
    """Shared by the tests that leave the session in order for the next one."""
    from in_browser import serving

    names = ["first.csv", "second.csv", "odd & <i>new.csv", "still.csv", "hung.csv",
             "clipped.csv", "long.parquet"]  # fmt: skip
    with serving(tmp_path_factory.mktemp("shared"), flights, names) as started:
        yield started


@pytest.fixture(scope="package")
def first_tab(browser, server):
    from in_browser import Tab

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
