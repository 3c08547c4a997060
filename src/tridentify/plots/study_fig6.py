"""Picture after the paper's Fig. 6: estimated over true coefficients against the noise level."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tridentify.numerics.arrays import Array
from tridentify.plots.study_fig5 import COLOURS
from tridentify.plots.style import BLACK, Panels, dress, make_axes, new_figure
from tridentify.studies.aircraft_numbers import (
    ESTIMATORS,
    PRINTED,
    TRUTH,
    Condition,
    EstimatorSummary,
)
from tridentify.studies.aircraft_result import AircraftResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ROWS = ((0, "a1 / true a1 [-]"), (1, "a0 / true a0 [-]"))
MARKERS = ("s", "o", "^")
PAPERS_SAMPLES = 100
SHIFT = 0.05
"""Between the estimators, so that points at one noise level do not hide each other."""


def plot_noise_levels(result: AircraftResult, *, axes: Sequence[Axes] | None = None) -> Panels:
    """Draw medians with 16-84 % bands, the Cramer-Rao bound and the paper's points.

    Parameters
    ----------
    result : AircraftResult
    axes : sequence of matplotlib Axes, optional
        Two for each record length: a1 for every length, then a0. A figure is made when left out.

    Returns
    -------
    Panels
        The axes.

    Raises
    ------
    OptionError
        Not as many axes as the picture needs.
    """
    groups = result.by_length()
    drawn = _make_axes(axes, len(groups))
    for row, (k, label) in enumerate(ROWS):
        low, high = _limits(result.conditions, k)
        for column, group in enumerate(groups):
            ax = drawn[row * len(groups) + column]
            ax.set_ylim(low, high)
            _draw_bound(ax, group, k)
            for j in range(len(ESTIMATORS)):
                _draw_estimator(ax, group, j, k)
            _draw_printed(ax, group, k)
            duration = group[0].n_samples * group[0].dt
            title = f"{group[0].n_samples} samples, {group[0].dt:g} s ({duration:g} s)"
            below = "noise std / RMS of y [-]" if row else ""
            beside = "" if column else label
            dress(ax, title="" if row else title, xlabel=below, ylabel=beside)
    _draw_legend(drawn[0])
    return drawn


def _make_axes(axes: Sequence[Axes] | None, n_lengths: int) -> Panels:
    count = len(ROWS) * n_lengths
    if axes is not None:
        return make_axes(axes, [1.0] * count)
    figure = new_figure(max(4.4 * n_lengths, 5.6), 7.2)
    return Panels(figure.subplots(len(ROWS), n_lengths, squeeze=False, sharex=True).flat)


def _limits(conditions: Sequence[Condition], k: int) -> tuple[float, float]:
    """Room for the bound at the strongest noise, on both sides of one."""
    bound = max(float(condition.bound[k]) for condition in conditions) / TRUTH[k]
    reach = max(1.15 * bound, 0.25)
    return 1.0 - reach, 1.0 + 1.15 * reach


def _draw_bound(ax: Axes, group: Sequence[Condition], k: int) -> None:
    ratios = np.array([condition.ratio for condition in group])
    bound = np.array([condition.bound[k] for condition in group]) / TRUTH[k]
    ax.fill_between(
        ratios, 1 - bound, 1 + bound, color="#ededed", linewidth=0, label="1 +/- Cramer-Rao std"
    )
    ax.axhline(1.0, color=BLACK, linewidth=0.9, linestyle="--")


def _draw_estimator(ax: Axes, group: Sequence[Condition], j: int, k: int) -> None:
    summaries = [condition.summary(j) for condition in group]
    ratios = np.array([condition.ratio for condition in group])
    # without noise there is nothing to hide, and the first point stays on its axis
    places = ratios + np.where(ratios > 0, SHIFT * (j - 1), 0.0)
    low, median, high = (_relative(summaries, which, k) for which in ("low", "median", "high"))
    colour = COLOURS[j]
    ax.fill_between(places, low, high, color=colour, alpha=0.13, linewidth=0)
    label = f"{ESTIMATORS[j]}: median, 16-84 %"
    look: dict[str, Any] = {"color": colour, "linewidth": 1.3, "elinewidth": 1.6, "markersize": 5}
    bars = median - low, high - median
    ax.errorbar(places, median, bars, marker=MARKERS[j], label=label, **look)
    _note_outside(ax, places, median, j)


def _relative(summaries: Sequence[EstimatorSummary], which: str, k: int) -> Array:
    return np.array([getattr(summary, which)[k] for summary in summaries]) / TRUTH[k]


def _note_outside(ax: Axes, places: Array, median: Array, j: int) -> None:
    """A median beyond the picture is written at its edge instead of vanishing."""
    low, high = ax.get_ylim()
    for place, value in zip(places, median, strict=True):
        if low <= value <= high or not np.isfinite(value):
            continue
        edge = high if value > high else low
        ax.annotate(
            f"{value:.3g}",
            (place, edge),
            xytext=(0, -4 if value > high else 4),
            textcoords="offset points",
            ha="right" if j == 0 else "center",
            va="top" if value > high else "bottom",
            fontsize=8,
            color=COLOURS[j],
            bbox={"facecolor": "white", "edgecolor": COLOURS[j], "linewidth": 0.6, "pad": 1.5},
        )


def _draw_printed(ax: Axes, group: Sequence[Condition], k: int) -> None:
    if group[0].n_samples != PAPERS_SAMPLES:
        return
    for j, name in enumerate(ESTIMATORS):
        points = PRINTED.get(name, {})
        ratios = [condition.ratio for condition in group if condition.ratio in points]
        if ratios:
            own = [points[ratio][k] / TRUTH[k] for ratio in ratios]
            look: dict[str, Any] = {"markersize": 8, "markerfacecolor": "none"}
            look |= {"markeredgecolor": COLOURS[j], "markeredgewidth": 1.4}
            ax.plot(ratios, own, MARKERS[j], label=f"{name}: printed in the paper", **look)


def _draw_legend(ax: Axes) -> None:
    """One for all axes, above them."""
    from matplotlib.figure import Figure

    handles, labels = ax.get_legend_handles_labels()
    order = sorted(range(len(labels)), key=lambda i: labels[i].rsplit(":", 1)[-1])
    figure = ax.figure
    if isinstance(figure, Figure):
        # the place outside exists only where a layout engine makes room for it
        arranged = figure.get_layout_engine() is not None
        place: Any = "outside upper center" if arranged else "upper center"
        sorted_ = [[each[i] for i in order] for each in (handles, labels)]
        figure.legend(*sorted_, loc=place, ncols=2, fontsize=9, frameon=False)
