"""The page is read and used by everyone: units, names, the keyboard, both themes, two widths."""

from __future__ import annotations

import re

import pytest

pytest.importorskip("fastapi", reason="the extra app is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from in_browser import expect, serving, tab, troubles


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


@pytest.mark.slow
def test_a_comparison_of_many_outputs_is_not_cut(seen):
    seen.open("second.csv")
    seen.open("first.csv")
    seen.estimated(lambda: seen.drag(0.14, 0.64))
    answer = {"outputs": ["roll rate", "pitch rate", "yaw rate"], "fits": [[91.0, 82.0, 73.0]],
              "summary": ""}  # fmt: skip
    seen.page.route("**/api/compare", lambda route: route.fulfill(json=answer))
    seen.at_rest()
    seen.key("target").select_option(label="first")
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


def test_names_are_text_and_never_markup(seen):
    seen.open("odd & <i>new.csv")
    seen.page.get_by_label("<b>alpha</b> is used as", exact=True).select_option("output")
    expect(seen.page.locator("#tray .channels")).to_contain_text("<img src=x onerror=alert(1)>")
    expect(seen.page.locator("#record .annotation").last).to_contain_text("<b>alpha</b>")
    assert seen.page.locator("#tray img, #record img, #tray .channels b").count() == 0


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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
