"""Whether white weights and a model of the noise lead to the same coefficients.

Of a system of the structure asked for, both are consistent, whatever the colour of the noise. They
weigh frequencies differently, so where the structure is not the system's each ends where its own
frequencies are explained. With ``d`` the difference of the two ends and ``V`` the covariance that
it may have had by chance, a large ``d_i^2 / V_ii`` says that the structure does not hold over all
frequencies (Hausman 1978). No choice of weights is right then. What the choice costs is added to
the covariance, as ``h h'`` with ``h = d / 2``: intervals of 95 % reach from one end to the other.

``V`` is the sum of both covariances, that of the white end from the scatter of its scores
(`likelihood.scores`). The difference of an efficient and another estimate varies less than that,
so chance is taken for a misfit in far less than the stated rate.

References
----------
J. A. Hausman, Econometrica 46 (1978), 1251-1271.
"""

from __future__ import annotations

import math

import numpy as np

from tridentify.estimation.likelihood.cost import Point
from tridentify.estimation.likelihood.curvature import Curvature
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import coefficients
from tridentify.numerics.arrays import Array

BY_CHANCE = 3.0
"""Joint standard errors that two ends may differ by: three in a thousand of one coefficient, and
less as the two are of one record."""

ELSEWHERE = math.log(10.0)
"""Difference in the log of a rate from which a pole is another one. Slow noise and a slow response
change places within a decade; ends farther off are answers to two questions, of which the likelier
is given, and no scatter of one."""

IN_WORDS = "standard errors widened by what the coefficients move with the weights"


def moved_by_weights(white: Point, own: Point) -> Array | None:
    """How uncertain the choice between white weights and a noise model leaves the coefficients.

    Parameters
    ----------
    white : Point
        The end with white weights.
    own : Point
        The end on whitened samples, of the same problem.

    Returns
    -------
    (n_coefficients,) array or None
        Half of the way from one to the other. None where chance explains the difference, where the
        two ends are not of the same poles, or where the samples do not tell all coefficients of
        the white end.
    """
    here, there = coefficients(own), coefficients(white)
    if here.size != there.size or not _same_place(white, own):
        return None
    try:
        wide, narrow = Curvature.at(white), Curvature.at(own)
        scatter = wide.scatter
    except np.linalg.LinAlgError:
        return None
    spread = wide.along if scatter is None else wide.along @ np.linalg.cholesky(scatter.covariance)
    joint = np.sqrt(np.sum(spread**2, axis=1) + narrow.std**2)
    if not np.all(np.isfinite(joint)):
        return None
    moved = np.asarray(there - here)
    return 0.5 * moved if np.any(np.abs(moved) > BY_CHANCE * joint) else None


def _same_place(white: Point, own: Point) -> bool:
    """Whether every pole has its counterpart at a rate of the same size."""
    if white.poles.size != own.poles.size:
        return False
    rates = [np.log(np.maximum(np.abs(point.poles), 1e-300)) for point in (white, own)]
    return bool(np.all(np.abs(np.sort(rates[0]) - np.sort(rates[1])) < ELSEWHERE))


def in_words(moved: Array, along: Array) -> str:
    """That the errors are wider, and by how much at most.

    Parameters
    ----------
    moved : (n_coefficients,) array
        From `moved_by_weights`.
    along : (n_coefficients,) array
        Standard errors without it.
    """
    size = 2.0 * float(np.max(np.abs(moved) / np.where(along > 0, along, np.inf)))
    return (
        f"{IN_WORDS}: white weights lead up to {size:.2g} standard errors elsewhere, so that the "
        "structure does not hold over all frequencies"
    )
