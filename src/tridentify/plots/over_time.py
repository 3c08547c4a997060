"""What the pictures of responses over time have in common: how long to look, and how to draw.

Picture of the step response with its confidence band.

Picture of the impulse response with its confidence band.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tridentify.errors import OptionError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.parameter import checked_level
from tridentify.judgement.comparison.entries import Models
from tridentify.numerics import delta_method
from tridentify.numerics.arrays import Array
from tridentify.plots import style
from tridentify.plots.lines import Line, band_label, lines_of, named_first, numbers
from tridentify.transfer_function import TransferFunction
from tridentify.uncertainty import (
    ImpulseBand,
    StepBand,
    impulse_band,
    sample,
    sampled_impulse_band,
    sampled_step_band,
    step_band,
)
from tridentify.uncertainty.checks import checked_times
from tridentify.uncertainty.step import powers_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AT_ZERO = 1e-9
"""Of the largest pole, below which another is one at zero."""
SETTLE = 6.0
"""Time constants after which nothing moves any more."""
PERIODS = 12.0
"""Of a hardly damped oscillation."""
GROW = 3.0
"""Time constants of a growing response."""
POINTS = 300
"""In each stretch of the time axis."""
PER_PERIOD = 24.0
"""Points in the fastest period of a model: a polygon of 24 sides looks round."""
LEVEL = 0.95
"""Of the bands, where none is asked for."""
AIR = 0.6
"""How far a band may reach beyond the line, as a share of the line's range."""


def default_times(*shown: style.Shown, final: float | None = None) -> Array:
    """Times over which all models settle, finer at the beginning where one has fast modes.

    Parameters
    ----------
    *shown : Estimate or Line
    final : float, optional
        Where the times end instead [s].

    Returns
    -------
    ndarray
        Rising from zero [s]; of a few different steps only.
    """
    dens = [den for one in shown for row in one.model.den for den in row]
    poles = np.concatenate([np.roots(den) for den in dens])
    late = max(float(np.max(one.model.delay, initial=0.0)) for one in shown)
    far = AT_ZERO * np.abs(poles).max(initial=0.0)
    ends = np.sort([_shown(pole) for pole in poles[np.abs(poles) > far]])
    horizon = float(ends[-1]) if ends.size else max(map(_length, shown))
    horizon = horizon if final is None else final
    edges, steps = [0.0], [_step(poles, 0.0, horizon)]
    for end in ends[ends < horizon]:
        if end > 4.0 * edges[-1] and horizon > 4.0 * end:
            edges.append(float(end))
            steps.append(_step(poles, float(end), horizon))
    ends = np.append(edges[1:], horizon)
    times = [
        np.arange(first, last, min(step, (last - first) / POINTS))
        for first, last, step in zip(edges, ends, steps, strict=True)
    ]
    # by rounding the last of a range may lie at its end, or just beyond
    grid = np.concatenate(
        [*(one[one < last] for one, last in zip(times, ends, strict=True)), [horizon]]
    )
    if late:
        grid = np.concatenate([np.linspace(0.0, late, 20, endpoint=False), late + grid])
    return grid if final is None else np.append(grid[grid < final], final)


def _length(one: style.Shown) -> float:
    """Mean length of the experiments, where they are known [s]."""
    estimate = one if isinstance(one, Estimate) else getattr(one, "estimate", None)
    if estimate is None:
        return 1.0
    return float((estimate.dt or 1.0) * estimate.n_samples / max(len(estimate.nuisance), 1))


def _shown(pole: complex) -> float:
    """How long a mode is worth looking at [s]."""
    decay = abs(pole.real)
    enough = PERIODS * 2 * np.pi / abs(pole.imag) if pole.imag else np.inf
    wanted = (GROW if pole.real > 0 else SETTLE) / decay if decay > AT_ZERO * abs(pole) else np.inf
    return float(min(enough, wanted))


def _step(poles: npt.NDArray[np.complex128], start: float, horizon: float) -> float:
    """Step that shows the oscillations which are still there."""
    alive = [abs(p.imag) for p in poles if p.imag and _shown(p) > start * (1 + 1e-9)]
    fastest = max(alive, default=0.0)
    fine = 2 * np.pi / fastest / PER_PERIOD if fastest else np.inf
    return max(float(fine), horizon / (20 * POINTS))


SETTLED = 0.004
"""Of a response's range: within it, it counts as settled."""


def trimmed(t: Array, response: Array) -> int:
    """Number of times until every response stays at its last value.

    Parameters
    ----------
    t : ndarray, shape (n_times,)
    response : ndarray, shape (n_times, ...)

    Returns
    -------
    int
        A third more than needed, at most all.
    """
    flat = response.reshape(t.size, -1)
    with np.errstate(invalid="ignore"):
        moving = np.abs(flat - flat[-1]) > SETTLED * np.ptp(flat, axis=0)
    last = int(np.flatnonzero(moving.any(axis=1)).max(initial=0))
    return min(int(np.searchsorted(t, 1.35 * t[last])) + 2, t.size) if last else t.size


@dataclass(frozen=True, eq=False)
class Course:
    """Responses of one model over time, shape (n_times, n_outputs, n_inputs), with their band.

    ``low`` and ``high`` are nan for a model without standard errors.
    """

    line: Line
    response: Array
    low: Array
    high: Array


@dataclass(frozen=True)
class Reply:
    """What kind of response is drawn, and who works it out.

    Attributes
    ----------
    name : str
        ``plot_step`` or ``plot_impulse``, for messages.
    formula : callable
        As of `tridentify.uncertainty.step.over_time`: a model without standard errors.
    linear, sampled : callable
        The band of an estimate to first order, and from the draws of a posterior mean.
    to : str
        What it answers.
    power : int
        Of seconds, by which its unit is divided.
    """

    name: str
    formula: Callable[..., tuple[Array, Array]]
    linear: Callable[..., StepBand | ImpulseBand]
    sampled: Callable[..., StepBand | ImpulseBand]
    to: str
    power: int


@dataclass(frozen=True, eq=False)
class Courses:
    """Responses of all models of a picture: all numbers that drawing needs.

    Attributes
    ----------
    t : ndarray, shape (n_times,)
    each : sequence of Course
    """

    t: Array
    each: Sequence[Course]


def _courses(lines: Sequence[Line], t: npt.ArrayLike | None, level: float, reply: Reply) -> Courses:
    """Times and responses of every model, by default until all have settled."""
    checked_level(level)
    if t is not None:
        given = numbers("t", t, f"{reply.name}([one, other], t)")
        times = _until(lines, float(given[0])) if given.size == 1 else checked_times(given)
        return Courses(times, [_course(line, times, level, reply) for line in lines])
    times = default_times(*lines)
    found = [_course(line, times, level, reply) for line in lines]
    stop = max(trimmed(times, one.response) for one in found)
    each = [Course(one.line, one.response[:stop], one.low[:stop], one.high[:stop]) for one in found]
    return Courses(times[:stop], each)


def _until(lines: Sequence[Line], final: float) -> Array:
    """Times from zero to a final one, as ``step(sys, Tfinal)`` means a single number."""
    if final <= 0.0:
        raise OptionError(
            f"found t={final:.6g}; expected rising times, or one number above zero, the final time "
            "[s]; correct it"
        )
    return default_times(*lines, final=final)


def _course(line: Line, t: Array, level: float, reply: Reply) -> Course:
    if line.estimate is None:
        response = _response(line.model, t, reply.formula)
        nothing = np.full_like(response, np.nan)
        return Course(line, response, nothing, nothing)
    free = any(name.startswith("delay") for name in line.estimate.names)
    if len(line.draws) and not free:
        band = reply.sampled(sample(line.estimate), t, level)
    else:
        band = reply.linear(line.estimate, t, level)
    return Course(line, band.response, band.low, band.high)


def _response(model: TransferFunction, t: Array, formula: Callable[..., Any]) -> Array:
    """Responses of a model that has no standard errors, (n_times, n_outputs, n_inputs)."""
    response = np.empty((t.size, model.n_outputs, model.n_inputs))
    for i in range(model.n_outputs):
        for j in range(model.n_inputs):
            num, den = model.num[i][j], model.den[i][j]
            response[:, i, j] = formula(num, den, powers_of(den), t - model.delay[i, j])[0]
    return response


def replies_of(
    models: Models,
    reply: Reply,
    t: npt.ArrayLike | None = None,
    *,
    names: Sequence[str] | None = None,
    level: float = LEVEL,
    axes: Sequence[Axes] | Axes | None = None,
) -> Courses:
    """What one kind of reply comes to, as its picture is asked for; ``axes`` tell used colours."""
    example = f"{reply.name}(estimate) or {reply.name}([one, other])"
    return _courses(lines_of(models, names, example, axes), t, level, reply)


def _draw_replies(
    replies: Courses, level: float, reply: Reply, axes: Sequence[Axes] | Axes | None
) -> style.Panels:
    """The picture of one kind of reply but for its legend and what is particular to it."""
    model = replies.each[0].line.model
    drawn = style.make_axes(axes, [2.1] * (model.n_outputs * model.n_inputs))
    draw_courses(drawn, replies.t, replies.each, level, reply.power)
    drawn[-1].set_xlabel(f"time after the {reply.to} [s]", fontsize=9)
    return drawn


def draw_courses(
    drawn: Sequence[Axes], t: Array, courses: Sequence[Course], level: float, power: int
) -> None:
    """Draw every channel with the lines and bands of all models.

    Parameters
    ----------
    drawn : sequence of matplotlib Axes
        One a channel, outputs in the outer loop.
    t : ndarray, shape (n_times,)
    courses : sequence of Course
    level : float
        Of the bands.
    power : int
        Seconds in the unit's denominator.
    """
    named = named_first([course.line for course in courses])
    n_inputs = len(named.input_names)
    for k, ax in enumerate(drawn):
        i, j = divmod(k, n_inputs)
        limits = [(ax.get_xlim(), ax.get_ylim())] if ax.lines else []
        ends = [_draw_course(ax, t, course, (i, j), level) for course in courses]
        ax.axhline(0.0, color="black", linewidth=0.6)
        ax.set_xlim(t[0], max([t[-1], *(x[1] for x, _ in limits)]))
        ends += [y for _, y in limits]
        ax.set_ylim(min(low for low, _ in ends), max(high for _, high in ends))
        name_channel(ax, named, i, j, power)


def _draw_course(
    ax: Axes, t: Array, course: Course, channel_: tuple[int, int], level: float
) -> tuple[float, float]:
    """Line and band of one model; the scale that it wants, so that a wide band does not flatten."""
    part = (slice(None), *channel_)
    line, low, high = course.response[part], course.low[part], course.high[part]
    own = course.line
    sound = np.isfinite(low) & np.isfinite(high)
    if np.any(sound):
        label = band_label(ax, level)
        low, high = np.where(sound, low, np.nan), np.where(sound, high, np.nan)
        ax.fill_between(t, low, high, color=own.colour, alpha=own.opacity, linewidth=0, label=label)
    ax.plot(
        t, line, color=own.colour, linestyle=own.dash, linewidth=1.5, label=style.literal(own.label)
    )
    seen = line[np.isfinite(line)]
    if not seen.size:
        return -1.0, 1.0
    bottom, top = min(float(seen.min()), 0.0), max(float(seen.max()), 0.0)
    reach = (top - bottom) or 1.0
    floor, ceiling = bottom, top
    if np.any(sound):
        floor = max(bottom - AIR * reach, min(bottom, float(np.nanmin(low))))
        ceiling = min(top + AIR * reach, max(top, float(np.nanmax(high))))
    return floor - 0.06 * reach, ceiling + 0.06 * reach


def name_channel(ax: Axes, estimate: style.Shown, output: int, input_: int, power: int) -> None:
    """Title and label of one channel; its unit is that of the output over that of the input.

    Parameters
    ----------
    ax : matplotlib Axes
    estimate : Estimate or Line
    output, input_ : int
    power : int
        Seconds in the unit's denominator.
    """
    title = style.literal(wrapped(style.channel(estimate, output, input_)))
    unit = style.in_brackets(style.channel_unit(estimate, output, input_, power))
    style.dress(ax, title=title, ylabel=style.literal(f"response{unit}"))
    style.scientific(ax)


def wrapped(text: str, width: int = 60) -> str:
    r"""Long names on several lines, so that they stay within a figure.

    Examples
    --------
    >>> wrapped("pitch rate / elevator", 14)
    'pitch rate /\nelevator'
    """
    return "\n".join(textwrap.wrap(text, width)) or text


STEP = Reply("plot_step", delta_method.step_response, step_band, sampled_step_band, "step", 0)


def plot_step(
    models: Models,
    t: npt.ArrayLike | None = None,
    *,
    names: Sequence[str] | None = None,
    level: float = LEVEL,
    axes: Sequence[Axes] | Axes | None = None,
) -> style.Panels:
    """Draw the response to a unit step of each input, with a pointwise confidence band.

    Parameters
    ----------
    models : Estimate, TransferFunction, sequence of these, or mapping of names to them
        Of the same channels. A transfer function has no band.
    t : float or array_like, shape (n_times,), optional
        Final time, or rising times [s]; the step comes at zero. By default until the model has
        settled.
    names : sequence of str, optional
        One a model, for the legend; by default the keys of a mapping, the orders where they differ,
        else the methods.
    level : float
        Probability that the band holds at each time. Of a posterior mean the band lies between
        quantiles of its draws.
    axes : sequence of matplotlib Axes, or one, optional
        One per channel, outputs in the outer loop. A figure is made when left out.

    Returns
    -------
    Panels
        The axes.

    Raises
    ------
    OptionError
        The level is no probability, the times do not rise, or there are not as many axes as
        channels.
    SampleTypeError, ChannelNameError
        Something is no model, or the models have different channels.

    Notes
    -----
    The dashed line is the static gain, where the model has one.
    """
    replies = replies_of(models, STEP, t, names=names, level=level, axes=axes)
    return draw_step(replies, level=level, axes=axes)


def draw_step(
    replies: Courses, *, level: float = LEVEL, axes: Sequence[Axes] | Axes | None = None
) -> style.Panels:
    """As `plot_step`, of responses that are known.

    Parameters
    ----------
    replies : Courses
        As `replies_of`, of `STEP`.
    level : float
        Theirs.
    axes : sequence of matplotlib Axes, or one, optional
    """
    drawn = _draw_replies(replies, level, STEP, axes)
    lines = [one.line for one in replies.each]
    gains = [line.model.dc_gain for line in lines]
    for k, ax in enumerate(drawn):
        i, j = divmod(k, gains[0].shape[1])
        for line, gain in zip(lines, gains, strict=True):
            stable = np.all(np.roots(line.model.den[i][j]).real < 0)
            if np.isfinite(gain[i, j]) and stable:
                label = None if line.number else "static gain"
                colour = style.GREY if line.together == 1 else line.colour
                dash = "--" if line.together == 1 else ":"
                ax.axhline(gain[i, j], color=colour, linewidth=0.9, linestyle=dash, label=label)
    style.legend(drawn[0], columns=style.legend_columns(drawn[0]))
    return drawn


IMPULSE = Reply(
    "plot_impulse",
    delta_method.impulse_response,
    impulse_band,
    sampled_impulse_band,
    "impulse",
    1,
)


def plot_impulse(
    models: Models,
    t: npt.ArrayLike | None = None,
    *,
    names: Sequence[str] | None = None,
    level: float = LEVEL,
    axes: Sequence[Axes] | Axes | None = None,
) -> style.Panels:
    """Draw the response to a unit impulse of each input, with a pointwise confidence band.

    Parameters
    ----------
    models : Estimate, TransferFunction, sequence of these, or mapping of names to them
        Of the same channels. A transfer function has no band.
    t : float or array_like, shape (n_times,), optional
        Final time, or rising times [s]; the impulse comes at zero. By default until the model has
        settled.
    names : sequence of str, optional
        One a model, for the legend; by default the keys of a mapping, the orders where they differ,
        else the methods.
    level : float
        Probability that the band holds at each time. Of a posterior mean the band lies between
        quantiles of its draws.
    axes : sequence of matplotlib Axes, or one, optional
        One per channel, outputs in the outer loop. A figure is made when left out.

    Returns
    -------
    Panels
        The axes.

    Raises
    ------
    OptionError
        The level is no probability, the times do not rise, or there are not as many axes as
        channels.
    SampleTypeError, ChannelNameError
        Something is no model, or the models have different channels.

    Notes
    -----
    A channel with as many zeros as poles passes the impulse on at once; the weight of that is
    written into the picture, and the curve is the rest.
    """
    replies = replies_of(models, IMPULSE, t, names=names, level=level, axes=axes)
    drawn, lines = _draw_replies(replies, level, IMPULSE, axes), [one.line for one in replies.each]
    for k, ax in enumerate(drawn):
        _tell_direct(ax, lines, *divmod(k, lines[0].model.n_inputs))
    style.legend(drawn[0], columns=style.legend_columns(drawn[0]))
    return drawn


def _tell_direct(ax: Axes, lines: Sequence[Line], output: int, input_: int) -> None:
    """Weights of the impulses that are passed on at once, in the corner."""
    told = []
    for line in lines:
        num, den = line.model.num[output][input_], line.model.den[output][input_]
        if num.size == den.size and num[0]:
            whose = "" if line.together == 1 else f" ({line.label})"
            told.append(f"and an impulse of weight {num[0]:.4g} at once{whose}")
    if told:
        behind = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5}
        corner: dict[str, Any] = {"transform": ax.transAxes, "ha": "right", "va": "top"}
        ax.text(0.985, 0.95, style.literal("\n".join(told)), fontsize=9, bbox=behind, **corner)
