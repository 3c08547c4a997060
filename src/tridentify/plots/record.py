"""Picture of a record: every input, output and reference against time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from tridentify.plots import style
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
