"""The picture of a validation: one axes for each test, with the values that were tested."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

from tridentify import Record, Structure, ThreeModel, TransferFunction, identify, simulate, validate
from tridentify.plots import plot_residual_tests
from tridentify.plots.residual_tests import _moving


@pytest.fixture(scope="module")
def validation():
    rng = np.random.default_rng(0)
    u = rng.choice([-1.0, 1.0], (50, 2)).repeat(6, axis=0)
    y = simulate(
        TransferFunction([[[4.0], [2.0]]], [[[1.0, 4.0]] * 2]), Record(u, u[:, 0], dt=0.05)
    )
    names = {"input_names": ["$elevator$", "a name of a channel that is long"]}
    y = y + 0.1 * rng.standard_normal(y.shape)
    pair = [
        Record(u[a:b], y[a:b], dt=0.05, units={"y": "m"}, **names)
        for a, b in ((0, 150), (150, 300))
    ]
    estimate = identify(pair, Structure(1, 0), ThreeModel(noise="white"))
    return validate(estimate, pair)


@pytest.mark.slow
def test_each_test_has_its_axes_and_labels(validation):
    axes = plot_residual_tests(validation)
    axes[0].figure.canvas.draw()
    assert len(axes) == 5
    assert all(ax.get_xlabel() and ax.get_ylabel() for ax in axes)
    assert "[m]" in axes[-1].get_ylabel()
    # the experiments stand side by side, each with its own time
    assert axes[-1].get_xlabel() == "time in each experiment [s]"
    assert [t.get_text() for t in axes[-1].texts] == ["experiment 1", "experiment 2"]
    assert [t.get_text() for t in axes[-1].get_xticklabels()].count("0") == 2
    assert axes[0].get_title(loc="left").startswith("y with itself")


def test_the_stems_are_the_correlations(validation):
    axes = plot_residual_tests(validation)
    for ax, picture in zip(axes[1:3], validation.cross_correlation, strict=True):
        ends = {}
        for lines in ax.collections:
            if hasattr(lines, "get_segments") and not hasattr(lines, "get_facecolors_"):
                for segment in lines.get_segments():
                    ends[round(float(segment[0][0]), 9)] = float(segment[1][1])
        expected = dict(
            zip(np.round(picture.lags, 9).tolist(), picture.correlation.tolist(), strict=True)
        )
        assert ends == pytest.approx(expected)


def test_it_draws_on_given_axes_and_counts_them(validation):
    given = Figure().subplots(5, 1)
    assert plot_residual_tests(validation, axes=given) == list(given)
    with pytest.raises(ValueError, match="found 4 axes; expected 5"):
        plot_residual_tests(validation, axes=given[:4])


def test_the_moving_level_is_that_of_each_stretch():
    rng = np.random.default_rng(1)
    values = 1e6 + rng.standard_normal(200)
    values[17] = np.nan
    at, level, scale = _moving(np.arange(200.0), values)
    seen = values[np.isfinite(values)]
    width = seen.size - level.size + 1
    stretches = np.lib.stride_tricks.sliding_window_view(seen, width)
    assert level == pytest.approx(stretches.mean(axis=1), rel=1e-12)
    assert scale == pytest.approx(stretches.std(axis=1), rel=1e-6)
    assert at[0] == pytest.approx((width - 1) / 2)


def test_a_record_without_noise_has_a_picture_too():
    u = np.repeat([1.0, -1.0, 1.0], 30)
    clean = Record(u, simulate(TransferFunction([4.0], [1.0, 4.0]), Record(u, u, dt=0.05)), dt=0.05)
    axes = plot_residual_tests(validate(identify(clean, Structure(1, 0)), clean))
    axes[0].figure.canvas.draw()
    assert "rounding" in axes[0].texts[0].get_text()
