"""Picture of several models side by side: their numbers with 95 % intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from tridentify.errors import OptionError, shown
from tridentify.estimation.answer.parameter import Parameter
from tridentify.judgement.comparison.entries import Models
from tridentify.judgement.comparison.quantities import Quantity, quantities
from tridentify.numerics.arrays import Array
from tridentify.plots import style
from tridentify.plots.bode import default_frequencies, draw_magnitudes
from tridentify.plots.lines import Line, lines_of, named_first
from tridentify.plots.over_time import wrapped

if TYPE_CHECKING:
    from matplotlib.axes import Axes


MARKERS = "osD^vP*X"
MAGNITUDE = 1.9
"""Height of a frequency response below the numbers [inch]."""
NARROW = 54
"""Characters of the legend beside each other: the names of the numbers take a part of the width."""
LEVEL = 0.95
"""Of the intervals and bands."""
FAR_END = 3.0
"""Intervals that reach further than so many times the typical one are cut."""


def plot_comparison(
    models: Models,
    names: Sequence[str] | None = None,
    *,
    truth: Mapping[str, float] | None = None,
    axes: Sequence[Axes] | Axes | None = None,
) -> style.Panels:
    """Draw what several models say, each number with its 95 % interval, relative to one value.

    Models of the same orders are compared coefficient by coefficient. The coefficients of models of
    different orders have nothing to do with each other: then natural frequencies, dampings, real
    poles and static gains stand there, those of one mode beside each other, and below them the
    magnitudes of the frequency responses.

    Parameters
    ----------
    models : Estimate, TransferFunction, sequence of these, or mapping of names to them
        Of the same system; a number that only some of them have is drawn of those.
    names : sequence of str, optional
        One a model, for the legend; by default the keys of a mapping, the orders where they differ,
        else the methods.
    truth : mapping of str to float, optional
        What is known of the numbers, by name. Differences count from it where it is given, else
        from the first model that has the number.
    axes : sequence of matplotlib Axes, or one, optional
        One for the numbers, and across orders one more per channel. A figure is made when left out.

    Returns
    -------
    Panels
        The axes.

    Raises
    ------
    SampleTypeError, ChannelNameError
        Something is no model, or their channels differ.
    OptionError
        There is no model, the names are not as many, or a truth is of no number that is shown.

    Notes
    -----
    The scale is relative: 10 % is a tenth of the value that stands beside the name. Where that
    value is smaller than its standard error, as of a coefficient that is zero, 100 % is the
    standard error, and the name says so. Intervals that would squeeze all others are cut at the
    frame, which an arrow marks.
    """
    lines = lines_of(models, names, "plot_comparison([one, other])")
    labels = [line.entry.name for line in lines]
    across = _across_orders(lines)
    if across:
        found = quantities([line.entry for line in lines])
        rows, columns = [row.name for row in found], _columns(found, len(lines))
    else:
        columns = [line.estimate.parameters for line in lines if line.estimate is not None]
        rows = list(dict.fromkeys(name for column in columns for name in column))
    strangers = [name for name in truth or {} if name not in rows]
    if strangers:
        raise OptionError(
            f"found a truth for {shown(strangers[0])}; expected names of the "
            f"{'poles and gains' if across else 'coefficients'} "
            f"({', '.join(rows[:6])}{', ...' if len(rows) > 6 else ''}); correct the name"
        )
    origins = [_origin(name, columns, truth or {}) for name in rows]
    texts = [_row(name, *origin) for name, origin in zip(rows, origins, strict=True)]
    tall = max(text.count("\n") + 1 for text in texts)
    height = 0.9 + len(rows) * max(0.18 + 0.16 * tall, 0.16 * len(lines) + 0.1)
    named = named_first(lines)
    channels = list(product(range(len(named.output_names)), range(len(named.input_names))))
    drawn = style.make_axes(axes, [height, *([MAGNITUDE] * len(channels) if across else [])])
    centre, half = _relative(columns, rows, origins)
    _draw_numbers(drawn[0], labels, centre, half, texts)
    start = "the truth" if truth else "the first"
    drawn[0].set_xlabel(f"difference from {start}, relative [%], with 95 % intervals", fontsize=9)
    if across:
        grid = default_frequencies(*lines)
        for ax, place in zip(drawn[1:], channels, strict=True):
            draw_magnitudes(ax, lines, grid, place, LEVEL)
        drawn[-1].set_xlabel("angular frequency [rad/s]", fontsize=9)
    return drawn


def _across_orders(lines: Sequence[Line]) -> bool:
    """Whether coefficients of one name are something else in some models."""
    orders = {
        tuple((den.size, num.size) for nums, dens in zip(m.num, m.den, strict=True)
              for num, den in zip(nums, dens, strict=True))
        for m in (line.model for line in lines)
    }  # fmt: skip
    return len(orders) > 1 or any(line.estimate is None for line in lines)


def _columns(found: Sequence[Quantity], count: int) -> list[Mapping[str, Parameter]]:
    """Poles and gains of every model, by the names that they share."""
    return [
        {row.name: value for row in found if (value := row.values[k]) is not None}
        for k in range(count)
    ]


def _draw_numbers(
    ax: Axes, labels: Sequence[str], centre: Array, half: Array, texts: Sequence[str]
) -> None:
    reach = _reach(centre, half)
    ax.set_xlim(-reach, reach)
    ax.axvline(0.0, color=style.BLACK, linewidth=0.9, linestyle="--")
    places = np.arange(len(texts), dtype=np.float64)
    for k, label in enumerate(labels):
        offset = 0.76 * ((k + 0.5) / len(labels) - 0.5)
        _draw(ax, offset + places, centre[k], half[k], k, label, reach)
    for y in range(1, len(texts)):
        ax.axhline(y - 0.5, color="#d8d8d8", linewidth=0.6)
    style.dress(ax)
    ax.set_ylim(len(texts) - 0.5, -0.5)
    ax.xaxis.get_offset_text().set_fontsize(8)
    ax.set_yticks(range(len(texts)), list(texts), fontsize=9)
    ax.tick_params(axis="y", length=0)
    ax.grid(False, axis="y")
    _legend(ax, labels)


def _origin(
    name: str, columns: Sequence[Mapping[str, Parameter]], truth: Mapping[str, float]
) -> tuple[float, float, bool]:
    """Where differences of a number count from, what is 100 %, and whether that is it."""
    holders = [column[name] for column in columns if name in column]
    value = float(truth.get(name, holders[0].value))
    spread = [p.std for p in holders if math.isfinite(p.std) and p.std > 0]
    size = spread[0] if spread else 0.0
    if name in truth and value:
        return value, abs(value), True
    if value and (name in truth or abs(value) > size):
        return value, abs(value), True
    return value, size or 1.0, False


def _relative(
    columns: Sequence[Mapping[str, Parameter]],
    rows: Sequence[str],
    origins: Sequence[tuple[float, float, bool]],
) -> tuple[Array, Array]:
    """Differences and half widths [%], shape (n_models, n_rows, ...); nan where there is none.

    The half widths are (below, above), since those of a posterior mean are not symmetric.
    """
    centre = np.full((len(columns), len(rows)), np.nan)
    half = np.full((len(columns), len(rows), 2), np.nan)
    for k, parameters in enumerate(columns):
        for r, name in enumerate(rows):
            if name not in parameters:
                continue
            origin, size, _ = origins[r]
            found = parameters[name]
            centre[k, r] = 100 * (found.value - origin) / size
            if math.isfinite(found.std) and found.std > 0:
                low, high = found.interval()
                half[k, r] = 100 * (found.value - low) / size, 100 * (high - found.value) / size
    return centre, half


def _reach(centre: Array, half: Array) -> float:
    """Half the width of the frame [%]."""
    widths = np.nanmax(half, axis=2, initial=-np.inf)
    ends = np.abs(centre) + np.where(np.isfinite(widths), widths, 0.0)
    ends = ends[np.isfinite(ends) & (ends > 0)]
    if not ends.size:
        return 1.0
    typical = float(np.quantile(ends, 0.75))
    kept = ends[ends <= FAR_END * typical]
    middle = np.abs(centre[np.isfinite(centre)])
    needed = float(np.max(middle[middle <= 2 * FAR_END * typical], initial=0.0))
    return 1.1 * max(float(kept.max()), needed)


def _draw(ax: Axes, y: Array, centre: Array, half: Array, k: int, label: str, reach: float) -> None:
    colour, marker = style.cycle_colour(k), MARKERS[k % len(MARKERS)]
    low, high = centre - half[:, 0], centre + half[:, 1]
    known = np.isfinite(low) & np.isfinite(high)
    ends = np.maximum(low[known], -2 * reach), np.minimum(high[known], 2 * reach)
    ax.hlines(y[known], *ends, color=colour, linewidth=1.8, alpha=0.8)
    ax.plot(centre, y, marker, markersize=5, color=colour, label=style.literal(label))
    for side, beyond in ((-1.0, low < -reach), (1.0, high > reach)):
        at = np.full(int(beyond.sum()), side * 0.985 * reach)
        ax.plot(at, y[beyond], "<" if side < 0 else ">", markersize=5, color=colour)


def _row(name: str, value: float, size: float, relative: bool) -> str:
    text = f"{wrapped(name, 30)}\n{value:.4g}"
    if len(name) < 8:
        text = text.replace("\n", " = ")
    return style.literal(text if relative else f"{text}\n100 % = {size:.2g}")


def _legend(ax: Axes, labels: Sequence[str]) -> None:
    """Above the axes, in as many columns as fit."""
    longest = max(len(label) for label in labels)
    columns = max(1, min(len(labels), NARROW // (longest + 6)))
    style.place_above(ax, "lower left", columns, handlelength=1.2)
