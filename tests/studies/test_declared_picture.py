"""The picture of a declared study: what is drawn is what the statistics say."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pytest

from declared import document
from tridentify.errors import IdentifiabilityError, OptionError, SampleTypeError
from tridentify.plots import plot_study_cells
from tridentify.plots.study import save_study_figures
from tridentify.studies import run_study, study_from


@pytest.fixture(scope="module")
def result():
    told = document() | {"draws": 4}
    told["noises"]["white"]["ratio"] = [0, 0.05, 0.2]
    return run_study(study_from(told), workers=1)


def drawn(ax, label):
    """Values of a method from the top down."""
    (bars,) = [bars for bars in ax.containers if bars.get_label() == label]
    x, y = bars.lines[0].get_data(orig=False)
    return x[np.argsort(-y)]


def test_the_largest_error_and_the_least_coverage_of_every_cell_are_drawn(result):
    error, coverage = plot_study_cells(result)
    cells = list(dict.fromkeys(row.cell for row in result.statistics if row.bound > 0))
    own = [
        [row for row in result.statistics if (row.cell, row.method) == (cell, "ours")]
        for cell in cells
    ]
    assert len(error.get_yticks()) == len(own) == 4
    largest = [max(row.ratio for row in rows) for rows in own]
    least = [100 * min(row.coverage for row in rows) for rows in own]
    np.testing.assert_allclose(drawn(error, "ours"), largest)
    np.testing.assert_allclose(drawn(coverage, "ours"), least)
    assert drawn(error, "raw").size == 4
    assert drawn(coverage, "raw").size == 0


def test_axes_may_be_given_two_of_them(result):
    _, axes = plt.subplots(1, 2)
    panels = plot_study_cells(result, axes=axes)
    assert panels[0] is axes[0]
    with pytest.raises(OptionError, match="found 1 axes; expected 2"):
        plot_study_cells(result, axes=axes[:1])
    with pytest.raises(SampleTypeError, match="plot_study_cells"):
        plot_study_cells("result")


def test_without_noise_there_is_nothing_to_draw(tmp_path):
    told = document()
    told["noises"] = {"none": {"std": 0}}
    clean = run_study(study_from(told), workers=1)
    with pytest.raises(IdentifiabilityError, match="found no cell with noise"):
        plot_study_cells(clean)
    assert save_study_figures(clean, tmp_path) == ()


@pytest.mark.slow
def test_pictures_are_saved(result, tmp_path):
    (path,) = save_study_figures(result, tmp_path)
    assert path.name == "cells.svg"
    assert path.stat().st_size > 10_000
