"""Picture of the frequency response with its confidence band."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from tridentify.errors import SampleTypeError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.parameter import checked_level
from tridentify.judgement.advice import FrequencyResponse
from tridentify.judgement.comparison.entries import Models
from tridentify.numerics.arrays import Array
from tridentify.plots import style
from tridentify.plots.lines import Line, band_label, frequencies, lines_of, named_first
from tridentify.plots.measured import draw_measured, whole_turns
from tridentify.plots.over_time import wrapped
from tridentify.uncertainty import ResponseBand, response_band, sample, sampled_response_band
from tridentify.writing.layout import IN_PICTURES, short

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Parts = tuple[Array, Array, Array]
"""A line with the lower and the upper end of its band."""


def plot_bode(
    models: Models,
    omega: npt.ArrayLike | None = None,
    *,
    names: Sequence[str] | None = None,
    level: float = 0.95,
    measured: FrequencyResponse | None = None,
    axes: Sequence[Axes] | None = None,
) -> style.Panels:
    """Draw magnitude and phase of every channel with a pointwise confidence band.

    Parameters
    ----------
    models : Estimate, TransferFunction, sequence of these, or mapping of names to them
        Of the same channels. A transfer function has no band.
    omega : array_like, shape (n_omega,), optional
        Angular frequencies [rad/s]; by default around the poles and zeros, up to the Nyquist
        frequency of the record.
    names : sequence of str, optional
        One a model, for the legend; by default the keys of a mapping, the orders where they differ,
        else the methods.
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
    Panels
        The axes.

    Raises
    ------
    SampleTypeError, ChannelNameError
        Something is no model, or the models have different channels.
    OptionError
        The level is no probability, ``omega`` no frequencies, or there are not as many axes.

    Examples
    --------
    >>> from tridentify import TransferFunction
    >>> pair = {"stiff": TransferFunction([9.0], [1.0, 1.0, 9.0]),
    ...         "soft": TransferFunction([4.0], [1.0, 1.0, 4.0])}
    >>> magnitude, phase = plot_bode(pair)
    >>> [line.get_label() for line in magnitude.lines]
    ['stiff', 'soft']
    """
    lines = lines_of(models, names, "plot_bode(estimate) or plot_bode([one, other])", axes)
    if not (measured is None or isinstance(measured, FrequencyResponse)):
        raise SampleTypeError(
            f"found {type(measured).__name__} in place of a measured frequency response; expected "
            "what frequency_response gives; write measured=frequency_response(record)"
        )
    grid = default_frequencies(*lines) if omega is None else frequencies(omega, EXAMPLE)
    bands = [_band(line, grid, level) for line in lines]
    named = named_first(lines)
    n_outputs, n_inputs = len(named.output_names), len(named.input_names)
    drawn = style.make_axes(axes, [1.7, 1.4] * (n_outputs * n_inputs), sharex=True)
    for k in range(n_outputs * n_inputs):
        i, j = divmod(k, n_inputs)
        magnitude, phase = drawn[2 * k : 2 * k + 2]
        degrees = _on_one_branch([_degrees(band, (i, j)) for band in bands])
        decibels = [_decibels(band, (i, j)) for band in bands]
        _draw(magnitude, grid, lines, decibels, level, least_reach=10.0)
        _draw(phase, grid, lines, degrees, level, least_reach=45.0)
        if measured is not None:
            _draw_behind(magnitude, phase, measured, (i, j), grid, degrees[0][0])
        _name_magnitude(magnitude, named, (i, j))
        _degree_ticks(phase)
        style.dress(phase, ylabel="phase [deg]")
    style.legend(drawn[0], columns=style.legend_columns(drawn[0]))
    drawn[-1].set_xlabel("angular frequency [rad/s]", fontsize=9)
    return drawn


EXAMPLE = "plot_bode([one, other], omega)"

BELOW = 3.0
"""Ratio of half a turn in a whole record, the slowest that it shows, to where a picture begins."""


def draw_magnitudes(
    ax: Axes, lines: Sequence[Line], grid: Array, channel_: tuple[int, int], level: float
) -> None:
    """Magnitudes of one channel of several models, with their bands, by themselves.

    Parameters
    ----------
    ax : matplotlib Axes
    lines : sequence of Line
    grid : ndarray, shape (n_omega,)
        [rad/s].
    channel_ : (int, int)
        Output and input.
    level : float
        Of the bands.
    """
    decibels = [_decibels(_band(line, grid, level), channel_) for line in lines]
    _draw(ax, grid, lines, decibels, level, least_reach=10.0)
    _name_magnitude(ax, named_first(lines), channel_)


def _decibels(band: ResponseBand, channel_: tuple[int, int]) -> Parts:
    own = (slice(None), *channel_)
    line, low, high = (
        part[own] for part in (band.magnitude, band.magnitude_low, band.magnitude_high)
    )
    with np.errstate(divide="ignore"):
        return 20 * np.log10(line), 20 * np.log10(low), 20 * np.log10(high)


def _degrees(band: ResponseBand, channel_: tuple[int, int]) -> Parts:
    own = (slice(None), *channel_)
    line, low, high = (part[own] for part in (band.phase, band.phase_low, band.phase_high))
    return np.degrees(line), np.degrees(low), np.degrees(high)


def _band(line: Line, grid: Array, level: float) -> ResponseBand:
    """Response with its band; nan for the band of a model without standard errors."""
    estimate = line.estimate
    if estimate is not None and len(line.draws):
        return sampled_response_band(sample(estimate), grid, level=level)
    if estimate is not None and np.all(np.isfinite(estimate.cov)):
        return response_band(estimate, grid, level=level)
    checked_level(level)
    response = line.model.frequency_response(grid)
    nothing = np.full(response.shape, np.nan)
    phase = np.unwrap(np.angle(response), axis=0)
    return ResponseBand(grid, np.abs(response), nothing, nothing, phase, nothing, nothing, level)


def _on_one_branch(degrees: Sequence[Parts]) -> list[Parts]:
    """Phases of the first model on the branch of all channels, the others near it."""
    found: list[Parts] = []
    for line, low, high in degrees:
        turned = whole_turns(line)
        if found:
            apart = found[0][0] - line
            apart = apart[np.isfinite(apart)]
            turned = 360.0 * float(np.round(np.median(apart) / 360.0)) if apart.size else 0.0
        found.append((line + turned, low + turned, high + turned))
    return found


def _name_magnitude(magnitude: Axes, named: Line, channel_: tuple[int, int]) -> None:
    unit = style.channel_unit(named, *channel_)
    reference = f" re {short(unit, IN_PICTURES)}" if unit not in ("", "-") else ""
    style.dress(
        magnitude,
        title=style.literal(wrapped(style.channel(named, *channel_))),
        ylabel=style.literal(f"magnitude\n[dB{reference}]"),
    )


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


def default_frequencies(*models: style.Shown, n_points: int = 240) -> Array:
    """Logarithmic grid around poles and zeros of all models, finer at resonances.

    It begins no lower than a little below what the longest record shows: where a pole of a plant
    that all but integrates may lie says nothing of what was seen.

    Parameters
    ----------
    *models : Estimate or Line
    n_points : int
        Size of the logarithmic part.

    Returns
    -------
    ndarray
        Increasing angular frequencies [rad/s].
    """
    parts = [
        p for one in models for rows in (one.model.num, one.model.den) for r in rows for p in r
    ]
    roots = np.concatenate([np.roots(part) for part in parts])
    sizes = np.abs(roots)
    sizes = sizes[sizes > 1e-9 * np.max(sizes, initial=0.0)]
    nyquist = max(np.pi / one.dt if one.dt else np.inf for one in models)
    centre = np.median(sizes) if sizes.size else 1.0
    low, high = np.min(sizes, initial=centre) / 10, np.max(sizes, initial=centre) * 10
    seen = min((_seen_from(one) for one in models), default=0.0)
    if low < seen:
        low, high = seen, max(high, seen * 1000.0)
    high = max(min(high, nyquist), low * 100)
    grid = [np.geomspace(low, high, n_points)]
    for root in roots[(roots.imag > 0) & (np.abs(roots.real) < 0.3 * np.abs(roots))]:
        width = max(abs(root.real), 1e-4 * abs(root))
        grid.append(root.imag + width * np.linspace(-6, 6, 61))
    union: Array = np.unique(np.concatenate(grid))
    inside: Array = union[(union >= low) & (union <= high)]
    return inside


def _seen_from(model: style.Shown) -> float:
    """Lowest frequency of a picture of an identified model [rad/s]; zero where nothing tells."""
    estimate = model if isinstance(model, Estimate) else getattr(model, "estimate", None)
    if estimate is None or not estimate.dt:
        return 0.0
    # experiments have about the same length, as far as an estimate knows
    duration = estimate.n_samples * estimate.dt / max(len(estimate.nuisance), 1)
    return float(np.pi / duration / BELOW)


def _draw(
    ax: Axes,
    omega: Array,
    lines: Sequence[Line],
    courses: Sequence[Parts],
    level: float,
    *,
    least_reach: float,
) -> None:
    """Lines and bands of all models, on a scale that shows every line."""
    ends, sides = ([ax.get_ylim()], [ax.get_xlim()]) if ax.lines else ([], [])
    for own, course in zip(lines, courses, strict=True):
        line, low, high = (np.where(np.isfinite(part), part, np.nan) for part in course)
        if np.any(np.isfinite(low)):
            ax.fill_between(
                omega, low, high, color=own.colour, alpha=own.opacity, linewidth=0,
                label=band_label(ax, level),
            )  # fmt: skip
        ax.plot(
            omega, line, color=own.colour, linestyle=own.dash, linewidth=1.5,
            label=style.literal(own.label),
        )  # fmt: skip
        if np.any(np.isfinite(line)):
            ends.append(_scale(line, low, high, least_reach))
    ax.set_xscale("log")
    if omega[0] < omega[-1]:
        sides.append((float(omega[0]), float(omega[-1])))
        ax.set_xlim(min(left for left, _ in sides), max(right for _, right in sides))
    if ends:
        ax.set_ylim(min(low for low, _ in ends), max(high for _, high in ends))


def _scale(line: Array, low: Array, high: Array, least_reach: float) -> tuple[float, float]:
    """Ends that follow the line, so that a wide band does not flatten it."""
    bottom, top = np.nanmin(line), np.nanmax(line)
    reach = max(0.5 * (top - bottom), least_reach)
    lowest = np.nanmin(low) if np.any(np.isfinite(low)) else bottom
    highest = np.nanmax(high) if np.any(np.isfinite(high)) else top
    margin = max(0.06 * (top - bottom), 0.1 * least_reach)
    floor, ceiling = max(lowest, bottom - reach), min(highest, top + reach)
    return float(floor - margin), float(ceiling + margin)


def _degree_ticks(ax: Axes) -> None:
    from matplotlib.ticker import MultipleLocator

    bottom, top = ax.get_ylim()
    steps = (5, 15, 30, 45, 90, 180, 360)
    fitting = [step for step in steps if (top - bottom) / step <= 5.5]
    ax.yaxis.set_major_locator(MultipleLocator(fitting[0] if fitting else 720))
