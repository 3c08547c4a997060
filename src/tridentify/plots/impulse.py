"""Picture of the impulse response with its confidence band."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from tridentify.estimation.answer.estimate import Estimate
from tridentify.plots.over_time import default_times, draw_band, name_channel, trimmed
from tridentify.plots.style import legend, make_axes
from tridentify.uncertainty import ImpulseBand, impulse_band, sample, sampled_impulse_band
from tridentify.uncertainty.checks import checked_times

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def plot_impulse(
    estimate: Estimate,
    *,
    t: npt.ArrayLike | None = None,
    level: float = 0.95,
    axes: Sequence[Axes] | Axes | None = None,
) -> list[Axes]:
    """Draw the response to a unit impulse of each input, with a pointwise confidence band.

    Parameters
    ----------
    estimate : Estimate
    t : array_like, shape (n_times,), optional
        Rising times [s]; the impulse comes at zero. By default until the model has settled.
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
    A channel with as many zeros as poles passes the impulse on at once; the weight of that is
    written into the picture, and the curve is the rest.
    """
    band = _band(estimate, default_times(estimate) if t is None else checked_times(t), level)
    seen = trimmed(band.t, band.response) if t is None else band.t.size
    n_outputs, n_inputs = len(estimate.output_names), len(estimate.input_names)
    drawn = make_axes(axes, [2.1] * (n_outputs * n_inputs))
    for k, ax in enumerate(drawn):
        i, j = divmod(k, n_inputs)
        line, low, high = (part[:seen, i, j] for part in (band.response, band.low, band.high))
        draw_band(ax, band.t[:seen], line, low, high, level)
        name_channel(ax, estimate, i, j, 1)
        if band.direct[i, j]:
            ax.text(
                0.985,
                0.95,
                f"and an impulse of weight {band.direct[i, j]:.4g} at once",
                transform=ax.transAxes,
                fontsize=9,
                ha="right",
                va="top",
                bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5},
            )
        if k == 0:
            legend(ax)
    drawn[-1].set_xlabel("time after the impulse [s]", fontsize=9)
    return drawn


def _band(estimate: Estimate, t: npt.NDArray[np.float64], level: float) -> ImpulseBand:
    if len(estimate.draws) and not any(name.startswith("delay") for name in estimate.names):
        return sampled_impulse_band(sample(estimate), t, level)
    return impulse_band(estimate, t, level)
