"""Picture of the frequency response with its confidence band."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from tridentify.estimation.answer.estimate import Estimate
from tridentify.judgement.advice import FrequencyResponse
from tridentify.numerics.arrays import Array
from tridentify.plots.measured import draw_measured, whole_turns
from tridentify.plots.over_time import wrapped
from tridentify.plots.style import BLUE, channel, dress, legend, literal, make_axes
from tridentify.uncertainty import response_band, sample, sampled_response_band
from tridentify.writing.layout import IN_PICTURES, short, unit_ratio

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def plot_bode(
    estimate: Estimate,
    *,
    omega: npt.ArrayLike | None = None,
    level: float = 0.95,
    measured: FrequencyResponse | None = None,
    axes: Sequence[Axes] | None = None,
) -> list[Axes]:
    """Draw magnitude and phase of every channel with a pointwise confidence band.

    Parameters
    ----------
    estimate : Estimate
    omega : array_like, shape (n_omega,), optional
        Angular frequencies [rad/s]; by default around the poles and zeros, up to the Nyquist
        frequency of the record.
    level : float
        Probability that the band holds at each frequency. Of a posterior mean the band lies
        between quantiles of its draws.
    measured : FrequencyResponse, optional
        What the record shows without a model (`tridentify.judgement.advice.frequency_response`):
        points with 95 % error bars where the coherence is good, faded elsewhere, and the excited
        band shaded.
    axes : sequence of matplotlib Axes, optional
        Two per channel (magnitude, phase), outputs in the outer loop. A figure is made when left
        out.

    Returns
    -------
    list of matplotlib Axes
    """
    grid = default_frequencies(estimate) if omega is None else np.asarray(omega, dtype=np.float64)
    band = (
        sampled_response_band(sample(estimate), grid, level=level)
        if len(estimate.draws)
        else response_band(estimate, grid, level=level)
    )
    known = bool(len(estimate.draws)) or bool(np.all(np.isfinite(estimate.cov)))
    n_outputs, n_inputs = len(estimate.output_names), len(estimate.input_names)
    drawn = make_axes(axes, [1.7, 1.4] * (n_outputs * n_inputs), sharex=True)
    for k in range(n_outputs * n_inputs):
        i, j = divmod(k, n_inputs)
        output, input_ = estimate.output_names[i], estimate.input_names[j]
        with np.errstate(divide="ignore"):
            decibels = [
                20 * np.log10(part[:, i, j])
                for part in (band.magnitude, band.magnitude_low, band.magnitude_high)
            ]
        turned = whole_turns(np.degrees(band.phase[:, i, j]))
        degrees = [
            np.degrees(part[:, i, j]) + turned
            for part in (band.phase, band.phase_low, band.phase_high)
        ]
        magnitude, phase = drawn[2 * k : 2 * k + 2]
        _draw(magnitude, grid, decibels, level, least_reach=10.0, known=known)
        _draw(phase, grid, degrees, level, least_reach=45.0, known=known)
        if measured is not None:
            _draw_behind(magnitude, phase, measured, (i, j), grid, degrees[0])
        unit = ""
        if output in estimate.units and input_ in estimate.units:
            unit = unit_ratio(estimate.units[output], estimate.units[input_])
        reference = f" re {short(unit, IN_PICTURES)}" if unit not in ("", "-") else ""
        dress(
            magnitude,
            title=literal(wrapped(channel(estimate, i, j))),
            ylabel=literal(f"magnitude\n[dB{reference}]"),
        )
        _degree_ticks(phase)
        dress(phase, ylabel="phase [deg]")
        if k == 0:
            legend(magnitude)
    drawn[-1].set_xlabel("angular frequency [rad/s]", fontsize=9)
    return drawn


def _draw_behind(
    magnitude: Axes,
    phase: Axes,
    measured: FrequencyResponse,
    channel_: tuple[int, int],
    grid: Array,
    degrees: Array,
) -> None:
    """Measured points behind the model's lines; they widen the scale, but not by far."""
    limits = [ax.get_xlim() for ax in (magnitude, phase)]
    scales = [ax.get_ylim() for ax in (magnitude, phase)]
    known = np.isfinite(degrees)
    nearby = np.interp(np.log(measured.omega), np.log(grid[known]), degrees[known])
    draw_measured(magnitude, phase, measured, *channel_, nearby)
    good = measured.good[:, channel_[0], channel_[1]]
    good = good & (measured.omega >= grid[0]) & (measured.omega <= grid[-1])
    response = measured.response[good, channel_[0], channel_[1]]
    turned = np.degrees(np.angle(response))
    turned = turned + 360.0 * np.round((nearby[good] - turned) / 360.0)
    for ax, values, (left, right), (low, high) in zip(
        (magnitude, phase),
        (20.0 * np.log10(np.maximum(np.abs(response), 1e-300)), turned),
        limits,
        scales,
        strict=True,
    ):
        ax.set_xlim(left, right)
        reach = 0.5 * (high - low)
        bottom = max(float(np.min(values, initial=low)), low - reach)
        top = min(float(np.max(values, initial=high)), high + reach)
        margin = 0.04 * (top - bottom)
        ax.set_ylim(bottom - margin * (bottom < low), top + margin * (top > high))


def default_frequencies(estimate: Estimate, n_points: int = 240) -> Array:
    """Logarithmic grid around poles and zeros, finer at resonances.

    Parameters
    ----------
    estimate : Estimate
    n_points : int
        Size of the logarithmic part.

    Returns
    -------
    ndarray
        Increasing angular frequencies [rad/s].
    """
    rows = zip(estimate.model.num, estimate.model.den, strict=True)
    pairs = [pair for nums, dens in rows for pair in zip(nums, dens, strict=True)]
    roots = np.concatenate([np.roots(part) for pair in pairs for part in pair])
    sizes = np.abs(roots)
    sizes = sizes[sizes > 1e-9 * np.max(sizes, initial=0.0)]
    nyquist = np.pi / estimate.dt if estimate.dt else np.inf
    centre = np.median(sizes) if sizes.size else 1.0
    low, high = np.min(sizes, initial=centre) / 10, np.max(sizes, initial=centre) * 10
    high = max(min(high, nyquist), low * 100)
    grid = [np.geomspace(low, high, n_points)]
    for root in roots[(roots.imag > 0) & (np.abs(roots.real) < 0.3 * np.abs(roots))]:
        width = max(abs(root.real), 1e-4 * abs(root))
        grid.append(root.imag + width * np.linspace(-6, 6, 61))
    union: Array = np.unique(np.concatenate(grid))
    inside: Array = union[(union >= low) & (union <= high)]
    return inside


def _draw(
    ax: Axes,
    omega: Array,
    parts: list[Array],
    level: float,
    *,
    least_reach: float,
    known: bool = True,
) -> None:
    """Line and band; the scale follows the line, so that a wide band does not flatten it."""
    line, low, high = (np.where(np.isfinite(part), part, np.nan) for part in parts)
    if known:
        label = f"{100 * level:.3g} % band"
        ax.fill_between(omega, low, high, color=BLUE, alpha=0.25, linewidth=0, label=label)
    else:
        low, high = line, line
    ax.plot(omega, line, color=BLUE, linewidth=1.5, label="model")
    ax.set_xscale("log")
    ax.set_xlim(omega[0], omega[-1])
    if np.any(np.isfinite(line)):
        bottom, top = np.nanmin(line), np.nanmax(line)
        reach = max(0.5 * (top - bottom), least_reach)
        lowest = np.nanmin(low) if np.any(np.isfinite(low)) else bottom
        highest = np.nanmax(high) if np.any(np.isfinite(high)) else top
        margin = max(0.06 * (top - bottom), 0.1 * least_reach)
        floor, ceiling = max(lowest, bottom - reach), min(highest, top + reach)
        ax.set_ylim(floor - margin, ceiling + margin)


def _degree_ticks(ax: Axes) -> None:
    from matplotlib.ticker import MultipleLocator

    bottom, top = ax.get_ylim()
    steps = (5, 15, 30, 45, 90, 180, 360)
    fitting = [step for step in steps if (top - bottom) / step <= 5.5]
    ax.yaxis.set_major_locator(MultipleLocator(fitting[0] if fitting else 720))
