"""Picture of a fit: recorded output and model response, with the inputs below."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from tridentify.estimation.answer.estimate import Estimate
from tridentify.numerics.arrays import Array
from tridentify.plots.record import draw_inputs
from tridentify.plots.style import (
    BLUE,
    GREY,
    ORANGE,
    course,
    dress,
    in_brackets,
    labelled,
    legend,
    literal,
    make_axes,
    outliers_of,
)
from tridentify.record.record import Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes


FEW = 1500
"""Samples of a record that are told apart as dots."""
MOST_TURNS = 100
"""Crossings of its middle beyond which a response is a band of ink, however few its samples."""
WIDE = 2.2
"""Of the line through more of them, so that the model's lies thin upon it [points]."""
PALE = "#b4b4b4"


def plot_fit(
    estimate: Estimate,
    record: Record,
    *,
    experiment: int = 0,
    axes: Sequence[Axes] | None = None,
) -> list[Axes]:
    """Draw recorded outputs, the model's response to the recorded inputs, and the inputs.

    Parameters
    ----------
    estimate : Estimate
    record : Record
        The identified record, or another one with the same channels.
    experiment : int
        Whose offset, drift and initial state belong to the record.
    axes : sequence of matplotlib Axes, optional
        One per channel: outputs, then inputs. A figure is made when left out.

    Returns
    -------
    list of matplotlib Axes
    """
    heights = [1.9] * record.n_outputs + [1.1] * record.n_inputs
    drawn = make_axes(axes, heights, sharex=True)
    response = estimate.predict(record, experiment=experiment)
    for i in range(record.n_outputs):
        far = outliers_of(estimate, record, experiment, i)
        draw_output(drawn[i], record, response[:, i], i, far)
    drawn[0].set_title(literal(record.name), loc="left", fontsize=10)
    legend(drawn[0])
    draw_inputs(record, drawn[record.n_outputs :])
    return drawn


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
    few = record.n_samples <= FEW and _turns(response) <= MOST_TURNS
    ax.plot(
        *course(record.t, record.y[:, output]),
        color=GREY if few else PALE,
        linewidth=0.7 if few else WIDE,
        marker="." if few else "",
        markersize=3.5,
        label="recorded",
    )
    thin = 1.5 if few else 0.7
    ax.plot(*course(record.t, response), color=ORANGE, linewidth=thin, label="model")
    if far.size:
        ax.plot(
            record.t[far],
            record.y[far, output],
            color=BLUE,
            linestyle="none",
            marker="o",
            markersize=4.5,
            markerfacecolor="none",
            label="outlier",
        )
    dress(ax, ylabel=labelled(record.output_names[output], record.units))


def _turns(values: Array) -> int:
    """How often a series crosses its middle."""
    seen = values[np.isfinite(values)]
    above = seen > np.median(seen) if seen.size else np.zeros(0, dtype=bool)
    return int(np.count_nonzero(above[1:] != above[:-1]))


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
    ax.plot(*course(record.t, residual), color=BLUE, linewidth=0.7)
    unit = in_brackets(record.units.get(record.output_names[output], ""))
    dress(ax, ylabel=literal(f"residual{unit}"))
