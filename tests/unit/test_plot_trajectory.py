"""Picture of a run on-line: bands, truth in its three forms, changes, flags, the vertical scale."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, online, plots, simulate

NAMES = ("a1", "a0", "b0")


@pytest.fixture(scope="module")
def run():
    """A real run: two stretches of missing samples, forgetting."""
    rng = np.random.default_rng(4)
    u = rng.choice([-1.0, 1.0], 120).repeat(10)
    clean = simulate(TransferFunction([3.0], [1.0, 4.0, 3.0]), Record(u, u, dt=0.05))[:, 0]
    y = clean + 0.02 * rng.standard_normal(u.size)
    y[400:460] = np.nan
    names = {"input_names": ["valve"], "output_names": ["level"]}
    record = Record(u, y, dt=0.05, units={"valve": "V", "level": "m"}, **names)
    method = online.ThreeModel(forgetting=0.998, on_change="flag")
    asked = Structure(2, 0, offset=False, initial_state="rest")
    return online.run(method, record, asked, every=3.0)


def made_up(**changes):
    """A run by hand, where the test is about one thing in it."""
    time = np.arange(1.0, 101.0)
    flags = [online.Flag(0)] * 100
    theta = np.column_stack([np.full(100, 4.0), np.full(100, 3.0), np.full(100, 3.0)])
    found = SimpleNamespace(
        time=time, names=NAMES, theta=theta, std=np.full((100, 3), 0.1), flags=flags,
        changes=np.zeros(0), units=(),
    )  # fmt: skip
    vars(found).update(changes)
    return found


def lines(ax):
    return {line.get_label(): line for line in ax.get_lines()}


@pytest.mark.slow
def test_the_picture_has_an_axes_a_coefficient_and_one_for_flags(run):
    axes = plots.plot_trajectory(run)
    assert len(axes) == 4
    axes[0].figure.draw_without_rendering()
    assert [ax.get_ylabel() for ax in axes] == [
        "a1 [1/s]", "a0 [1/s^2]", "b0 [m/(V s^2)]", "flags",
    ]  # fmt: skip
    assert axes[-1].get_xlabel() == "time [s]"
    assert all(ax.has_data() for ax in axes)
    line = lines(axes[1])["estimate"]
    assert np.array_equal(line.get_ydata(), run.theta[:, 1], equal_nan=True)


def test_it_draws_on_given_axes(run):
    from matplotlib.figure import Figure

    given = Figure().subplots(4, 1)
    assert plots.plot_trajectory(run, axes=given) == list(given)
    with pytest.raises(ValueError, match="expected 4 for this picture"):
        plots.plot_trajectory(run, axes=given[:3])


def test_the_band_is_of_95_percent():
    ax = plots.plot_trajectory(made_up())[0]
    (band,) = ax.collections
    heights = band.get_paths()[0].vertices[:, 1]
    assert (heights.min(), heights.max()) == pytest.approx((4 - 0.19600, 4 + 0.19600), abs=1e-4)


def test_truth_is_a_number_values_or_a_function_of_time():
    run = made_up()
    truth = {"a1": 5.0, "a0": np.linspace(2.0, 4.0, 100), "b0": lambda t: 3.0 + 0.01 * t}
    axes = plots.plot_trajectory(run, truth)
    drawn = [lines(ax)["truth"].get_ydata() for ax in axes[:3]]
    assert np.all(np.asarray(drawn[0]) == 5.0)
    assert drawn[1] == pytest.approx(truth["a0"])
    assert drawn[2] == pytest.approx(3.0 + 0.01 * run.time)
    assert axes[0].get_ylim()[1] > 5.0  # it is not cut off
    assert "truth" not in lines(plots.plot_trajectory(run, {"a0": 3.0})[0])


def test_a_truth_that_does_not_fit_is_refused():
    with pytest.raises(ValueError, match="found a truth for k; expected names of a1, a0, b0"):
        plots.plot_trajectory(made_up(), {"k": 1.0})
    with pytest.raises(ValueError, match="found 7 values of a1; expected 100"):
        plots.plot_trajectory(made_up(), {"a1": np.ones(7)})


def test_changes_stand_at_their_instants_on_all_axes():
    run = made_up(changes=np.array([20.0, 45.0]))
    for ax in plots.plot_trajectory(run):
        upright = [line for line in ax.get_lines() if line.get_linestyle() not in ("-", "None")]
        assert [line.get_xdata()[0] for line in upright] == [20.0, 45.0]


def test_each_kind_of_flag_has_a_row_with_a_mark_where_it_was_raised():
    both = online.Flag.STUCK | online.Flag.MISSING_OUTPUT
    flags = [online.Flag(0)] * 100
    flags[10], flags[30] = both, online.Flag.STUCK
    ax = plots.plot_trajectory(made_up(flags=flags))[-1]
    rows = dict(zip((label.get_text() for label in ax.get_yticklabels()), ax.get_lines()))  # noqa: B905
    assert sorted(rows) == ["missing output", "stuck"]
    assert list(rows["stuck"].get_xdata()) == [11.0, 31.0]
    assert list(rows["missing output"].get_xdata()) == [11.0]


def test_a_wild_beginning_does_not_set_the_scale():
    theta = np.column_stack([np.full(100, 4.0)] * 3)
    std = np.full((100, 3), 0.1)
    theta[:3], std[:4] = 1e6, 1e7
    theta[5], std[5] = np.nan, np.nan
    ax = plots.plot_trajectory(made_up(theta=theta, std=std))[0]
    low, high = ax.get_ylim()
    assert low < 4.0 < high
    assert high - low < 2.0


def test_a_run_that_was_never_ready_can_be_drawn():
    nothing = np.full((100, 3), np.nan)
    flags = [online.Flag.NOT_READY] * 100
    axes = plots.plot_trajectory(made_up(theta=nothing, std=nothing, flags=flags), {"a1": 4.0})
    axes[0].figure.draw_without_rendering()
    assert axes[-1].get_yticklabels()[0].get_text() == "not ready"
