"""Picture of poles and zeros with their confidence ellipses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.numerics.root_draws import stacked_roots
from tridentify.plots.style import BLACK, CYCLE, WIDTH, dress, literal, make_axes
from tridentify.uncertainty import RootUncertainty, poles, zeros
from tridentify.writing.layout import format_std, format_value, short

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FAR_ROOT = 6.0
"""Zeros beyond this multiple of the largest pole would squeeze all else into a dot."""
REACH = 2.45
"""Of a 95 % ellipse, in standard errors."""
DOTS = 500
"""Models whose poles are drawn of a posterior mean."""
LONGEST_CHANNEL = 30
"""Name of a channel, in characters."""
THIN = 0.2
"""Width of all that is shown over half its height, below which the scales differ."""
TOO_VAGUE = 0.5
"""Standard error of a root that is not shown over its size, from which it is not determined."""
ASPECT = 1.5
"""Width over height of the frame."""


def plot_pole_zero(estimate: Estimate, *, level: float = 0.95, ax: Axes | None = None) -> Axes:
    """Draw poles (crosses) and zeros (circles) with confidence ellipses from the delta method.

    Parameters
    ----------
    estimate : Estimate
    level : float
        Probability that an ellipse holds; a real root has an interval on the real axis. Of a
        posterior mean, the poles of its draws stand in place of ellipses.
    ax : matplotlib Axes, optional
        A figure is made when left out.

    Returns
    -------
    matplotlib Axes
    """
    drawn = make_axes(None if ax is None else [ax], [WIDTH / 1.6])[0]
    channels = [
        (i, j) for i in range(len(estimate.output_names)) for j in range(len(estimate.input_names))
    ]
    shared = estimate.structure.shared
    all_poles = [poles(estimate, i, j) for i, j in channels]
    size = max(float(np.max(np.abs(region.roots), initial=0.0)) for region in all_poles) or 1.0
    regions: list[tuple[str, RootUncertainty]] = []
    for k, (i, j) in enumerate(channels):
        pair = estimate.output_names[i], estimate.input_names[j]
        name = literal(" / ".join(short(one, LONGEST_CHANNEL) for one in pair))
        colour = CYCLE[k % len(CYCLE)]
        if not shared or k == 0:
            style = (BLACK, "poles") if shared else (colour, f"poles of {name}")
            regions.append(("pole", all_poles[k]))
            _draw(drawn, all_poles[k], "x", *style, level, ellipses=not len(estimate.draws))
            _draw_cloud(drawn, estimate, (i, j), style[0])
        found = zeros(estimate, i, j)
        near = np.abs(found.roots) < FAR_ROOT * size
        regions.append((f"zero of {name}", found))
        inside = RootUncertainty(found.roots[near], found.cov[near])
        _draw(drawn, inside, "o", colour, f"zeros of {name}", level)
    outside = _frame(drawn, regions, size)
    drawn.axhline(0.0, color="black", linewidth=0.6)
    drawn.axvline(0.0, color="black", linewidth=0.6)
    drawn.axvspan(0.0, drawn.get_xlim()[1], color="#f3f3f3", zorder=0)
    label = "\n".join(["real part [1/s]", *outside])
    dress(drawn, xlabel=label, ylabel="imaginary part [rad/s]")
    drawn.ticklabel_format(axis="both", style="sci", scilimits=(-3, 4), useOffset=False)
    title = "dots: as likely" if len(estimate.draws) else f"with {100 * level:.3g} % regions"
    above = _legend(drawn, title)
    if ax is None and (above or outside):
        _heighten(drawn, WIDTH / 1.6 + 0.55 + 0.23 * above + 0.17 * len(outside))
    return drawn


def _heighten(ax: Axes, height: float) -> None:
    """Make the figure high enough for what stands above and below the axes [inch]."""
    from matplotlib.figure import Figure

    if isinstance(ax.figure, Figure):
        ax.figure.set_size_inches(WIDTH, height)


def _legend(ax: Axes, title: str) -> int:
    """In the corner while it is small, else above the axes; lines that it takes there."""
    labels = ax.get_legend_handles_labels()[1]
    longest = max(map(len, labels), default=0)
    small = len(labels) <= 2 and longest <= 24
    columns = 1 if small or longest > 34 else 2
    ax.legend(
        title=title,
        title_fontsize=9,
        fontsize=9,
        framealpha=0.8,
        edgecolor="none",
        alignment="center" if small else "left",
        loc="upper right" if small else "lower right",
        bbox_to_anchor=(1.0, 1.0 if small else 1.04),
        borderaxespad=0.2,
        ncols=columns,
        columnspacing=1.4,
    )
    return 0 if small else 1 + -(-len(labels) // columns)


def _draw(
    ax: Axes,
    region: RootUncertainty,
    marker: str,
    colour: str,
    label: str,
    level: float,
    *,
    ellipses: bool = True,
) -> None:
    if region.roots.size == 0:
        return
    ax.plot(
        region.roots.real,
        region.roots.imag,
        linestyle="none",
        marker=marker,
        markersize=7,
        markerfacecolor="none",
        markeredgewidth=1.6,
        color=colour,
        label=label,
    )
    for k in range(region.roots.size if ellipses else 0):
        curve = region.ellipse(k, level)
        if np.all(np.isfinite(curve)):
            ax.fill(curve[:, 0], curve[:, 1], facecolor=colour, alpha=0.2, linewidth=0)
            ax.plot(curve[:, 0], curve[:, 1], color=colour, linewidth=1.2)


def _draw_cloud(ax: Axes, estimate: Estimate, channel: tuple[int, int], colour: str) -> None:
    """Draw the poles of the draws of a posterior mean, as many as can be told apart."""
    if not len(estimate.draws):
        return
    chosen = np.asarray(estimate.draws)[:: max(len(estimate.draws) // DOTS, 1)]
    roots = stacked_roots(estimate.channel_draws(chosen, *channel)[1]).ravel()
    ax.plot(
        roots.real,
        roots.imag,
        linestyle="none",
        marker=".",
        markersize=2.5,
        alpha=0.35,
        markeredgewidth=0,
        color=colour,
        zorder=1,
    )


def _frame(ax: Axes, regions: list[tuple[str, RootUncertainty]], size: float) -> list[str]:
    """Scale around the poles and what is not far from them; mark and say what lies outside."""
    near = [region.roots[np.abs(region.roots) < FAR_ROOT * size] for _, region in regions]
    edges = [_edge(region, size) for _, region in regions]
    shown = np.concatenate([*near, *edges, np.zeros(1)])
    left, right = float(shown.real.min()), float(shown.real.max())
    half_height = 1.25 * max(float(np.max(np.abs(shown.imag))), 0.2 * (right - left), 0.05 * size)
    centre = (left + right) / 2
    told, far = [], []
    if right - left < THIN * half_height:
        # to scale, all of it would be one dot on the axis
        width = 1.7 * max(right - left, 1e-9 * size)
        told.append("scales differ: the poles are lightly damped")
    else:
        width = max(1.4 * (right - left), 0.3 * size, ASPECT * 2 * half_height)
        half_height = width / ASPECT / 2
        ax.set_aspect("equal", adjustable="box")
    ax.set_xlim(centre - width / 2, centre + width / 2)
    ax.set_ylim(-half_height, half_height)
    for kind, region in regions:
        for root, cov in zip(region.roots, region.cov, strict=True):
            if abs(root) >= FAR_ROOT * size and root.imag >= 0:
                _point_outside(ax, root)
                far.append(f"{kind}: {_far(root, float(cov[0, 0]))}")
    return [*told, *(["outside the frame [1/s]"] if far else []), *far]


def _point_outside(ax: Axes, root: complex) -> None:
    """An arrow head at the edge of the frame where a root lies beyond it."""
    (left, right), top = ax.get_xlim(), ax.get_ylim()[1]
    half = max(right, -left)
    scale = max(abs(root.real) / half, abs(root.imag) / top)
    x = min(max(root.real / scale, left), right)
    sideways = abs(root.real) / half >= abs(root.imag) / top
    marker = (">" if root.real > 0 else "<") if sideways else "^"
    ax.plot(
        x, root.imag / scale, marker, color=BLACK, markersize=8, clip_on=False, zorder=3,
        markerfacecolor="white",
    )  # fmt: skip


def _far(root: complex, variance: float) -> str:
    """Where a root lies that is not shown, with the standard error of its real part."""
    std = float(np.sqrt(variance)) if variance > 0 else 0.0
    if not std < TOO_VAGUE * abs(root):
        return f"{root.real:.2g}, not determined"
    imaginary = f" + {root.imag:.3g}j" if root.imag else ""
    return f"{format_value(root.real, std)} ± {format_std(std)}{imaginary}"


def _edge(region: RootUncertainty, size: float) -> np.ndarray[tuple[int], np.dtype[np.complex128]]:
    """Corners of the regions of roots, as far as they do not squeeze the picture."""
    with np.errstate(invalid="ignore"):
        spread = REACH * np.sqrt(np.diagonal(region.cov, axis1=1, axis2=2))
    sound = np.all(np.isfinite(spread), axis=1) & (np.abs(region.roots) < FAR_ROOT * size)
    half = np.minimum(spread[sound], size)
    roots = region.roots[sound]
    corners = [roots + a * half[:, 0] + 1j * b * half[:, 1] for a in (-1, 1) for b in (-1, 1)]
    return np.concatenate(corners).astype(np.complex128)
