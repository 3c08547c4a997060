"""Picture of several estimates side by side: every coefficient with its 95 % interval."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from tridentify.errors import OptionError, shown
from tridentify.estimation.answer.estimate import Estimate
from tridentify.numerics.arrays import Array
from tridentify.plots.over_time import wrapped
from tridentify.plots.style import BLACK, CYCLE, dress, literal, make_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes


MARKERS = "osD^vP*X"
FAR_END = 3.0
"""Intervals that reach further than so many times the typical one are cut."""


def plot_comparison(
    estimates: Sequence[Estimate],
    names: Sequence[str] | None = None,
    *,
    truth: Mapping[str, float] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the coefficients of several estimates with their 95 % intervals, relative to one value.

    Parameters
    ----------
    estimates : sequence of Estimate
        Of the same system; a coefficient that only some of them have is drawn of those.
    names : sequence of str, optional
        One an estimate, for the legend; by default the methods' names.
    truth : mapping of str to float, optional
        What is known of the coefficients, by name. Differences count from it where it is given,
        else from the first estimate that has the coefficient.
    ax : matplotlib Axes, optional
        A figure is made when left out.

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    OptionError
        There is no estimate, the names are not as many, or a truth is no coefficient's.

    Notes
    -----
    The scale is relative: 10 % is a tenth of the value that stands beside the coefficient's name.
    Where that value is smaller than its standard error, as of a coefficient that is zero, 100 % is
    the standard error, and the name says so. Intervals that would squeeze all others are cut at
    the frame, which an arrow marks.
    """
    if not estimates:
        raise OptionError("found no estimate; expected at least one; give a sequence of estimates")
    labels = _labels(estimates, names)
    rows = list(dict.fromkeys(name for one in estimates for name in one.names))
    strangers = [name for name in truth or {} if name not in rows]
    if strangers:
        raise OptionError(
            f"found a truth for {shown(strangers[0])}; expected names of the coefficients "
            f"({', '.join(rows[:6])}{', ...' if len(rows) > 6 else ''}); correct the name"
        )
    origins = [_origin(name, estimates, truth or {}) for name in rows]
    texts = [_row(name, *origin) for name, origin in zip(rows, origins, strict=True)]
    lines = max(text.count("\n") + 1 for text in texts)
    height = 0.9 + len(rows) * max(0.18 + 0.16 * lines, 0.16 * len(estimates) + 0.1)
    drawn = make_axes(None if ax is None else [ax], [height])[0]
    centre, half = _relative(estimates, rows, origins)
    reach = _reach(centre, half)
    drawn.set_xlim(-reach, reach)
    drawn.axvline(0.0, color=BLACK, linewidth=0.9, linestyle="--")
    for k, label in enumerate(labels):
        offset = 0.76 * ((k + 0.5) / len(labels) - 0.5)
        _draw(
            drawn,
            offset + np.arange(len(rows), dtype=np.float64),
            centre[k],
            half[k],
            k,
            label,
            reach,
        )
    for y in range(1, len(rows)):
        drawn.axhline(y - 0.5, color="#d8d8d8", linewidth=0.6)
    start = "the truth" if truth else "the first"
    dress(drawn, xlabel=f"difference from {start}, relative [%], with 95 % intervals")
    drawn.set_ylim(len(rows) - 0.5, -0.5)
    drawn.xaxis.get_offset_text().set_fontsize(8)
    drawn.set_yticks(range(len(rows)), texts, fontsize=9)
    drawn.tick_params(axis="y", length=0)
    drawn.grid(False, axis="y")
    _legend(drawn, labels)
    return drawn


def _labels(estimates: Sequence[Estimate], names: Sequence[str] | None) -> list[str]:
    if names is not None:
        if len(names) != len(estimates):
            raise OptionError(
                f"found {len(names)} names for {len(estimates)} estimates; expected one each; "
                "give as many"
            )
        return [str(name) for name in names]
    methods = [one.method for one in estimates]
    return [
        f"{method} {methods[: k + 1].count(method)}" if methods.count(method) > 1 else method
        for k, method in enumerate(methods)
    ]


def _origin(
    name: str, estimates: Sequence[Estimate], truth: Mapping[str, float]
) -> tuple[float, float, bool]:
    """Where differences of a coefficient count from, what is 100 %, and whether that is it."""
    holders = [one.parameters[name] for one in estimates if name in one.names]
    value = float(truth.get(name, holders[0].value))
    spread = [p.std for p in holders if math.isfinite(p.std) and p.std > 0]
    size = spread[0] if spread else 0.0
    if name in truth and value:
        return value, abs(value), True
    if value and (name in truth or abs(value) > size):
        return value, abs(value), True
    return value, size or 1.0, False


def _relative(
    estimates: Sequence[Estimate], rows: Sequence[str], origins: Sequence[tuple[float, float, bool]]
) -> tuple[Array, Array]:
    """Differences and half widths [%], shape (n_estimates, n_rows, ...); nan where there is none.

    The half widths are (below, above), since those of a posterior mean are not symmetric.
    """
    centre = np.full((len(estimates), len(rows)), np.nan)
    half = np.full((len(estimates), len(rows), 2), np.nan)
    for k, one in enumerate(estimates):
        parameters = one.parameters
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
    colour, marker = CYCLE[k % len(CYCLE)], MARKERS[(k + k // len(CYCLE)) % len(MARKERS)]
    low, high = centre - half[:, 0], centre + half[:, 1]
    known = np.isfinite(low) & np.isfinite(high)
    ax.hlines(
        y[known],
        np.maximum(low[known], -2 * reach),
        np.minimum(high[known], 2 * reach),
        color=colour,
        linewidth=1.8,
        alpha=0.8,
    )
    ax.plot(
        centre, y, linestyle="none", marker=marker, markersize=5, color=colour, label=literal(label)
    )
    for side, beyond in ((-1.0, low < -reach), (1.0, high > reach)):
        ax.plot(
            np.full(int(beyond.sum()), side * 0.985 * reach),
            y[beyond],
            linestyle="none",
            marker="<" if side < 0 else ">",
            markersize=5,
            color=colour,
        )


def _row(name: str, value: float, size: float, relative: bool) -> str:
    text = f"{wrapped(name, 30)}\n{value:.4g}"
    if len(name) < 8:
        text = text.replace("\n", " = ")
    return literal(text if relative else f"{text}\n100 % = {size:.2g}")


def _legend(ax: Axes, labels: Sequence[str]) -> None:
    """Above the axes, in as many columns as fit."""
    longest = max(len(label) for label in labels)
    columns = max(1, min(len(labels), 66 // (longest + 6)))
    ax.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=columns,
        fontsize=9,
        frameon=False,
        borderaxespad=0.1,
        handlelength=1.2,
        columnspacing=1.2,
    )
