"""Picture of the step response with its confidence band."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from tridentify.estimation.answer.estimate import Estimate
from tridentify.plots.over_time import default_times, draw_band, name_channel, trimmed
from tridentify.plots.style import GREY, legend, make_axes
from tridentify.uncertainty import StepBand, sample, sampled_step_band, step_band
from tridentify.uncertainty.checks import checked_times

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def plot_step(
    estimate: Estimate,
    *,
    t: npt.ArrayLike | None = None,
    level: float = 0.95,
    axes: Sequence[Axes] | Axes | None = None,
) -> list[Axes]:
    """Draw the response to a unit step of each input, with a pointwise confidence band.

    Parameters
    ----------
    estimate : Estimate
    t : array_like, shape (n_times,), optional
        Rising times [s]; the step comes at zero. By default until the model has settled.
    level : float
        Probability that the band holds at each time. Of a posterior mean the band lies between
        quantiles of its draws.
    axes : sequence of matplotlib Axes, or one, optional
        One per channel, outputs in the outer loop. A figure is made when left out.

    Returns
    -------
    list of matplotlib Axes

    Raises
    ------
    OptionError
        The level is no probability, or the times do not rise.
    ValueError
        Not as many axes as there are channels.

    Notes
    -----
    The dashed line is the static gain, where the model has one.
    """
    band = _band(estimate, default_times(estimate) if t is None else checked_times(t), level)
    seen = trimmed(band.t, band.response) if t is None else band.t.size
    n_outputs, n_inputs = len(estimate.output_names), len(estimate.input_names)
    drawn = make_axes(axes, [2.1] * (n_outputs * n_inputs))
    gains = estimate.model.dc_gain
    for k, ax in enumerate(drawn):
        i, j = divmod(k, n_inputs)
        line, low, high = (part[:seen, i, j] for part in (band.response, band.low, band.high))
        draw_band(ax, band.t[:seen], line, low, high, level)
        if np.isfinite(gains[i, j]) and np.all(np.roots(estimate.model.den[i][j]).real < 0):
            ax.axhline(gains[i, j], color=GREY, linewidth=0.9, linestyle="--", label="static gain")
        name_channel(ax, estimate, i, j, 0)
        if k == 0:
            legend(ax)
    drawn[-1].set_xlabel("time after the step [s]", fontsize=9)
    return drawn


def _band(estimate: Estimate, t: npt.NDArray[np.float64], level: float) -> StepBand:
    if len(estimate.draws) and not any(name.startswith("delay") for name in estimate.names):
        return sampled_step_band(sample(estimate), t, level)
    return step_band(estimate, t, level)
