"""What the pictures have in common: colours, axes, labels, and long series made short."""

from __future__ import annotations

import io
import itertools
import os
import textwrap
import threading
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from tridentify.errors import OptionError, SampleTypeError, shown
from tridentify.estimation.answer.estimate import Estimate
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record
from tridentify.transfer_function import TransferFunction
from tridentify.writing.layout import IN_PICTURES, short, unit_ratio
from tridentify.writing.views import are_unseen

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


Kind = TypeVar("Kind")
Corner = Literal["lower left", "lower right"]

# Okabe and Ito's palette: told apart with every common kind of colour vision.
BLUE, ORANGE, GREEN, PURPLE = "#0072B2", "#D55E00", "#009E73", "#CC79A7"
SKY, AMBER, BLACK, GREY = "#56B4E9", "#E69F00", "#000000", "#767676"
CYCLE = (BLUE, ORANGE, GREEN, PURPLE, SKY, AMBER, BLACK)
DASHES = ("-", "--", "-.", ":")
"""Kinds of line, one model after the other: two that lie on each other are both seen."""

WIDTH = 5.6
"""Of a figure [inch]: narrow enough for its text to stay readable on a telephone."""
PER_INCH = 11.0
"""Characters of a title or a legend beside each other."""
ALONGSIDE = 16.0
"""Characters of a label at the side in each inch of it."""
LEGEND = 64
"""Characters, handles included, that stand beside each other above axes of the usual width."""
HANDLE = 7
"""Characters that a legend's line and the space around it take."""
MAX_POINTS = 4000
"""Longer series are drawn as the envelope of their stretches."""


def cycle_colour(number: int) -> str:
    """Colour of one of several models; from the eighth on they come again."""
    return CYCLE[number % len(CYCLE)]


class Panels(list["Axes"]):
    """The axes of one picture, in the order in which its function names them.

    A notebook shows the figure once, and not a list; elsewhere this is the list.

    Examples
    --------
    >>> from tridentify import TransferFunction
    >>> from tridentify.plots import plot_bode
    >>> picture = plot_bode(TransferFunction([1.0], [1.0, 1.0]))
    >>> len(picture), picture.figure is picture[0].figure
    (2, True)
    """

    @property
    def figure(self) -> Figure:
        """The matplotlib figure that holds the axes."""
        # axes may stand in a subfigure, whose canvas is that of the whole
        return self[0].figure.canvas.figure

    def savefig(self, path: str | os.PathLike[str], **options: Any) -> None:
        """Write the figure to a file, as `matplotlib.figure.Figure.savefig`."""
        self.figure.savefig(path, **options)

    def _ipython_display_(self) -> None:
        """Show the figure, unless pyplot is about to."""
        import matplotlib.pyplot as plt
        from IPython.display import Image, display
        from matplotlib import get_backend

        number = getattr(self.figure, "number", None)
        seen = number is not None and plt.fignum_exists(number)
        if seen and get_backend().lower() not in FILES_ONLY:
            return
        buffer = io.BytesIO()
        self.figure.savefig(buffer, format="png")
        display(Image(buffer.getvalue()))
        if seen:
            plt.close(self.figure)


FILES_ONLY = ("agg", "cairo", "pdf", "pgf", "ps", "svg", "template")
"""Back ends of matplotlib that have no window and show nothing in a notebook."""


def new_figure(width: float, height: float) -> Figure:
    """A figure that pyplot knows of, so that `plt.show` and `plt.savefig` have it.

    Parameters
    ----------
    width, height : float
        [inch].

    Returns
    -------
    matplotlib Figure
        One by itself, without pyplot, where it is made for a file (`writing.views.unseen`) or in
        another thread, where a window could not be.
    """
    if are_unseen() or threading.current_thread() is not threading.main_thread():
        from matplotlib.figure import Figure

        return Figure(figsize=(width, height), layout="constrained")
    import matplotlib.pyplot as plt

    return plt.figure(figsize=(width, height), layout="constrained")


def make_axes(
    axes: Sequence[Axes] | Axes | None,
    heights: Sequence[float],
    *,
    sharex: bool = False,
) -> Panels:
    """Check the given axes, or stack new ones in a figure of their own.

    Parameters
    ----------
    axes : sequence of matplotlib Axes, one of them, or None
    heights : sequence of float
        Height of each of the axes [inch].
    sharex : bool
        New axes have one horizontal scale.

    Returns
    -------
    Panels

    Raises
    ------
    OptionError
        Not axes, or not as many as the picture needs.
    """
    if axes is not None:
        given = list(np.ravel(np.asarray(axes, dtype=object)))
        if not all(hasattr(ax, "get_figure") and hasattr(ax, "plot") for ax in given):
            raise OptionError(
                f"found axes={shown(axes)}; expected matplotlib axes, {len(heights)} for this "
                "picture; make them with plt.subplots"
            )
        if len(given) != len(heights):
            raise OptionError(
                f"found {len(given)} axes; expected {len(heights)} for this picture; make them "
                f"with plt.subplots({len(heights)})"
            )
        return Panels(given)
    figure = new_figure(WIDTH, sum(heights) + 0.3)
    grid = figure.subplots(
        len(heights), 1, squeeze=False, sharex=sharex, gridspec_kw={"height_ratios": list(heights)}
    )
    return Panels(grid[:, 0])


def checked(given: object, kind: type[Kind], example: str) -> Kind:
    """What was given, if it is of a kind, or one line about it.

    Parameters
    ----------
    given : object
    kind : type
    example : str
        How one writes the call.

    Raises
    ------
    SampleTypeError
    """
    if isinstance(given, kind):
        return given
    raise SampleTypeError(
        f"found {_called(type(given))} in place of {_called(kind)}; expected one {kind.__name__}; "
        f"write {example}"
    )


def _called(kind: type) -> str:
    article = "an" if kind.__name__[0] in "AEIO" else "a"
    return f"{article} {kind.__name__}"


def dress(ax: Axes, *, title: str = "", xlabel: str = "", ylabel: str = "") -> None:
    """Labels, a light grid, and no more lines than needed."""
    if title:
        ax.set_title(title, loc="left", fontsize=10)
    if xlabel:
        ax.set_xlabel(xlabel, fontsize=9)
    if ylabel:
        ax.set_ylabel(_stacked(ax, ylabel), fontsize=9)
    ax.tick_params(labelsize=9)
    ax.grid(True, color="#e4e4e4", linewidth=0.6)
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def _stacked(ax: Axes, label: str) -> str:
    """A label at the side, in at most three lines of no more than the axes' height."""
    room = max(int(ALONGSIDE * ax.get_window_extent().height / ax.figure.dpi), 14)
    if "\n" in label or len(label) <= room:
        return label
    return "\n".join(textwrap.wrap(short(label, 3 * room - 6), room)[:3])


def legend(ax: Axes, *, columns: int = 3) -> None:
    """Legend above the axes on the right, where it covers no data; a long title moves up."""
    labels = ax.get_legend_handles_labels()[1]
    if labels:
        title = ax.get_title(loc="left")
        shown = sum(len(label) for label in labels[:columns]) + HANDLE * min(len(labels), columns)
        width = ax.get_window_extent().width / ax.figure.dpi
        lines = -(-len(labels) // columns)
        longest = max(len(line) for line in title.split("\n"))
        if longest and longest + shown > PER_INCH * width:
            ax.set_title(title, loc="left", fontsize=10, pad=6.0 + 13.0 * lines)
        place_above(ax, "lower right", columns, handlelength=1.6)


def place_above(ax: Axes, corner: Corner, columns: int, *, handlelength: float) -> None:
    """The legend without a frame above the axes, ending or beginning with them."""
    at = (1.0, 1.0) if corner == "lower right" else (0.0, 1.0)
    spaces: dict[str, Any] = {
        "borderaxespad": 0.1,
        "handlelength": handlelength,
        "columnspacing": 1.2,
    }
    ax.legend(loc=corner, bbox_to_anchor=at, ncols=columns, fontsize=9, frameon=False, **spaces)


def legend_columns(ax: Axes) -> int:
    """Entries of a legend beside each other: as many as fit above a figure of the usual width."""
    return columns_for(ax.get_legend_handles_labels()[1])


def columns_for(labels: Sequence[str]) -> int:
    """As `legend_columns`, of labels that are not drawn yet.

    Examples
    --------
    >>> columns_for(["model", "recorded"]), columns_for(["2 poles, 1 zero: 94.8 %"])
    (3, 2)
    """
    longest = max(map(len, labels), default=0)
    return max(1, min(3, LEGEND // (longest + HANDLE)))


def outliers_of(
    estimate: Estimate, record: Record, experiment: int, output: int
) -> npt.NDArray[np.intp]:
    """Positions of the samples that the estimate counts as outliers.

    Parameters
    ----------
    estimate : Estimate
    record : Record
    experiment, output : int

    Returns
    -------
    ndarray
        None for another record than the identified one, as far as its length tells.
    """
    rows = estimate.outliers
    here = (rows[:, 0] == experiment) & (rows[:, 1] == output) & (rows[:, 2] < record.n_samples)
    positions: npt.NDArray[np.intp] = rows[here, 2].astype(np.intp)
    return positions


def labelled(name: str, units: Mapping[str, str]) -> str:
    """Name of a channel with its unit, as in ``alpha [rad]``, long ones without their middles.

    Examples
    --------
    >>> labelled("alpha", {"alpha": "rad"}), labelled("q", {})
    ('alpha [rad]', 'q')
    """
    unit = in_brackets(units.get(name, ""))
    return literal(short(name, IN_PICTURES) + unit)


def channel_unit(model: Shown, output: int, input_: int, power: int = 0) -> str:
    """Unit of a response over that of its input, over seconds to a power; or empty."""
    names = model.output_names[output], model.input_names[input_]
    if not all(name in model.units for name in names):
        return ""
    return unit_ratio(model.units[names[0]], model.units[names[1]], power)


def scientific(ax: Axes) -> None:
    """Numbers at both axes with a common power of ten where they are large or small."""
    ax.ticklabel_format(axis="both", style="sci", scilimits=(-3, 4), useOffset=False)
    for axis in (ax.xaxis, ax.yaxis):
        axis.get_offset_text().set_fontsize(8)


def in_brackets(unit: str) -> str:
    """A unit behind what it is the unit of; empty where there is none.

    Examples
    --------
    >>> in_brackets("rad/s"), in_brackets("")
    (' [rad/s]', '')
    """
    return f" [{short(unit, IN_PICTURES)}]" if unit else ""


class Shown(Protocol):
    """What a picture has to know of a model: an estimate tells it, and a `plots.lines.Line`."""

    @property
    def model(self) -> TransferFunction:
        """The transfer function."""
        ...

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs."""
        ...

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the outputs."""
        ...

    @property
    def units(self) -> Mapping[str, str]:
        """Channel to unit."""
        ...

    @property
    def dt(self) -> float | None:
        """Sampling interval of the record behind it [s]."""
        ...


def channel(estimate: Shown, output: int, input_: int) -> str:
    """Names of an output and an input in a title, long ones without their middles.

    Parameters
    ----------
    estimate : Estimate or Line
    output, input_ : int

    Returns
    -------
    str
    """
    names = estimate.output_names[output], estimate.input_names[input_]
    return " / ".join(short(name, IN_PICTURES) for name in names)


def literal(text: str) -> str:
    """Keep matplotlib from reading dollar signs in foreign names as mathematics."""
    return text.replace("$", r"\$")


GAP = 5.0
"""A step of more than so many typical ones is a gap, across which no line is drawn."""


def course(t: Array, values: Array) -> tuple[Array, Array]:
    """Points of a line through what was recorded, at most as many as can be told apart.

    Parameters
    ----------
    t, values : ndarray, shape (n_samples,)
        ``nan`` is a sample that is missing; single ones are bridged, as between the samples of a
        channel that is slower than the others.

    Returns
    -------
    t, values : ndarray
        A value of ``nan`` stands in every gap.

    Examples
    --------
    >>> course(np.array([0.0, 1.0, 2.0, 3.0, 22.0]), np.array([0.0, np.nan, 2.0, 3.0, 4.0]))
    (array([ 0.,  2.,  3.,  3., 22.]), array([ 0.,  2.,  3., nan,  4.]))
    """
    there = np.isfinite(values)
    t, values = t[there], values[there]
    if t.size < 3:
        return t, values
    steps = np.diff(t)
    ends = t[:-1][steps > GAP * np.median(steps)]
    t, values = shorten(t, values, MAX_POINTS)
    place = np.searchsorted(t, ends, side="right")
    return np.insert(t, place, ends), np.insert(values, place, np.nan)


def shorten(t: Array, values: Array, max_points: int = MAX_POINTS) -> tuple[Array, Array]:
    """Least and greatest value of each of many stretches, in their order, in place of all.

    Parameters
    ----------
    t, values : ndarray, shape (n_samples,)
    max_points : int
        A series up to this length is given back as it is.

    Returns
    -------
    t, values : ndarray, at most ``max_points`` long
        A line through them covers the same ink. ``nan`` where a whole stretch is missing.

    Examples
    --------
    >>> shorten(np.arange(6.0), np.array([0.0, 5.0, 1.0, 2.0, -3.0, 0.0]), 4)
    (array([0., 1., 3., 4.]), array([ 0.,  5.,  2., -3.]))
    """
    if values.size <= max_points:
        return t, values
    edges = np.linspace(0, values.size, max_points // 2 + 1).astype(int)
    missing = np.isnan(values)
    low = np.where(missing, np.inf, values)
    high = np.where(missing, -np.inf, values)
    picked = []
    for start, stop in itertools.pairwise(edges):
        pair = (start + int(np.argmin(low[start:stop])), start + int(np.argmax(high[start:stop])))
        picked += sorted(pair)
    return t[picked], values[picked]
