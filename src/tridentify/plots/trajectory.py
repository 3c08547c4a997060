"""Picture of a run on-line: every coefficient over time with its band, and what was flagged."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tridentify.numerics.arrays import Array
from tridentify.online import Flag, Run
from tridentify.plots import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Truth = float | npt.ArrayLike | Callable[[Array], npt.ArrayLike]

SPAN = 1.959964
"""Standard errors in a 95 % band."""
SHOWN = 0.9
"""Share of the points that the vertical scale holds; the wild beginning may leave it."""
TRAJECTORY_AIR = 0.25


def plot_trajectory(
    run: Run,
    truth: Mapping[str, Truth] | None = None,
    *,
    axes: Sequence[Axes] | None = None,
) -> style.Panels:
    """Draw the coefficients over time with 95 % bands, changes, and flags below.

    Parameters
    ----------
    run : Run
        From `tridentify.online.run`.
    truth : mapping of str to number, array of shape (k,) or function of time, optional
        What is known of some of the coefficients, by name: a constant, values at ``run.time``, or a
        function of an array of times [s].
    axes : sequence of matplotlib Axes, optional
        One for each coefficient and one for the flags. A figure is made when left out.

    Returns
    -------
    Panels
        The axes.

    Raises
    ------
    ValueError
        Not as many axes as the picture needs, a truth for a name that is no coefficient, or one
        with another number of values than the run has points.
    """
    if not hasattr(run, "flags"):
        style.checked(run, Run, "plot_trajectory(online.run(method, record, structure))")
    known = _known(run, truth or {})
    flagged = [flag for flag in Flag if any(flag in at for at in run.flags)]
    heights = [1.3] * len(run.names) + [0.45 + 0.17 * max(len(flagged), 1)]
    drawn = style.make_axes(axes, heights, sharex=True)
    units = dict(zip(run.names, run.units, strict=False))
    for k, name in enumerate(run.names):
        _draw_coefficient(drawn[k], run, k, known.get(name))
        style.dress(drawn[k], ylabel=style.labelled(name, units))
    _draw_flags(drawn[-1], run, flagged)
    for ax in drawn:
        for at, when in enumerate(run.changes):
            label = None if at else "change found"
            ax.axvline(when, color=style.BLACK, linewidth=0.9, linestyle=(0, (4, 2)), label=label)
    style.legend(drawn[0], columns=4)
    return drawn


def _known(run: Run, truth: Mapping[str, Truth]) -> dict[str, Array]:
    """Values of the truth at the points of the run."""
    stranger = [name for name in truth if name not in run.names]
    if stranger:
        raise ValueError(
            f"found a truth for {', '.join(stranger)}; expected names of {', '.join(run.names)}"
        )
    found = {}
    for name, value in truth.items():
        given = np.asarray(value(run.time) if callable(value) else value, dtype=np.float64)
        if given.ndim and given.shape != run.time.shape:
            raise ValueError(
                f"found {given.size} values of {name}; expected {run.time.size}, as many as the "
                "run has points, a number, or a function of time"
            )
        found[name] = np.broadcast_to(given, run.time.shape)
    return found


def _draw_coefficient(ax: Axes, run: Run, k: int, truth: Array | None) -> None:
    theta, half = run.theta[:, k], SPAN * run.std[:, k]
    pale: dict[str, Any] = {"color": style.SKY, "alpha": 0.45, "linewidth": 0}
    ax.fill_between(run.time, theta - half, theta + half, label="95 % band", **pale)
    ax.plot(run.time, theta, color=style.BLUE, linewidth=1.3, label="estimate")
    if truth is not None:
        ax.plot(run.time, truth, color=style.ORANGE, linewidth=1.3, linestyle="--", label="truth")
    limits = _limits(theta, half, truth)
    if limits is not None:
        ax.set_ylim(*limits)


def _limits(theta: Array, half: Array, truth: Array | None) -> tuple[float, float] | None:
    """Vertical scale by most of the points, so that the first ones do not hide the others."""
    there = np.isfinite(theta)
    if not np.any(there):
        return None
    shares = ((1 - SHOWN) / 2, (1 + SHOWN) / 2)
    width = np.where(np.isfinite(half), half, 0.0)[there]
    typical = min(float(np.quantile(width, SHOWN)), 3.0 * float(np.median(width)))
    low, high = np.quantile(theta[there], shares)
    low, high = float(low) - typical, float(high) + typical
    if truth is not None:
        low, high = min(low, float(np.min(truth))), max(high, float(np.max(truth)))
    air = TRAJECTORY_AIR * (high - low) or 0.05 * abs(high) or 1.0
    return low - air, high + air


def _draw_flags(ax: Axes, run: Run, flagged: Sequence[Flag]) -> None:
    """One row for each kind of flag, a mark at each point that has it."""
    for row, flag in enumerate(flagged):
        raised = np.array([flag in at for at in run.flags])
        at = np.full(int(raised.sum()), row)
        look: dict[str, Any] = {"color": style.ORANGE, "markersize": 8, "markeredgewidth": 1.4}
        ax.plot(run.time[raised], at, "|", **look)
    names = [str(flag.name).lower().replace("_", " ") for flag in flagged]
    ax.set_ylim(max(len(flagged), 1) - 0.4, -0.6)
    style.dress(ax, xlabel="time [s]", ylabel="flags")
    ax.set_yticks(range(len(names)), [style.literal(name) for name in names], fontsize=8)
    if not names:
        ax.set_yticks([])
        ax.text(
            0.5, 0.5, "none", transform=ax.transAxes, ha="center", va="center", color=style.GREY
        )
    ax.grid(False, axis="y")
