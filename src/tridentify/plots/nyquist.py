"""Picture of the frequency response in the complex plane, with confidence ellipses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tridentify.estimation.answer.parameter import checked_level
from tridentify.judgement.comparison.entries import Models
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.delta_method import confidence_ellipse
from tridentify.plots import style
from tridentify.plots.bode import default_frequencies
from tridentify.plots.lines import Line, frequencies, lines_of, named_first
from tridentify.plots.over_time import wrapped
from tridentify.uncertainty import response_covariance
from tridentify.uncertainty.draws import frequency_values

if TYPE_CHECKING:
    from matplotlib.axes import Axes


ASPECT = 1.5
"""Width over height of the frame."""
MARKED = 7
"""Ellipses that are outlined and named by their frequency."""
BETWEEN = 3
"""Ellipses filled from one frequency to the next."""
CURVES = 60
"""Curves drawn of a posterior mean."""
FAR_POINT = 8.0
"""How many times the typical gain an unbounded curve is followed."""
SHADE = 0.19
"""Share of a colour in the ellipses of its curve."""


def plot_nyquist(
    models: Models,
    omega: npt.ArrayLike | None = None,
    *,
    names: Sequence[str] | None = None,
    level: float = 0.95,
    axes: Sequence[Axes] | Axes | None = None,
) -> style.Panels:
    """Draw the frequency response of every channel in the complex plane.

    Parameters
    ----------
    models : Estimate, TransferFunction, sequence of these, or mapping of names to them
        Of the same channels. A transfer function has no ellipses.
    omega : array_like, shape (n_omega,), optional
        Increasing angular frequencies [rad/s]; by default around the poles and zeros, up to the
        Nyquist frequency of the record.
    names : sequence of str, optional
        One a model, for the legend; by default the keys of a mapping, the orders where they differ,
        else the methods.
    level : float
        Probability that an ellipse holds at its frequency, to first order. Of a posterior mean,
        curves of its draws stand in place of ellipses.
    axes : sequence of matplotlib Axes, or one, optional
        One per channel, outputs in the outer loop. A figure is made when left out.

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

    Notes
    -----
    The solid line is for positive frequencies, the dashed one its mirror image for negative ones;
    arrows point towards higher frequencies. Where the response has no bound (an integrator), the
    frame ends at a multiple of its typical size. The scale follows the line, so that wide ellipses
    may leave the frame.
    """
    checked_level(level)
    lines = lines_of(models, names, "plot_nyquist(estimate) or plot_nyquist([one, other])", axes)
    grid = _frequencies(lines) if omega is None else frequencies(omega, EXAMPLE)
    named = named_first(lines)
    n_outputs, n_inputs = len(named.output_names), len(named.input_names)
    drawn = style.make_axes(axes, [style.WIDTH / ASPECT] * (n_outputs * n_inputs))
    responses = [line.model.frequency_response(grid) for line in lines]
    # powers of ten in the numbers of fast and slow systems would cover each other
    exponent = 3 * math.floor(math.log10(float(np.median(grid)) or 1.0) / 3)
    exponent = 0 if -3 <= exponent <= 3 else exponent
    around = [_uncertain(line, grid) for line in lines]
    for k, ax in enumerate(drawn):
        i, j = divmod(k, n_inputs)
        curves = [response[:, i, j] for response in responses]
        half = _frame(ax, curves)
        for line, curve, (cov, clouds) in zip(lines, curves, around, strict=True):
            if cov is not None:
                _draw_ellipses(ax, curve, cov[:, i, j], level, half, line)
            elif clouds is not None:
                _draw_cloud(ax, clouds[:, :, i, j], line)
            _draw_curve(ax, grid / 10.0**exponent, curve, half, line)
        _draw_critical(ax, half)
        _name(ax, named, i, j, exponent)
        _legend(ax)
    return drawn


EXAMPLE = "plot_nyquist([one, other], omega)"


def _uncertain(line: Line, grid: Array) -> tuple[Array | None, Complex | None]:
    """Covariances for ellipses, or curves of the draws of a posterior mean."""
    if line.estimate is None:
        return None, None
    draws = line.draws[:: max(len(line.draws) // CURVES, 1)]
    if len(draws):
        return None, frequency_values(line.estimate, draws, grid)
    return response_covariance(line.estimate, grid), None


def _frequencies(lines: Sequence[Line]) -> Array:
    """Those of a Bode plot and slower ones, so that the curve begins at the static gain."""
    grid = default_frequencies(*lines, n_points=480)
    return np.concatenate([np.geomspace(grid[0] / 100, grid[0], 40, endpoint=False), grid])


def _frame(ax: Axes, curves: Sequence[Complex]) -> float:
    """Scale both axes alike around all curves; half the height of the frame."""
    extents = [_extent(curve) for curve in curves]
    left, right = min(one[0] for one in extents), max(one[1] for one in extents)
    height = max(one[2] for one in extents)
    reach = max(right - left, 2 * height) or 1.0
    if 0.0 < left + 1.0 < 1.2 * reach:
        left = -1.0
    width = max(1.3 * (right - left), ASPECT * 2.6 * height, 1e-9 * reach)
    centre = 0.5 * (left + right)
    half = width / ASPECT / 2
    ax.set_xlim(centre - width / 2, centre + width / 2)
    ax.set_ylim(-half, half)
    ax.set_aspect("equal", adjustable="box")
    return half


def _extent(curve: Complex) -> tuple[float, float, float]:
    """Least and largest real part, with zero, and largest imaginary part, as far as drawn."""
    sizes = np.abs(curve[np.isfinite(curve)])
    limit = FAR_POINT * float(np.median(sizes)) if sizes.size else 1.0
    bounded = sizes.size == curve.size and (
        sizes[0] < 4.0 * np.median(sizes) or sizes[0] < 1.2 * sizes[min(20, sizes.size - 1)]
    )
    inside = curve[np.isfinite(curve) & (np.abs(curve) <= (np.inf if bounded else limit))]
    parts = np.concatenate([inside.real, [0.0]]) if inside.size else np.array([0.0, 1.0])
    height = float(np.max(np.abs(inside.imag), initial=0.0))
    return float(parts.min()), float(parts.max()), height


def _draw_ellipses(
    ax: Axes, curve: Complex, cov: Array, level: float, half: float, line: Line
) -> None:
    """A band of many ellipses, and a few of them outlined."""
    from matplotlib.collections import PolyCollection

    sound = np.isfinite(curve) & np.all(np.isfinite(cov), axis=(1, 2))
    with np.errstate(invalid="ignore"):
        spread = np.sqrt(np.trace(cov, axis1=1, axis2=2))
    sound &= spread < 50 * half
    if np.count_nonzero(sound) < 2 or not np.any(cov[sound]):
        return
    centres, covs = curve[sound], cov[sound]
    shares = np.linspace(0.0, 1.0, BETWEEN, endpoint=False)
    polygons = []
    for first, last, cov_1, cov_2 in zip(
        centres[:-1], centres[1:], covs[:-1], covs[1:], strict=True
    ):
        for share in shares:
            at = (1 - share) * first + share * last
            around = confidence_ellipse((1 - share) * cov_1 + share * cov_2, level, 37)
            polygons.append(around + np.array([at.real, at.imag]))
    # opaque, so that they do not darken where they overlap
    pale = _paler(line.colour)
    ax.add_collection(
        PolyCollection(polygons, facecolor=pale, edgecolor=pale, linewidth=0.6, zorder=1),
        autolim=False,
    )
    label = f"{100 * level:.3g} % ellipses"
    if label not in ax.get_legend_handles_labels()[1]:
        ax.fill([], [], facecolor=pale, label=label)
    for k in _spaced(ax, curve, MARKED, 0.0):
        if sound[k]:
            around = confidence_ellipse(cov[k], level) + np.array([curve[k].real, curve[k].imag])
            ax.plot(around[:, 0], around[:, 1], color=line.colour, linewidth=0.9, zorder=2.5)


def _paler(colour: str) -> tuple[float, float, float]:
    """The colour on white, as its band would be."""
    from matplotlib.colors import to_rgb

    red, green, blue = (1.0 - SHADE * (1.0 - part) for part in to_rgb(colour))
    return red, green, blue


def _draw_cloud(ax: Axes, curves: Complex, line: Line) -> None:
    """Curves of the draws of a posterior mean."""
    for k, one in enumerate(curves):
        one = np.where(np.isfinite(one), one, np.nan)
        label = None if k else "as likely"
        ax.plot(
            one.real, one.imag, color=line.colour, alpha=0.25, linewidth=0.6, zorder=1, label=label
        )


def _draw_curve(ax: Axes, omega: Array, curve: Complex, half: float, line: Line) -> None:
    shown, colour = np.where(np.isfinite(curve), curve, np.nan), line.colour
    ax.plot(shown.real, -shown.imag, color=colour, linewidth=0.9, linestyle="--", zorder=2)
    label = style.literal(line.label)
    ax.plot(shown.real, shown.imag, color=colour, linewidth=1.6, label=label, zorder=3)
    marked = _spaced(ax, curve, MARKED, 0.0)
    at = curve[marked]
    ax.plot(at.real, at.imag, "o", markersize=3.5, color=colour, zorder=4)
    for k in _spaced(ax, curve, 3, 0.35):
        ahead = curve[k + 1] - curve[k]
        if ahead:
            start = curve[k] - 1e-3 * half * ahead / abs(ahead)
            ax.annotate(
                "",
                xy=(curve[k].real, curve[k].imag),
                xytext=(start.real, start.imag),
                arrowprops={"arrowstyle": "-|>", "color": colour, "mutation_scale": 13},
                zorder=4,
            )
    if not line.number:
        _name_frequencies(ax, omega, curve, marked)


def _name_frequencies(ax: Axes, omega: Array, curve: Complex, marked: Sequence[int]) -> None:
    """Numbers beside the marked points, across the curve and away from its middle."""
    inside = curve[_inside(ax, curve)]
    middle = inside.mean() if inside.size else 0j
    for k in marked:
        along = curve[k + 1] - curve[k - 1] if k else curve[k + 1] - curve[k]
        away = -1j * along / abs(along) if along else -1j
        if (away * np.conj(curve[k] - middle)).real < 0:
            away = -away
        ax.annotate(
            f"{omega[k]:.3g}",
            xy=(curve[k].real, curve[k].imag),
            xytext=(9 * away.real, 9 * away.imag),
            textcoords="offset points",
            fontsize=8,
            ha="center" if abs(away.real) < 0.5 else ("left" if away.real > 0 else "right"),
            va="center" if abs(away.imag) < 0.5 else ("bottom" if away.imag > 0 else "top"),
            annotation_clip=True,
            zorder=5,
        )


def _spaced(ax: Axes, curve: Complex, count: int, offset: float) -> list[int]:
    """Positions spread evenly along the part of the curve that is in the frame."""
    inside = _inside(ax, curve)
    steps = np.abs(np.diff(curve, prepend=curve[:1]))
    both = inside & np.roll(inside, 1)
    length = np.cumsum(np.where(both & np.isfinite(steps), steps, 0.0))
    if not length[-1] > 0:
        return []
    wanted = (np.arange(count) + 0.5 + offset) / count * length[-1]
    found = np.unique(np.searchsorted(length, wanted[wanted < length[-1]]))
    apart = 0.4 * length[-1] / count
    kept: list[int] = []
    for k in found.tolist():
        if k < curve.size - 1 and all(abs(curve[k] - curve[one]) > apart for one in kept):
            kept.append(k)
    return kept


def _inside(ax: Axes, curve: Complex) -> npt.NDArray[np.bool_]:
    low, high = ax.get_xlim()
    bottom, top = ax.get_ylim()
    across = (curve.real > low) & (curve.real < high)
    return np.asarray(np.isfinite(curve) & across & (curve.imag > bottom) & (curve.imag < top))


def _draw_critical(ax: Axes, half: float) -> None:
    """The point -1, or where it lies."""
    ax.axhline(0.0, color="black", linewidth=0.6, zorder=0.5)
    ax.axvline(0.0, color="black", linewidth=0.6, zorder=0.5)
    low, high = ax.get_xlim()
    if low < -1.0 < high and half < 60.0:
        point: dict[str, Any] = {"markersize": 10, "markeredgewidth": 2.0, "color": style.ORANGE}
        ax.plot([-1.0], [0.0], "+", label="-1", zorder=5, **point)
    else:
        where = "outside the frame" if half < 60.0 else "close to the origin at this scale"
        ax.text(
            0.01, 0.02, f"-1 lies {where}", transform=ax.transAxes, fontsize=8, color=style.BLACK
        )


def _name(ax: Axes, estimate: style.Shown, output: int, input_: int, exponent: int) -> None:
    unit = style.in_brackets(style.channel_unit(estimate, output, input_))
    scale = f"1e{exponent} " if exponent else ""
    title = wrapped(f"{style.channel(estimate, output, input_)}   (numbers: {scale}rad/s)")
    sides = (style.literal(f"{part} part{unit}") for part in ("real", "imaginary"))
    style.dress(ax, title=style.literal(title), xlabel=next(sides), ylabel=next(sides))
    style.scientific(ax)


def _legend(ax: Axes) -> None:
    frame = {"framealpha": 0.8, "edgecolor": "none", "borderaxespad": 0.2}
    ax.legend(loc="upper left", fontsize=8, **frame)
