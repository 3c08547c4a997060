"""Picture of what a validation tests: correlations with their bounds, distribution, course."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtri

from tridentify.judgement.validation.result import CrossCorrelation, Validation, Whiteness
from tridentify.numerics.arrays import Array
from tridentify.plots import style
from tridentify.writing.layout import p_in_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes


HEIGHT, SQUARE = 1.5, 2.2
"""Inches of a panel over time or lag, and of the square one."""
WINDOWS = 20
"""Of the running spread: each has a twentieth of the record,"""
FEWEST = 9
"""and at least this many samples."""
MOST_POINTS = 2000
"""Of the quantiles: more are drawn over each other."""
LONG_NAME = 22
"""Letters of a channel that fit beside a panel."""
GAP = 0.06
"""Between experiments that stand beside each other, as a share of one."""
MOST_TICKS = 9
"""Of the time axis, all experiments together."""
MOST_NUMBERED = 4
"""Experiments beside each other that leave room for a word."""

UNTESTED = "no correlation is shown: what is left is rounding, or a predictor's (see the notes)"


def plot_residual_tests(
    validation: Validation, *, axes: Sequence[Axes] | None = None
) -> style.Panels:
    """Draw what the verdict on an estimate rests on.

    Parameters
    ----------
    validation : Validation
    axes : sequence of matplotlib Axes, optional
        For each output: one for its autocorrelation, one for each input, one for its distribution,
        one for its course. A figure is made when left out.

    Returns
    -------
    Panels
        The axes.

    Raises
    ------
    OptionError
        Not as many axes as the picture needs.

    Notes
    -----
    The shaded bounds hold at each lag by itself, for the residual of a fit and for inputs that are
    correlated with their own past. Among many lags some lie outside by chance: the verdict is that
    of the joint tests (`Validation.tests`).
    """
    style.checked(validation, Validation, "plot_residual_tests(validate(estimate, record))")
    n_inputs = len(validation.input_names)
    heights = [HEIGHT, *[HEIGHT] * n_inputs, SQUARE, HEIGHT] * len(validation.output_names)
    drawn = style.make_axes(axes, heights)
    each = n_inputs + 3
    for i, name in enumerate(validation.output_names):
        own = drawn[each * i : each * (i + 1)]
        if not validation.whiteness:
            for ax in own[:-1]:
                ax.set_axis_off()
            own[0].text(0.0, 0.5, UNTESTED, fontsize=9)
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
    return style.literal(name)


def _times(validation: Validation, lags: Array) -> tuple[Array, str]:
    if not validation.uneven:
        return lags, "lag [s]"
    return lags, "lag [samples, as seconds of the typical step]"


def _stems(ax: Axes, lags: Array, values: Array, bound: Array, level: float) -> None:
    """Values at lags over their bounds; those outside stand out."""
    label = f"{100 * level:g} % at each lag"
    ax.fill_between(
        lags, -bound, bound, step="mid", color=style.GREY, alpha=0.22, linewidth=0, label=label
    )
    out = np.abs(values) > bound
    width = float(np.clip(260.0 / max(lags.size, 1), 0.8, 3.0))
    ax.vlines(lags[~out], 0.0, values[~out], color=style.BLUE, linewidth=width)
    if out.any():
        ax.vlines(lags[out], 0.0, values[out], color=style.ORANGE, linewidth=width, label="outside")
    ax.axhline(0.0, color="black", linewidth=0.6)
    reach = 1.15 * max(2.0 * float(np.max(bound)), float(np.max(np.abs(values))), 1e-12)
    ax.set_ylim(-reach, reach)
    step = float(lags[1] - lags[0]) if lags.size > 1 else 1.0
    ax.set_xlim(float(lags[0]) - step, float(lags[-1]) + step)
    style.legend(ax, columns=2)


def _autocorrelation(ax: Axes, validation: Validation, one: Whiteness) -> None:
    lags, label = _times(validation, one.lags)
    _stems(ax, lags, one.autocorrelation, one.bound, validation.level)
    ax.set_xlim(left=0.0)
    style.dress(ax, xlabel=label, ylabel="correlation [-]")
    _title(ax, f"{_short(one.output)} with itself, {p_in_words(one.p_value)}")


def _cross_correlation(ax: Axes, validation: Validation, one: CrossCorrelation) -> None:
    lags, label = _times(validation, one.lags)
    _stems(ax, lags, one.correlation, one.bound, validation.level)
    ax.axvline(0.0, color="black", linewidth=0.6, linestyle=":")
    style.dress(ax, xlabel=f"{label}: input first to the right", ylabel="correlation [-]")
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
    ax.plot(expected, seen, ".", color=style.BLUE, markersize=3.5)
    ax.set_xlim(-reach, reach)
    style.legend(ax)
    style.dress(ax, xlabel="Gaussian quantile [standard deviations]", ylabel="residual / std [-]")
    one = validation.normality[i]
    _title(ax, f"{_short(one.output)}: distribution, {p_in_words(one.p_value)}")


def _course(ax: Axes, validation: Validation, i: int, name: str) -> None:
    """The residual over time with its moving level and twice its moving standard deviation."""
    starts = _beside(validation)
    for e, (t, residual) in enumerate(zip(validation.times, validation.residual, strict=True)):
        since = t - t[0] + starts[e]
        ax.plot(*style.course(since, residual[:, i]), color=style.BLUE, linewidth=0.6, alpha=0.8)
        at, level, scale = _moving(since, residual[:, i])
        first = e == 0
        ax.plot(at, level, color=style.ORANGE, linewidth=1.6, label="level" if first else "")
        band = "± 2 standard deviations" if first else ""
        ax.plot(at, level + 2 * scale, color="black", linewidth=1.0, linestyle="--", label=band)
        ax.plot(at, level - 2 * scale, color="black", linewidth=1.0, linestyle="--")
    style.legend(ax, columns=2)
    several = len(validation.times) > 1
    if several:
        _own_times(ax, validation, starts)
    unit = style.labelled("residual", {"residual": validation.units.get(name, "")})
    style.dress(ax, xlabel="time in each experiment [s]" if several else "time [s]", ylabel=unit)
    _title(ax, f"{_short(name)}: moving level and size")


def _beside(validation: Validation) -> list[float]:
    """Where each experiment begins on the axis [s]: one beside the other, a gap between them."""
    times = validation.times
    spans = [float(t[-1] - t[0]) for t in times]
    gap = GAP * sum(spans) / len(spans)
    starts = [float(times[0][0])]
    for span in spans[:-1]:
        starts.append(starts[-1] + span + gap)
    return starts


def _own_times(ax: Axes, validation: Validation, starts: list[float]) -> None:
    """Time of its own, and a number, for each experiment."""
    from matplotlib.ticker import MaxNLocator

    places, labels = [], []
    each = max(MOST_TICKS // len(starts), 1)
    for e, (t, start) in enumerate(zip(validation.times, starts, strict=True)):
        ticks = MaxNLocator(each).tick_values(t[0], t[-1])
        inside = ticks[(ticks >= t[0]) & (ticks < t[-1] - 0.05 * (t[-1] - t[0]))]
        places += [float(tick - t[0]) + start for tick in inside]
        labels += [f"{tick:.6g}" for tick in inside]
        if len(starts) <= MOST_NUMBERED:
            ax.text(
                start, 0.98, f"experiment {e + 1}", transform=ax.get_xaxis_transform(),
                fontsize=8, va="top", color=style.GREY,
            )  # fmt: skip
        if e:
            edge = 0.5 * (start + starts[e - 1] + float(np.ptp(validation.times[e - 1])))
            ax.axvline(edge, color=style.GREY, linewidth=0.8)
    ax.set_xticks(places, labels)


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
