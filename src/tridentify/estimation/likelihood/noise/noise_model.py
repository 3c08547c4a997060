"""A model of coloured measurement noise, and whether a residual is noise at all.

With ``A_i(q) v_i = e_i`` for the noise of output ``i`` the likelihood is that of the innovations
``e``, and for a held ``A`` it is the output-error cost of whitened samples (`regression`): all
that is known about its minimum stays true. Where both stand still (`around_maximum.turns`), the
information matrix is block diagonal, as the derivatives of the innovations with respect to ``A``
are made of past noise and those with respect to the system of the input alone (Pierce 1972; Ljung
1999, section 9.3). So ``(J' J)^{-1}`` with ``J`` of the whitened columns is the covariance of the
coefficients, as if ``A`` were known; its count lowers the degrees of freedom.

Whether the noise is white is tested on the residual of the white fit. A response that the model
misses looks like coloured noise there, but no whitening can make it independent of the input. A
small part that follows the input is usual in measured records; the standard errors then allow for
its colour, and `cautions` says that it is there.

References: D. Pierce, Biometrika 59 (1972) 73-78. G. Box, G. Jenkins & G. Reinsel, *Time Series
Analysis*, 4th ed., chapter 12 (2008). L. Ljung, *System Identification*, 2nd ed. (1999).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from tridentify.errors import OptionError, TooFewSamplesError, UnsupportedError
from tridentify.estimation.likelihood.cost import Point
from tridentify.estimation.likelihood.curvature import taken
from tridentify.estimation.likelihood.fitted_point import TESTED
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import (
    at_rounding,
)
from tridentify.estimation.likelihood.setup.raster import JITTER, places_on_raster
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import (
    fit_autoregression,
    most_coefficients,
)
from tridentify.numerics.whiteness import input_share

NoiseChoice = Literal["white", "ar", "auto"]

CHOICES = ("white", "ar", "auto")
ROUNDING = 1e-9
"""Residual over output below which there is no noise to be modelled: filters and solves leave up to
that much of colour of their own."""
PER_UNKNOWN = 2.0
"""Samples taken off for each unknown before the highest order is chosen: twice what it costs in
degrees of freedom, as it also bends the correlations."""
MOSTLY = 0.5
"""Share of the whitened residual's power that follows the input from which most of it is a missing
response, and not noise."""
LONGEST_MODELLED = 20_000
"""Samples on which the share that follows the input is found, and up to which what the fit took
from the residual's correlations is put back: beyond it that is less than their error."""
HARDLY = 0.1
"""Share of a residual that may follow the input for nothing but noise to be left: right models in
coloured noise leave 0.04 at most, in 12 records; one to four poles for the heating record of the
benchmark of real records, none of which explains it, 0.18 to 0.53. Set with that record in view.
In 180 other random systems with noise of four colours the search ended early in 132, 105 of them
identifiable: AICc was the same in these to 1e-3. In two of the others whitened samples then ended
at a limit; with every start tried there (`around_maximum.turns`) AICc is the same to 0.3."""
MOST_ROUNDS = 8
"""Turns of noise model and coefficients: they stand still after three or four."""
STILL = 0.01
"""Movement [standard errors] below which coefficients stand still between two turns."""


def check_noise(noise: str) -> None:
    """Refuse an unknown option.

    Raises
    ------
    OptionError
    """
    if noise not in CHOICES:
        raise OptionError(
            f"found noise={noise!r}; expected 'white', 'ar' or 'auto'; choose one of them"
        )


def residual_series(point: Point, most: int | None = None) -> list[list[Array]]:
    """Residuals, ``[output][experiment]``, over the noise of each experiment."""
    residuals = point.standardised(most)
    return [[one[:, i] for one in residuals] for i in range(point.problem.n_outputs)]


def noise_models(
    point: Point, tinted: Sequence[bool], orders: Sequence[int] | None
) -> tuple[Array, ...]:
    """Autoregressions for the residuals of those outputs that are tinted.

    Parameters
    ----------
    point : Point
    tinted : sequence of bool
        One an output; the others stay white.
    orders : sequence of int, optional
        Theirs; by default AICc chooses.
    """
    found = []
    for i, series in enumerate(residual_series(point)):
        if not tinted[i]:
            found.append(np.zeros(0))
            continue
        order = None if orders is None else orders[i]
        small = point.counts.sum() < LONGEST_MODELLED
        extra = taken(point, i) if small else []
        found.append(
            fit_autoregression(series, most_orders(point, i), order, fewest=1, taken=extra)
        )
    return tuple(found)


def follows_input(
    point: Point, output: int, series: Sequence[Array], share: float = MOSTLY
) -> bool:
    """Whether more than a share of the residual is a response that the model misses, not noise."""
    a = fit_autoregression(series, most_orders(point, output), fewest=1)
    found = [
        (
            input_share(one[:LONGEST_MODELLED], e.u[:LONGEST_MODELLED], a)[0],
            one[:LONGEST_MODELLED].size,
        )
        for one, e in zip(series, point.problem.experiments, strict=True)
    ]
    return sum(own * n for own, n in found) > share * sum(n for _, n in found)


def most_orders(point: Point, output: int) -> int:
    """Highest order for one output: what its samples leave after the other unknowns."""
    own = int(point.linear.sizes[output]) + point.problem.n_poles
    return most_coefficients(int(point.counts[output] - PER_UNKNOWN * own))


def leaves_coloured_noise(point: Point) -> bool:
    """Whether a model of the noise is what the residual of a point asks for.

    A richer model of the plant explains coloured noise, too, and AICc for white noise cannot tell:
    so long as nothing but noise is left, that is no sign of poles at a wrong place.
    """
    if refusal(point) is not None:
        return False
    tinted = [i for i, passes in enumerate(point.white) if not passes]
    series = residual_series(point, TESTED) if tinted else []
    return bool(tinted) and not any(follows_input(point, i, series[i], HARDLY) for i in tinted)


def refusal(point: Point) -> UnsupportedError | TooFewSamplesError | None:
    """Why there can be no model of the noise."""
    power = point.rss / point.counts
    if at_rounding(point) or np.any(power < ROUNDING**2 * point.problem.size):
        return UnsupportedError(
            "found a residual that is no more than rounding; expected noise; use noise='white'"
        )
    instants = [e.t for e in point.problem.experiments if e.t is not None]
    if any(not _is_nearly_uniform(t) for t in instants):
        return UnsupportedError(
            "found time that is not uniform; expected a uniform step, as an autoregression is a "
            "model of evenly spaced samples; use noise='white', or resample the record"
        )
    steps = [e.dt for e in point.problem.experiments]
    same = JITTER if instants else 1e-6
    if not all(math.isclose(dt, steps[0], rel_tol=same) for dt in steps):
        return UnsupportedError(
            f"found experiments with sampling intervals from {min(steps):g} to {max(steps):g} s; "
            "expected one interval, as the noise model is that of the samples; resample the "
            "records to one interval, or use noise='white'"
        )
    fewest = min(most_orders(point, i) for i in range(point.problem.n_outputs))
    if fewest == 0:
        return TooFewSamplesError(
            f"found too few samples for a noise model ({int(point.counts.min())}); expected at "
            "least 20 more than twice the unknowns; record longer, or use noise='white'"
        )
    return None


def _is_nearly_uniform(t: Array) -> bool:
    """Whether samples are so evenly spaced that noise makes no difference of it."""
    places = places_on_raster(t)
    return places is not None and bool(places[-1] + 1 == t.size)
