"""Picture of a record: every input and output against time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from tridentify.plots.style import (
    BLUE,
    GREEN,
    Panels,
    checked,
    course,
    dress,
    labelled,
    literal,
    make_axes,
    shorten,
)
from tridentify.record.record import Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def plot_record(record: Record, *, axes: Sequence[Axes] | None = None) -> Panels:
    """Draw every channel, outputs first.

    Parameters
    ----------
    record : Record
    axes : sequence of matplotlib Axes, optional
        One per channel: outputs, then inputs. A figure is made when left out.

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
    checked(record, Record, "plot_record(record)")
    heights = [1.5] * record.n_outputs + [1.1] * record.n_inputs
    drawn = make_axes(axes, heights, sharex=True)
    for i, name in enumerate(record.output_names):
        drawn[i].plot(*course(record.t, record.y[:, i]), color=BLUE, linewidth=1.0)
        dress(drawn[i], ylabel=labelled(name, record.units))
    draw_inputs(record, drawn[record.n_outputs :])
    drawn[0].set_title(literal(record.name), loc="left", fontsize=10)
    return drawn


def draw_inputs(record: Record, axes: Sequence[Axes]) -> None:
    """Draw the inputs as they stand between the samples: held, or joined by straight lines."""
    held = record.behaviour == "zoh"
    for j, name in enumerate(record.input_names):
        axes[j].plot(
            *shorten(record.t, record.u[:, j]),
            color=GREEN,
            linewidth=1.2,
            drawstyle="steps-post" if held else "default",
        )
        dress(axes[j], ylabel=labelled(name, record.units))
    axes[-1].set_xlabel("time [s]", fontsize=9)
