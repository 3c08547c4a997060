"""Picture of the step response with its confidence band."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from tridentify.judgement.comparison.entries import Models
from tridentify.numerics import delta_method
from tridentify.plots.over_time import Reply, plot_replies
from tridentify.plots.style import GREY, Panels, legend, legend_columns
from tridentify.uncertainty import sampled_step_band, step_band

if TYPE_CHECKING:
    from matplotlib.axes import Axes


STEP = Reply("plot_step", delta_method.step_response, step_band, sampled_step_band, "step", 0)


def plot_step(
    models: Models,
    t: npt.ArrayLike | None = None,
    *,
    names: Sequence[str] | None = None,
    level: float = 0.95,
    axes: Sequence[Axes] | Axes | None = None,
) -> Panels:
    """Draw the response to a unit step of each input, with a pointwise confidence band.

    Parameters
    ----------
    models : Estimate, TransferFunction, sequence of these, or mapping of names to them
        Of the same channels. A transfer function has no band.
    t : float or array_like, shape (n_times,), optional
        Final time, or rising times [s]; the step comes at zero. By default until the model has
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
    The dashed line is the static gain, where the model has one.
    """
    drawn, lines = plot_replies(models, names, t, level, STEP, axes)
    gains = [line.model.dc_gain for line in lines]
    for k, ax in enumerate(drawn):
        i, j = divmod(k, gains[0].shape[1])
        for line, gain in zip(lines, gains, strict=True):
            stable = np.all(np.roots(line.model.den[i][j]).real < 0)
            if np.isfinite(gain[i, j]) and stable:
                label = None if line.number else "static gain"
                colour = GREY if line.together == 1 else line.colour
                dash = "--" if line.together == 1 else ":"
                ax.axhline(gain[i, j], color=colour, linewidth=0.9, linestyle=dash, label=label)
    legend(drawn[0], columns=legend_columns(drawn[0]))
    return drawn
