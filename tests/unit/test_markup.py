"""What a notebook shows: fractions as MathML, signals as small drawings, doubts before numbers."""

from __future__ import annotations

import dataclasses
from xml.etree import ElementTree

import numpy as np
import pytest

from tridentify.estimation.answer.finding import Finding
from tridentify.record.record import Record
from tridentify.writing.notebook import HEIGHT, WIDTH, fraction, sparkline


def texts(markup):
    return "".join(ElementTree.fromstring(markup.replace("&#", "&amp;#")).itertext())


def test_a_fraction_is_what_one_would_write():
    told = texts(fraction("q / <u>", [(-2.0, 0.0), (3.0, 0.25)], [(1.0, 0.0), (1e-9, 1e-11)], ""))
    assert told == "q / <u>=&#8722;2s+(3.00&#177;0.25)s+(1.000&#177;0.010)&#183;10-9"


def test_powers_stand_above_their_base():
    root = ElementTree.fromstring(
        fraction("y", [(1.0, 0.0)], [(1.0, 0.0), (0.0, 0.0), (4.0, 0.0)], "").replace("&#", "")
    )
    assert [node.text for node in root.find("mfrac").findall(".//msup/*")] == ["s", "2"]


@pytest.mark.parametrize("count", [1, 2, 50, 100_000])
def test_a_drawing_stays_in_its_frame_and_small(count):
    values = np.cumsum(np.random.default_rng(count).standard_normal(count))
    drawing = sparkline(values, "alpha < 5")
    path = ElementTree.fromstring(drawing).find("path").get("d")
    points = np.array([p.split() for p in path.replace("L", "M").split("M")[1:]], dtype=float)
    assert len(drawing) < 12_000
    assert np.all((points[:, 0] >= 0) & (points[:, 0] <= WIDTH))
    assert np.all((points[:, 1] >= 0) & (points[:, 1] <= HEIGHT))
    if count > 1:
        assert np.ptp(points[:, 1]) == pytest.approx(HEIGHT - 4, abs=0.2)


def test_missing_samples_are_gaps():
    values = np.sin(np.arange(100.0))
    values[40:60] = np.nan
    assert sparkline(values, "y").count("M") == 2
    assert 'd=""' in sparkline(np.full(5, np.nan), "y")


def test_a_record_shows_its_first_channels():
    rng = np.random.default_rng(0)
    shown = Record(rng.random((20, 8)), rng.random((20, 2)), dt=0.1)._repr_html_()
    assert shown.count("<svg") == 8
    assert 'aria-label="y2"' in shown


def test_an_estimate_shows_its_doubts_before_its_numbers(single):
    doubted = dataclasses.replace(
        single.estimate, findings=(Finding("noise-model", "warning", "It <is> not white."),)
    )
    shown = doubted._repr_html_()
    assert shown.index("&lt;is&gt;") < shown.index("<math") < shown.index("<table")
    assert "damping" in shown
    assert "<ul>" not in single.estimate._repr_html_()
