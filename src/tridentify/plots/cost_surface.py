"""Picture of why: the ravine of the output error beside the bowl that Step 2 solves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tridentify.errors import OptionError, shown
from tridentify.estimation.answer.estimate import Estimate
from tridentify.numerics.arrays import Array
from tridentify.plots import style
from tridentify.record.record import Record
from tridentify.uncertainty.checks import checked_count
from tridentify.uncertainty.cost_surface import Bowl, CostSurface, cost_surface, step_2_bowl

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Range = tuple[float, float]

LEVELS = 16
DECADES = 6.0
"""Depth of the scale; below lies only what has no noise."""
REGION = 5.991465
"""Rise of -2 log L at the edge of a 95 % region of two coefficients."""
WIDE, HIGH = 8.6, 4.1
BELOW, ABOVE = 0.8, 1.4
"""Reach of the frame, in sizes of a coefficient."""
MARGINS = 8.0
"""Standard errors that the frame holds at least."""


def plot_cost_surface(
    estimate: Estimate,
    records: Record | Sequence[Record],
    coefficients: tuple[str, str] | None = None,
    *,
    pass_number: int | None = None,
    truth: Mapping[str, float] | None = None,
    ranges: tuple[Range, Range] | None = None,
    n_points: int = 33,
    axes: Sequence[Axes] | None = None,
) -> style.Panels:
    """Draw the output-error cost over two coefficients beside the quadratic that Step 2 solves.

    Parameters
    ----------
    estimate : Estimate
    records : Record or sequence of Record
        What was identified.
    coefficients : tuple of two str, optional
        Names of the estimate; by default the last two of the (first) denominator, ``("a1", "a0")``,
        or its only one and the static numerator.
    pass_number : int, optional
        Whose denominator is the filter of Step 2; the first pass by default.
    truth : mapping of str to float, optional
        What is known of the two coefficients, by name; marked where both are given.
    ranges : two pairs of float, optional
        Lowest and highest value of either coefficient.
    n_points : int
        Values of either coefficient at which the cost is computed; the time grows with its square.
    axes : sequence of two matplotlib Axes, optional
        Output error, Step 2. A figure is made when left out.

    Returns
    -------
    Panels
        The axes.

    Raises
    ------
    OptionError
        The coefficients are not two of the estimate's, there is no such pass, or the ranges are no
        rising numbers.

    Notes
    -----
    Every value on the left is a mean-square output error that was computed from the record, all
    other coefficients and nuisance terms at their best (`tridentify.uncertainty.cost_surface`); the
    scale is logarithmic. The dashed line is the 95 % region of both coefficients by the likelihood
    ratio. On the right is the mean square of the equation error of Step 2, exactly quadratic, whose
    minimum (star) is where a pass of `ThreeModel` goes next. Grey: unstable models.
    """
    style.checked(estimate, Estimate, "plot_cost_surface(estimate, record)")
    names = _default(estimate) if coefficients is None else coefficients
    count = checked_count("n_points", n_points, 5)
    theta = _filter_of(estimate, pass_number)
    bowl = step_2_bowl(estimate, records, names, theta)
    where = [estimate.names.index(name) for name in names]
    path = np.array([np.asarray(one.theta)[where] for one in estimate.trace.passes]).reshape(-1, 2)
    marked = _truth(names, truth)
    spans = _spans(estimate, where, path, marked, bowl) if ranges is None else _checked(ranges)
    grids = [np.linspace(low, high, count) for low, high in spans]
    surface = cost_surface(estimate, records, names, *grids)
    drawn = _axes(axes)
    _draw_surface(drawn[0], surface, estimate)
    fine = [np.linspace(low, high, 160) for low, high in spans]
    _filled(drawn[1], fine[0], fine[1], bowl.cost(fine[0][:, None], fine[1][None, :]))
    titles = (
        "output error: a ravine",
        f"Step 2, filter 1/a of pass {_number(estimate, pass_number)}: a bowl",
    )
    units = {name: estimate.parameters[name].unit for name in names}
    units = {name: unit for name, unit in units.items() if unit not in ("", "-")}
    for ax, title in zip(drawn, titles, strict=True):
        ax.plot(path[:, 0], path[:, 1], color="white", linewidth=2.6, zorder=3)
        ax.plot(
            path[:, 0], path[:, 1], color=style.ORANGE, linewidth=1.3, marker="o", markersize=3.5,
            label="passes", zorder=4,
        )  # fmt: skip
        best = estimate.theta[where]
        _mark(ax, best, "x", style.BLACK, "estimate")
        if marked is not None:
            _mark(ax, marked, "+", style.BLACK, "truth")
        ax.set_xlim(*spans[0])
        ax.set_ylim(*spans[1])
        style.dress(
            ax,
            title=title,
            xlabel=style.labelled(names[0], units),
            ylabel=style.labelled(names[1], units),
        )
        ax.grid(False)
        style.scientific(ax)
    start = np.asarray(theta)[where]
    _mark(drawn[1], start, "s", style.BLACK, "a of the filter")
    _mark(drawn[1], bowl.centre, "*", style.BLACK, "minimum of Step 2")
    for ax in drawn:
        _legend(ax)
    return drawn


def _default(estimate: Estimate) -> tuple[str, str]:
    own = [name for name in estimate.names if name.startswith("a")]
    where = own[0].partition("[")[2]
    own = [name for name in own if name.partition("[")[2] == where]
    if len(own) > 1:
        return own[-2], own[-1]
    return own[0], next(name for name in estimate.names if name.startswith("b0"))


def _number(estimate: Estimate, pass_number: int | None) -> int:
    if pass_number is not None:
        return pass_number
    return estimate.trace.passes[0].number if estimate.trace.passes else 0


def _filter_of(estimate: Estimate, pass_number: int | None) -> Array:
    """Coefficients of the pass whose denominator filters Step 2."""
    passes = {one.number: one for one in estimate.trace.passes}
    if pass_number is not None and pass_number not in passes:
        raise OptionError.found("pass_number=", pass_number, f"one of {list(passes)}")
    theta = np.array(estimate.theta)
    if passes:
        found = np.asarray(passes[_number(estimate, pass_number)].theta)
        theta[: found.size] = found
    return theta


def _truth(names: tuple[str, str], truth: Mapping[str, float] | None) -> Array | None:
    if not truth or any(name not in truth for name in names):
        return None
    return np.array([truth[name] for name in names], dtype=np.float64)


def _checked(ranges: tuple[Range, Range]) -> list[Range]:
    spans = np.asarray(ranges, dtype=np.float64)
    if spans.shape != (2, 2) or not np.all(np.isfinite(spans)) or np.any(np.diff(spans) <= 0):
        raise OptionError(
            f"found ranges={shown(ranges)}; expected two pairs of a lower and a higher number; "
            "write ((0.0, 2.0), (1.0, 5.0))"
        )
    return [(float(low), float(high)) for low, high in spans]


def _spans(
    estimate: Estimate, where: list[int], path: Array, truth: Array | None, bowl: Bowl
) -> list[Range]:
    """Frame around the estimate, the passes that are not far off, and the bowl's minimum."""
    found = []
    for k, position in enumerate(where):
        value, std = float(estimate.theta[position]), float(estimate.std[position])
        size = abs(value) or 1.0
        margin = MARGINS * std if np.isfinite(std) else 0.0
        margin = min(margin, 2.5 * size) if value else margin or 1.0
        down, up = (BELOW, ABOVE) if value >= 0 else (ABOVE, BELOW)
        # little of the frame beyond zero, where models are mostly unstable
        inward = min(margin, 1.1 * size) if value else margin
        below, above = (inward, margin) if value >= 0 else (margin, inward)
        low = value - max(below, down * size if value else 0.0)
        high = value + max(above, up * size if value else 0.0)
        also = np.concatenate([path[:, k], bowl.centre[k : k + 1]])
        if truth is not None:
            also = np.append(also, truth[k])
        reach = high - low
        near = also[(also > low - reach) & (also < high + reach)]
        low = min(low, float(near.min(initial=low)) - 0.05 * reach)
        high = max(high, float(near.max(initial=high)) + 0.05 * reach)
        found.append((low, high))
    return found


def _axes(axes: Sequence[Axes] | None) -> style.Panels:
    if axes is not None:
        return style.make_axes(axes, [HIGH, HIGH])
    return style.Panels(style.new_figure(WIDE, HIGH).subplots(1, 2))


def _filled(ax: Axes, x: Array, y: Array, cost: Array) -> None:
    """Filled contours of the logarithm, with a scale beside them."""
    from matplotlib.ticker import MaxNLocator

    known = cost[np.isfinite(cost) & (cost > 0)]
    if not known.size:
        return
    top = float(np.log10(known.max()))
    bottom = max(float(np.log10(known.min())), top - DECADES)
    if top - bottom < 1e-9:
        bottom = top - 1e-3
    levels = np.linspace(bottom, top, LEVELS + 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        height = np.clip(np.log10(cost), bottom, top)
    height = np.where(cost == 0, bottom, height)
    ax.set_facecolor("#c8c8c8")
    filled = ax.contourf(x, y, height.T, levels=levels, cmap="cividis_r")
    ax.contour(
        x, y, height.T, levels=levels[1:-1], colors="white", linewidths=0.5, linestyles="solid"
    )
    bar = ax.figure.colorbar(filled, ax=ax, pad=0.02, ticks=MaxNLocator(6))
    bar.set_label("log10 of the mean square", fontsize=9)
    bar.ax.tick_params(labelsize=8)


def _draw_surface(ax: Axes, surface: CostSurface, estimate: Estimate) -> None:
    x, y, cost = surface.first, surface.second, surface.cost
    if np.all(np.isfinite(cost)) and np.all(cost > 0):
        from scipy.interpolate import RectBivariateSpline

        # the cost is smooth: a spline through its logarithm draws the contours without corners
        fine_x, fine_y = (np.linspace(v[0], v[-1], 4 * v.size) for v in (x, y))
        spline = RectBivariateSpline(x, y, np.log(cost))
        x, y, cost = fine_x, fine_y, np.exp(spline(fine_x, fine_y))
    _filled(ax, x, y, cost)
    known = cost[np.isfinite(cost)]
    least = float(np.min(known, initial=estimate.cost))
    edge = least * float(np.exp(REGION / max(estimate.degrees_of_freedom, 1)))
    if known.size and known.min() < edge < known.max():
        ax.contour(
            x, y, cost.T, levels=[edge], colors=style.BLACK, linewidths=1.2, linestyles="dashed"
        )
        ax.plot([], [], color=style.BLACK, linewidth=1.2, linestyle="--", label="95 % region")


def _mark(ax: Axes, at: Array, marker: str, colour: str, label: str) -> None:
    if marker in "x+":
        behind: dict[str, Any] = {"color": "white", "markersize": 10, "markeredgewidth": 4.0}
        ax.plot([at[0]], [at[1]], marker, zorder=4.5, **behind)
    face, edge = ("white", 1.1) if marker in "s*" else (colour, 2.0)
    look: dict[str, Any] = {"markerfacecolor": face, "markeredgecolor": colour, "zorder": 5}
    ax.plot([at[0]], [at[1]], marker, markersize=8, markeredgewidth=edge, label=label, **look)


def _legend(ax: Axes) -> None:
    """Below the axes, where it covers nothing."""
    below: dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.16)}
    ax.legend(ncols=2, fontsize=8, frameon=False, borderaxespad=0.2, columnspacing=1.2, **below)
