"""Pictures of a measured frequency response: by itself, and behind that of a model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tridentify.judgement.advice import FrequencyResponse
from tridentify.numerics.arrays import Array
from tridentify.plots import style
from tridentify.plots.over_time import wrapped
from tridentify.writing.layout import IN_PICTURES, short

if TYPE_CHECKING:
    from matplotlib.axes import Axes


TWO_SIDED = 1.96
"""Of 95 % of a Gaussian error [standard errors]."""

LONGEST_BAR = 20.0, 90.0
"""Error bars are cut there [dB, deg]: what is longer says no more."""


def plot_frequency_response(
    measured: FrequencyResponse, *, axes: Sequence[Axes] | None = None
) -> style.Panels:
    """Draw magnitude, phase and coherence of every channel as measured.

    Parameters
    ----------
    measured : FrequencyResponse
    axes : sequence of matplotlib Axes, optional
        Three per channel (magnitude, phase, coherence), outputs in the outer loop. A figure is
        made when left out.

    Returns
    -------
    Panels
        The axes.

    Notes
    -----
    Points of good coherence have 95 % error bars; the others are faded. The shaded band is the
    one that the input excites.
    """
    style.checked(
        measured, FrequencyResponse, "plot_frequency_response(frequency_response(record))"
    )
    n_outputs, n_inputs = len(measured.output_names), len(measured.input_names)
    drawn = style.make_axes(axes, [1.7, 1.4, 1.0] * (n_outputs * n_inputs), sharex=True)
    for k in range(n_outputs * n_inputs):
        i, j = divmod(k, n_inputs)
        magnitude, phase, coherence = drawn[3 * k : 3 * k + 3]
        response = measured.response[:, i, j]
        unwrapped = np.full(response.size, np.nan)
        seen = np.isfinite(response)
        unwrapped[seen] = np.degrees(np.unwrap(np.angle(response[seen])))
        unwrapped += whole_turns(unwrapped[measured.good[:, i, j] & seen])
        draw_measured(magnitude, phase, measured, i, j, unwrapped)
        for ax in (magnitude, phase):
            _fit_to(ax, measured, i, j)
        coherence.plot(
            measured.omega, measured.coherence[:, i, j], color=style.ORANGE, linewidth=1.2
        )
        shade_excited([coherence], measured, j)
        coherence.set_ylim(0.0, 1.05)
        coherence.set_xscale("log")
        coherence.set_xlim(measured.omega[0], measured.omega[-1])
        name = f"{short(measured.output_names[i], IN_PICTURES)} / " + short(
            measured.input_names[j], IN_PICTURES
        )
        style.dress(magnitude, title=style.literal(wrapped(name)), ylabel="magnitude\n[dB]")
        style.dress(phase, ylabel="phase [deg]")
        style.dress(coherence, ylabel="coherence")
        if k == 0:
            style.legend(magnitude)
    drawn[-1].set_xlabel("angular frequency [rad/s]", fontsize=9)
    return drawn


def draw_measured(
    magnitude: Axes,
    phase: Axes,
    measured: FrequencyResponse,
    output: int,
    input_: int,
    nearby: Array,
) -> None:
    """Draw the points of one channel and the excited band.

    Parameters
    ----------
    magnitude, phase : matplotlib Axes
    measured : FrequencyResponse
    output, input_ : int
    nearby : (n_omega,) array
        Phases [deg] that those of the points are to be near to, by whole turns.
    """
    response, std = measured.response[:, output, input_], measured.std[:, output, input_]
    good = measured.good[:, output, input_] & np.isfinite(response)
    size = np.where(np.abs(response) > 0, np.abs(response), np.nan)
    decibels, degrees = 20.0 * np.log10(size), np.degrees(np.angle(response))
    degrees = degrees + 360.0 * np.round(np.nan_to_num(nearby - degrees) / 360.0)
    # half of the square of the error is along the response, half across
    relative = np.minimum(TWO_SIDED * std / np.sqrt(2.0) / size, 0.9)
    bars = (
        np.minimum(np.vstack([-np.log10(1.0 - relative), np.log10(1.0 + relative)]) * 20.0,
                   LONGEST_BAR[0]),
        np.minimum(np.degrees(np.vstack([relative, relative])), LONGEST_BAR[1]),
    )  # fmt: skip
    for ax, values, bar in ((magnitude, decibels, bars[0]), (phase, degrees, bars[1])):
        ax.plot(
            measured.omega[~good], values[~good], ".", color=style.GREY, alpha=0.35, markersize=3,
            zorder=1.5,
        )  # fmt: skip
        ax.errorbar(
            measured.omega[good], values[good], yerr=bar[:, good], fmt=".", color=style.ORANGE,
            markersize=4, elinewidth=0.8, zorder=1.8,
            label="measured" if np.any(good) else None,
        )  # fmt: skip
    shade_excited([magnitude, phase], measured, input_)


def whole_turns(degrees: Array) -> float:
    """What brings phases to the branch that all channels are drawn on.

    Parameters
    ----------
    degrees : ndarray, shape (n_omega,)
        Unwrapped [deg].

    Returns
    -------
    float
        A multiple of 360 [deg], so that the first phase lies from -225 to below 135: a gain that is
        negative begins at -180 in every channel, a differentiator at 90.

    Examples
    --------
    >>> whole_turns(np.array([179.0, 90.0])), whole_turns(np.array([-181.0])), whole_turns(
    ...     np.array([90.0])
    ... )
    (-360.0, 0.0, 0.0)
    """
    seen = degrees[np.isfinite(degrees)]
    return -360.0 * float(np.floor((seen[0] + 225.0) / 360.0)) if seen.size else 0.0


def shade_excited(axes: Sequence[Axes], measured: FrequencyResponse, input_: int) -> None:
    """Shade the frequencies that an input excites.

    Parameters
    ----------
    axes : sequence of matplotlib Axes
    measured : FrequencyResponse
    input_ : int
    """
    at = np.flatnonzero(np.diff(np.concatenate([[0], measured.excited[:, input_], [0]])))
    edges = np.sqrt(measured.omega[:-1] * measured.omega[1:])
    edges = np.concatenate([measured.omega[:1], edges, measured.omega[-1:]])
    for ax in axes:
        for k, (first, last) in enumerate(at.reshape(-1, 2)):
            ax.axvspan(
                float(edges[first]), float(edges[last]), color=style.SKY, alpha=0.13, linewidth=0,
                label="excited" if k == 0 else None,
            )  # fmt: skip


def _fit_to(ax: Axes, measured: FrequencyResponse, output: int, input_: int) -> None:
    """Scale to the points in full, where there are any."""
    good = measured.good[:, output, input_]
    ax.set_xscale("log")
    ax.set_xlim(measured.omega[0], measured.omega[-1])
    if not np.any(good):
        return
    points = [line for line in ax.get_lines() if line.get_alpha() is None]
    values = np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in points])
    values = values[np.isfinite(values)]
    if values.size:
        low, high = float(values.min()), float(values.max())
        margin = max(0.15 * (high - low), 3.0)
        ax.set_ylim(low - margin, high + margin)
