"""Picture of poles and zeros with their confidence ellipses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.parameter import checked_level
from tridentify.judgement.comparison.entries import Models
from tridentify.numerics.root_draws import stacked_roots
from tridentify.plots.lines import Line, lines_of
from tridentify.plots.style import BLACK, CYCLE, WIDTH, Panels, dress, literal, make_axes
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


def plot_pole_zero(
    models: Models,
    *,
    names: Sequence[str] | None = None,
    level: float = 0.95,
    axes: Sequence[Axes] | Axes | None = None,
) -> Panels:
    """Draw poles (crosses) and zeros (circles) with confidence ellipses from the delta method.

    Parameters
    ----------
    models : Estimate, TransferFunction, sequence of these, or mapping of names to them
        A transfer function has no ellipses.
    names : sequence of str, optional
        One a model, for the legend; by default the keys of a mapping, the orders where they differ,
        else the methods.
    level : float
        Probability that an ellipse holds; a real root has an interval on the real axis. Of a
        posterior mean, the poles of its draws stand in place of ellipses.
    axes : matplotlib Axes, optional
        A figure is made when left out.

    Returns
    -------
    Panels
        The axes.

    Raises
    ------
    SampleTypeError
        Something is no model.
    OptionError
        The level is no probability, or there is more than one of the axes.
    """
    lines = lines_of(models, names, "plot_pole_zero(estimate) or plot_pole_zero([one, other])")
    checked_level(level)
    drawn = make_axes(axes, [WIDTH / 1.6])
    ax = drawn[0]
    regions = [region for line in lines for region in _regions(line)]
    poles_of_all = [one.region.roots for one in regions if one.marker == "x"]
    size = max(float(np.max(np.abs(roots), initial=0.0)) for roots in poles_of_all) or 1.0
    for one in regions:
        near = np.abs(one.region.roots) < FAR_ROOT * size
        kept = one.region
        if one.marker == "o":
            kept = RootUncertainty(one.region.roots[near], one.region.cov[near])
        _draw(ax, kept, one, level)
        if one.marker == "x":
            _draw_cloud(ax, one)
    outside = _frame(ax, [(one.kind, one.region) for one in regions], size)
    ax.axhline(0.0, color="black", linewidth=0.6)
    ax.axvline(0.0, color="black", linewidth=0.6)
    ax.axvspan(0.0, ax.get_xlim()[1], color="#f3f3f3", zorder=0)
    label = "\n".join(["real part [1/s]", *outside])
    dress(ax, xlabel=label, ylabel="imaginary part [rad/s]")
    ax.ticklabel_format(axis="both", style="sci", scilimits=(-3, 4), useOffset=False)
    above = _legend(ax, _title(lines, level))
    if axes is None and (above or outside):
        _heighten(ax, WIDTH / 1.6 + 0.55 + 0.23 * above + 0.17 * len(outside))
    return drawn


@dataclass(frozen=True, eq=False)
class _Roots:
    """Poles or zeros of one channel of one model, and how they are drawn."""

    line: Line
    channel: tuple[int, int]
    region: RootUncertainty
    marker: str
    colour: str
    label: str
    kind: str


def _regions(line: Line) -> list[_Roots]:
    """Poles of every denominator and zeros of every channel.

    The channels of one model have their colours; of several models each has one, and its name
    stands at its poles.
    """
    alone = line.together == 1
    shared = line.model.common_denominator is not None
    front = "" if alone else f"{line.label}: "
    found = []
    for k, (i, j) in enumerate(product(range(line.model.n_outputs), range(line.model.n_inputs))):
        pair = line.output_names[i], line.input_names[j]
        name = " / ".join(short(one, LONGEST_CHANNEL) for one in pair)
        colour = CYCLE[k % len(CYCLE)] if alone else line.colour
        if not shared or k == 0:
            dark = BLACK if shared and alone else colour
            label = "poles" if shared else f"poles of {name}"
            label = label if alone else line.label if k == 0 else ""
            region = _region(line, i, j, poles)
            found.append(_Roots(line, (i, j), region, "x", dark, literal(label), f"{front}pole"))
        label = literal(f"zeros of {name}") if alone else ""
        region = _region(line, i, j, zeros)
        kind = literal(f"{front}zero of {name}")
        found.append(_Roots(line, (i, j), region, "o", colour, label, kind))
    return found


def _region(
    line: Line, output: int, input_: int, which: Callable[[Estimate, int, int], RootUncertainty]
) -> RootUncertainty:
    if line.estimate is not None:
        return which(line.estimate, output, input_)
    sides = line.model.den if which is poles else line.model.num
    roots = np.roots(np.trim_zeros(sides[output][input_], "f")).astype(np.complex128)
    return RootUncertainty(roots, np.zeros((roots.size, 2, 2)))


def _title(lines: Sequence[Line], level: float) -> str:
    told = [] if len(lines) == 1 else ["x poles, o zeros"]
    if any(len(line.draws) for line in lines):
        told.append("dots: as likely")
    elif any(line.estimate is not None for line in lines):
        told.append(f"with {100 * level:.3g} % regions")
    return ", ".join(told)


def _heighten(ax: Axes, height: float) -> None:
    """Make the figure high enough for what stands above and below the axes [inch]."""
    from matplotlib.figure import Figure

    if isinstance(ax.figure, Figure):
        ax.figure.set_size_inches(WIDTH, height)


def _legend(ax: Axes, title: str) -> int:
    """In a corner that is empty while it is small, else above the axes; lines it takes there."""
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
        loc="best" if small else "lower right",
        bbox_to_anchor=None if small else (1.0, 1.04),
        borderaxespad=0.2,
        ncols=columns,
        columnspacing=1.4,
    )
    return 0 if small else 1 + -(-len(labels) // columns)


def _draw(ax: Axes, region: RootUncertainty, how: _Roots, level: float) -> None:
    """Roots, and their regions where they are known and no draws stand for them."""
    if region.roots.size == 0:
        return
    # what lies beneath the roots of another model is seen around them
    size = 7 + 2.5 * min(how.line.together - 1 - how.line.number, 3)
    look: dict[str, Any] = {"markersize": size, "markerfacecolor": "none", "markeredgewidth": 1.6}
    label = how.label or "_nolegend_"
    roots = region.roots
    ax.plot(roots.real, roots.imag, how.marker, color=how.colour, label=label, **look)
    if how.line.estimate is None or (how.marker == "x" and len(how.line.draws)):
        return
    for k in range(region.roots.size):
        curve = region.ellipse(k, level)
        if np.all(np.isfinite(curve)):
            ax.fill(curve[:, 0], curve[:, 1], facecolor=how.colour, alpha=0.2, linewidth=0)
            ax.plot(curve[:, 0], curve[:, 1], color=how.colour, linewidth=1.2)


def _draw_cloud(ax: Axes, how: _Roots) -> None:
    """Draw the poles of the draws of a posterior mean, as many as can be told apart."""
    estimate = how.line.estimate
    if estimate is None or not len(estimate.draws):
        return
    chosen = np.asarray(estimate.draws)[:: max(len(estimate.draws) // DOTS, 1)]
    roots = stacked_roots(estimate.channel_draws(chosen, *how.channel)[1]).ravel()
    look: dict[str, Any] = {
        "markersize": 2.5,
        "alpha": 0.35,
        "markeredgewidth": 0,
        "color": how.colour,
    }
    ax.plot(roots.real, roots.imag, ".", zorder=1, **look)


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
