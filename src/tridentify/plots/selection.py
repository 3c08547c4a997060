"""Picture of an order selection: criteria, fit and certainty of every candidate, side by side.

Picture of the Hankel singular values of the parallel model, above what noise alone gives.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tridentify.errors import UnsupportedError
from tridentify.judgement.selection import Hankel, Selection, SelectionRow
from tridentify.numerics.arrays import Array
from tridentify.plots import style
from tridentify.plots.style import BLUE, GREY, ORANGE, Panels, checked, dress, make_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CRITERIA = (
    ("aic", "AIC", style.AMBER, "^"),
    ("aicc", "AICc", style.BLUE, "o"),
    ("bic", "BIC", style.PURPLE, "s"),
)
LINEAR = 10.0
"""Differences of criteria are drawn to scale up to here, beyond it by their logarithm."""
CROWDED = 8
"""Labels, or letters of one, beyond which they are turned."""


def plot_selection(selection: Selection, *, axes: Sequence[Axes] | None = None) -> style.Panels:
    """Draw what the candidates of a selection have to say for themselves.

    Parameters
    ----------
    selection : Selection
    axes : sequence of matplotlib Axes, optional
        Three: AIC, AICc and BIC above the lowest of each; fit [percent] on the samples that were
        fitted and on those that were not; largest standard error over its coefficient [percent].
        A figure is made when left out.

    Returns
    -------
    Panels
        The axes.

    Notes
    -----
    The recommended candidate has a shaded column. Filled marks are usable estimates, hollow ones
    are not; a candidate that failed has a cross at the foot. Of several outputs the worst fit
    counts.
    """
    style.checked(selection, Selection, "plot_selection(select_structure(record))")
    drawn = style.make_axes(axes, [2.4, 1.5, 1.5], sharex=True)
    rows = selection.rows
    places = np.arange(len(rows), dtype=np.float64)
    for ax in drawn:
        _mark_recommended(ax, selection)
    _draw_criteria(drawn[0], rows, places)
    _draw_fits(drawn[1], rows, places)
    _draw_errors(drawn[2], rows, places)
    labels = [style.literal(row.label) for row in rows]
    turned = len(rows) > CROWDED or max(map(len, labels), default=0) > CROWDED
    for ax in drawn:
        ax.set_xlim(-0.6, len(rows) - 0.4)
        ax.set_xticks(places, labels, rotation=90 if turned else 0, fontsize=9)
    for ax in drawn[:-1] if axes is None else ():
        ax.tick_params(labelbottom=False)
    told = "" if selection.recommended is None else " (shaded: the recommended one)"
    drawn[-1].set_xlabel(f"poles, zeros{told}", fontsize=9)
    return drawn


def _mark_recommended(ax: Axes, selection: Selection) -> None:
    for k, row in enumerate(selection.rows):
        if row is selection.recommended:
            ax.axvspan(k - 0.5, k + 0.5, color=style.GREEN, alpha=0.16, linewidth=0)


def _draw_criteria(ax: Axes, rows: Sequence[SelectionRow], places: Array) -> None:
    highest = 1.0
    for number, (field, name, colour, marker) in enumerate(CRITERIA):
        values = np.array([getattr(row, field) for row in rows], dtype=np.float64)
        if not np.any(np.isfinite(values)):
            continue
        values = values - np.nanmin(values)
        highest = max(highest, float(np.nanmax(values)))
        # side by side, so that equal values do not hide one another
        moved = places + 0.22 * (number - 1)
        _marks(ax, rows, moved, values, colour, marker, name)
    if highest > 5.0 * LINEAR:
        ax.set_yscale("symlog", linthresh=LINEAR, linscale=1.5)
        decades = [10.0**k for k in range(1, math.ceil(math.log10(highest)) + 1)]
        ax.set_yticks([0.0, 5.0, *decades], ["0", "5", *(f"{d:,.0f}" for d in decades)])
        ax.minorticks_off()
        ax.axhline(LINEAR, color=style.GREY, linewidth=0.7, linestyle=":")
    ax.set_ylim(bottom=-0.12 * (LINEAR if highest > 5.0 * LINEAR else highest))
    failed = [k for k, row in enumerate(rows) if row.estimate is None]
    if failed:
        foot, level = np.full(len(failed), 0.04), ax.get_xaxis_transform()
        how: dict[str, Any] = {"color": style.GREY, "markersize": 6, "label": "failed"}
        ax.plot(places[failed], foot, "x", transform=level, **how)
    style.dress(ax, title="above the lowest", ylabel="criterion [-]")
    style.legend(ax, columns=4)


def _draw_fits(ax: Axes, rows: Sequence[SelectionRow], places: Array) -> None:
    fitted = np.array([_least(row.fit) for row in rows])
    unseen = np.array([_least(row.cross_fit) for row in rows])
    _marks(ax, rows, places - 0.12, fitted, style.BLUE, "o", "fitted")
    _marks(ax, rows, places + 0.12, unseen, style.ORANGE, "D", "held out")
    every = np.concatenate([fitted, unseen])
    every = every[np.isfinite(every)]
    if every.size:
        high = float(every.max())
        # a hopeless candidate must not press all others into one line
        low = max(float(every.min()), min(0.0, high))
        margin = 0.08 * max(high - low, 0.5)
        ax.set_ylim(low - margin, high + margin)
    style.dress(ax, title="fit", ylabel="fit [%]")
    style.legend(ax)


def _draw_errors(ax: Axes, rows: Sequence[SelectionRow], places: Array) -> None:
    values = np.array([100.0 * row.relative_std for row in rows])
    seen = np.isfinite(values) & (values > 0)
    shown = np.where(seen, np.minimum(values, 1e5), np.nan)
    if seen.any():
        ax.set_yscale("log")
        low, high = float(np.nanmin(shown)), float(np.nanmax(shown))
        ax.set_ylim(min(0.5 * low, 5.0), max(2.0 * high, 200.0))
        ax.minorticks_off()
    ax.axhline(100.0, color=style.ORANGE, linewidth=0.9, linestyle="--", label="as large as itself")
    _marks(ax, rows, places, shown, style.BLUE, "o", "")
    style.dress(ax, title="least certain coefficient", ylabel="std error\nover value [%]")
    style.legend(ax)


def _marks(
    ax: Axes,
    rows: Sequence[SelectionRow],
    places: Array,
    values: Array,
    colour: str,
    marker: str,
    label: str,
) -> None:
    """Filled marks for usable estimates, hollow ones for the others."""
    usable = np.array([row.ok for row in rows], dtype=bool)
    for which, face in ((usable, colour), (~usable, "white")):
        own = np.where(which, values, np.nan)
        if not np.any(np.isfinite(own)):
            continue
        how: dict[str, Any] = {"markersize": 5, "markerfacecolor": face, "markeredgecolor": colour}
        ax.plot(places, own, marker, markeredgewidth=1.0, label=label or None, **how)
        label = ""


def _least(values: Array) -> float:
    seen = values[np.isfinite(values)]
    return float(seen.min()) if seen.size else math.nan


DECADES_BELOW = 4.0
"""Values farther than this below the floor are drawn at the foot: they are rounding."""


def plot_hankel(
    selection: Selection | Hankel, *, axes: Sequence[Axes] | Axes | None = None
) -> Panels:
    """Draw Hankel singular values on a logarithmic scale with the noise's floor.

    Parameters
    ----------
    selection : Selection or Hankel
    axes : matplotlib Axes, optional
        A figure is made when left out.

    Returns
    -------
    Panels
        The axes.

    Raises
    ------
    UnsupportedError
        The selection has no parallel model.
    SampleTypeError
        It is no selection.

    Notes
    -----
    What rises above the shaded floor is more than noise (`selection.hankel`), so the number of
    filled marks is a lower bound of the number of poles. The line shows what noise alone gives
    value by value.
    """
    if not isinstance(selection, Hankel):
        selection = checked(selection, Selection, "plot_hankel(select_structure(record))")
    hankel = selection.hankel if isinstance(selection, Selection) else selection
    if hankel is None:
        raise UnsupportedError(
            "found a selection without a parallel model; expected one to draw; select from other "
            "candidates or a longer record"
        )
    drawn = make_axes(axes, [2.6])
    ax = drawn[0]
    numbers = np.arange(1, hankel.values.size + 1)
    largest = max(float(hankel.values.max()), hankel.floor)
    foot = (hankel.floor if hankel.floor > 0 else largest * 1e-12) / 10.0**DECADES_BELOW
    values = np.maximum(hankel.values, foot)
    above = hankel.values > hankel.floor
    ax.set_yscale("log")
    low = min(float(values.min()), 0.3 * hankel.floor if hankel.floor > 0 else largest)
    ax.set_ylim(0.5 * low, 10.0 * largest)
    if hankel.floor > 0:
        ax.axhspan(0.5 * low, hankel.floor, color=ORANGE, alpha=0.16, linewidth=0)
        ax.axhline(hankel.floor, color=ORANGE, linewidth=1.0, label="noise floor (95 %)")
        alone = np.where(hankel.noise > 0.5 * low, hankel.noise, np.nan)
        ax.plot(numbers, alone, color=GREY, linewidth=1.0, linestyle=":", label="noise alone")
    for which, face, label in (
        (above, BLUE, "more than noise"),
        (~above, "white", "not told from noise"),
    ):
        if which.any():
            ax.vlines(numbers[which], 0.5 * low, values[which], color=BLUE, linewidth=1.0)
            how: dict[str, Any] = {
                "markersize": 5.5,
                "markerfacecolor": face,
                "markeredgecolor": BLUE,
            }
            ax.plot(numbers[which], values[which], "o", label=label, **how)
    every = max(1, numbers.size // 12)
    ax.set_xticks(numbers[::every])
    ax.set_xlim(0.4, numbers.size + 0.6)
    ax.minorticks_off()
    count = hankel.order
    several = "value" if count == 1 else "values"
    ylabel = "Hankel singular value,\ninput over noise [-]"
    dress(ax, xlabel=f"number\nparallel model: {hankel.operators}", ylabel=ylabel)
    dress(ax, title=f"{count} {several} above the noise")
    # the values fall from the left, so the upper right is free
    ax.legend(fontsize=8, loc="upper right", framealpha=0.9, edgecolor="none")
    return drawn
