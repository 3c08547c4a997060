"""Picture of a comparison: several models over several records, each with its fit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tridentify.judgement.comparison import Comparison
from tridentify.plots import style
from tridentify.plots.fit import draw_recorded, draw_response, is_ink
from tridentify.writing.layout import IN_PICTURES, short

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def plot_compared(
    comparison: Comparison, *, axes: Sequence[Axes] | Axes | None = None
) -> style.Panels:
    """Draw every model over every record, with what was fitted to the record.

    Parameters
    ----------
    comparison : Comparison
        What `tridentify.compare` gives.
    axes : sequence of matplotlib Axes, optional
        One per output and record, records in the inner loop; those without a measured output are
        left out. A figure is made when left out.

    Returns
    -------
    Panels
        The axes.

    Raises
    ------
    SampleTypeError
        It is no comparison.
    OptionError
        There are not as many axes.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Record, TransferFunction, compare
    >>> record = Record(np.ones(5), 3.0 - np.exp(-np.arange(5.0)), dt=1.0)
    >>> (ax,) = plot_compared(compare(TransferFunction([1.0], [1.0, 1.0]), record))
    >>> [line.get_label() for line in ax.lines]
    ['recorded', 'model: 100.0 %']
    """
    style.checked(comparison, Comparison, "compare([one, other], record).plot()")
    panels = [
        (i, r, y)
        for i, output in enumerate(comparison.output_names)
        for r in range(len(comparison.records))
        if (y := comparison.measured(r, output)) is not None
    ]
    drawn = style.make_axes(axes, [2.1 + 0.22 * _legend_rows(comparison)] * len(panels))
    for ax, (i, r, y) in zip(drawn, panels, strict=True):
        record, output = comparison.records[r], comparison.output_names[i]
        courses = [row[r][:, i] for row in comparison.responses]
        inked = is_ink(record.t, courses)
        draw_recorded(ax, record.t, y, inked)
        for k, (name, response) in enumerate(zip(comparison.names, courses, strict=True)):
            fit = float(comparison.fits[k, r, i])
            label = f"{short(name, IN_PICTURES)}: " + (f"{fit:.1f} %" if np.isfinite(fit) else "-")
            how = (style.cycle_colour(k), style.DASHES[k % len(style.DASHES)], label)
            draw_response(ax, record.t, response, how, inked)
        several = len(comparison.records) > 1 or record.name
        title = style.literal(short(comparison.record_names[r], IN_PICTURES)) if several else ""
        style.dress(ax, title=title, ylabel=style.labelled(output, comparison.units))
        style.legend(ax, columns=style.legend_columns(ax))
    drawn[-1].set_xlabel("time [s]", fontsize=9)
    return drawn


def _legend_rows(comparison: Comparison) -> int:
    """Lines that the legend takes beyond the first, roughly."""
    labels = [f"{short(name, IN_PICTURES)}: 100.0 %" for name in comparison.names]
    return -(-(1 + len(labels)) // style.columns_for(labels)) - 1
