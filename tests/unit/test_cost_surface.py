"""The cost over two coefficients against simulation, and its picture."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, ThreeModel, TransferFunction, identify, simulate
from tridentify.errors import ChannelCountError, OptionError
from tridentify.plots import plot_cost_surface
from tridentify.uncertainty.cost_surface import cost_surface, step_2_bowl

pytestmark = pytest.mark.unjudged

REST = {"offset": False, "initial_state": "rest"}


def made(num, den, structure, *, scale=1.0, noise=0.1, n=200, seed=0, method=None):
    """An estimate and its record; time runs ``scale`` times as fast."""
    rng = np.random.default_rng(seed)
    truth = TransferFunction(num, den)
    u = np.repeat(rng.choice([-1.0, 1.0], (n // 10, truth.n_inputs)), 10, axis=0)
    dt = 0.05 / scale
    y = simulate(truth, Record(u, np.zeros((n, truth.n_outputs)), dt=dt))
    y = y + noise * y.std(axis=0) * rng.standard_normal(y.shape)
    record = Record(u, y, dt=dt)
    return identify(record, structure, **({"method": method} if method else {})), record


@pytest.fixture(scope="module")
def second():
    return made([0.5], [1.0, 1.0, 3.0], Structure(2, 0, **REST))


def test_cost_is_the_mean_square_of_the_simulated_residual_with_the_best_numerator(second):
    estimate, record = second
    a1, a0 = np.array([0.3, 1.1, 2.0]), np.array([1.0, 3.2])
    found = cost_surface(estimate, record, ("a1", "a0"), a1, a0)
    for i, one in enumerate(a1):
        for j, other in enumerate(a0):
            unit = simulate(TransferFunction([1.0], [1.0, one, other]), record)[:, 0]
            y = record.y[:, 0]
            expected = np.mean((y - unit * (unit @ y) / (unit @ unit)) ** 2)
            assert found.cost[i, j] == pytest.approx(expected, rel=1e-9)


def test_cost_with_a_numerator_held_is_that_of_the_simulated_model(second):
    estimate, record = second
    first = made([2.0], [1.0, 4.0], Structure(1, 0, **REST))
    found = cost_surface(*first, ("a0", "b0"), [3.0, 5.0], [1.0, 2.5])
    for i, a0 in enumerate((3.0, 5.0)):
        for j, b0 in enumerate((1.0, 2.5)):
            model = TransferFunction([b0], [1.0, a0])
            expected = np.mean((first[1].y - simulate(model, first[1])) ** 2)
            assert found.cost[i, j] == pytest.approx(expected, rel=1e-9)
    at_end = cost_surface(estimate, record, ("a0", "b0"), estimate.theta[1:2], estimate.theta[2:])
    assert at_end.cost[0, 0] == pytest.approx(estimate.cost, rel=1e-9)


@pytest.mark.parametrize(
    ("num", "den", "structure", "scale"),
    [
        ([2.0], [1.0, 4.0], Structure(1, 0), 1.0),
        ([1.0, 3.0], [1.0, 1.0, 3.0], Structure(2, 1), 1.0),
        ([0.5e12], [1.0, 1e6, 3e12], Structure(2, 0), 1e6),
        ([0.5e-12], [1.0, 1e-6, 3e-12], Structure(2, 0), 1e-6),
        ([1.0, 3.0], [1.0, 3.0, 12.0, 10.0], Structure(3, 1), 1.0),
        ([[[1.0, 2.0], [3.0]], [[1.0], [0.5, -1.0]]], [1.0, 1.0, 3.0], Structure(2, 1), 1.0),
        (
            [[[1.0, 2.0], [3.0]]],
            [[[1.0, 1.0, 3.0], [1.0, 2.0]]],
            Structure([[2, 1]], [[1, 0]]),
            1.0,
        ),
    ],
)
def test_cost_is_least_at_the_estimate(num, den, structure, scale):
    estimate, record = made(num, den, structure, scale=scale, n=400)
    pair = (estimate.names[0], estimate.names[1])
    grids = [estimate.theta[k] * np.array([0.97, 1.0, 1.03]) for k in (0, 1)]
    cost = cost_surface(estimate, record, pair, *grids).cost
    assert cost[1, 1] == pytest.approx(estimate.cost, rel=1e-9)
    assert np.unravel_index(np.argmin(cost), cost.shape) == (1, 1)
    bowl = step_2_bowl(estimate, record, pair, estimate.theta)
    assert np.all(np.abs(bowl.centre - estimate.theta[:2]) < 0.5 * estimate.std[:2] + 1e-12)
    assert np.all(np.linalg.eigvalsh(bowl.curvature / np.outer(grids[0][1], grids[1][1])) > 0)


def test_minimum_of_the_bowl_is_the_step_that_the_pass_took(second):
    """The passes were made at rest and without offset, as the surface is."""
    estimate, record = second
    for one in estimate.trace.passes[:2]:
        step = next(step for step in one.steps if step.name == "series-parallel")
        for pair in (("a1", "a0"), ("a0", "b0")):
            where = [estimate.names.index(name) for name in pair]
            bowl = step_2_bowl(estimate, record, pair, one.theta)
            assert bowl.centre == pytest.approx(step.coefficients[where], rel=1e-8)
            assert bowl.least == pytest.approx(step.cost, rel=1e-6)


def test_near_the_estimate_the_cost_curves_as_the_covariance_says(second):
    estimate, record = second
    d = 0.3 * estimate.std[:2]
    a1, a0 = (estimate.theta[k] + d[k] * np.array([-1.0, 0.0, 1.0]) for k in (0, 1))
    cost = cost_surface(estimate, record, ("a1", "a0"), a1, a0).cost
    rise = estimate.degrees_of_freedom * np.log(cost / cost[1, 1])
    information = np.linalg.inv(estimate.cov[:2, :2])
    for i, j in ((0, 0), (0, 1), (2, 0), (2, 2)):
        away = np.array([(i - 1) * d[0], (j - 1) * d[1]])
        assert rise[i, j] == pytest.approx(away @ information @ away, rel=0.1)


def test_unstable_models_have_no_cost(second):
    estimate, record = second
    cost = cost_surface(estimate, record, ("a1", "a0"), [-0.5, 1.0], [-1.0, 3.0]).cost
    assert np.isnan(cost[0]).all()
    assert np.isnan(cost[1, 0])
    assert np.isfinite(cost[1, 1])


@pytest.mark.parametrize("names", [("a1",), ("a1", "a1"), ("a1", "delay"), ("a1", "x")])
def test_other_coefficients_are_refused(second, names):
    with pytest.raises(OptionError, match="expected two different ones of a1, a0, b0"):
        cost_surface(*second, names, [1.0], [3.0])
    with pytest.raises(OptionError, match="expected two different ones of a1, a0, b0"):
        step_2_bowl(*second, names, second[0].theta)


def test_a_filter_that_is_not_stable_is_refused(second):
    with pytest.raises(OptionError, match="unstable denominator"):
        step_2_bowl(*second, ("a1", "a0"), [-1.0, 3.0, 0.5])


# ------------------------------------------------------------------------------------ picture
def lines(ax):
    return {line.get_label(): line.get_xydata() for line in ax.get_lines()}


@pytest.mark.slow
def test_picture_marks_estimate_passes_truth_and_minimum(second):
    estimate, record = second
    truth = {"a1": 1.0, "a0": 3.0}
    left, right = plot_cost_surface(estimate, record, truth=truth, n_points=9)
    for ax in (left, right):
        drawn = lines(ax)
        assert drawn["estimate"][0] == pytest.approx(estimate.theta[:2])
        assert drawn["truth"][0].tolist() == [1.0, 3.0]
        assert drawn["passes"] == pytest.approx(
            np.array([one.theta[:2] for one in estimate.trace.passes])
        )
        assert (ax.get_xlabel(), ax.get_ylabel()) == ("a1 [1/s]", "a0 [1/s^2]")
    first = estimate.trace.passes[0]
    assert lines(right)["a of the filter"][0] == pytest.approx(first.theta[:2])
    assert lines(right)["minimum of Step 2"][0] == pytest.approx(
        first.steps[1].coefficients[:2], rel=1e-6
    )
    assert "95 % region" in lines(left)
    left.figure.draw_without_rendering()


@pytest.mark.slow
def test_picture_has_no_texts_that_overlap(second):
    from itertools import combinations

    for axes in (
        plot_cost_surface(*second, n_points=7),
        plot_cost_surface(
            *made([0.5e12], [1.0, 1e6, 3e12], Structure(2, 0), scale=1e6), n_points=7
        ),
    ):
        figure = axes[0].figure
        figure.draw_without_rendering()
        texts = []
        for ax in figure.axes:
            texts += [ax._left_title, ax.xaxis.label, ax.yaxis.label]
            texts += [ax.xaxis.get_offset_text(), ax.yaxis.get_offset_text()]
            texts += ax.get_legend().get_texts() if ax.get_legend() else []
        boxes = [t.get_window_extent().padded(-1.0) for t in texts if t.get_text()]
        assert len(boxes) > 8
        assert not [1 for one, other in combinations(boxes, 2) if one.overlaps(other)]


def test_picture_on_given_axes_and_ranges(second):
    from matplotlib.figure import Figure

    axes = Figure().subplots(1, 2)
    drawn = plot_cost_surface(
        *second, ("a0", "b0"), ranges=((1.0, 5.0), (0.2, 0.8)), n_points=5, pass_number=2, axes=axes
    )
    assert drawn == list(axes)
    assert axes[0].get_xlim() == (1.0, 5.0)
    assert axes[1].get_ylim() == (0.2, 0.8)
    assert "pass 2" in axes[1].get_title(loc="left")
    with pytest.raises(ValueError, match="expected 2 for this picture"):
        plot_cost_surface(*second, n_points=5, axes=axes[:1])


@pytest.mark.parametrize(
    ("structure", "options"),
    [
        (Structure(1, 0), {}),
        (Structure(2, 0, fixed={"a0": 0.0}), {}),
        (Structure(2, 0, **REST), {"method": ThreeModel.paper(gamma=2.0)}),
        (Structure(2, 0, **REST), {"noise": 0.0}),
    ],
)
@pytest.mark.slow
def test_picture_of_first_order_integrator_printed_method_and_no_noise(structure, options):
    integrating = bool(structure.fixed)
    den = [1.0, 4.0] if structure.poles == 1 else [1.0, 3.0, 0.0 if integrating else 3.0]
    estimate, record = made([2.0], den, structure, **options)
    axes = plot_cost_surface(estimate, record, n_points=7)
    axes[0].figure.draw_without_rendering()
    assert lines(axes[0])["estimate"].shape == (1, 2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pass_number": 77}, "found pass_number=77"),
        ({"ranges": ((1.0, 0.0), (0.0, 1.0))}, "found ranges="),
        ({"n_points": 2}, "found n_points=2"),
    ],
)
def test_picture_refuses(second, options, message):
    with pytest.raises(OptionError, match=message):
        plot_cost_surface(*second, **options)


def test_a_record_of_other_channels_is_refused(second):
    estimate, record = second
    wide = Record(np.hstack([record.u, record.u]), record.y, dt=record.dt)
    with pytest.raises(ChannelCountError, match="found a record with 2 inputs and 1 outputs"):
        plot_cost_surface(estimate, wide)
