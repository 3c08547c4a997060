"""Picture of the impulse response with its confidence band."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy.typing as npt

from tridentify.judgement.comparison.entries import Models
from tridentify.numerics import delta_method
from tridentify.plots.lines import Line
from tridentify.plots.over_time import Reply, plot_replies
from tridentify.plots.style import Panels, legend, legend_columns, literal
from tridentify.uncertainty import impulse_band, sampled_impulse_band

if TYPE_CHECKING:
    from matplotlib.axes import Axes


IMPULSE = Reply(
    "plot_impulse",
    delta_method.impulse_response,
    impulse_band,
    sampled_impulse_band,
    "impulse",
    1,
)


def plot_impulse(
    models: Models,
    t: npt.ArrayLike | None = None,
    *,
    names: Sequence[str] | None = None,
    level: float = 0.95,
    axes: Sequence[Axes] | Axes | None = None,
) -> Panels:
    """Draw the response to a unit impulse of each input, with a pointwise confidence band.

    Parameters
    ----------
    models : Estimate, TransferFunction, sequence of these, or mapping of names to them
        Of the same channels. A transfer function has no band.
    t : float or array_like, shape (n_times,), optional
        Final time, or rising times [s]; the impulse comes at zero. By default until the model has
        settled.
    names : sequence of str, optional
        One a model, for the legend; by default the keys of a mapping, the orders where they differ,
        else the methods.
    level : float
        Probability that the band holds at each time. Of a posterior mean the band lies between
        quantiles of its draws.
    axes : sequence of matplotlib Axes, or one, optional
        One per channel, outputs in the outer loop. A figure is made when left out.

    Returns
    -------
    Panels
        The axes.

    Raises
    ------
    OptionError
        The level is no probability, the times do not rise, or there are not as many axes as
        channels.
    SampleTypeError, ChannelNameError
        Something is no model, or the models have different channels.

    Notes
    -----
    A channel with as many zeros as poles passes the impulse on at once; the weight of that is
    written into the picture, and the curve is the rest.
    """
    drawn, lines = plot_replies(models, names, t, level, IMPULSE, axes)
    for k, ax in enumerate(drawn):
        _tell_direct(ax, lines, *divmod(k, lines[0].model.n_inputs))
    legend(drawn[0], columns=legend_columns(drawn[0]))
    return drawn


def _tell_direct(ax: Axes, lines: Sequence[Line], output: int, input_: int) -> None:
    """Weights of the impulses that are passed on at once, in the corner."""
    told = []
    for line in lines:
        num, den = line.model.num[output][input_], line.model.den[output][input_]
        if num.size == den.size and num[0]:
            whose = "" if line.together == 1 else f" ({line.label})"
            told.append(f"and an impulse of weight {num[0]:.4g} at once{whose}")
    if told:
        behind = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5}
        corner: dict[str, Any] = {"transform": ax.transAxes, "ha": "right", "va": "top"}
        ax.text(0.985, 0.95, literal("\n".join(told)), fontsize=9, bbox=behind, **corner)
