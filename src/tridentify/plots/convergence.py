"""Picture of the passes: coefficients, cost, and the measures of how settled they are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.plots import style
from tridentify.writing.layout import short

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MARKERS = "osD^vP*"
COLUMNS = 3
"""Of the legend."""
LONGEST_NAME = 18
"""Name of a coefficient in it, in characters."""


def plot_convergence(estimate: Estimate, *, axes: Sequence[Axes] | None = None) -> style.Panels:
    """Draw how coefficients, cost and stop measures went from pass to pass.

    Parameters
    ----------
    estimate : Estimate
    axes : sequence of matplotlib Axes, optional
        Three: distance of each coefficient from its final value in standard errors, output-error
        cost, and stop measures. A figure is made when left out.

    Returns
    -------
    Panels
        The axes.
    """
    from matplotlib.ticker import NullFormatter

    style.checked(estimate, Estimate, "plot_convergence(estimate)")
    rows = -(-len(estimate.names) // COLUMNS)
    drawn = style.make_axes(axes, [2.0 + 0.18 * rows, 1.3, 1.6], sharex=True)
    passes = estimate.trace.passes
    numbers = np.array([item.number for item in passes])
    thetas = [item.theta for item in passes]
    n_parameters = estimate.theta.size
    # before delays are estimated along they are missing at the end
    path = np.array(
        [np.append(theta, np.full(n_parameters, np.nan))[:n_parameters] for theta in thetas]
    ).reshape(-1, n_parameters)
    _draw_distances(drawn[0], estimate, numbers, path)
    cost = np.array([item.cost for item in passes], dtype=np.float64)
    drawn[1].plot(numbers, cost, color=style.BLUE, marker="o", markersize=4, linewidth=1.2)
    positive = cost[np.isfinite(cost) & (cost > 0)]
    if positive.size == cost.size > 0 and positive.max() > 20 * positive.min():
        drawn[1].set_yscale("log")
        drawn[1].yaxis.set_minor_formatter(NullFormatter())
    else:
        drawn[1].ticklabel_format(axis="y", style="sci", scilimits=(-3, 4), useOffset=False)
        drawn[1].yaxis.get_offset_text().set_fontsize(8)
    style.dress(drawn[1], ylabel="output-error\ncost [-]")
    beta = np.array([item.beta_distance for item in passes], dtype=np.float64)
    gradient = np.array([item.gradient for item in passes], dtype=np.float64)
    _log_line(drawn[2], numbers, beta, style.ORANGE, "s", "distance of beta from (1, 0, ..., 0)")
    _log_line(drawn[2], numbers, gradient, style.GREEN, "D", "relative gradient of the cost")
    style.dress(drawn[2], xlabel="pass", ylabel="stop measures [-]")
    _finish(drawn, numbers)
    return drawn


def _draw_distances(
    ax: Axes,
    estimate: Estimate,
    numbers: np.ndarray[tuple[int], np.dtype[np.int_]],
    path: np.ndarray[tuple[int, int], np.dtype[np.float64]],
) -> None:
    for k, name in enumerate(estimate.names):
        std = estimate.std[k]
        known = np.isfinite(std) and std > 0
        scale = std if known else (abs(estimate.theta[k]) or 1.0)
        distance = np.abs(path[:, k] - estimate.theta[k]) / scale
        colour = style.cycle_colour(k)
        marker = MARKERS[(k + k // len(style.CYCLE)) % len(MARKERS)]
        label = short(name, LONGEST_NAME if known else LONGEST_NAME - 11)
        label = style.literal(label if known else f"{label} (relative)")
        _log_line(ax, numbers, distance, colour, marker, label)
    if ax.get_yscale() == "log":
        ax.axhline(1.0, color="black", linewidth=0.8, linestyle="--")
    style.dress(ax, ylabel="distance from final\n[standard errors]")


def _log_line(
    ax: Axes,
    numbers: np.ndarray[tuple[int], np.dtype[np.int_]],
    values: np.ndarray[tuple[int], np.dtype[np.float64]],
    colour: str,
    marker: str,
    label: str,
) -> None:
    """A line on a logarithmic scale; what cannot stand there (zero, nan) is left out."""
    shown = np.where(np.isfinite(values) & (values > 0), values, np.nan)
    if not np.any(np.isfinite(shown)):
        return
    ax.set_yscale("log")
    ax.plot(numbers, shown, color=colour, marker=marker, markersize=4, linewidth=1.2, label=label)


def _finish(axes: Sequence[Axes], numbers: np.ndarray[tuple[int], np.dtype[np.int_]]) -> None:
    from matplotlib.ticker import MaxNLocator

    for ax in (axes[0], axes[2]):
        if ax.get_legend_handles_labels()[1]:
            # above the axes, where it can cover no line
            above: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0)}
            above |= {"columnspacing": 1.0, "borderaxespad": 0.1}
            ax.legend(fontsize=8, frameon=False, ncols=COLUMNS, **above)
        else:
            ax.text(0.5, 0.5, "nothing to show", transform=ax.transAxes, ha="center", fontsize=9)
    axes[-1].xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    if numbers.size:
        axes[-1].set_xlim(numbers[0] - 0.3, numbers[-1] + 0.3)
