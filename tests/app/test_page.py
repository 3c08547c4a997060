"""The workbench as a person uses it: open, drag, compare, export, reload, go on after a kill."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("fastapi", reason="the extra app is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from in_browser import TOKEN, expect, serving, tab


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.parametrize(
    ("kind", "ending"),
    [
        ("Model (JSON)", ".json"),
        pytest.param("C header", ".h", marks=pytest.mark.slow),
        pytest.param("Report", ".html", marks=pytest.mark.slow),
    ],
)
def test_a_model_is_exported(seen, kind, ending):
    seen.open("first.csv")
    if not seen.page.locator(".card.model").count():
        seen.estimated(lambda: seen.drag(0.1, 0.5))
    seen.page.locator("#export-button").click()
    with seen.page.expect_download() as saved:
        seen.page.locator("#kinds").get_by_role("button", name=kind).click()
    assert saved.value.suggested_filename.endswith(ending)
    assert Path(saved.value.path()).stat().st_size > 100


DROP = """async (files) => {
  const carried = new DataTransfer();
  for (const [name, text] of files) carried.items.add(new File([text], name));
  for (const type of ["dragover", "drop"]) {
    document.body.dispatchEvent(new DragEvent(type,
      { dataTransfer: carried, bubbles: true, cancelable: true }));
  }
}"""


def test_files_that_are_dropped_are_opened(seen):
    rows = "\n".join(f"{0.02 * k:.2f},{(-1) ** (k // 9)},{k % 7}" for k in range(90))
    units = "time,elevator,pitch rate\ns,deg,deg/s\n" + rows
    cards = seen.page.locator(".card.record .name")
    before = cards.all_inner_texts()
    seen.page.evaluate(DROP, [["with units.csv", units], ["other.csv", "t,u,y\n" + rows]])
    expect(cards).to_have_text([*before, "with units", "other"])
    cards.nth(len(before)).click()
    channels = seen.page.locator(".card.record.current .channels")
    expect(channels).to_contain_text("pitch rate [deg/s]")


@pytest.mark.slow
def test_pictures_over_time_are_linked(seen):
    seen.open("first.csv")
    seen.estimated(lambda: seen.drag(0.1, 0.7))
    seen.at_rest()
    place = seen.page.locator('[data-panel="fit"] .nsewdrag').first
    place.scroll_into_view_if_needed()
    box = place.bounding_box()
    mouse, across = seen.page.mouse, [box["x"] + share * box["width"] for share in (0.3, 0.6)]
    mouse.move(across[0], box["y"] + 50)
    mouse.down()
    mouse.move(across[1], box["y"] + 55, steps=4)
    mouse.up()
    seen.page.wait_for_function(LINKED)
    mouse.dblclick(across[0], box["y"] + 50)


LINKED = """() => {
  const [fit, residual] = ["fit", "residual"].map((name) =>
    document.querySelector(`[data-panel="${name}"] .plot`).layout.xaxis.range.map(Number));
  const near = (one, other) => Math.abs(one - other) < 1e-6;
  return fit[1] - fit[0] < 10 && near(fit[0], residual[0]) && near(fit[1], residual[1]);
}"""


@pytest.mark.slow
def test_an_estimate_is_cancelled_on_the_page(seen):
    seen.open("first.csv")
    before = seen.page.locator(".card.model").count()
    seen.page.route("**/api/jobs/*wait*", lambda route: None)  # its end is not told
    seen.drag(0.05, 0.95)
    expect(seen.page.locator("progress")).to_be_visible()
    seen.page.get_by_role("button", name="Cancel", exact=True).click()
    expect(seen.page.locator("progress")).to_have_count(0)
    expect(seen.key("run")).to_have_text("Estimate")
    seen.page.unroute("**/api/jobs/*wait*")
    assert seen.page.locator(".card.model").count() - before in (0, 1)  # it may have been done
    seen.estimated(lambda: seen.drag(0.1, 0.6))


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
        held: list[Any] = []
        seen.page.route("**/api/jobs/*", lambda route: held.append(route))
        seen.page.locator("#option-poles").select_option("auto")  # for long enough
        seen.drag(0.1, 0.9)
        expect(seen.page.locator("progress")).to_be_visible()
        server.kill()
        for route in held:
            route.abort()
        seen.told("server does not answer")
        server.start()
        seen.told("estimate that was under way ended with it: start it again")
        seen.page.unroute("**/api/jobs/*")
        seen.key("reset").click()
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


@pytest.mark.slow
def test_the_same_range_again_estimates_again(seen):
    seen.open("second.csv")
    first = seen.estimated(lambda: seen.drag(0.22, 0.66))
    ranges = [seen.key(f"{end} 0").input_value() for end in ("start", "end")]
    again = seen.estimated(lambda: seen.drag(0.22, 0.66))
    assert again != first
    assert [seen.key(f"{end} 0").input_value() for end in ("start", "end")] == ranges


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_the_current_model_is_in_sight_after_a_reload(seen):
    seen.open("first.csv")
    for start in (0.11, 0.12, 0.15, 0.17):
        seen.estimated(lambda start=start: seen.drag(start, 0.6))
    seen.page.reload()
    expect(seen.page.locator("#result .sentence")).not_to_be_empty()
    # the list of the records, which comes meanwhile, takes room from that of the models
    seen.page.wait_for_function("""() => {
      const [list, card] = [".models", ".card.model.current"].map(
        (query) => document.querySelector(query).getBoundingClientRect());
      return list.top <= card.top && card.bottom <= list.bottom + 1;
    }""")


@pytest.mark.slow
def test_a_link_of_another_page_opens_the_workbench(browser, server):
    context = browser.new_context()
    notebook = context.new_page()
    notebook.set_content(f'<a href="{server.address}/?token={TOKEN}" target="_blank">open</a>')
    with context.expect_page() as opened:
        notebook.locator("a").click()
    expect(opened.value.locator("#options .field").first).to_be_visible()
    assert "token" not in opened.value.url
    context.close()


@pytest.mark.slow
def test_two_tabs_show_the_same(browser, server, seen):
    with tab(browser, server) as other:
        seen.open("second.csv")
        other.open("second.csv")
        other.use("alpha", "unused")
        expect(seen.page.get_by_label("alpha is used as", exact=True)).to_have_value("unused")
        expect(seen.page.locator("#told")).to_contain_text("another tab")
        other.use("alpha", "output")
