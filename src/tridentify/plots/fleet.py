"""Picture of a fleet: how its coefficients are distributed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tridentify.errors import IdentifiabilityError
from tridentify.fleet.run import Run, coefficients
from tridentify.numerics.arrays import Array
from tridentify.plots import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HEIGHT = 1.5
"""Of the axes of one coefficient [inch]."""

MOST_BINS = 60
"""Of a histogram: bars of two pixels are no bars."""

TAIL = 0.005
"""Share of the units at either end that may lie beyond the scale: they are counted in the last bar,
so that one absurd estimate does not press all others into one."""


def plot_fleet(run: Run, *, axes: Sequence[Axes] | None = None) -> style.Panels:
    """Draw how the coefficients of a fleet are distributed.

    Parameters
    ----------
    run : Run
        All its units with the same coefficients.
    axes : sequence of matplotlib Axes, optional
        One a coefficient. A figure is made when left out.

    Returns
    -------
    Panels
        The axes.

    Raises
    ------
    IdentifiabilityError
        No unit has an estimate, or they have different coefficients.

    Notes
    -----
    Bars count the units' own estimates; where the fleet was pooled, a line shows the population
    that they come from, and ticks at the foot mark the units that deviate.
    """
    style.checked(run, Run, "plot_fleet(fleet.fit(...))")
    rows = run.rows(["key", "ok", "names", "coefficients"])
    good = rows.filter(rows["ok"])
    names, values = coefficients(good)
    if not names:
        raise IdentifiabilityError(
            f"found {rows.height} units without estimates of the same coefficients; expected some "
            "to draw; look at run.failed()"
        )
    drawn = style.make_axes(axes, [HEIGHT] * len(names))
    keys = good["key"].to_list()
    for k, (ax, name) in enumerate(zip(drawn, names, strict=True)):
        _draw(ax, name, values[:, k], keys, run, k)
    return drawn


def _draw(ax: Axes, name: str, values: Array, keys: Sequence[str], run: Run, number: int) -> None:
    low, high = np.quantile(values, [TAIL, 1.0 - TAIL])
    margin = 0.05 * (high - low) or 0.05 * abs(low) or 1.0
    bins = int(min(max(np.sqrt(values.size), 8), MOST_BINS))
    edges = np.linspace(low - margin, high + margin, bins + 1)
    inside = np.clip(values, edges[0], edges[-1])
    counts, _ = np.histogram(inside, edges)
    ax.stairs(counts, edges, fill=True, color=style.BLUE, alpha=0.55, label="own estimates")
    ax.axvline(float(np.median(values)), color=style.BLUE, linewidth=1.2, label="median")
    pool = run.population
    if pool is not None:
        at = np.linspace(edges[0], edges[-1], 300)
        own = pool.mean[number], pool.spread[number], bool(pool.logarithmic[number])
        expected = _density(at, *own) * values.size * (edges[1] - edges[0])
        ax.plot(at, expected, color=style.GREEN, linewidth=1.4, label="population")
        apart = set(pool.outliers)
        where = [x for key, x in zip(keys, inside, strict=True) if key in apart]
        if where:
            foot, level = np.full(len(where), 0.03), ax.get_xaxis_transform()
            how: dict[str, Any] = {"color": style.ORANGE, "markersize": 9, "markeredgewidth": 1.6}
            ax.plot(where, foot, "|", transform=level, label="deviates", **how)
    ax.set_xlim(edges[0], edges[-1])
    style.dress(ax, title=style.literal(name), ylabel="units")
    if number == 0:
        style.legend(ax, columns=4)


def _density(at: Array, centre: float, spread: float, logarithmic: bool) -> Array:
    """Of a Gaussian, or of one of the logarithm."""
    if not logarithmic:
        return np.asarray(np.exp(-0.5 * ((at - centre) / spread) ** 2) / (spread * 2.5066282746))
    ratio = at / centre
    safe = np.where(ratio > 0.0, ratio, 1.0)
    bell = np.exp(-0.5 * (np.log(safe) / spread) ** 2) / (np.abs(at) * spread * 2.5066282746)
    return np.where(ratio > 0.0, bell, 0.0)
