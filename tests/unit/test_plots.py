"""Pictures: what is drawn, on which axes, with which labels."""

from __future__ import annotations

import dataclasses
import itertools
import subprocess
import sys

import numpy as np
import pytest

from tridentify import plots
from tridentify.estimation.answer.estimate import Pass, Start, Step, Trace
from tridentify.numerics.correlation import autocorrelation
from tridentify.plots.bode import default_frequencies
from tridentify.plots.style import shorten
from tridentify.record.record import Record
from tridentify.transfer_function import TransferFunction

PICTURES = {
    "record": lambda case, axes: plots.plot_record(case.record, axes=axes),
    "fit": lambda case, axes: plots.plot_fit(case.estimate, case.record, axes=axes),
    "residual": lambda case, axes: plots.plot_residual(case.estimate, case.record, axes=axes),
    "bode": lambda case, axes: plots.plot_bode(case.estimate, axes=axes),
    "convergence": lambda case, axes: plots.plot_convergence(case.estimate, axes=axes),
}
EXPECTED_AXES = {"record": 3, "fit": 3, "residual": 4, "bode": 4, "convergence": 3}


def _rendered(ax):
    """Draw for real: layout and log scales warn only then, and a warning is an error here."""
    ax.figure.draw_without_rendering()
    return ax.figure


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_makes_its_axes_and_labels_them(double, name):
    axes = PICTURES[name](double, None)
    assert len(axes) == EXPECTED_AXES[name]
    _rendered(axes[0])
    assert all(ax.get_ylabel() for ax in axes)
    assert axes[-1].get_xlabel()
    assert all(ax.has_data() for ax in axes)


@pytest.mark.parametrize("name", PICTURES)
@pytest.mark.fast("record", "fit")
def test_a_picture_draws_on_given_axes(double, name):
    from matplotlib.figure import Figure

    given = Figure().subplots(EXPECTED_AXES[name], 1)
    assert PICTURES[name](double, given) == list(given)
    with pytest.raises(ValueError, match=f"expected {EXPECTED_AXES[name]} for this picture"):
        PICTURES[name](double, given[:1])


@pytest.mark.slow
def test_a_plotting_library_is_loaded_by_the_first_picture():
    code = (
        "import sys, tridentify; assert tridentify.plots.__name__ == 'tridentify.plots'\n"
        "import tridentify.plots.study, tridentify.report; assert 'matplotlib' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_fit_shows_record_and_prediction(single):
    ax = plots.plot_fit(single.estimate, single.record)[0]
    recorded, model = ax.get_lines()
    assert recorded.get_ydata() == pytest.approx(single.record.y[:, 0])
    assert model.get_ydata() == pytest.approx(single.estimate.predict(single.record)[:, 0])
    assert ax.get_ylabel() == "q [rad/s]"


def test_held_input_is_drawn_in_steps(single):
    held = plots.plot_record(single.record)[1].get_lines()[0]
    linear = Record(single.record.u, single.record.y, dt=0.02, intersample="foh")
    assert held.get_drawstyle() == "steps-post"
    assert plots.plot_record(linear)[1].get_lines()[0].get_drawstyle() == "default"


def test_residual_bounds_hold_white_noise(single):
    axes = plots.plot_residual(single.estimate, single.record, n_lags=20)
    bound = 2.5758 / np.sqrt(single.record.n_samples)
    box = axes[1].patches[0].get_extents().transformed(axes[1].transData.inverted())
    assert (box.y0, box.y1) == pytest.approx((-bound, bound), rel=1e-3)
    bars = axes[1].collections[0].get_segments()
    assert len(bars) == 20
    assert sum(abs(bar[1][1]) > bound for bar in bars) <= 2


def test_autocorrelation_skips_missing_samples():
    rng = np.random.default_rng(0)
    series = np.convolve(rng.standard_normal(4001), [1.0, 0.5], "valid")  # r(1) = 0.4
    series[::7] = np.nan
    correlation, count = autocorrelation(series, 3)
    assert count == np.sum(~np.isnan(series))
    assert correlation[0] == 1.0
    # of the products at lag 1, five in six pairs of present samples remain
    assert correlation[1] == pytest.approx(0.4 * 5 / 6, abs=0.05)
    assert np.abs(correlation[2:]).max() < 0.06
    assert not autocorrelation(np.ones(5), 2)[0].any()


def test_bode_shows_response_in_decibels_and_degrees(double):
    omega = np.array([0.5, 2.0, 5.0])
    magnitude, phase, *_ = plots.plot_bode(double.estimate, omega=omega)
    response = double.estimate.model.frequency_response(omega)[:, 0, 0]
    assert magnitude.get_lines()[0].get_ydata() == pytest.approx(20 * np.log10(abs(response)))
    degrees = phase.get_lines()[0].get_ydata()
    assert np.exp(1j * np.radians(degrees)) == pytest.approx(response / abs(response))
    assert magnitude.get_ylabel() == "magnitude\n[dB re 1/s]"


def test_phases_of_one_figure_are_on_one_branch(single):
    """A negative gain begins at -180 degrees wherever unwrapping left it, a positive one at 0."""
    den = [[1.0, 1.0, 3.0]]
    starts = []
    for gains in ([0.5], [-0.5], [-0.5, -0.01], [0.5, 0.0], [-0.5, 0.0]):
        model = TransferFunction(gains, den[0])
        estimate = dataclasses.replace(single.estimate, model=model, theta=np.array(den[0]))
        bare = dataclasses.replace(estimate, cov=np.full((3, 3), np.nan))
        axes = plots.plot_bode(bare, omega=np.geomspace(1e-4, 10.0, 60))
        starts.append(axes[1].get_lines()[0].get_ydata()[0])
    assert starts == pytest.approx([0.0, -180.0, -180.0, 90.0, -90.0], abs=8.0)


def test_a_lightly_damped_plant_fills_the_map(single):
    """To scale its poles would be dots on the axis; a zero far outside is pointed at."""
    model = TransferFunction([0.01, 40.0], [1.0, 0.02, 100.0])
    bare = dataclasses.replace(single.estimate, model=model, cov=np.full((3, 3), np.nan))
    (ax,) = plots.plot_pole_zero(bare)
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    assert ax.get_aspect() == "auto"
    assert right - left < 0.1 < 20.0 < top - bottom
    assert "scales differ" in ax.get_xlabel()
    assert "outside the frame" in ax.get_xlabel()
    arrow = next(line for line in ax.get_lines() if line.get_marker() == "<")
    assert arrow.get_xdata()[0] == pytest.approx(left)


def test_the_model_lies_thin_upon_a_long_record(single):
    long = Record(
        np.tile(single.record.u, (8, 1)),
        np.tile(single.record.y, (8, 1)),
        dt=0.02,
        input_names=["elevator"],
        output_names=["q"],
    )
    for record, thinner in ((single.record, False), (long, True)):
        recorded, model = plots.plot_fit(single.estimate, record)[0].get_lines()[:2]
        assert (model.get_linewidth() < recorded.get_linewidth()) == thinner
        assert (recorded.get_marker() == ".") != thinner


@pytest.mark.slow
def test_bode_scale_follows_the_line_and_not_a_wild_band(single):
    wild = dataclasses.replace(single.estimate, cov=np.eye(3) * 1e6)
    for ax, wildest in zip(plots.plot_bode(wild), (200.0, 720.0), strict=True):
        _rendered(ax)
        assert np.ptp(ax.get_ylim()) < wildest


def test_default_frequencies_begin_where_the_record_does(single):
    slow = TransferFunction([2.0], np.polymul([1.0, 1e-6], [1.0, 3.0]))
    estimate = dataclasses.replace(single.estimate, model=slow)
    duration = estimate.n_samples * estimate.dt
    low = float(default_frequencies(estimate)[0])
    assert np.pi / duration / 10.0 < low < np.pi / duration
    assert float(default_frequencies(estimate)[-1]) >= 10.0


def test_default_frequencies_resolve_a_resonance(single):
    model = TransferFunction([1.0], [1.0, 0.002, 1.0])
    grid = default_frequencies(dataclasses.replace(single.estimate, model=model))
    peak = np.abs(model.frequency_response(grid)).max()
    assert peak == pytest.approx(500.0, rel=0.01)
    assert np.all(np.diff(grid) > 0)


@pytest.mark.slow
@pytest.mark.parametrize("den", [[1.0, 0.0], [1.0, 2.0, 1.0], [1.0, 0.0, 0.0]])
def test_integrators_and_repeated_poles_can_be_drawn(single, den):
    n = len(den) - 1
    names = (*(f"a{k}" for k in reversed(range(n))), "b0")
    estimate = dataclasses.replace(
        single.estimate,
        model=TransferFunction([2.0], den, input_names=["elevator"], output_names=["q"]),
        structure=dataclasses.replace(single.estimate.structure, poles=n),
        names=names,
        theta=np.array([*den[1:], 2.0]),
        cov=np.eye(n + 1) * 1e-4,
    )
    _rendered(plots.plot_bode(estimate)[0])
    _rendered(plots.plot_pole_zero(estimate)[0])


def test_pole_zero_map_marks_every_near_root(double):
    (ax,) = plots.plot_pole_zero(double.estimate)
    _rendered(ax)
    crosses, *rest = (line for line in ax.get_lines() if line.get_marker() == "x")
    assert not rest  # a shared denominator is drawn once
    poles = np.roots(double.estimate.model.den[0][0])
    assert np.sort(crosses.get_ydata()) == pytest.approx(np.sort(poles.imag))
    assert ax.get_legend_handles_labels()[1] == ["poles", "zeros of q / elevator"]
    # the zero of alpha is far to the left: named instead of drawn
    assert "zero of alpha / elevator: -8" in ax.get_xlabel()
    assert ax.get_xlim()[0] > -10


@pytest.mark.parametrize("factor", [1e-6, 1e-4, 1.0, 1e5])
@pytest.mark.fast("100000.0")
def test_tick_labels_of_the_map_do_not_overlap(single, factor):
    scale = factor ** np.array([1.0, 2.0, 2.0])
    estimate = dataclasses.replace(
        single.estimate,
        model=TransferFunction([3.0 * factor**2], [1.0, 6.5 * factor, 4.1 * factor**2]),
        theta=np.array([6.5, 4.1, 3.0]) * scale,
        cov=1e-4 * np.diag(scale**2),
    )
    (ax,) = plots.plot_pole_zero(estimate)
    ax.figure.draw_without_rendering()
    low, high = ax.get_xlim()
    shown = [k for k, at in enumerate(ax.get_xticks()) if low <= at <= high]
    labels = [ax.get_xticklabels()[k].get_window_extent() for k in shown]
    assert all(two.x0 - one.x1 > 5 for one, two in itertools.pairwise(labels))


def test_ellipse_on_the_map_has_the_size_of_its_uncertainty(single):
    estimate = dataclasses.replace(single.estimate, cov=np.diag([0.04, 0.0, 0.0]))
    (ax,) = plots.plot_pole_zero(estimate)
    real = [line.get_xdata() for line in ax.get_lines() if len(line.get_xdata()) == 73]
    # d Re(pole) / d a1 = -1/2, so its std is 0.1; 2.4477 is the radius of 95 % in the plane
    assert np.ptp(real[0]) / 2 == pytest.approx(2.4477 * 0.1, rel=1e-3)


def test_convergence_measures_in_standard_errors(single):
    ax = plots.plot_convergence(single.estimate)[0]
    line = ax.get_lines()[0]
    first = single.estimate.trace.passes[0].theta[0]
    distance = abs(first - single.estimate.theta[0]) / single.estimate.std[0]
    assert line.get_ydata()[0] == pytest.approx(distance)
    assert np.isnan(line.get_ydata()[-1])  # zero has no place on a logarithmic scale
    assert line.get_label() == "a1"


@pytest.mark.parametrize("steps", [0, 1])
@pytest.mark.fast("0")
def test_convergence_of_hardly_any_pass(single, steps):
    passes = tuple(
        dataclasses.replace(item, steps=(Step("series", [1.0], 1.0, 1.0),))
        for item in single.estimate.trace.passes[-1:][:steps]
    )
    trace = Trace(passes, (Start("only", single.estimate.theta, 1.0),))
    _rendered(plots.plot_convergence(dataclasses.replace(single.estimate, trace=trace))[0])


@pytest.mark.parametrize("costs", [(9.0, 0.4, 0.2), (3e5, 2.0, 1.9), (1.02, 1.01, 1.0), (0.5,)])
@pytest.mark.fast("costs0", "costs3")
def test_tick_labels_of_the_cost_do_not_overlap(single, costs):
    passes = tuple(Pass(k, (), single.estimate.theta, cost) for k, cost in enumerate(costs, 1))
    estimate = dataclasses.replace(single.estimate, trace=Trace(passes))
    ax = plots.plot_convergence(estimate)[1]
    ax.figure.draw_without_rendering()
    low, high = ax.get_ylim()
    labels = [
        label.get_window_extent()
        for which in ("major", "minor")
        for tick, label in zip(
            ax.yaxis.get_ticklocs(minor=which == "minor"),
            ax.yaxis.get_ticklabels(which=which),
            strict=True,
        )
        if label.get_text() and low <= tick <= high
    ]
    assert labels
    labels.sort(key=lambda box: box.y0)
    assert all(one.y1 <= two.y0 for one, two in itertools.pairwise(labels))


def test_long_series_keep_their_extremes():
    rng = np.random.default_rng(3)
    values = rng.standard_normal(100_000)
    values[31_000], values[77_777] = 50.0, -60.0
    values[500:1500] = np.nan
    t, short = shorten(np.arange(values.size) * 0.01, values)
    assert short.size <= 4000
    assert (np.nanmax(short), np.nanmin(short)) == (50.0, -60.0)
    assert np.all(np.diff(t) >= 0)
    assert t[np.nanargmax(short)] == pytest.approx(310.0)
    assert np.isnan(short).any()


@pytest.mark.slow
def test_dollar_signs_in_names_are_no_mathematics(single):
    names = {"input_names": ["a$b"], "output_names": ["c$d_{"]}
    record = Record(single.record.u, single.record.y, dt=0.02, name="$^$", **names)
    model = TransferFunction([0.5], [1.0, 1.0, 3.0], **names)
    estimate = dataclasses.replace(
        single.estimate, model=model, input_names=("a$b",), output_names=("c$d_{",)
    )
    for axes in (
        plots.plot_fit(estimate, record),
        plots.plot_residual(estimate, record),
        plots.plot_bode(estimate),
        plots.plot_pole_zero(estimate),
    ):
        _rendered(axes[0])
