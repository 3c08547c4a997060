"""Pictures of measured frequency responses."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate
from tridentify.judgement.advice import frequency_response
from tridentify.plots import plot_bode, plot_frequency_response
from tridentify.report.figures import draw_figures

SYSTEM = TransferFunction([-2.0, -3.0], [1.0, 1.5, 9.0])


@pytest.fixture(scope="module")
def record():
    rng = np.random.default_rng(2)
    u = np.repeat(rng.choice([-1.0, 1.0], 120), 5)
    y = simulate(SYSTEM, Record(u, u, dt=0.05))
    return Record(u, y + 0.05 * rng.standard_normal(y.shape), dt=0.05)


@pytest.fixture(scope="module")
def estimate(record):
    return identify(record, Structure(2, 1))


def points(ax):
    """Places of the points in full."""
    return np.column_stack(ax.containers[0].lines[0].get_data())


def test_points_lie_on_the_line_of_a_right_model(record, estimate):
    measured = frequency_response(record)
    magnitude, phase = plot_bode(estimate, measured=measured)
    response = estimate.model.frequency_response(measured.omega)[:, 0, 0]
    good = measured.good[:, 0, 0]
    assert good.sum() > 20
    off = points(magnitude)[:, 1] - 20.0 * np.log10(np.abs(response[good]))
    assert np.median(np.abs(off)) < 0.5
    # phases are on the turn of the model's line
    line = next(one for one in phase.get_lines() if one.get_label() == "model")
    x, y = (np.asarray(part) for part in line.get_data())
    inside = (points(phase)[:, 0] > x[0]) & (points(phase)[:, 0] < x[-1])
    at = points(phase)[inside]
    assert np.median(np.abs(at[:, 1] - np.interp(at[:, 0], x, y))) < 5.0


def test_the_excited_band_is_shaded_and_the_scale_stays_that_of_the_model(record, estimate):
    plain = plot_bode(estimate)
    drawn = plot_bode(estimate, measured=frequency_response(record))
    assert drawn[0].get_xlim() == plain[0].get_xlim()
    assert "excited" in [text.get_text() for text in drawn[0].get_legend().get_texts()]
    assert "measured" not in [text.get_text() for text in plain[0].get_legend().get_texts()]


def test_poor_points_are_faded(record):
    measured = frequency_response(record)
    magnitude, _, coherence = plot_frequency_response(measured)
    faded = [one for one in magnitude.get_lines() if one.get_alpha() is not None]
    assert len(faded) == 1
    assert faded[0].get_xdata().size == (~measured.good).sum()
    assert coherence.get_ylabel() == "coherence"


@pytest.mark.slow
def test_the_report_shows_what_was_measured(record, estimate):
    bode = next(one for one in draw_figures(estimate, [record]) if one.stem == "bode")
    assert "measured without a model" in bode.caption
    assert bode.figure.axes[0].containers
    short = Record(record.u[:25], record.y[:25], dt=0.05)
    without = next(one for one in draw_figures(estimate, [short]) if one.stem == "bode")
    assert "measured" not in without.caption
    assert not without.figure.axes[0].containers
