"""Picture of a fit: recorded output and model responses, with the inputs below.

Picture of a comparison: several models over several records, each with its fit.

Picture of the residual: its course, and its autocorrelation against that of white noise.

Picture of a record: every input, output and reference against time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from statistics import NormalDist
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tridentify.errors import OptionError, SampleTypeError, shown
from tridentify.estimation.answer.assemble import fingerprint
from tridentify.estimation.answer.estimate import Estimate
from tridentify.judgement.comparison import Comparison
from tridentify.numerics.arrays import Array
from tridentify.numerics.correlation import autocorrelation
from tridentify.plots import style
from tridentify.plots.lines import Line, lines_of
from tridentify.record.record import Record
from tridentify.writing.layout import IN_PICTURES, short

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def plot_record(record: Record, *, axes: Sequence[Axes] | None = None) -> style.Panels:
    """Draw every channel, outputs first.

    Parameters
    ----------
    record : Record
    axes : sequence of matplotlib Axes, optional
        One per channel: outputs, then inputs, then references. A figure is made when left out.
        A reference whose unit is stated and is that of exactly one output is drawn behind that
        output and has no axes of its own.

    Returns
    -------
    Panels
        The axes.

    Examples
    --------
    >>> axes = plot_record(Record([0.0, 1.0, 1.0], [0.0, 0.2, 0.3], dt=0.1))
    >>> [ax.get_ylabel() for ax in axes]
    ['y', 'u']
    """
    style.checked(record, Record, "plot_record(record)")
    behind = [_followed_by(record, name) for name in record.reference_names]
    own = behind.count(None)
    heights = [1.5] * record.n_outputs + [1.1] * (record.n_inputs + own)
    drawn = style.make_axes(axes, heights, sharex=True)
    for i, name in enumerate(record.output_names):
        line = style.literal(short(name, IN_PICTURES))
        drawn[i].plot(
            *style.course(record.t, record.y[:, i]), color=style.BLUE, linewidth=1.0, label=line
        )
        style.dress(drawn[i], ylabel=style.labelled(name, record.units))
    last = record.n_outputs + record.n_inputs
    draw_inputs(record, drawn[record.n_outputs : last])
    alone = iter(drawn[last:])
    for k, place in enumerate(behind):
        _draw_reference(record, k, next(alone) if place is None else drawn[place], place)
    if own:
        drawn[last - 1].set_xlabel("")
        drawn[-1].set_xlabel("time [s]", fontsize=9)
    drawn[0].set_title(style.literal(record.name), loc="left", fontsize=10)
    return drawn


def _followed_by(record: Record, name: str) -> int | None:
    """The output that a reference is the set point of, to judge by the unit; None if not known."""
    unit = record.units.get(name)
    same = [i for i, one in enumerate(record.output_names) if record.units.get(one) == unit]
    return same[0] if unit and len(same) == 1 else None


def _draw_reference(record: Record, k: int, ax: Axes, behind: int | None) -> None:
    assert record.reference is not None
    name = record.reference_names[k]
    ax.plot(
        *style.shorten(record.t, record.reference[:, k]),
        color=style.ORANGE,
        linewidth=1.2,
        linestyle="--" if behind is not None else "-",
        drawstyle="steps-post" if record.reference_behaviour == "zoh" else "default",
        label=style.literal(short(name, IN_PICTURES)),
        zorder=1.5,
    )
    if behind is None:
        style.dress(ax, ylabel=style.labelled(name, record.units))
    else:
        style.legend(ax)


def draw_inputs(record: Record, axes: Sequence[Axes]) -> None:
    """Draw the inputs as they stand between the samples: held, or joined by straight lines."""
    held = record.behaviour == "zoh"
    for j, name in enumerate(record.input_names):
        course = style.shorten(record.t, record.u[:, j])
        how = "steps-post" if held else "default"
        axes[j].plot(*course, color=style.GREEN, linewidth=1.2, drawstyle=how)
        style.dress(axes[j], ylabel=style.labelled(name, record.units))
    axes[-1].set_xlabel("time [s]", fontsize=9)


EXAMPLE = "plot_fit(estimate, record)"

FEW = 1500
"""Samples of a record that are told apart as dots."""
MOST_TURNS = 100
"""Crossings of its middle beyond which a response is a band of ink, however few its samples."""
WIDE = 2.2
"""Of the line through more of them, so that the model's lies thin upon it [points]."""
PALE = "#b4b4b4"


def plot_fit(
    estimates: Estimate | Sequence[Estimate] | Mapping[str, Estimate],
    record: Record,
    *,
    names: Sequence[str] | None = None,
    experiment: int = 0,
    axes: Sequence[Axes] | None = None,
) -> style.Panels:
    """Draw recorded outputs, the models' responses to the recorded inputs, and the inputs.

    Parameters
    ----------
    estimates : Estimate, sequence of Estimate, or mapping of names to them
    record : Record
        The identified record, or another one with the same channels. On another one, offset, drift
        and initial state are held as they were estimated, and the picture says so:
        `tridentify.compare` fits them to it.
    names : sequence of str, optional
        One an estimate, for the legend.
    experiment : int
        Whose offset, drift and initial state belong to the record.
    axes : sequence of matplotlib Axes, optional
        One per channel: outputs, then inputs. A figure is made when left out.

    Returns
    -------
    Panels
        The axes.

    Raises
    ------
    SampleTypeError, ChannelNameError, DataError
        Something is no estimate or no record, or their channels differ.
    OptionError
        An estimate has no such experiment, or there are not as many axes as channels.
    """
    record = style.checked(record, Record, EXAMPLE)
    lines = lines_of(estimates, names, EXAMPLE)
    found = [_estimate(line) for line in lines]
    for one in found:
        if not (isinstance(experiment, int) and 0 <= experiment < len(one.nuisance)):
            raise OptionError(
                f"found experiment={shown(experiment)} of an estimate of {len(one.nuisance)} "
                "experiments; expected one of them, the first is 0; correct it"
            )
    responses = [one.predict(record, experiment=experiment) for one in found]
    heights = [1.9] * record.n_outputs + [1.1] * record.n_inputs
    drawn = style.make_axes(axes, heights, sharex=True)
    for i, name in enumerate(record.output_names):
        if len(found) == 1:
            far = style.outliers_of(found[0], record, experiment, i)
            draw_output(drawn[i], record, responses[0][:, i], i, far)
            continue
        courses = [response[:, i] for response in responses]
        inked = is_ink(record.t, courses)
        draw_recorded(drawn[i], record.t, record.y[:, i], inked)
        for line, response in zip(lines, courses, strict=True):
            draw_response(drawn[i], record.t, response, (line.colour, line.dash, line.label), inked)
        style.dress(drawn[i], ylabel=style.labelled(name, record.units))
    title = [style.literal(record.name), _held(found, record)]
    drawn[0].set_title("\n".join(text for text in title if text), loc="left", fontsize=10)
    style.legend(drawn[0], columns=style.legend_columns(drawn[0]))
    draw_inputs(record, drawn[record.n_outputs :])
    return drawn


def _estimate(line: Line) -> Estimate:
    if line.estimate is None:
        raise SampleTypeError(
            "found a TransferFunction, which knows no offset and no initial state of a record; "
            "expected an estimate; write compare(model, record).plot(), which fits them"
        )
    return line.estimate


def _held(estimates: Sequence[Estimate], record: Record) -> str:
    """What a reader has to know where the record is not the one that was identified."""
    for one in estimates:
        seen = fingerprint([record.settled(one.intersample)])
        if len(one.nuisance) == 1 and one.record_fingerprint != seen:
            return (
                "another record: offset, drift, initial state held\n"
                "as identified (compare fits them)"
            )
    return ""


def draw_output(
    ax: Axes, record: Record, response: Array, output: int, far: npt.NDArray[np.intp]
) -> None:
    """Draw one recorded output and the model's; of a long record the model lies thin upon it.

    Parameters
    ----------
    ax : matplotlib Axes
    record : Record
    response : ndarray, shape (n_samples,)
        The model's.
    output : int
        Its position.
    far : ndarray of int
        Positions of outliers.
    """
    inked = is_ink(record.t, [response])
    draw_recorded(ax, record.t, record.y[:, output], inked)
    draw_response(ax, record.t, response, (style.ORANGE, "-", "model"), inked)
    if far.size:
        how: dict[str, Any] = {"color": style.BLUE, "markersize": 4.5, "markerfacecolor": "none"}
        ax.plot(record.t[far], record.y[far, output], "o", label="outlier", **how)
    style.dress(ax, ylabel=style.labelled(record.output_names[output], record.units))


def is_ink(t: Array, responses: Sequence[Array]) -> bool:
    """Whether a record is a band of ink, upon which the models lie thin.

    Parameters
    ----------
    t : ndarray, shape (n_samples,)
    responses : sequence of ndarray, shape (n_samples,)
        Of the models: noise does not count.
    """
    return t.size > FEW or any(_turns(one) > MOST_TURNS for one in responses)


def _turns(values: Array) -> int:
    """How often a series crosses its middle."""
    seen = values[np.isfinite(values)]
    above = seen > np.median(seen) if seen.size else np.zeros(0, dtype=bool)
    return int(np.count_nonzero(above[1:] != above[:-1]))


def draw_recorded(ax: Axes, t: Array, y: Array, inked: bool) -> None:
    """Samples of an output as dots, or as a pale broad line where they are ink."""
    colour, width, marker = (PALE, WIDE, "") if inked else (style.GREY, 0.7, ".")
    look: dict[str, Any] = {"color": colour, "linewidth": width, "marker": marker}
    ax.plot(*style.course(t, y), markersize=3.5, label="recorded", **look)


def draw_response(ax: Axes, t: Array, y: Array, how: tuple[str, str, str], inked: bool) -> None:
    """A model's output: colour, kind of line and label; thin upon a record that is ink."""
    colour, dash, label = how
    ax.plot(
        *style.course(t, y), color=colour, linestyle=dash, linewidth=0.7 if inked else 1.5,
        label=style.literal(label),
    )  # fmt: skip


def draw_residual(ax: Axes, record: Record, residual: Array, output: int) -> None:
    """Draw what the model leaves of one output, to stand beneath its fit.

    Parameters
    ----------
    ax : matplotlib Axes
    record : Record
    residual : ndarray, shape (n_samples,)
        Recorded minus fitted; ``nan`` where nothing was recorded.
    output : int
        Its position.
    """
    ax.axhline(0.0, color="black", linewidth=0.6)
    ax.plot(*style.course(record.t, residual), color=style.BLUE, linewidth=0.7)
    unit = style.in_brackets(record.units.get(record.output_names[output], ""))
    style.dress(ax, ylabel=style.literal(f"residual{unit}"))


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


LEVEL = 0.99
RESIDUAL_EXAMPLE = "plot_residual(estimate, record)"


def plot_residual(
    estimate: Estimate,
    record: Record,
    *,
    experiment: int = 0,
    n_lags: int = 40,
    axes: Sequence[Axes] | None = None,
) -> style.Panels:
    """Draw the residual of each output over time, and its autocorrelation with 99 % bounds.

    Parameters
    ----------
    estimate : Estimate
    record : Record
        The identified record, or another one with the same channels: offset, drift and initial
        state are held as they were estimated (`validate` fits them to it).
    experiment : int
        Whose offset, drift and initial state belong to the record.
    n_lags : int
        Largest lag of the autocorrelation [samples].
    axes : sequence of matplotlib Axes, optional
        Two per output: course, autocorrelation. A figure is made when left out.

    Returns
    -------
    Panels
        The axes.

    Notes
    -----
    For white noise, ``r(k)`` lies within ``2.58 / sqrt(n_samples)`` with probability 99 % at each
    lag k > 0. Structure that stands out means noise that is coloured, or a model that misses some
    of the response. Outliers of a robust fit stand at the edge, with the rest at full scale, and
    do not count in the autocorrelation.
    """
    style.checked(estimate, Estimate, RESIDUAL_EXAMPLE)
    style.checked(record, Record, RESIDUAL_EXAMPLE)
    drawn = style.make_axes(axes, [1.5, 1.5] * record.n_outputs)
    residual = estimate.residual(record, experiment=experiment)
    lags = np.arange(min(n_lags, max(record.n_samples - 1, 1)) + 1)
    times, unit = (lags * record.dt, "s") if record.dt is not None else (lags, "samples")
    for i, name in enumerate(record.output_names):
        series, correlogram = drawn[2 * i : 2 * i + 2]
        series.axhline(0.0, color="black", linewidth=0.6)
        far = style.outliers_of(estimate, record, experiment, i)
        rest = residual[:, i].copy()
        rest[far] = np.nan
        series.plot(*style.course(record.t, rest), color=style.BLUE, linewidth=0.8)
        if far.size:
            _mark(series, record.t[far], residual[far, i], float(np.nanmax(np.abs(rest))))
        title = style.literal(f"residual of {short(name, 60)}")
        label = style.labelled(name, record.units)
        style.dress(series, title=title, xlabel="time [s]", ylabel=label)
        correlation, count = autocorrelation(rest, int(lags[-1]))
        bound = NormalDist().inv_cdf((1 + LEVEL) / 2) / math.sqrt(max(count, 1))
        correlogram.axhspan(-bound, bound, color=style.ORANGE, alpha=0.2, linewidth=0)
        correlogram.vlines(times[1:], 0.0, correlation[1:], color=style.BLUE, linewidth=1.6)
        correlogram.axhline(0.0, color="black", linewidth=0.6)
        reach = 1.15 * max(2 * bound, float(np.max(np.abs(correlation[1:]), initial=0.0)))
        correlogram.set_ylim(-reach, reach)
        correlogram.set_xlim(0.0, float(times[-1]) * 1.02)
        title = f"autocorrelation, with the {100 * LEVEL:.0f} % bounds of white noise"
        style.dress(correlogram, title=title, xlabel=f"lag [{unit}]", ylabel="correlation [-]")
        correlogram.ticklabel_format(axis="x", style="sci", scilimits=(-3, 4), useOffset=False)
    return drawn


def _mark(ax: Axes, t: Array, values: Array, largest: float) -> None:
    """Show outliers as triangles, at the edge where they lie beyond it."""
    edge = 1.5 * largest
    label = f"{t.size} outlier{'' if t.size == 1 else 's'}"
    for sign, marker in ((1.0, "^"), (-1.0, "v")):
        own = np.sign(values) == sign
        if own.any():
            places = np.clip(values[own], -0.93 * edge, 0.93 * edge)
            ax.plot(t[own], places, marker, color=style.ORANGE, markersize=4.5, label=label)
            label = ""
    ax.set_ylim(-edge, edge)
    style.legend(ax)
