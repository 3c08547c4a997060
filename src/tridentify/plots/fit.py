"""Picture of a fit: recorded output and model responses, with the inputs below."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tridentify.errors import OptionError, SampleTypeError, shown
from tridentify.estimation.answer.assemble import fingerprint
from tridentify.estimation.answer.estimate import Estimate
from tridentify.numerics.arrays import Array
from tridentify.plots import style
from tridentify.plots.lines import Line, lines_of
from tridentify.plots.record import draw_inputs
from tridentify.record.record import Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
    title = [style.literal(record.name), _held(found, record, experiment)]
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


def _held(estimates: Sequence[Estimate], record: Record, experiment: int) -> str:
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
