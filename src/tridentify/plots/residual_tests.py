"""Picture of what a validation tests: correlations with their bounds, distribution, course."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtri

from tridentify.judgement.validation.result import CrossCorrelation, Validation, Whiteness
from tridentify.numerics.arrays import Array
from tridentify.plots.style import (
    BLUE,
    GREY,
    ORANGE,
    course,
    dress,
    labelled,
    legend,
    literal,
    make_axes,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes


HEIGHT, SQUARE = 1.5, 2.2
WINDOWS = 20
FEWEST = 9
MOST_POINTS = 2000
LONG_NAME = 22


def plot_residual_tests(
    validation: Validation, *, axes: Sequence[Axes] | None = None
) -> list[Axes]:
    """Draw what the verdict on an estimate rests on.

    Parameters
    ----------
    validation : Validation
    axes : sequence of matplotlib Axes, optional
        For each output: one for its autocorrelation, one for each input, one for its distribution,
        one for its course. A figure is made when left out.

    Returns
    -------
    list of matplotlib Axes

    Raises
    ------
    ValueError
        Not as many axes as the picture needs.

    Notes
    -----
    The shaded bounds hold at each lag by itself, for the residual of a fit and for inputs that are
    correlated with their own past. Among many lags some lie outside by chance: the verdict is that
    of the joint tests (`Validation.tests`).
    """
    n_inputs = len(validation.input_names)
    heights = [HEIGHT, *[HEIGHT] * n_inputs, SQUARE, HEIGHT] * len(validation.output_names)
    drawn = make_axes(axes, heights)
    each = n_inputs + 3
    for i, name in enumerate(validation.output_names):
        own = drawn[each * i : each * (i + 1)]
        if not validation.whiteness:
            for ax in own[:-1]:
                ax.set_axis_off()
            own[0].text(0.0, 0.5, "a residual that is rounding is not tested", fontsize=9)
        else:
            _autocorrelation(own[0], validation, validation.whiteness[i])
            for j in range(n_inputs):
                picture = validation.cross_correlation[n_inputs * i + j]
                _cross_correlation(own[1 + j], validation, picture)
            _quantiles(own[-2], validation, i)
        _course(own[-1], validation, i, name)
    return drawn


def _short(name: str) -> str:
    """A name that fits beside others in a title."""
    if len(name) > LONG_NAME:
        name = f"{name[: LONG_NAME - 9]}…{name[-8:]}"
    return literal(name)


def _times(validation: Validation, lags: Array) -> tuple[Array, str]:
    if not validation.uneven:
        return lags, "lag [s]"
    return lags, "lag [samples, as seconds of the typical step]"


def _stems(ax: Axes, lags: Array, values: Array, bound: Array, level: float) -> None:
    """Values at lags over their bounds; those outside stand out."""
    label = f"{100 * level:g} % at each lag"
    ax.fill_between(
        lags, -bound, bound, step="mid", color=GREY, alpha=0.22, linewidth=0, label=label
    )
    out = np.abs(values) > bound
    width = float(np.clip(260.0 / max(lags.size, 1), 0.8, 3.0))
    ax.vlines(lags[~out], 0.0, values[~out], color=BLUE, linewidth=width)
    if out.any():
        ax.vlines(lags[out], 0.0, values[out], color=ORANGE, linewidth=width, label="outside")
    ax.axhline(0.0, color="black", linewidth=0.6)
    reach = 1.15 * max(2.0 * float(np.max(bound)), float(np.max(np.abs(values))), 1e-12)
    ax.set_ylim(-reach, reach)
    step = float(lags[1] - lags[0]) if lags.size > 1 else 1.0
    ax.set_xlim(float(lags[0]) - step, float(lags[-1]) + step)
    legend(ax, columns=2)


def _autocorrelation(ax: Axes, validation: Validation, one: Whiteness) -> None:
    lags, label = _times(validation, one.lags)
    _stems(ax, lags, one.autocorrelation, one.bound, validation.level)
    ax.set_xlim(left=0.0)
    dress(ax, xlabel=label, ylabel="correlation [-]")
    _title(ax, f"{_short(one.output)} with itself, p = {one.p_value:.2g}")


def _cross_correlation(ax: Axes, validation: Validation, one: CrossCorrelation) -> None:
    lags, label = _times(validation, one.lags)
    _stems(ax, lags, one.correlation, one.bound, validation.level)
    ax.axvline(0.0, color="black", linewidth=0.6, linestyle=":")
    dress(ax, xlabel=f"{label}: input first to the right", ylabel="correlation [-]")
    _title(ax, f"{_short(one.output)} with {_short(one.input)}")


def _title(ax: Axes, text: str) -> None:
    """A title above the legend, so that neither is cut."""
    ax.set_title(text, loc="left", fontsize=10, pad=20)


def _quantiles(ax: Axes, validation: Validation, i: int) -> None:
    joined = np.concatenate([one[:, i] for one in validation.innovations])
    seen = np.sort(joined[np.isfinite(joined)])
    n = seen.size
    expected = ndtri((np.arange(1, n + 1) - 0.375) / (n + 0.25))
    if n > MOST_POINTS:
        middle = np.linspace(100, n - 101, MOST_POINTS - 200).astype(int)
        kept = np.concatenate([np.arange(100), middle, np.arange(n - 100, n)])
        seen, expected = seen[kept], expected[kept]
    reach = 1.05 * float(max(np.max(np.abs(expected)), 1.0))
    ax.plot([-reach, reach], [-reach, reach], color="black", linewidth=0.8, label="Gaussian")
    ax.plot(expected, seen, ".", color=BLUE, markersize=3.5)
    ax.set_xlim(-reach, reach)
    legend(ax)
    dress(ax, xlabel="Gaussian quantile [standard deviations]", ylabel="residual / std [-]")
    one = validation.normality[i]
    _title(ax, f"{_short(one.output)}: distribution, p = {one.p_value:.2g}")


def _course(ax: Axes, validation: Validation, i: int, name: str) -> None:
    """The residual over time with its moving level and twice its moving standard deviation."""
    shift = 0.0
    for e, (t, residual) in enumerate(zip(validation.times, validation.residual, strict=True)):
        since = t if len(validation.times) == 1 else t - t[0] + shift
        ax.plot(*course(since, residual[:, i]), color=BLUE, linewidth=0.6, alpha=0.8)
        at, level, scale = _moving(since, residual[:, i])
        first = e == 0
        ax.plot(at, level, color=ORANGE, linewidth=1.6, label="level" if first else "")
        band = "± 2 standard deviations" if first else ""
        ax.plot(at, level + 2 * scale, color="black", linewidth=1.0, linestyle="--", label=band)
        ax.plot(at, level - 2 * scale, color="black", linewidth=1.0, linestyle="--")
        shift = float(since[-1]) + 0.02 * float(t[-1] - t[0])
        if not first:
            ax.axvline(float(since[0]), color=GREY, linewidth=0.8)
    legend(ax, columns=2)
    several = ", one experiment after the other" if len(validation.times) > 1 else ""
    unit = labelled("residual", {"residual": validation.units.get(name, "")})
    dress(ax, xlabel=f"time [s]{several}", ylabel=unit)
    _title(ax, f"{_short(name)}: moving level and size")


def _moving(t: Array, values: Array) -> tuple[Array, Array, Array]:
    """Mean and standard deviation over a moving stretch."""
    there = np.isfinite(values)
    t, values = t[there], values[there]
    n = values.size
    width = min(max(n // WINDOWS, FEWEST), n)
    total = np.concatenate([[0.0], np.cumsum(values)])
    mean = (total[width:] - total[:-width]) / width
    # about the mean of all, so that no digits are lost
    centred = np.concatenate([[0.0], np.cumsum((values - values.mean()) ** 2)])
    square = (centred[width:] - centred[:-width]) / width - (mean - values.mean()) ** 2
    at = 0.5 * (t[width - 1 :] + t[: n - width + 1])
    return at, mean, np.sqrt(np.maximum(square, 0.0))
