"""Pictures of a study's result, as files.

Picture after the paper's Fig. 5: the aircraft's step response, a noisy record, the fits.

Picture after the paper's Fig. 6: estimated over true coefficients against the noise level.

Picture of a declared study: error over the bound and coverage, every method in every cell.
"""

from __future__ import annotations

import io
import math
import os
import textwrap
from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tridentify.errors import IdentifiabilityError
from tridentify.models.simulate import simulate
from tridentify.numerics.arrays import Array
from tridentify.plots import style
from tridentify.plots.style import BLACK, Panels, dress, make_axes, new_figure
from tridentify.record.record import Record
from tridentify.studies.aircraft_result import (
    ESTIMATORS,
    PRINTED,
    TRUTH,
    AircraftResult,
    Condition,
    EstimatorSummary,
)
from tridentify.studies.base import StudyResult
from tridentify.studies.declared.result import CoefficientStatistics, DeclaredResult
from tridentify.transfer_function import TransferFunction
from tridentify.writing.files import write_atomically
from tridentify.writing.views import unseen

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = (style.ORANGE, style.BLUE, style.GREEN)
"""Of the estimators, in the pictures of this study."""
FINE = 5
"""Points of a drawn response for each sample of the record."""


def plot_step_responses(
    result: AircraftResult, *, axes: Sequence[Axes] | None = None
) -> style.Panels:
    """Draw the truth with one noisy record, what the estimators make of all draws, and the input.

    Parameters
    ----------
    result : AircraftResult
        Its first record length at the noise ratio nearest to one is drawn.
    axes : sequence of matplotlib Axes, optional
        Five: record, one for each estimator, input. A figure is made when left out.

    Returns
    -------
    Panels
        The axes.
    """
    drawn = style.make_axes(axes, [2.2, 1.35, 1.35, 1.35, 0.9], sharex=True)
    condition = min(result.by_length()[0], key=lambda c: abs(c.ratio - 1.0))
    x = np.ones(condition.n_samples * FINE)
    grid = Record(x, x, dt=condition.dt / FINE)
    truth = _response(TRUTH, grid)
    example = condition.example
    thin: dict[str, Any] = {"color": style.GREY, "linewidth": 0.6, "markersize": 3.5}
    drawn[0].plot(example.t, example.y[:, 0], ".-", label="one record", **thin)
    drawn[0].plot(grid.t, truth, color=style.BLACK, linewidth=1.6, label="truth")
    title = f"noise {condition.ratio:g} x RMS of the truth"
    style.dress(drawn[0], title=title, ylabel="y [units of x]")
    style.legend(drawn[0], columns=2)
    bands = [response_band(condition, j, grid) for j in range(len(ESTIMATORS))]
    for ax, colour, name, band in zip(drawn[1:-1], COLOURS, ESTIMATORS, bands, strict=True):
        _draw_band(ax, grid.t, truth, band, colour, name)
    low, high = _response_limits(truth, bands)
    for ax in drawn[1:-1]:
        ax.set_ylim(low, high)
    end = float(grid.t[-1])
    drawn[-1].plot(
        [-0.05 * end, 0.0, 0.0, end], [0.0, 0.0, 1.0, 1.0], color=style.BLACK, linewidth=1.2
    )
    style.dress(drawn[-1], xlabel="time [s]", ylabel="x [-]")
    return drawn


def response_band(condition: Condition, estimator: int, grid: Record) -> Array:
    """Quantiles of the fitted models' responses, instant by instant.

    Parameters
    ----------
    condition : Condition
    estimator : int
        Place in ``ESTIMATORS``.
    grid : Record
        Whose input and times are used.

    Returns
    -------
    ndarray, shape (3, n_samples)
        16, 50 and 84 %; ``nan`` when no draw gave a model.
    """
    theta = condition.theta[estimator]
    found = theta[np.all(np.isfinite(theta), axis=1)]
    if not found.size:
        return np.full((3, grid.n_samples), np.nan)
    with np.errstate(over="ignore", invalid="ignore"):
        responses = [_response(own, grid) for own in found]
    return np.asarray(np.quantile(responses, [0.16, 0.5, 0.84], axis=0))


def _response(theta: Sequence[float] | Array, grid: Record) -> Array:
    a1, a0, b0 = theta
    return simulate(TransferFunction([b0], [1.0, a1, a0]), grid)[:, 0]


def _draw_band(ax: Axes, t: Array, truth: Array, band: Array, colour: str, name: str) -> None:
    ax.fill_between(t, band[0], band[2], color=colour, alpha=0.25, linewidth=0, label="16-84 %")
    ax.plot(t, band[1], color=colour, linewidth=1.5, label="median")
    ax.plot(t, truth, color=style.BLACK, linewidth=1.0, linestyle="--", label="truth")
    style.dress(ax, title=name, ylabel="y [units of x]")
    style.legend(ax)


def _response_limits(truth: Array, bands: Sequence[Array]) -> tuple[float, float]:
    """Of all bands, but at most twice as far as the truth: an unstable median may run away."""
    values = np.concatenate([np.ravel(band) for band in bands])
    span = float(np.ptp(truth))
    inside = values[np.isfinite(values)]
    low = max(float(np.min(inside, initial=truth.min())), float(truth.min()) - span)
    high = min(float(np.max(inside, initial=truth.max())), float(truth.max()) + span)
    room = 0.06 * (high - low)
    return low - room, high + room


ROWS = ((0, "a1 / true a1 [-]"), (1, "a0 / true a0 [-]"))
MARKERS = ("s", "o", "^")
PAPERS_SAMPLES = 100
"""Length of the records in the paper's table."""
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


CELL_MARKERS = "osD^v<>Pp*Xh"
WIDTH = 9.6
"""Of the figure [inch]: two panels and names of cells beside them."""
PER_METHOD = 0.14
"""Height for one method of a cell [inch]."""
LIMIT = 100.0
"""Bounds: larger errors stand on the right edge, with their number."""
LEVEL = 0.95
NAME = 22
"""Characters of a line in the name of a cell."""


def plot_study_cells(result: DeclaredResult, *, axes: Sequence[Axes] | None = None) -> style.Panels:
    """Draw error over the Cramer-Rao bound, and coverage, of every method in every cell.

    Parameters
    ----------
    result : DeclaredResult
    axes : sequence of matplotlib Axes, optional
        Two: error, coverage. A figure is made when left out.

    Returns
    -------
    Panels
        The axes.

    Raises
    ------
    IdentifiabilityError
        No cell has noise and a draw with an answer.

    Notes
    -----
    On the left the coefficient with the largest error over its bound, on the right that whose 95 %
    interval holds the truth least often; bars are two standard errors.
    """
    style.checked(result, DeclaredResult, "plot_study_cells(run_study(...))")
    cells = shown_cells(result)
    if not cells:
        raise IdentifiabilityError(
            "found no cell with noise and an answer; expected one to draw; look at result.table()"
        )
    drawn = _panels(len(cells), len(_methods(result)), axes)
    _draw(drawn[0], result, cells, _error)
    _draw(drawn[1], result, cells, _coverage)
    drawn[0].axvline(1.0, color=style.BLACK, linewidth=0.8, zorder=1)
    drawn[0].set_xscale("log")
    low, high = drawn[0].get_xlim()
    drawn[0].set_xlim(min(low, 0.8), max(min(high, 1.2 * LIMIT), 3.0))
    drawn[0].xaxis.set_major_formatter("{x:g}")
    drawn[1].axvline(100 * LEVEL, color=style.BLACK, linewidth=0.8, zorder=1)
    drawn[1].set_xlim(-3, 103)
    style.dress(drawn[0], title="largest error", xlabel="RMSE over the Cramer-Rao bound")
    style.dress(drawn[1], title="least coverage", xlabel="95 % intervals that hold the truth [%]")
    for ax in drawn:
        ax.grid(False, axis="y")
    if axes is None:
        handles, labels = drawn[0].get_legend_handles_labels()
        drawn.figure.legend(
            handles, labels, loc="outside upper center", ncols=4, fontsize=8, frameon=False
        )
    return drawn


def shown_cells(result: DeclaredResult) -> list[str]:
    """Cells with noise and an answer, in the order of the study."""
    return list(dict.fromkeys(row.cell for row in result.statistics if math.isfinite(row.ratio)))


def _methods(result: DeclaredResult) -> list[str]:
    return [method.name for method in result.study.methods]


def _panels(n_cells: int, n_methods: int, axes: Sequence[Axes] | None) -> style.Panels:
    if axes is not None:
        return style.make_axes(axes, [1.0, 1.0])
    height = 1.3 + n_cells * max(0.5, PER_METHOD * n_methods)
    figure = style.new_figure(WIDTH, height + 0.1 * n_methods / 4)
    return style.Panels(figure.subplots(1, 2, sharey=True, width_ratios=[1.4, 1.0]))


def _draw(
    ax: Axes,
    result: DeclaredResult,
    cells: Sequence[str],
    worst: Callable[[Sequence[CoefficientStatistics]], tuple[float, float]],
) -> None:
    names = _methods(result)
    for number, name in enumerate(names):
        height = 0.36 - 0.72 * (number + 0.5) / len(names)
        own = [row for row in result.statistics if row.method == name and row.cell in cells]
        found = {cell: worst(list(rows)) for cell, rows in groupby(own, lambda row: row.cell)}
        points = [(cell, *values) for cell, values in found.items() if math.isfinite(values[0])]
        places = [height - cells.index(cell) for cell, _, _ in points]
        values = [min(value, LIMIT) if worst is _error else value for _, value, _ in points]
        errors = [2 * e if math.isfinite(e) and v <= LIMIT else 0.0 for _, v, e in points]
        bars = [[min(e, v - v / 10) for e, v in zip(errors, values, strict=True)], errors]
        marker, label = CELL_MARKERS[number % len(CELL_MARKERS)], style.literal(name)
        look: dict[str, Any] = {"markersize": 4.5, "linewidth": 1}
        look["color"] = style.cycle_colour(number)
        ax.errorbar(values, places, xerr=bars, fmt=marker, label=label, **look)
        for (_, value, _), place in zip(points, places, strict=True):
            if value > LIMIT:
                ax.text(LIMIT, place, f"  {value:.2g}", fontsize=6, va="center")
    for k in range(len(cells) - 1):
        ax.axhline(-k - 0.5, color=style.GREY, linewidth=0.4)
    ax.set_yticks([-k for k in range(len(cells))], [_told(cell) for cell in cells])
    ax.set_ylim(-len(cells) + 0.5, 0.5)


def _error(rows: Sequence[CoefficientStatistics]) -> tuple[float, float]:
    """Largest error over the bound, with its standard error."""
    found = [(row.ratio, row.ratio_error) for row in rows if math.isfinite(row.ratio)]
    return max(found, default=(math.nan, math.nan))


def _coverage(rows: Sequence[CoefficientStatistics]) -> tuple[float, float]:
    """Least coverage, with its standard error [%]."""
    found = [(row.coverage, row.coverage_error) for row in rows if math.isfinite(row.coverage)]
    least, error = min(found, default=(math.nan, math.nan))
    return 100 * least, 100 * error


def _told(cell: str) -> str:
    lines = [line for part in cell.split(" / ") for line in textwrap.wrap(part, NAME)]
    return style.literal("\n".join(lines))


@unseen()
def save_study_figures(result: StudyResult, folder: str | os.PathLike[str]) -> tuple[Path, ...]:
    """Draw what a study found, and write every picture to a file.

    Parameters
    ----------
    result : StudyResult
    folder : path-like
        Made if it does not exist.

    Returns
    -------
    tuple of Path
        ``aircraft-step-response.svg`` (after the paper's Fig. 5) and ``aircraft-noise-levels.svg``
        (after its Fig. 6) of the aircraft; ``cells.svg`` of a declared study that has noise; none
        for a result that has no pictures.

    Raises
    ------
    OutputPathError
        The folder or a file cannot be written.
    """
    written = []
    for stem, drawn in _pictures(result).items():
        buffer = io.BytesIO()
        figure: Any = drawn.figure
        figure.savefig(buffer, format="svg")
        written.append(write_atomically(Path(folder) / f"{stem}.svg", buffer.getvalue()))
    return tuple(written)


def _pictures(result: StudyResult) -> Mapping[str, Panels]:
    if isinstance(result, AircraftResult):
        return {
            "aircraft-step-response": plot_step_responses(result),
            "aircraft-noise-levels": plot_noise_levels(result),
        }
    if isinstance(result, DeclaredResult) and shown_cells(result):
        return {"cells": plot_study_cells(result)}
    return {}
