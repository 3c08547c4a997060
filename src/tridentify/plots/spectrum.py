"""Picture of a planned input: its course, and where in frequency its power lies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.excitation import Excitation, Spectrum
from tridentify.judgement.comparison.entries import entries_of
from tridentify.numerics.arrays import Array
from tridentify.plots.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    Panels,
    checked,
    dress,
    labelled,
    legend,
    literal,
    make_axes,
    shorten,
)
from tridentify.transfer_function import TransferFunction

if TYPE_CHECKING:
    from matplotlib.axes import Axes


VISIBLE = 1e-3
"""Lines below this share of the largest are not drawn."""
LONGEST_TITLE = 56
"""Characters of a list of coefficients."""


def plot_excitation(
    excitation: Excitation,
    model: TransferFunction | Estimate | None = None,
    *,
    axes: Sequence[Axes] | None = None,
) -> Panels:
    """Draw every input against time, and its amplitude spectrum.

    Parameters
    ----------
    excitation : Excitation
    model : TransferFunction or Estimate, optional
        Of the plant: the magnitude of its response to each input is drawn beside the spectrum, the
        largest of several outputs.
    axes : sequence of matplotlib Axes, optional
        Two per input: course, spectrum. A figure is made when left out.

    Returns
    -------
    Panels
        The axes.

    Examples
    --------
    >>> from tridentify.excitation import doublet
    >>> axes = plot_excitation(doublet(0.1, 0.5, dt=0.1, tail=2.0))
    >>> [ax.get_xlabel() for ax in axes]
    ['time [s]', 'angular frequency [rad/s]']
    """
    checked(excitation, Excitation, "plot_excitation(excitation)")
    plant = None if model is None else _plant(model)
    drawn = make_axes(axes, [1.6, 2.2] * excitation.n_inputs)
    omega, lines = excitation.spectrum()
    units = excitation.units or {}
    for j, name in enumerate(excitation.input_names):
        course, spectrum = drawn[2 * j : 2 * j + 2]
        _draw_course(course, excitation, j)
        title = literal(excitation.what) if j == 0 else ""
        dress(course, title=title, xlabel="time [s]", ylabel=labelled(name, units))
        _draw_lines(spectrum, omega[1:], lines[1:, j], excitation.period > 0)
        label = f"amplitude of\n{labelled(name, units)}"
        dress(spectrum, xlabel="angular frequency [rad/s]", ylabel=label)
        if plant is not None and j < plant.n_inputs:
            _draw_plant(spectrum, plant, j)
    return drawn


def plot_spectrum(
    spectrum: Spectrum | Excitation,
    model: TransferFunction | Estimate | None = None,
    *,
    axes: Sequence[Axes] | None = None,
) -> Panels:
    """Draw an optimal spectrum: power by line, its certificate, and the plant's response.

    Parameters
    ----------
    spectrum : Spectrum or Excitation
        An excitation is drawn by `plot_excitation`.
    model : TransferFunction or Estimate, optional
        Whose response is drawn; by default that for which the spectrum is optimal.
    axes : sequence of matplotlib Axes, optional
        Two per input: power with the plant's response, and the slope, which is nowhere above one if
        the spectrum is optimal. A figure is made when left out.

    Returns
    -------
    Panels
        The axes.

    Examples
    --------
    >>> from tridentify.excitation import optimal_spectrum
    >>> best = optimal_spectrum(TransferFunction([2.0], [1.0, 1.0, 9.0]))
    >>> len(plot_spectrum(best))
    2
    """
    if isinstance(spectrum, Excitation):
        return plot_excitation(spectrum, model, axes=axes)
    checked(spectrum, Spectrum, "plot_spectrum(optimal_spectrum(model))")
    plant = spectrum.model if model is None else _plant(model)
    inputs = spectrum.power.shape[1]
    drawn = make_axes(axes, [2.1, 1.5] * inputs)
    wanted = ", ".join(spectrum.coefficients)
    if len(wanted) > LONGEST_TITLE:
        wanted = f"{len(spectrum.coefficients)} coefficients"
    for j, name in enumerate(spectrum.model.input_names):
        power, slope = drawn[2 * j : 2 * j + 2]
        ends = (float(spectrum.omega[0]), float(spectrum.omega[-1]))
        own = [(omega, share) for omega, source, share in spectrum.support if source == j]
        shares = np.array([share for _, share in own])
        power.vlines([omega for omega, _ in own], 0.0, 100 * shares, color=BLUE, linewidth=2.5)
        power.plot([omega for omega, _ in own], 100 * shares, "o", color=BLUE, markersize=5)
        power.set_ylim(0.0, 112.0 * max(shares, default=1.0))
        power.set_xscale("log")
        power.set_xlim(*ends)
        title = f"optimal spectrum ({spectrum.criterion})" if j == 0 else ""
        dress(power, title=title, ylabel=literal(f"power of {name}\n[%]"))
        _draw_plant(power, plant, j)
        slope.axhline(1.0, color=GREY, linewidth=1.0, linestyle="--")
        slope.plot(spectrum.omega, spectrum.slopes[:, j], color=ORANGE, linewidth=1.4)
        slope.set_xscale("log")
        slope.set_xlim(*ends)
        slope.set_ylim(0.0, 1.12 * max(float(spectrum.slopes[:, j].max()), 1.0))
        title = literal(f"for {wanted}") if j == 0 else ""
        label = "slope\n(optimal: at most 1)"
        dress(slope, title=title, xlabel="angular frequency [rad/s]", ylabel=label)
    return drawn


def _plant(model: TransferFunction | Estimate) -> TransferFunction:
    (entry,) = entries_of([model], example="plot_excitation(excitation, model)")
    return entry.model


def _draw_course(ax: Axes, excitation: Excitation, j: int) -> None:
    """Held inputs as steps, the last one to its end."""
    t, u = excitation.t, excitation.u[:, j]
    held = excitation.intersample == "zoh"
    if held:
        t, u = np.append(t, excitation.duration), np.append(u, u[-1])
    style = "steps-post" if held else "default"
    ax.plot(*shorten(t, u), color=GREEN, linewidth=1.0, drawstyle=style)
    ax.set_xlim(0.0, excitation.duration)


def _draw_lines(ax: Axes, omega: Array, lines: Array, periodic: bool) -> None:
    """Lines of a periodic signal where they are few, else a curve; both axes logarithmic."""
    top = float(lines.max())
    ax.set_xscale("log")
    ax.set_yscale("log")
    there = lines > VISIBLE * top
    if periodic and np.sum(there) <= 60:
        ax.vlines(omega[there], VISIBLE * top, lines[there], color=BLUE, linewidth=1.6)
        ax.plot(omega[there], lines[there], "o", color=BLUE, markersize=3.5)
    else:
        ax.plot(*shorten(omega, np.where(lines > 0, lines, np.nan)), color=BLUE, linewidth=1.0)
    seen = omega[there]
    ax.set_xlim(seen[0] / 1.6, min(seen[-1] * 1.6, omega[-1]))
    ax.set_ylim(0.7 * VISIBLE * top if not periodic else VISIBLE * top, 2.0 * top)


def _draw_plant(ax: Axes, plant: TransferFunction, j: int) -> None:
    """Magnitude of the response to one input, on an axis of its own on the right."""
    low, high = ax.get_xlim()
    grid = np.geomspace(low, high, 400)
    response = np.abs(plant.frequency_response(grid)[:, :, j]).max(axis=1)
    with np.errstate(divide="ignore"):
        decibels = 20.0 * np.log10(response)
    right = ax.twinx()
    right.plot(grid, decibels, color=ORANGE, linewidth=1.2, linestyle="--", label="plant")
    ax.plot([], [], color=BLUE, linewidth=1.6, label="input")
    ax.plot([], [], color=ORANGE, linewidth=1.2, linestyle="--", label="plant")
    legend(ax)
    right.set_ylabel("plant [dB]", fontsize=9, color=ORANGE)
    right.tick_params(labelsize=9, colors=ORANGE)
    right.spines["top"].set_visible(False)
