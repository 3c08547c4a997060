"""The best distribution of power over lines, with a proof of how good it is.

The information is linear in the powers, ``M(w) = sum_k w_k F_k``, and both criteria are convex in
``M``: with ``C = W M^{-1} W'`` the covariance of the coefficients of interest,

    "A":  trace C,              slope  a_k = trace(F_k M^{-1} W' W M^{-1}),
    "D":  log det C,            slope  d_k = trace(F_k M^{-1} W' C^{-1} W M^{-1}).

The multiplicative algorithm (Silvey, Titterington & Torsney 1978) multiplies every power by its
slope to the power ``lambda`` and norms them: 1/2 for "A" and 1 for "D", for which the criterion
never rises (Yu 2010). With several inputs, each with a limit of its own, the powers of each input
are normed apart.

*Certificate.* By the general equivalence theorem (Kiefer & Wolfowitz 1960; Goodwin & Payne 1977,
chapter 6) powers are optimal exactly if no line has a slope above the mean slope of its input.
Short of that, convexity bounds what is left: with ``q`` the sum over inputs of the largest slope,
no powers give a trace below ``(2 - q / trace C)`` times this one, none a log det below this one by
more than ``q`` less the number of coefficients of interest.

Of several models the criterion is averaged, which keeps it convex: a design for all of them.

References: S. D. Silvey, D. M. Titterington & B. Torsney, Communications in Statistics A 7 (1978)
1379-1389. Y. Yu, Annals of Statistics 38 (2010) 1593-1606. J. Kiefer & J. Wolfowitz, Canadian
Journal of Mathematics 12 (1960) 363-366. G. C. Goodwin & R. L. Payne, *Dynamic System
Identification: Experiment Design and Data Analysis*, Academic Press 1977.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tridentify.errors import UndeterminedError
from tridentify.estimation.likelihood.curvature import SINGULAR
from tridentify.numerics.arrays import Array

Criterion = Literal["A", "D"]

TOLERANCE = 1e-3
"""Of the efficiency: a design that reaches all but this share of the best is taken."""

MOST = 20_000
"""Iterations."""

NEGLIGIBLE = 1e-12
"""Share of the largest power below which a line adds rounding to the information."""


@dataclass(frozen=True, eq=False)
class SpectralLines:
    """What each line tells, for one model or several.

    Attributes
    ----------
    rows : (n_models, n_points, r, k) array
        ``H`` with ``F = H' H`` for all the power of the input at this line.
    owner : (n_points,) int array
        The input that each belongs to.
    wanted : (n_models, s, k) array
        ``W``.
    """

    rows: Array
    owner: NDArray[np.intp]
    wanted: Array

    def factor(self, power: Array) -> Array:
        """(n_models, k, k): ``R^{-1}`` with ``R' R = M``.

        Raises
        ------
        UndeterminedError
            Lines with power do not determine the coefficients.
        """
        models, k = self.rows.shape[0], self.rows.shape[3]
        kept = power > NEGLIGIBLE * power.max()
        stacked = np.sqrt(power[kept])[:, None, None] * self.rows[:, kept]
        triangles = np.asarray(np.linalg.qr(stacked.reshape(models, -1, k), mode="r"))
        s = np.linalg.svd(triangles, compute_uv=False)
        if triangles.shape[1] < k or np.any(s[:, -1] * SINGULAR <= s[:, 0]):
            raise UndeterminedError(
                "found lines that cannot tell the coefficients apart; expected enough of them, in "
                "a band where all coefficients show; widen the band, or state what is known"
            )
        return np.asarray(np.linalg.inv(triangles))


@dataclass(frozen=True, eq=False)
class Design:
    """Powers, and how good they are.

    Attributes
    ----------
    power : (n_points,) array
        Shares of each input's power.
    value : float
        Of the criterion.
    efficiency : float
        At least so much of the best is reached: ratio of the traces, or of the ``s``-th roots of
        the determinants.
    slopes : (n_points,) array
        Over their mean by input: at most one for lines of an optimal design.
    """

    power: Array
    value: float
    efficiency: float
    slopes: Array


def best_powers(lines: SpectralLines, criterion: Criterion) -> Design:
    """Powers that are optimal to within a tolerance.

    Parameters
    ----------
    lines : SpectralLines
    criterion : {"A", "D"}

    Returns
    -------
    Design

    Raises
    ------
    UndeterminedError
        All lines together do not determine the coefficients.

    Examples
    --------
    Two lines that tell one coefficient each, equally well, get half of the power each.

    >>> rows = np.array([[[[1.0, 0.0]], [[0.0, 1.0]], [[0.5, 0.5]]]])
    >>> found = best_powers(SpectralLines(rows, np.zeros(3, int), np.eye(2)[None]), "D")
    >>> found.power.round(3).tolist(), bool(found.efficiency > 0.999)
    ([0.5, 0.5, 0.0], True)
    """
    owner, inputs = lines.owner, int(lines.owner.max()) + 1
    members = [owner == j for j in range(inputs)]
    power = np.zeros(owner.size)
    for own in members:
        power[own] = 1.0 / own.sum()
    rate = 0.5 if criterion == "A" else 1.0
    n_wanted = lines.wanted.shape[1]
    for _ in range(MOST):
        value, slopes = _slopes(lines, power, criterion)
        mean = np.array([power[own] @ slopes[own] for own in members])
        top = float(sum(np.max(slopes[own]) for own in members))
        if criterion == "A":
            efficiency = max(2.0 - top / value, 0.0)
        else:
            efficiency = float(np.exp(-(top - n_wanted) / n_wanted))
        if efficiency >= 1.0 - TOLERANCE:
            break
        power = power * slopes**rate
        for own in members:
            power[own] /= power[own].sum()
    relative = slopes / np.where(mean > 0, mean, 1.0)[owner]
    return Design(power, value, efficiency, relative)


def _slopes(lines: SpectralLines, power: Array, criterion: Criterion) -> tuple[float, Array]:
    """The criterion, and what each line would lower it by per share of power."""
    inverse = lines.factor(power)
    outer = lines.wanted @ inverse
    direction = inverse @ np.swapaxes(outer, 1, 2)
    if criterion == "A":
        value = float(np.mean(np.sum(outer**2, axis=(1, 2))))
    else:
        corner = np.asarray(np.linalg.qr(np.swapaxes(outer, 1, 2), mode="r"))
        direction = direction @ np.linalg.inv(corner)
        diagonal = np.abs(np.diagonal(corner, axis1=1, axis2=2))
        value = float(np.mean(2.0 * np.sum(np.log(diagonal), axis=1)))
    seen = np.einsum("dkri,dis->dkrs", lines.rows, direction, optimize=True)
    return value, np.asarray(np.mean(np.sum(seen**2, axis=(2, 3)), axis=0))
