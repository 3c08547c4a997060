"""A figure of axes whose places are reckoned once, from what stands around them.

To solve for the places, as matplotlib's constrained layout does, costs more than the drawing: every
text is measured several times. Here the axes keep the heights they are given, and the figure grows
by what titles, legends and labels take.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tridentify.plots.style import WIDTH

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.backends.backend_agg import RendererAgg
    from matplotlib.figure import Figure

EDGE = 0.08
"""Free of ink around the figure and between what stands beside each other [inch]."""
LINE = 0.165
"""Height of a line of a label [inch]."""
TICKS = 0.22
"""Height of the labels below an axis [inch]."""
DIGIT = 0.0795
"""Width of a digit of a label at an axis [inch]."""
APART = 0.17
"""Marks of the scale, and what separates their labels from them and from what is beside [inch]."""
LEFT, RIGHT, ABOVE, BELOW = 0.75, 0.14, 0.3, 0.42
"""Around axes before anything is drawn: labels and legends are wrapped to what is left [inch]."""


class Sheet:
    """Axes in rows and columns, each row of one height.

    Parameters
    ----------
    heights : sequence of float
        Of the axes' boxes, row by row [inch].
    columns : int
    share : bool
        The axes of a column have one horizontal scale, labelled at the foot.
    """

    def __init__(self, heights: Sequence[float], columns: int = 1, *, share: bool = True) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        self.heights = tuple(heights)
        around = [(LEFT + RIGHT, BELOW + ABOVE) for _ in range(max(columns, 1))]
        size = WIDTH * columns, sum(heights) + len(heights) * around[0][1]
        self.figure: Figure = Figure(figsize=size)
        self._canvas = FigureCanvasAgg(self.figure)
        self.grid: Any = self.figure.subplots(
            len(heights), columns, squeeze=False, sharex="col" if share else False
        )
        rows = len(heights)
        self._place([LEFT] * columns, [ABOVE] * rows, [BELOW] * rows)

    @property
    def axes(self) -> list[Axes]:
        """Row by row."""
        return list(self.grid.ravel())

    def settle(self) -> Figure:
        """Give everything its place; call it once, when all is drawn."""
        for ax in self.axes:
            if not ax.has_data() and not ax.get_title(loc="left") and not ax.texts:
                ax.set_axis_off()
        left = [max(_beside(ax) for ax in column) for column in self.grid.T]
        renderer: RendererAgg = self._canvas.get_renderer()  # type: ignore[no-untyped-call]
        above = [max(_above(ax, renderer) for ax in row) for row in self.grid]
        below = [max(_below(ax) for ax in row) for row in self.grid]
        self._place(left, above, below)
        for ax in self.axes:
            box = ax.get_position()
            width = box.width * self.figure.get_figwidth()
            ax.yaxis.set_label_coords(-_ticks_beside(ax) / width, 0.5)
        return self.figure

    def _place(self, left: Sequence[float], above: Sequence[float], below: Sequence[float]) -> None:
        columns = self.grid.shape[1]
        height = sum(self.heights) + sum(above) + sum(below)
        self.figure.set_size_inches(WIDTH * columns, height)
        top = height
        for i, row in enumerate(self.grid):
            top -= above[i] + self.heights[i]
            for j, ax in enumerate(row):
                start, width = j * WIDTH + left[j], WIDTH - left[j] - RIGHT
                across = WIDTH * columns
                ax.set_position(
                    (start / across, top / height, width / across, self.heights[i] / height)
                )
            top -= below[i]


def _labels(axis: Axis) -> list[str]:
    """The labels that are seen."""
    low, high = sorted(axis.get_view_interval())
    shown = zip(axis.get_majorticklocs(), axis.get_majorticklabels(), strict=False)
    return [text.get_text() for at, text in shown if low <= at <= high]


def _length(label: str) -> float:
    """Of a label [digits]; a power of ten is written as mathematics, a minus is wide."""
    if "$" in label:
        return 2.6 + 0.7 * sum(c.isdigit() for c in label.split("^")[-1])
    return len(label) + 0.35 * label.count("\N{MINUS SIGN}") - 0.5 * label.count(".")


def _ticks_beside(ax: Axes) -> float:
    """Width of tick labels and what separates them from the axis and from the label [inch]."""
    return APART + DIGIT * max((_length(label) for label in _labels(ax.yaxis)), default=0.0)


def _beside(ax: Axes) -> float:
    """Room at the left of axes [inch]."""
    if not ax.axison:
        return EDGE
    label = ax.get_ylabel()
    return EDGE + _ticks_beside(ax) + LINE * (label.count("\n") + 1 if label else 0)


def _below(ax: Axes) -> float:
    """Room below axes [inch]."""
    if not ax.axison:
        return EDGE
    label = ax.get_xlabel()
    ticks = ax.xaxis.get_tick_params().get("labelbottom", True)
    turned = any(text.get_rotation() for text in ax.get_xticklabels()) if ticks else False
    size = TICKS
    if turned:
        size = 0.1 + DIGIT * max(map(_length, _labels(ax.xaxis)), default=0.0)
    return EDGE + size * bool(ticks) + LINE * (label.count("\n") + 1 if label else 0)


def _above(ax: Axes, renderer: RendererAgg) -> float:
    """Room above axes [inch]: a legend there, a title, the factor of the scale."""
    from matplotlib.text import Text

    title, legend = ax.get_title(loc="left"), ax.get_legend()
    over = [
        child
        for child in ax.get_children()
        if child is legend or (title and isinstance(child, Text) and child.get_text() == title)
    ]
    top = ax.get_window_extent().y1
    high = [child.get_window_extent(renderer).y1 - top for child in over]
    found = max([0.5 * LINE, *(each / ax.figure.dpi for each in high)])
    if any(np.abs(v) >= 1e4 or 0 < np.abs(v) < 1e-3 for v in ax.get_ylim()):
        found += LINE
    return float(EDGE + found)
