"""Picture of a declared study: error over the bound and coverage, every method in every cell."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any

from tridentify.errors import IdentifiabilityError
from tridentify.plots import style
from tridentify.studies.declared.result import DeclaredResult
from tridentify.studies.declared.statistics import CoefficientStatistics

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MARKERS = "osD^v<>Pp*Xh"
WIDTH = 9.6
"""Of the figure [inch]: two panels and names of cells beside them."""
PER_METHOD = 0.14
"""Height for one method of a cell [inch]."""
LIMIT = 100.0
"""Bounds: larger errors stand on the right edge, with their number."""
LEVEL = 0.95
NAME = 22
"""Characters of a line in the name of a cell."""

Row = tuple[str, float, float]
"""Method, value, standard error."""


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
        marker, label = MARKERS[number % len(MARKERS)], style.literal(name)
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
