"""Long names of channels lose their middles where they are shown, and keep nothing waiting."""

from __future__ import annotations

import dataclasses
import re
import time

import numpy as np
import pytest

from tridentify import Estimate, Record, Structure, SvfLeastSquares, identify
from tridentify.cli import tables
from tridentify.plots import (
    plot_bode,
    plot_excitation,
    plot_fit,
    plot_impulse,
    plot_nyquist,
    plot_record,
    plot_residual,
    plot_step,
)
from tridentify.plots.diagrams import draw_flow_chart
from tridentify.plots.diagrams.drawing import fitted, text_width
from tridentify.report import write_report
from tridentify.report.tables import course_tables, result_tables
from tridentify.writing.layout import IN_PICTURES, IN_TABLES

pytestmark = pytest.mark.unjudged

LONGEST = 200
"""Characters of the longest name that a record takes."""


def long_name(letter: str, number: int) -> str:
    return f"{letter}{number:02d}" + "W" * (LONGEST - 6) + f"{number:02d}{letter}"


def flight(n_outputs: int, n_samples: int = 400) -> tuple[Record, Estimate]:
    """Outputs that follow one input, each by itself."""
    u = np.sign(np.sin(0.11 * np.arange(n_samples) ** 1.1))
    one = np.convolve(u, 0.1 * 0.9 ** np.arange(60.0))[:n_samples]
    noise = 0.01 * np.random.default_rng(5).standard_normal((n_samples, n_outputs))
    outputs = [long_name("y", k) for k in range(n_outputs)]
    y = one[:, None] * (1.0 + np.arange(n_outputs)) + noise
    units = dict.fromkeys([*outputs, long_name("u", 0)], "furlong " * 12)
    names = {"input_names": [long_name("u", 0)], "output_names": outputs}
    record = Record(u, y, dt=0.05, units={k: v.strip() for k, v in units.items()}, **names)
    return record, identify(record, Structure(1, 0), SvfLeastSquares())


@pytest.fixture(scope="module")
def two() -> tuple[Record, Estimate]:
    return flight(2)


def longest_word(texts: list[str]) -> int:
    return max(len(word) for text in texts for word in re.split(r"[\s/,\[\]()]+", text))


@pytest.mark.slow
def test_pictures(two):
    record, estimate = two
    drawn = [
        plot_record(record),
        plot_fit(estimate, record),
        plot_residual(estimate, record),
        plot_bode(estimate),
        plot_step(estimate),
        plot_impulse(estimate),
        plot_nyquist(estimate),
    ]
    for axes in drawn:
        texts = [
            text
            for ax in axes
            for text in (ax.get_title(loc="left"), ax.get_xlabel(), ax.get_ylabel())
        ]
        assert any("..." in text for text in texts), texts
        assert longest_word(texts) <= max(IN_PICTURES, 60), texts
    assert "W" * 60 not in str(draw_flow_chart(estimate))


def test_a_planned_input():
    from tridentify.excitation import doublet

    plan = doublet(0.1, 0.5, dt=0.1, tail=2.0)
    plan = dataclasses.replace(plan, input_names=(long_name("u", 0),))
    assert longest_word([ax.get_ylabel() for ax in plot_excitation(plan)]) <= IN_PICTURES


def test_tables(two):
    record, estimate = two
    cells = [
        cell
        for table in (*result_tables(estimate), *course_tables(estimate))
        for row in (table.titles, *table.rows)
        for cell in row[:-1]
    ]
    assert any("..." in cell for cell in cells)
    assert max(map(len, cells)) <= IN_TABLES
    for table in (tables.coefficient_table(estimate), tables.fit_table(estimate)):
        names = [str(cell) for cell in table.columns[0].cells]
        assert max(map(len, names)) <= IN_TABLES
        assert len(set(names)) == len(names)
    assert max(map(len, estimate.model_text().splitlines())) <= 78
    # what programs read is whole
    document = tables.estimate_document(estimate, [record])
    assert document["fit"][1]["output"] == long_name("y", 1)


def test_a_text_without_end_is_fitted_at_once():
    began = time.process_time()
    found = fitted("W" * 200_000, 120.0)
    assert time.process_time() - began < 2.0
    assert text_width(found) <= 120.0
    assert "…" in found


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_a_report_of_thirty_channels_ends(tmp_path):
    record, estimate = flight(30)
    began = time.process_time()
    page = write_report(estimate, record, tmp_path / "report.html").read_text(encoding="utf-8")
    assert time.process_time() - began < 240.0
    assert long_name("y", 29) in page  # in the settings
    pictures = "".join(re.findall(r"<svg.*?</svg>", page, flags=re.DOTALL))
    assert "W" * 60 not in pictures
