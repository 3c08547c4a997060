"""Picture after the paper's Fig. 5: the aircraft's step response, a noisy record, the fits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tridentify.models.simulate import simulate
from tridentify.numerics.arrays import Array
from tridentify.plots import style
from tridentify.record.record import Record
from tridentify.studies.aircraft import PLANT
from tridentify.studies.aircraft_numbers import ESTIMATORS, Condition
from tridentify.studies.aircraft_result import AircraftResult
from tridentify.transfer_function import TransferFunction

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = (style.ORANGE, style.BLUE, style.GREEN)
"""Of the estimators, in the pictures of this study."""
FINE = 5
"""Points of a drawn response for each sample of the record."""


def plot_step_responses(
    result: AircraftResult, *, axes: Sequence[Axes] | None = None
) -> style.Panels:
    """Draw the truth with one noisy record, what the estimators make of all draws, and the input.

    Parameters
    ----------
    result : AircraftResult
        Its first record length at the noise ratio nearest to one is drawn.
    axes : sequence of matplotlib Axes, optional
        Five: record, one for each estimator, input. A figure is made when left out.

    Returns
    -------
    Panels
        The axes.
    """
    drawn = style.make_axes(axes, [2.2, 1.35, 1.35, 1.35, 0.9], sharex=True)
    condition = min(result.by_length()[0], key=lambda c: abs(c.ratio - 1.0))
    x = np.ones(condition.n_samples * FINE)
    grid = Record(x, x, dt=condition.dt / FINE)
    truth = simulate(PLANT, grid)[:, 0]
    example = condition.example
    thin: dict[str, Any] = {"color": style.GREY, "linewidth": 0.6, "markersize": 3.5}
    drawn[0].plot(example.t, example.y[:, 0], ".-", label="one record", **thin)
    drawn[0].plot(grid.t, truth, color=style.BLACK, linewidth=1.6, label="truth")
    title = f"noise {condition.ratio:g} x RMS of the truth"
    style.dress(drawn[0], title=title, ylabel="y [units of x]")
    style.legend(drawn[0], columns=2)
    bands = [response_band(condition, j, grid) for j in range(len(ESTIMATORS))]
    for ax, colour, name, band in zip(drawn[1:-1], COLOURS, ESTIMATORS, bands, strict=True):
        _draw_band(ax, grid.t, truth, band, colour, name)
    low, high = _limits(truth, bands)
    for ax in drawn[1:-1]:
        ax.set_ylim(low, high)
    end = float(grid.t[-1])
    drawn[-1].plot(
        [-0.05 * end, 0.0, 0.0, end], [0.0, 0.0, 1.0, 1.0], color=style.BLACK, linewidth=1.2
    )
    style.dress(drawn[-1], xlabel="time [s]", ylabel="x [-]")
    return drawn


def response_band(condition: Condition, estimator: int, grid: Record) -> Array:
    """Quantiles of the fitted models' responses, instant by instant.

    Parameters
    ----------
    condition : Condition
    estimator : int
        Place in ``ESTIMATORS``.
    grid : Record
        Whose input and times are used.

    Returns
    -------
    ndarray, shape (3, n_samples)
        16, 50 and 84 %; ``nan`` when no draw gave a model.
    """
    theta = condition.theta[estimator]
    found = theta[np.all(np.isfinite(theta), axis=1)]
    if not found.size:
        return np.full((3, grid.n_samples), np.nan)
    with np.errstate(over="ignore", invalid="ignore"):
        responses = [
            simulate(TransferFunction([b0], [1.0, a1, a0]), grid)[:, 0] for a1, a0, b0 in found
        ]
    return np.asarray(np.quantile(responses, [0.16, 0.5, 0.84], axis=0))


def _draw_band(ax: Axes, t: Array, truth: Array, band: Array, colour: str, name: str) -> None:
    ax.fill_between(t, band[0], band[2], color=colour, alpha=0.25, linewidth=0, label="16-84 %")
    ax.plot(t, band[1], color=colour, linewidth=1.5, label="median")
    ax.plot(t, truth, color=style.BLACK, linewidth=1.0, linestyle="--", label="truth")
    style.dress(ax, title=name, ylabel="y [units of x]")
    style.legend(ax)


def _limits(truth: Array, bands: Sequence[Array]) -> tuple[float, float]:
    """Of all bands, but at most twice as far as the truth: an unstable median may run away."""
    values = np.concatenate([np.ravel(band) for band in bands])
    span = float(np.ptp(truth))
    inside = values[np.isfinite(values)]
    low = max(float(np.min(inside, initial=truth.min())), float(truth.min()) - span)
    high = min(float(np.max(inside, initial=truth.max())), float(truth.max()) + span)
    room = 0.06 * (high - low)
    return low - room, high + room
