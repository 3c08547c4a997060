"""Picture of the residual: its course, and its autocorrelation against that of white noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.numerics.arrays import Array
from tridentify.numerics.correlation import autocorrelation
from tridentify.plots import style
from tridentify.record.record import Record
from tridentify.writing.layout import short

if TYPE_CHECKING:
    from matplotlib.axes import Axes


LEVEL = 0.99
EXAMPLE = "plot_residual(estimate, record)"


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
    style.checked(estimate, Estimate, EXAMPLE)
    style.checked(record, Record, EXAMPLE)
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
