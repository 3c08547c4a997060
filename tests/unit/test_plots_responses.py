"""Pictures of responses and of several estimates: what is drawn is what the estimate says."""

from __future__ import annotations

import dataclasses
import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest

from tridentify import Structure, plots, uncertainty
from tridentify.errors import OptionError
from tridentify.estimation.answer.estimate import Status
from tridentify.numerics.delta_method import impulse_response, step_response
from tridentify.plots.over_time import default_times
from tridentify.record.record import Record
from tridentify.transfer_function import TransferFunction
from tridentify.uncertainty.step import powers_of

PICTURES = {"step": plots.plot_step, "impulse": plots.plot_impulse, "nyquist": plots.plot_nyquist}
PLANTS = {
    "first order": ([2.0], [1.0, 4.0]),
    "biproper": ([1.5, 0.3, 2.0], [1.0, 2.1, 5.5]),
    "rao-garnier": ([-6400.0, 1600.0], [1.0, 5.0, 408.0, 416.0, 1600.0]),
    "unstable": ([1.0, 2.0], [1.0, -0.5, 2.0]),
    "integrator": ([2.0], [1.0, 3.0, 0.0]),
    "undamped": ([2.0], [1.0, 0.0, 4.0]),
    "fast": ([0.5e12], [1.0, 1e6, 3e12]),
    "slow": ([0.5e-12], [1.0, 1e-6, 3e-12]),
    "far apart": ([100.0], [1.0, 100.01, 1.0]),
}


def with_model(case, num, den, *, spread=0.02, units=None, names=("elevator", "q")):
    """The estimate of a case with another model, whose coefficients have a relative error."""
    num, den = np.asarray(num, float), np.asarray(den, float)
    theta = np.concatenate([den[1:], num])
    labels = [f"a{k}" for k in reversed(range(den.size - 1))]
    labels += [f"b{k}" for k in reversed(range(num.size))]
    speed = np.abs(den[-1] or den[-2]) ** (1 / (den.size - 1))
    return dataclasses.replace(
        case.estimate,
        model=TransferFunction(num, den, input_names=names[:1], output_names=names[1:]),
        structure=Structure(den.size - 1, num.size - 1),
        names=tuple(labels),
        theta=theta,
        cov=np.diag((spread * theta) ** 2),
        input_names=names[:1],
        output_names=names[1:],
        units=case.estimate.units if units is None else units,
        dt=0.02 / speed,
    )


def overlaps(figure):
    """Pairs of texts of a figure that cover each other."""
    figure.draw_without_rendering()
    boxes = []
    for ax in figure.axes:
        texts = [ax.title, ax._left_title, ax.xaxis.label, ax.yaxis.label]
        texts += [ax.xaxis.get_offset_text(), ax.yaxis.get_offset_text(), *ax.texts]
        texts += [*ax.get_legend().get_texts()] if ax.get_legend() else []
        for axis, (low, high) in ((ax.xaxis, ax.get_xlim()), (ax.yaxis, ax.get_ylim())):
            places = zip(axis.get_ticklocs(), axis.get_ticklabels(), strict=False)
            texts += [t for at, t in places if min(low, high) <= at <= max(low, high)]
        boxes += [
            (text.get_text(), text.get_window_extent().padded(-1.0))
            for text in texts
            if text.get_text().strip() and text.get_visible()
        ]
    return [
        (one, two)
        for (one, box), (two, other) in itertools.combinations(boxes, 2)
        if box.overlaps(other)
    ]


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("picture", PICTURES)
@pytest.mark.fast("step-biproper", "impulse-undamped", "nyquist-integrator")
def test_every_plant_can_be_drawn_without_texts_that_overlap(single, picture, plant):
    (ax,) = PICTURES[picture](with_model(single, *PLANTS[plant]))
    assert overlaps(ax.figure) == []
    assert np.all(np.isfinite([*ax.get_xlim(), *ax.get_ylim()]))
    assert ax.get_title(loc="left").startswith("q / elevator")


@pytest.mark.parametrize("picture", PICTURES)
@pytest.mark.fast("step")
def test_channels_have_axes_of_their_own_and_one_axes_serves_a_single_channel(
    single, double, picture
):
    from matplotlib.figure import Figure

    titles = [ax.get_title(loc="left") for ax in PICTURES[picture](double.estimate)]
    assert [title.split(" / ")[0].strip() for title in titles] == ["q", "alpha"]
    given = Figure().subplots()
    assert PICTURES[picture](single.estimate, axes=given) == [given]
    with pytest.raises(ValueError, match="expected 2 for this picture"):
        PICTURES[picture](double.estimate, axes=given)


@pytest.mark.parametrize("picture", PICTURES)
@pytest.mark.fast("step")
def test_long_names_with_dollars_stay_in_the_figure(single, picture):
    names = ("elevator deflection $a_{ measured at the actuator of the left wing", "pitch $rate")
    estimate = with_model(single, *PLANTS["first order"], names=names)
    (ax,) = PICTURES[picture](estimate)
    assert overlaps(ax.figure) == []
    width = ax.figure.get_size_inches()[0] * ax.figure.dpi
    assert ax._left_title.get_window_extent().x1 <= width


@pytest.mark.parametrize("std", [0.0, math.nan])
@pytest.mark.parametrize("picture", PICTURES)
@pytest.mark.fast("step-nan", "nyquist-0.0", "impulse-0.0")
def test_without_standard_errors_there_is_a_line_and_no_band(single, picture, std):
    estimate = dataclasses.replace(single.estimate, cov=np.full((3, 3), std))
    (ax,) = PICTURES[picture](estimate)
    ax.figure.draw_without_rendering()
    labels = ax.get_legend_handles_labels()[1]
    assert "model" in labels
    if math.isnan(std):
        assert not any("band" in label or "ellipses" in label for label in labels)


@pytest.mark.parametrize(
    ("picture", "response"),
    [(plots.plot_step, step_response), (plots.plot_impulse, impulse_response)],
)
def test_line_and_band_over_time(single, picture, response):
    estimate, t = single.estimate, np.linspace(0.0, 6.0, 61)
    (ax,) = picture(estimate, t=t)
    num, den, cov = estimate.channel(0, 0)
    value, jacobian = response(num, den, powers_of(den), t)
    line = next(one for one in ax.get_lines() if one.get_label() == "model")
    assert line.get_ydata() == pytest.approx(value)
    half = 1.959964 * np.sqrt(np.einsum("ti,ij,tj->t", jacobian, cov, jacobian))
    edges = ax.collections[0].get_paths()[0].vertices
    for k in (10, 35, 60):
        ends = edges[np.isclose(edges[:, 0], t[k]), 1]
        assert (ends.min(), ends.max()) == pytest.approx((value[k] - half[k], value[k] + half[k]))


@pytest.mark.parametrize("plant", [p for p in PLANTS if p != "undamped"])
def test_impulse_response_is_the_slope_of_the_step_response(plant):
    num, den = map(np.asarray, PLANTS[plant])
    slow = 1.0 / np.min(np.abs(np.roots(den)[np.abs(np.roots(den)) > 0]))
    t, h = slow * np.array([0.1, 0.5, 1.0, 2.0]), 1e-5 / np.max(np.abs(np.roots(den)))
    value, jacobian = impulse_response(num, den, powers_of(den), t)
    ahead, ahead_jacobian = step_response(num, den, powers_of(den), t + h)
    before, before_jacobian = step_response(num, den, powers_of(den), t - h)
    size = np.abs(value).max()
    assert value == pytest.approx((ahead - before) / (2 * h), rel=1e-5, abs=1e-5 * size)
    slopes = (ahead_jacobian - before_jacobian) / (2 * h)
    for k in range(jacobian.shape[1]):
        size = np.abs(jacobian[:, k]).max()
        assert jacobian[:, k] == pytest.approx(slopes[:, k], rel=1e-4, abs=1e-4 * size)


def test_sampled_impulse_band_agrees_where_errors_are_small(single):
    t = np.linspace(0.0, 4.0, 9)
    small = dataclasses.replace(single.estimate, cov=1e-4 * single.estimate.cov)
    drawn = uncertainty.sampled_impulse_band(uncertainty.sample(small, 4000), t)
    linear = uncertainty.impulse_band(small, t)
    width = (linear.high - linear.low).max()
    assert drawn.low == pytest.approx(linear.low, abs=0.05 * width)
    assert drawn.high == pytest.approx(linear.high, abs=0.05 * width)


def test_direct_term_is_written_into_the_impulse_response(single):
    (ax,) = plots.plot_impulse(with_model(single, *PLANTS["biproper"]))
    assert "impulse of weight 1.5" in ax.texts[0].get_text()
    assert not plots.plot_impulse(single.estimate)[0].texts


def test_static_gain_is_drawn_of_a_stable_model_only(single):
    def labels(plant):
        (ax,) = plots.plot_step(with_model(single, *PLANTS[plant]))
        return ax.get_legend_handles_labels()[1]

    assert "static gain" in labels("first order")
    assert not {"static gain"} & {*labels("unstable"), *labels("integrator")}


@pytest.mark.parametrize("plant", ["fast", "slow", "rao-garnier", "far apart"])
def test_default_times_show_the_whole_response_and_its_oscillations(single, plant):
    estimate = with_model(single, *PLANTS[plant])
    t = default_times(estimate)
    poles = np.roots(estimate.model.den[0][0])
    assert t[0] == 0.0
    assert np.all(np.diff(t) > 0)
    assert t[-1] * np.min(np.abs(poles.real)) >= 5.0
    assert t.size < 8000
    step = np.diff(t)[0]
    assert step * np.max(np.abs(poles.imag)) < 2 * np.pi / 12
    assert np.count_nonzero(t * np.max(np.abs(poles.real)) < 3) > 20


def test_delay_moves_the_response(single):
    model = single.estimate.model
    late = TransferFunction(
        model.num, model.den, delay=0.7, input_names=("elevator",), output_names=("q",)
    )
    t = np.array([0.0, 0.5, 1.2])
    (ax,) = plots.plot_step(dataclasses.replace(single.estimate, model=late), t=t)
    line = next(one for one in ax.get_lines() if one.get_label() == "model").get_ydata()
    assert line[:2].tolist() == [0.0, 0.0]
    expected = uncertainty.step_band(single.estimate, [0.5]).response[0, 0, 0]
    assert line[2] == pytest.approx(expected)


def test_units_of_an_impulse_response_are_per_second(single):
    assert plots.plot_impulse(single.estimate)[0].get_ylabel() == "response [1/s^2]"
    assert plots.plot_step(single.estimate)[0].get_ylabel() == "response [1/s]"
    assert plots.plot_step(with_model(single, [1.0], [1.0, 2.0], units={}))[0].get_ylabel() == (
        "response"
    )


# ------------------------------------------------------------------------------------ Nyquist
def test_nyquist_curve_is_the_response_and_its_mirror_image(single):
    omega = np.geomspace(0.1, 20.0, 50)
    (ax,) = plots.plot_nyquist(single.estimate, omega=omega)
    mirrored, curve = (line.get_xydata() for line in ax.get_lines() if len(line.get_xdata()) == 50)
    response = single.estimate.model.frequency_response(omega)[:, 0, 0]
    assert curve[:, 0] + 1j * curve[:, 1] == pytest.approx(response)
    assert mirrored[:, 0] + 1j * mirrored[:, 1] == pytest.approx(response.conj())
    assert ax.get_aspect() == 1.0


def test_ellipses_of_the_response_hold_their_share_of_draws(single):
    omega = np.array([0.5, 1.7, 4.0])
    small = dataclasses.replace(single.estimate, cov=1e-4 * single.estimate.cov)
    cov = uncertainty.response_covariance(small, omega)[:, 0, 0]
    theta = uncertainty.sample(small, 4000, 1).theta
    drawn = np.array([theta[:, 2] / (-(w**2) + 1j * w * theta[:, 0] + theta[:, 1]) for w in omega])
    away = drawn - small.model.frequency_response(omega)[:, 0, :]
    for k in range(3):
        parts = np.array([away[k].real, away[k].imag])
        inside = np.einsum("in,ij,jn->n", parts, np.linalg.inv(cov[k]), parts) < 5.9915
        assert np.mean(inside) == pytest.approx(0.95, abs=0.015)


@pytest.mark.slow
def test_critical_point_is_marked_where_the_frame_has_it(single):
    def told(gain):
        (ax,) = plots.plot_nyquist(with_model(single, [gain], [1.0, 1.0, 3.0]))
        return ax.get_legend_handles_labels()[1], [text.get_text() for text in ax.texts]

    labels, texts = told(5.0)
    assert "-1" in labels
    assert not any("-1" in text for text in texts)
    labels, texts = told(0.01)
    assert "-1" not in labels
    assert "-1 lies outside the frame" in texts


def test_nyquist_arrows_point_to_higher_frequencies(single):
    (ax,) = plots.plot_nyquist(single.estimate)
    omega = np.geomspace(1e-2, 1e2, 20000)
    response = single.estimate.model.frequency_response(omega)[:, 0, 0]
    arrows = [text for text in ax.texts if text.get_text() == "" and text.arrow_patch]
    assert len(arrows) == 3
    for arrow in arrows:
        head, tail = complex(*arrow.xy), complex(*arrow.xyann)
        k = int(np.argmin(np.abs(response - head)))
        assert ((head - tail) * np.conj(response[k + 1] - response[k])).real > 0


def test_frequencies_of_a_fast_system_are_written_with_one_power_of_ten(single):
    (ax,) = plots.plot_nyquist(with_model(single, *PLANTS["fast"]))
    assert "(numbers: 1e6 rad/s)" in ax.get_title(loc="left")
    numbers = [float(t.get_text()) for t in ax.texts if t.get_text() and "-1" not in t.get_text()]
    assert len(numbers) > 3
    assert 0.01 < min(numbers) < max(numbers) < 100


@pytest.mark.slow
def test_posterior_mean_shows_its_draws(single):
    rng = np.random.default_rng(4)
    draws = single.estimate.theta * np.exp(0.3 * rng.standard_normal((200, 3)))
    estimate = dataclasses.replace(single.estimate, draws=draws, status=Status.POSTERIOR_MEAN)
    (ax,) = plots.plot_nyquist(estimate)
    assert "as likely" in ax.get_legend_handles_labels()[1]
    for picture in (plots.plot_step, plots.plot_impulse):
        (ax,) = picture(estimate, t=[0.0, 1.0, 2.0])
        low, high = np.quantile(
            [
                (step_response if picture is plots.plot_step else impulse_response)(
                    one[2:], [1.0, *one[:2]], powers_of(np.array([1.0, *one[:2]])), [1.0]
                )[0][0]
                for one in draws
            ],
            [0.025, 0.975],
        )
        edges = ax.collections[0].get_paths()[0].vertices
        ends = edges[np.isclose(edges[:, 0], 1.0), 1]
        assert (ends.min(), ends.max()) == pytest.approx((low, high), rel=0.1)


# --------------------------------------------------------------- long names in every picture
LONG = {"elevator": "elevator deflection, measured at the actuator", "q": "pitch rate of the body"}


def renamed(case):
    """The case with long names of its channels."""
    estimate = case.estimate

    def longer(text):
        for old, new in LONG.items():
            text = new if text == old else text.replace(f"[{old},", f"[{new},")
            text = text.replace(f",{old}]", f",{new}]")
        return text

    inputs, outputs = (
        tuple(map(longer, names)) for names in (estimate.input_names, estimate.output_names)
    )
    units = {longer(name): unit for name, unit in estimate.units.items()}
    channels = {"input_names": inputs, "output_names": outputs}
    model = TransferFunction(estimate.model.num, estimate.model.den, **channels)
    names = tuple(map(longer, estimate.names))
    found = dataclasses.replace(estimate, model=model, names=names, units=units, **channels)
    return found, Record(case.record.u, case.record.y, dt=0.02, units=units, **channels)


@pytest.mark.slow
@pytest.mark.parametrize(
    "draw",
    [
        lambda estimate, record: plots.plot_record(record),
        plots.plot_fit,
        plots.plot_residual,
        lambda estimate, record: plots.plot_bode(estimate),
        lambda estimate, record: plots.plot_pole_zero(estimate),
        lambda estimate, record: plots.plot_convergence(estimate),
        lambda estimate, record: plots.plot_comparison([estimate]),
    ],
)
def test_long_names_neither_overlap_nor_leave_any_picture(double, draw):
    axes = draw(*renamed(double))
    assert overlaps(axes[0].figure) == []
    whole = axes[0].figure.bbox.padded(2.0)
    for ax in axes:
        texts = [ax._left_title, ax.xaxis.label, ax.yaxis.label]
        texts += ax.get_legend().get_texts() if ax.get_legend() else []
        for text in texts:
            if text.get_text():
                box = text.get_window_extent()
                assert whole.x0 <= box.x0 < box.x1 <= whole.x1, text
                assert whole.y0 <= box.y0 < box.y1 <= whole.y1, text


def test_frequency_response_without_standard_errors_has_no_band(single):
    bare = dataclasses.replace(single.estimate, cov=np.full((3, 3), np.nan))
    for ax in plots.plot_bode(bare):
        assert not ax.collections
        assert ax.get_legend_handles_labels()[1] == ["model"]


# --------------------------------------------------------------------------------- comparison
def bars(ax):
    """Segments of the intervals, in data coordinates, for every estimate."""
    return [np.array(group.get_segments()) for group in ax.collections if len(group.get_segments())]


def test_comparison_draws_relative_differences_with_intervals(single):
    first = single.estimate
    other = dataclasses.replace(first, theta=first.theta * 1.1, cov=4 * first.cov)
    (ax,) = plots.plot_comparison([first, other], ["one", "two"])
    points = {line.get_label(): line.get_xdata() for line in ax.get_lines()}
    assert points["one"] == pytest.approx(np.zeros(3))
    assert points["two"] == pytest.approx(np.full(3, 10.0))
    widths = [np.ptp(group[:, :, 0], axis=1) / 2 for group in bars(ax)]
    expected = 100 * 1.959964 * first.std / np.abs(first.theta)
    assert widths[0] == pytest.approx(expected, rel=1e-4)
    assert widths[1] == pytest.approx(2 * expected, rel=1e-4)
    assert overlaps(ax.figure) == []


def test_comparison_counts_from_the_truth(single):
    truth = dict(zip(single.estimate.names, single.truth, strict=True))
    (ax,) = plots.plot_comparison([single.estimate], truth=truth)
    (line,) = (one for one in ax.get_lines() if one.get_label() == "ThreeModel")
    assert line.get_xdata() == pytest.approx(100 * (single.estimate.theta / single.truth - 1))
    assert "from the truth" in ax.get_xlabel()


def test_comparison_of_missing_errors_and_a_zero(single):
    bare = dataclasses.replace(single.estimate, cov=np.full((3, 3), np.nan))
    (ax,) = plots.plot_comparison([single.estimate, single.estimate, bare])
    assert [text.get_text().split(" ")[0] for text in ax.get_yticklabels()] == ["a1", "a0", "b0"]
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels == ["ThreeModel 1", "ThreeModel 2", "ThreeModel 3"]
    assert overlaps(ax.figure) == []
    (zero,) = plots.plot_comparison([with_model(single, [0.0], [1.0, 2.0])])
    assert "b0 = 0\n100 % = 1" in [text.get_text() for text in zero.get_yticklabels()]


def test_comparison_across_orders_shows_poles_gains_and_responses(single):
    """The coefficient a1 of two poles has nothing to do with that of three."""
    first = single.estimate.model
    third = TransferFunction(
        20.0 * first.num[0][0], np.polymul(first.den[0][0], [1.0, 20.0]),
        input_names=first.input_names, output_names=first.output_names,
    )  # fmt: skip
    numbers, magnitudes = plots.plot_comparison({"two": single.estimate, "three": third})
    rows = [text.get_text().replace("\n", " = ").split(" = ")[0]
            for text in numbers.get_yticklabels()]  # fmt: skip
    assert rows == ["natural frequency", "damping", "real pole", "dc gain"]
    of_third = next(one for one in numbers.get_lines() if one.get_label() == "three")
    assert np.nan_to_num(of_third.get_xdata()) == pytest.approx(np.zeros(4), abs=1e-6)
    assert [line.get_label() for line in magnitudes.get_lines()] == ["two", "three"]
    assert overlaps(numbers.figure) == []


def test_comparison_cuts_an_interval_that_would_squeeze_the_others(single):
    wild = dataclasses.replace(single.estimate, cov=1e8 * single.estimate.cov)
    (ax,) = plots.plot_comparison([single.estimate] * 4 + [wild])
    reach = ax.get_xlim()[1]
    assert reach < 10 * 100 * 1.96 * np.max(single.estimate.std / np.abs(single.estimate.theta))
    assert {line.get_marker() for line in ax.get_lines() if len(line.get_xdata()) == 3} >= {
        "<",
        ">",
    }


@pytest.mark.parametrize(
    ("count", "names", "truth", "message"),
    [
        (0, None, None, "found no model"),
        (2, ["one"], None, "found 1 names for 2 models"),
        (1, None, {"c7": 1.0}, "found a truth for 'c7'"),
    ],
)
def test_comparison_refuses(single, count, names, truth, message):
    with pytest.raises(OptionError, match=message):
        plots.plot_comparison([single.estimate] * count, names, truth=truth)


@pytest.mark.parametrize("kind", ["step", "impulse"])
@pytest.mark.parametrize("final", [0.3, 10, 200.0])
def test_one_number_is_the_final_time(single, kind, final):
    (ax,) = PICTURES[kind](single.estimate, final)
    t, response = ax.lines[0].get_data()
    assert (t[0], t[-1]) == (0.0, final)
    assert t.size > 200
    assert np.all(np.diff(t) > 0)
    assert np.ptp(response) > 0
    drawn = np.diff(ax.get_xlim())[0]
    assert 0.9 * final < drawn < 1.2 * final


def test_a_final_time_within_the_delay_and_beyond(single):
    late = TransferFunction([1.0], [1.0, 1.0], delay=2.0)
    for final in (1.0, 5.0):
        (ax,) = plots.plot_step(late, final)
        t, response = ax.lines[0].get_data()
        assert t[-1] == final
        np.testing.assert_allclose(response, 1 - np.exp(-np.maximum(t - 2.0, 0.0)), atol=1e-12)
    assert single.estimate.step(10)[0].lines[0].get_xdata()[-1] == 10.0


@pytest.mark.parametrize("given", [0, -1.0])
def test_a_final_time_that_is_none_is_refused_in_one_line(single, given):
    with pytest.raises(OptionError, match="final time") as caught:
        plots.plot_step(single.estimate, given)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("draw", [plots.plot_bode, plots.plot_nyquist])
def test_one_frequency_is_no_curve(single, draw):
    with pytest.raises(OptionError, match="found one frequency, omega=10; expected several"):
        draw(single.estimate, 10)


def test_default_times_rise_whatever_the_modes():
    for seed in (470, 475, 993, *range(40)):
        rng = np.random.default_rng(seed)
        size, damping = np.exp(rng.uniform(-3, 4, 2)), rng.uniform(0.02, 1, 2)
        pairs = [[1.0, 2 * d * w, w * w] for d, w in zip(damping, size, strict=True)]
        model = TransferFunction([1.0], np.polymul(*pairs))
        assert np.all(np.diff(default_times(SimpleNamespace(model=model))) > 0)
