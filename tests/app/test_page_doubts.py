"""Doubts on the page: each once, with a button where the advice is an action."""

from __future__ import annotations

import re

import pytest

pytest.importorskip("fastapi", reason="the extra app is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from in_browser import expect


@pytest.mark.slow
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
    known = seen.page.locator('details[data-group="What is known"]')
    known.locator("summary").click()
    seen.key("reset").click()
    expect(seen.page.locator("#option-delay")).to_have_value("0")
    expect(known).to_have_attribute("open", "")
    known.locator("summary").click()


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


@pytest.mark.slow
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


@pytest.mark.slow
def test_what_was_clipped_is_left_out_though_the_limit_was_tried(seen):
    seen.open("clipped.csv")
    seen.estimated(lambda: seen.drag(0.05, 0.95))
    findings = seen.page.locator("#result .findings")
    expect(findings).to_contain_text("Of all causes tried, a limit of alpha")
    button = seen.page.get_by_role("button", name=re.compile("^Leave out where alpha \u2265 0.0"))
    seen.estimated(button.click)
    assert len(seen.page.evaluate(BAD)) > 3
    expect(findings).not_to_contain_text("largest value")


@pytest.mark.slow
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


@pytest.mark.slow
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


BAD = """async () => {
  const { recordOf } = await import("/page/state.js");
  return recordOf().bad.map(({ start, end }) => [start, end]);
}"""


def test_only_exact_advice_becomes_an_option(seen):
    found = seen.page.evaluate(ADVICE)
    assert found == [{"intersample": "auto"}, {"intersample": "foh"}, None,
                     {"poles": "auto", "zeros": "auto"},
                     {"noise": "ar", "loss": "squared", "method": "three-model"}, {"fixed": "a0=0"},
                     None]  # fmt: skip


ADVICE = """async () => {
  const { optionsOf } = await import("/page/remedies.js");
  return [["intersample", "State intersample='foh' (--intersample foh), or 'auto'."],
    ["intersample", "State intersample='foh' (--intersample foh)."],
    ["intersample", "State how the controller works (controller='sampled')."],
    ["order-low", "Use poles=3 and zeros=2, or compare (select_structure; tridentify select)."],
    ["drift", "Use a noise model (noise='ar', --noise ar); a drift (drift=True) does not."],
    ["outside-the-record", "Fix the pole at zero if it integrates (--fix a0=0), or record longer."],
    ["nonlinear", "Use smaller amplitudes."]].map(([code, remedy]) => optionsOf({ code, remedy }));
}"""


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
