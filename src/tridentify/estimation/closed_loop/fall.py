"""How far the likelihood falls on both sides of an estimate, beside what its curvature says.

The covariance is that of the curvature at the estimate. Where a loop is moved little, or its record
is short, coefficients hang together, and derivatives along their longest axis change within a
standard error or two: an estimate that lies off to where they are large has errors that are too
small for itself. So the likelihood is followed along that axis to both sides, everything else at
its best (Bates & Watts 1988, section 6.1), to where it has fallen as far below its highest as the
curvature awaits it where an interval ends. Where that is farther off, the axis grows. The highest
is not the estimate itself where that is a root of instruments.

Reference: D. Bates & D. Watts, *Nonlinear Regression Analysis and Its Applications* (1988).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Protocol, Self

import numpy as np
from scipy.linalg import null_space

from tridentify.errors import TridentifyError
from tridentify.numerics.arrays import Array

REACH = 2.0
"""Standard errors at which the fall of the likelihood is measured: where an interval ends."""
BESIDE = 4
"""Steps of Gauss and Newton beside the axis; they begin where the curvature says they end."""
MOST = 5.0
"""Times that an axis grows: beyond, nothing tells it."""
TIMES = (1.0, 2.0, MOST)
"""Where the fall is looked at, over `REACH`."""
HALVED = 4
"""Times that what lies between two of these is halved: to a tenth."""


class Place(Protocol):
    """Errors and what they change by, at values of all unknowns."""

    @property
    def size(self) -> float:
        """Sum of squares of the errors."""

    @property
    def innovations(self) -> Array:
        """The errors."""

    @property
    def columns(self) -> Array:
        """(n_errors, n_unknowns) minus their derivatives."""

    def moved(self, change: Array) -> Self | None:
        """Elsewhere; None where there is nothing."""


def farther(here: Place, cov: Array, n: int) -> Array:
    """What the fall on both sides adds to the covariance of the first ``n`` unknowns.

    Parameters
    ----------
    here : Place
        A minimum of the sum of squares, or a root near one.
    cov : (k, k) array
        Of all unknowns, by the curvature.
    n : int

    Returns
    -------
    (n, n) array
    """
    with np.errstate(all="ignore"):
        sizes = np.sqrt(np.diag(cov)) + 1e-300
        scaled = cov / np.outer(sizes, sizes)
    if not np.isfinite(scaled).all():
        return np.zeros((n, n))
    values, turned = np.linalg.eigh(scaled[:n, :n])
    weakest, length = turned[:, -1], np.sqrt(values[-1])
    axis = length * weakest * sizes[:n]
    along = sizes * (scaled[:, :n] @ weakest) / length
    beside = sizes[:, None] * null_space(np.pad(weakest, (0, sizes.size - n))[None, :])
    with np.errstate(all="ignore"):
        awaited = REACH**2 * _curvature(here, along, beside)
        if not awaited > 0.0:
            return np.zeros((n, n))
        highest = _lowest(here, np.column_stack([along, beside]))

        def fallen(side: float, times: float) -> float:
            """The likelihood's fall over the one that is awaited at `REACH`."""
            try:
                moved = here.moved(side * times * REACH * along)
                size = np.inf if moved is None else _lowest(moved, beside)
            except (TridentifyError, np.linalg.LinAlgError):  # a plant that runs off
                return np.inf
            return max(size - highest, 0.0) / awaited

        times = max(1.0, _end(partial(fallen, -1.0)), _end(partial(fallen, 1.0)))
    return (times**2 - 1.0) * np.outer(axis, axis)


def _end(fallen: Callable[[float], float]) -> float:
    """Where the likelihood has fallen as awaited, over `REACH`; a wall ends the way to it."""
    low = 0.0
    for high in TIMES:
        if fallen(high) >= 1.0:
            break
        low = high
    else:
        return low
    for _ in range(HALVED if low else 0):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if fallen(middle) >= 1.0 else (middle, high)
    return low


def _curvature(here: Place, along: Array, beside: Array) -> float:
    """Rise of the sum of squares over a step, everything else at its best, by the derivatives.

    Of what the references explain of the errors it is less than that of all of them.
    """
    if not np.isfinite(here.columns).all():
        return 0.0
    rest, step = here.columns @ beside, here.columns @ along
    left = step - rest @ np.linalg.lstsq(rest, step, rcond=1e-12)[0]
    return float(left @ left)


def _lowest(here: Place, beside: Array) -> float:
    """Sum of squares that steps in given directions lead to."""
    for _ in range(BESIDE):
        if not np.isfinite(here.columns).all():
            break
        change = np.linalg.lstsq(here.columns @ beside, here.innovations, rcond=1e-12)[0]
        other = here.moved(beside @ change)
        if other is None or not other.size < here.size:
            break
        here = other
    return here.size
