"""What the pictures of responses over time have in common: how long to look, and how to draw."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from tridentify.estimation.answer.estimate import Estimate
from tridentify.numerics.arrays import Array
from tridentify.plots.style import BLUE, channel, dress, in_brackets, literal
from tridentify.writing.layout import unit_ratio

if TYPE_CHECKING:
    from matplotlib.axes import Axes


SETTLE = 6.0
"""Time constants after which nothing moves any more."""
PERIODS = 12.0
"""Of a hardly damped oscillation."""
GROW = 3.0
"""Time constants of a growing response."""
POINTS = 300
"""In each stretch of the time axis."""
PER_PERIOD = 24.0
AIR = 0.6
"""How far a band may reach beyond the line, as a share of the line's range."""


def default_times(estimate: Estimate) -> Array:
    """Times over which the model settles, finer at the beginning where it has fast modes.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    ndarray
        Rising from zero [s]; of a few different steps only.
    """
    poles = np.concatenate([np.roots(den) for row in estimate.model.den for den in row])
    late = float(np.max(estimate.model.delay, initial=0.0))
    ends = np.sort([_shown(pole) for pole in poles[np.abs(poles) > 1e-9 * np.abs(poles).max()]])
    whole = (estimate.dt or 1.0) * estimate.n_samples / max(len(estimate.nuisance), 1)
    horizon = float(ends[-1]) if ends.size else whole
    edges, steps = [0.0], [_step(poles, 0.0, horizon)]
    for end in ends[:-1]:
        if end > 4.0 * edges[-1] and horizon > 4.0 * end:
            edges.append(float(end))
            steps.append(_step(poles, float(end), horizon))
    times = [
        np.arange(first, last, min(step, (last - first) / POINTS))
        for first, last, step in zip(edges, [*edges[1:], horizon], steps, strict=True)
    ]
    grid = np.concatenate([*times, [horizon]])
    if not late:
        return grid
    return np.concatenate([np.linspace(0.0, late, 20, endpoint=False), late + grid])


def _shown(pole: complex) -> float:
    """How long a mode is worth looking at [s]."""
    decay = abs(pole.real)
    enough = PERIODS * 2 * np.pi / abs(pole.imag) if pole.imag else np.inf
    wanted = (GROW if pole.real > 0 else SETTLE) / decay if decay > 1e-9 * abs(pole) else np.inf
    return float(min(enough, wanted))


def _step(poles: npt.NDArray[np.complex128], start: float, horizon: float) -> float:
    """Step that shows the oscillations which are still there."""
    alive = [abs(p.imag) for p in poles if p.imag and _shown(p) > start * (1 + 1e-9)]
    fastest = max(alive, default=0.0)
    fine = 2 * np.pi / fastest / PER_PERIOD if fastest else np.inf
    return max(float(fine), horizon / (20 * POINTS))


def trimmed(t: Array, response: Array, share: float = 0.004) -> int:
    """Number of times until every response stays at its last value.

    Parameters
    ----------
    t : ndarray, shape (n_times,)
    response : ndarray, shape (n_times, ...)
    share : float
        Of a response's range within which it counts as settled.

    Returns
    -------
    int
        A third more than needed, at most all.
    """
    flat = response.reshape(t.size, -1)
    with np.errstate(invalid="ignore"):
        moving = np.abs(flat - flat[-1]) > share * np.ptp(flat, axis=0)
    last = int(np.flatnonzero(moving.any(axis=1)).max(initial=0))
    return min(int(np.searchsorted(t, 1.35 * t[last])) + 2, t.size) if last else t.size


def draw_band(ax: Axes, t: Array, line: Array, low: Array, high: Array, level: float) -> None:
    """Line and band; the scale follows the line, so that a wide band does not flatten it."""
    sound = np.isfinite(low) & np.isfinite(high)
    label = f"{100 * level:.3g} % band"
    if np.any(sound):
        low, high = np.where(sound, low, np.nan), np.where(sound, high, np.nan)
        ax.fill_between(t, low, high, color=BLUE, alpha=0.25, linewidth=0, label=label)
    ax.axhline(0.0, color="black", linewidth=0.6)
    ax.plot(t, line, color=BLUE, linewidth=1.5, label="model")
    ax.set_xlim(t[0], t[-1])
    seen = line[np.isfinite(line)]
    if seen.size:
        bottom, top = min(float(seen.min()), 0.0), max(float(seen.max()), 0.0)
        reach = (top - bottom) or 1.0
        floor = max(bottom - AIR * reach, min(bottom, float(np.nanmin(low, initial=bottom))))
        ceiling = min(top + AIR * reach, max(top, float(np.nanmax(high, initial=top))))
        ax.set_ylim(floor - 0.06 * reach, ceiling + 0.06 * reach)


def name_channel(ax: Axes, estimate: Estimate, output: int, input_: int, power: int) -> None:
    """Title and label of one channel; its unit is that of the output over that of the input.

    Parameters
    ----------
    ax : matplotlib Axes
    estimate : Estimate
    output, input_ : int
    power : int
        Seconds in the unit's denominator.
    """
    names = estimate.output_names[output], estimate.input_names[input_]
    unit = ""
    if all(name in estimate.units for name in names):
        unit = unit_ratio(estimate.units[names[0]], estimate.units[names[1]], power)
    dress(
        ax,
        title=literal(wrapped(channel(estimate, output, input_))),
        ylabel=literal(f"response{in_brackets(unit)}"),
    )
    ax.ticklabel_format(axis="both", style="sci", scilimits=(-3, 4), useOffset=False)
    for axis in (ax.xaxis, ax.yaxis):
        axis.get_offset_text().set_fontsize(8)


def wrapped(text: str, width: int = 60) -> str:
    r"""Long names on several lines, so that they stay within a figure.

    Examples
    --------
    >>> wrapped("pitch rate / elevator", 14)
    'pitch rate /\nelevator'
    """
    return "\n".join(textwrap.wrap(text, width)) or text
