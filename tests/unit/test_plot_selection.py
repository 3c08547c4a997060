"""Pictures of a selection: what is drawn, that all is readable, on given axes too."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from matplotlib.figure import Figure

from tridentify import Structure
from tridentify.judgement.selection import Hankel, Selection, SelectionRow
from tridentify.plots import plot_hankel, plot_selection

HANKEL = Hankel(np.array([90.0, 40.0, 0.5, 1e-9]), np.array([2.0, 1.0, 0.5, 0.2]), 2.0, "some")


@pytest.fixture
def table(double):
    """Twenty candidates, a failed one and an unusable one among them."""
    rows = []
    for k in range(20):
        structure = Structure(k // 4 + 1, min(k % 4, k // 4 + 1))
        if k == 7:
            rows.append(SelectionRow(structure, None, "found nothing; expected more; do it"))
            continue
        far = float(abs(k - 9)) ** 3
        rows.append(
            SelectionRow(
                structure,
                double.estimate,
                aic=far - 100.0,
                aicc=far - 99.0,
                bic=1.1 * far - 90.0,
                yic=-5.0,
                fit=np.array([90.0 - k, 80.0]),
                cross_fit=np.array([88.0 - k, 70.0]),
                condition=10.0,
                relative_std=0.01 * 1.8**k,
                ok=k != 12,
            )
        )
    return Selection(tuple(rows), rows[9], "because", HANKEL)


def _texts_overlap(labels):
    boxes = [label.get_window_extent() for label in labels if label.get_text()]
    return any(a.overlaps(b) for k, a in enumerate(boxes) for b in boxes[k + 1 :])


@pytest.mark.slow
def test_twenty_candidates_are_readable_and_one_is_marked(table):
    axes = plot_selection(table)
    axes[0].figure.canvas.draw()
    assert len(axes) == 3
    assert all(ax.get_ylabel() for ax in axes)
    labels = axes[-1].get_xticklabels()
    assert [label.get_text() for label in labels] == [row.label for row in table.rows]
    assert not _texts_overlap(labels)
    for ax in axes:
        (band,) = ax.patches
        assert band.get_window_extent().x0 < ax.transData.transform((9.0, 0.0))[0]
        assert band.get_window_extent().x1 > ax.transData.transform((9.0, 0.0))[0]
    names = axes[0].get_legend_handles_labels()[1]
    assert names == ["AIC", "AICc", "BIC", "failed"]


def test_criteria_count_from_their_lowest(table):
    (ax, *_) = plot_selection(table)
    drawn = [line for line in ax.lines if line.get_label() == "BIC"]
    heights = np.concatenate([line.get_ydata() for line in drawn])
    assert np.nanmin(heights) == 0.0
    assert np.nanmax(heights) == pytest.approx(1.1 * 10.0**3)


@pytest.mark.slow
def test_one_candidate_alone_and_a_table_of_failures_can_be_drawn(table):
    for rows in (table.rows[9:10], table.rows[7:8]):
        axes = plot_selection(dataclasses.replace(table, rows=rows, recommended=None))
        axes[0].figure.canvas.draw()


def test_given_axes_are_used(table):
    given = Figure().subplots(3, 1)
    assert plot_selection(table, axes=given) == list(given)
    with pytest.raises(ValueError, match="expected 3 for this picture"):
        plot_selection(table, axes=given[:2])
    ax = Figure().subplots()
    assert plot_hankel(table, axes=ax) == [ax]


def test_hankel_values_above_the_floor_are_filled(table):
    (ax,) = plot_hankel(table)
    ax.figure.canvas.draw()
    assert ax.get_yscale() == "log"
    assert "2 values above the noise" in ax.get_title(loc="left")
    filled = next(line for line in ax.lines if line.get_label() == "more than noise")
    assert list(filled.get_xdata()) == [1, 2]
    floor = next(line for line in ax.lines if str(line.get_label()).startswith("noise floor"))
    assert set(floor.get_ydata()) == {2.0}


def test_without_a_parallel_model_there_is_nothing_to_draw(table):
    with pytest.raises(ValueError, match="without a parallel model"):
        plot_hankel(dataclasses.replace(table, hankel=None))
