"""Picture of the Hankel singular values of the parallel model, above what noise alone gives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tridentify.errors import UnsupportedError
from tridentify.judgement.selection import Hankel, Selection
from tridentify.plots.style import BLUE, GREY, ORANGE, Panels, checked, dress, make_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
