"""Pictures of planned inputs: what is drawn is what was planned, and labels do not collide."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import TransferFunction
from tridentify.excitation import doublet, multisine, optimal_spectrum
from tridentify.plots import plot_excitation, plot_spectrum

PLANT = TransferFunction([[[2.0], [1.0, 3.0]]], [1.0, 1.0, 9.0])


def test_course_and_lines_are_drawn_in_their_units():
    plan = multisine(10.0, dt=0.05, harmonics=[3, 7], amplitude=0.2)
    plan = plan.named(["elevator"], {"elevator": "rad"})
    course, spectrum = plot_excitation(plan, TransferFunction([1.0], [1.0, 1.0]))
    assert course.get_ylabel() == "elevator [rad]"
    t, u = course.lines[0].get_data()
    assert t[-1] == pytest.approx(plan.duration)
    np.testing.assert_array_equal(u[:-1], plan.u[:, 0])
    omega = next(line for line in spectrum.lines if len(line.get_xdata()) == 2).get_xdata()
    np.testing.assert_allclose(omega, 2 * np.pi * np.array([3, 7]) / 10.0)
    assert "rad" in spectrum.get_ylabel()


def test_a_pulse_is_drawn_as_a_curve():
    axes = plot_excitation(doublet(0.1, dt=0.02, for_frequency=4.0, tail=5.0))
    assert len(axes) == 2
    assert len(axes[1].lines[0].get_xdata()) > 60


@pytest.mark.slow
def test_the_optimal_spectrum_shows_power_and_certificate_of_every_input():
    best = optimal_spectrum(PLANT, limit=[1.0, 2.0])
    axes = plot_spectrum(best)
    assert len(axes) == 4
    for j, ax in enumerate(axes[1::2]):
        slope = ax.lines[1].get_ydata()
        np.testing.assert_array_equal(slope, best.slopes[:, j])
    figure = axes[0].figure
    figure.draw_without_rendering()
    legend = axes[0].get_legend().get_window_extent()
    title = axes[0].title if axes[0].title.get_text() else axes[0]._left_title
    assert not legend.overlaps(title.get_window_extent())


def test_given_axes_are_used():
    from matplotlib.figure import Figure

    axes = Figure().subplots(2, 1)
    plan = doublet(0.1, 0.5, dt=0.1)
    assert list(plot_spectrum(plan, axes=axes)) == list(axes)
    with pytest.raises(ValueError, match="expected 2"):
        plot_excitation(plan, axes=axes[:1])
