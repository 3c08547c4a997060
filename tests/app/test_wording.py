"""Advice names the fields of the page, and leaves what it does not know as it was."""

from __future__ import annotations

import pytest

from tridentify import Finding, list_options
from tridentify.app.plain import finding, in_words_of_the_page


@pytest.mark.parametrize(
    ("remedy", "told"),
    [
        (
            "Use a robust loss (loss='huber' or 'student'; --loss), or mark them as missing.",
            "Use a robust loss (Loss: huber or student), or mark them as bad samples.",
        ),
        (
            "Try a drift (--drift auto, in Python drift='auto'), more poles or zeros.",
            "Try a drift (Drift: auto), more poles or zeros.",
        ),
        ("Shift the input (--delay, in Python delay='free' or a number).",
         "Shift the input (Delay: free or a number)."),
        ("Fix the pole at zero (fixed={'a0': 0}; --fix a0=0).",
         "Fix the pole at zero (Fixed: a0=0)."),
        ("Compare with ThreeModel(noise='white').", "Compare with Noise = white."),
        ("Try rest (--initial-state rest or equilibrium, in Python initial_state=...).",
         "Try rest (Initial state: rest or equilibrium)."),
        ("State it: controller='sampled' or 'continuous' (--controller).",
         "State it: How it works = sampled or continuous."),
        ("Use poles=4 and zeros=3, or compare orders (select_structure; tridentify select).",
         "Use Poles = 4 and Zeros = 3, or compare orders (Poles: auto)."),
        ("Mark these samples as missing (nan, record.mask; --missing).",
         "Mark these samples as bad samples."),
    ],
)  # fmt: skip
def test_advice_names_the_fields_of_the_page(remedy, told):
    assert in_words_of_the_page(remedy) == told


@pytest.mark.parametrize(
    "remedy",
    [
        "Follow them with online.ThreeModel(forgetting=...).",
        "Use smaller amplitudes (by half), or identify each operating point on its own.",
        "",
    ],
)
def test_what_has_no_field_stays_as_it_is(remedy):
    assert in_words_of_the_page(remedy) == remedy


def test_a_finding_tells_both():
    said = finding(Finding("delay", "error", "It acts later.", "State it (delay=0.1; --delay)."))
    assert said["remedy"] == "State it (delay=0.1; --delay)."
    assert said["advice"] == "State it (Delay: 0.1)."


def test_every_option_has_a_label_that_is_found():
    for one in list_options():
        if one.switch.startswith("--"):
            told = in_words_of_the_page(f"Try it ({one.switch}).")
            assert told == f"Try it ({one.label.split(' [')[0]})."
