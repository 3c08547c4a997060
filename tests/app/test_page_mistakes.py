"""What a person does wrong on the page leads to one sentence each."""

from __future__ import annotations

import re

import pytest

pytest.importorskip("fastapi", reason="the extra app is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from in_browser import expect, flight, serving, tab, table

HELD_SESSION = """() => {
  const real = fetch;
  window.fetch = async (path, request) => {
    const answer = await real(path, request);
    if (path === "/api/session" && !window.release) {
      await new Promise((resolve) => { window.release = resolve; });
    }
    return answer;
  };
}"""
"""The server's next answer about the session arrives when `release()` is called."""


@pytest.mark.slow
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
        expect(seen.page.locator('[data-panel="fit"] .main-svg').first).to_be_visible()
        second = seen.estimated(lambda: seen.drag(0.1, 0.8))
        assert first != second
        expect(card.locator(".bad")).to_have_count(0)
        expect(models).to_have_count(1)
        expect(seen.page.locator("#messages .message")).to_have_count(0)
        expect(seen.page.locator("#result p.bad")).to_have_count(0)
        table(flight(800, 9), ("elevator", "q", "beta")).write_csv(tmp_path / "first.csv")
        seen.told("1,000 samples became 800")
        seen.at_rest()
        table(flight(700, 9), ("elevator", "r", "beta")).write_csv(tmp_path / "first.csv")
        seen.told("800 samples became 700, 15.98 s became 13.98 s, gone: q (in use), new: r.")
        expect(seen.page.locator("#result p.bad")).to_contain_text("no pictures, since q is not")
        expect(seen.page.locator('[data-panel="fit"]')).to_be_hidden()
        expect(seen.page.locator("#result .plot")).to_be_hidden()
        expect(seen.page.locator("#messages .message")).to_have_count(1)
        seen.page.get_by_label("It is known that the file was changed").click()
        expect(card.locator(".bad")).to_have_count(0)
        expect(seen.page.locator("#messages .message")).to_have_count(0)


def test_mistakes_lead_to_one_sentence_each(seen):
    seen.open("first.csv")
    seen.use("elevator", "unused")
    seen.key("run").click()
    seen.told("No channel is an input")
    seen.use("elevator", "input")
    card = seen.page.locator(".card.record.current")
    expect(card.locator(".bad")).to_have_count(0)
    seen.use("elevator", "output")
    seen.use("q", "input")
    expect(card.locator(".bad")).to_contain_text("elevator was moved and q answered")
    seen.use("q", "output")
    seen.use("elevator", "input")
    seen.open("still.csv")
    seen.key("run").click()
    seen.told(re.compile("elevator|input|excit", re.IGNORECASE))
    expect(seen.page.locator("#messages .message")).to_have_count(1)
    seen.page.get_by_label("Close this message").click()
    expect(seen.page.locator("#messages .message")).to_have_count(0)
    assert all(one.startswith("Failed to load resource") for one in seen.complaints)
    seen.complaints.clear()


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_session_from_before_a_change_does_not_undo_it_on_the_page(seen):
    """The window comes to the front, and before its answer arrives a channel is used otherwise."""
    seen.open("first.csv")
    seen.page.evaluate(HELD_SESSION)
    seen.page.evaluate("dispatchEvent(new Event('focus'))")
    while not seen.page.evaluate("Boolean(window.release)"):
        seen.page.wait_for_timeout(20)
    seen.use("elevator", "output")
    seen.page.evaluate("release()")
    seen.at_rest()
    seen.use("q", "input")
    card = seen.page.locator(".card.record.current")
    expect(card.locator(".bad")).to_contain_text("elevator was moved and q answered")
    seen.use("q", "output")
    seen.use("elevator", "input")


def test_files_that_are_no_records_are_each_named(seen):
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


@pytest.mark.slow
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
