"""Physical parameters straight from the records: the likelihood's maximum under the restriction.

The reduced output error `profile` at ``g(phi)`` is minimised over the parameters themselves. Every
output has its own noise level, so ``sum_i N_i log RSS_i`` is minimised by least squares with the
weights ``N_i / RSS_i``, brought up to date until they stand still; what is known of the parameters
enters as further rows. The search begins at the parameters of least distance (`distance`), from
which it differs by terms of second order in the noise: nothing on long records, something on short
ones, where the distance takes the likelihood for a parabola.

The coordinates ``w`` of the search are those in which the least distance is a unit sphere, so
``z = z_0 + T w`` with ``T = V / s`` from the singular values of its Jacobian; directions that
nothing is known about are left out. A step of the differences is then a hundredth of a standard
error, or what rounding asks for, and needs no scale of its own.

The restriction is tested by the likelihood ratio ``sum_i f_i log(RSS_i / RSS_i^free)``, with the
degrees of freedom ``f_i`` in place of the samples ``N_i`` as a correction for short records.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tridentify.numerics.arrays import Array
from tridentify.physical.distance import Restriction
from tridentify.physical.profile import HeldResidual, Profile

PROFILE_STEP = 1e-2
"""Step of the differences in standard errors: the curvature of the residual within it is small."""
LEAST_MOVE = 1e-6
"""Of the logarithm of a parameter: below it the difference is rounding."""
MOST_MOVE = 1e-3
"""The same, above which it is no derivative any more."""
MOST_ROUNDS = 12
"""Of the weights: each round gains one or two digits."""
SETTLED = 1e-7
"""Relative change of a noise variance that stands still."""
ROUNDING = 1e-22
"""Of a sum of squares relative to that of the output: residuals of 1e-11 of it are none."""
NEGLIGIBLE = 1e-9
"""To the power of 3/2, the share of the largest singular value from which a direction is known."""


@dataclass(frozen=True, eq=False)
class PhysicalMaximum:
    """The parameters of greatest likelihood.

    Attributes
    ----------
    z : (n_parameters,) array
        Coordinates.
    root : (n_parameters, rank) array
        ``root root'`` is the covariance of the coordinates.
    held : HeldResidual
        What is left of the outputs.
    ratio : float
        Likelihood ratio of the restriction, ``nan`` where the residual is no more than rounding.
    converged : bool
    """

    z: Array
    root: Array
    held: HeldResidual
    ratio: float
    converged: bool


def directions(restriction: Restriction, z: Array, rank: int) -> Array:
    """(n_parameters, rank) steps of one standard error, independent of each other."""
    free = restriction.free
    if rank == 0:
        return np.zeros((z.size, 0))
    table = restriction.jacobian(z)[:, free]
    norms = np.linalg.norm(table, axis=0)
    norms = np.where(norms > 0, norms, 1.0)
    _, s, vt = np.linalg.svd(table / norms, full_matrices=False)
    kept = s[:rank] > NEGLIGIBLE**1.5 * s[0]
    root = np.zeros((z.size, int(kept.sum())))
    root[free] = (vt[:rank][kept].T / s[:rank][kept]) / norms[:, None]
    return root


def maximum(
    restriction: Restriction, profile: Profile, start: Array, rank: int
) -> PhysicalMaximum | None:
    """Search the maximum from the parameters of least distance.

    Parameters
    ----------
    restriction : Restriction
    profile : Profile
    start : (n_parameters,) array
        Coordinates.
    rank : int
        Independent functions of the parameters that are determined.

    Returns
    -------
    PhysicalMaximum or None
        None where the model at the start has no finite response.
    """
    root = directions(restriction, start, rank)
    held = profile.at(restriction.model.theta_at(start))
    unrestricted = profile.at(restriction.theta)
    if held is None or unrestricted is None:
        return None
    freedom = profile.counts - profile.own_unknowns - rank / profile.counts.size
    freedom = np.maximum(freedom, 1.0)
    floor = ROUNDING * np.maximum(profile.spread, 1e-300)
    exact = bool(np.all(unrestricted.rss < floor))
    z, converged = start, False
    variance = np.maximum(unrestricted.rss, floor) / freedom
    for _ in range(MOST_ROUNDS):
        z, table = _weighted(restriction, profile, z, root, variance)
        found = profile.at(restriction.model.theta_at(z))
        assert found is not None
        held, before = found, variance
        variance = np.maximum(held.rss, floor) / freedom
        if exact or np.all(np.abs(variance - before) <= SETTLED * variance):
            converged = True
            break
    ratio = float(freedom @ np.log(np.maximum(held.rss, floor) / unrestricted.rss))
    prior = restriction.prior(z)
    ratio += float(prior @ prior)
    return PhysicalMaximum(
        z, root @ _inverse_root(table), held, np.nan if exact else max(ratio, 0.0), converged
    )


def _weighted(
    restriction: Restriction, profile: Profile, z: Array, root: Array, variance: Array
) -> tuple[Array, Array]:
    """Least squares with held weights; the coordinates, and the derivatives there."""
    scale = 1.0 / np.sqrt(variance)
    base = profile.at(restriction.model.theta_at(z))
    assert base is not None
    size = sum(r.size for r in base.residuals)
    if root.shape[1] == 0:  # everything is known: there is nothing to search
        return z, np.zeros((size, 0))
    steps = _steps(root)

    def value(w: Array) -> Array:
        at = z + root @ w
        held = profile.at(restriction.model.theta_at(at))
        left = (
            np.full(size, np.nan)
            if held is None
            else np.concatenate([a * r for a, r in zip(scale, held.residuals, strict=True)])
        )
        return np.concatenate([left, restriction.prior(at)])

    def slope(w: Array) -> Array:
        columns = []
        for j, h in enumerate(steps):
            above, below = w.copy(), w.copy()
            above[j] += h
            below[j] -= h
            columns.append((value(above) - value(below)) / (above[j] - below[j]))
        return np.asarray(np.nan_to_num(np.stack(columns, axis=1)))

    start = np.zeros(root.shape[1])
    # slow to import, seldom needed
    from scipy.optimize import least_squares

    done = least_squares(
        value, start, slope, method="trf", xtol=1e-9, ftol=1e-12, gtol=1e-12, max_nfev=60
    )
    return z + root @ done.x, np.asarray(done.jac)


def _steps(root: Array) -> list[float]:
    """A hundredth of a standard error, within what rounding and curvature allow."""
    largest = np.abs(root).max(axis=0)
    low, high = LEAST_MOVE / largest, MOST_MOVE / largest
    steps: list[float] = np.clip(PROFILE_STEP, low, np.maximum(high, low)).tolist()
    return steps


def _inverse_root(table: Array) -> Array:
    """``(J' J)^{-1/2}``, by the SVD of ``J`` with unit columns."""
    if table.shape[1] == 0:
        return np.zeros((0, 0))
    norms = np.linalg.norm(table, axis=0)
    norms = np.where(norms > 0, norms, 1.0)
    _, s, vt = np.linalg.svd(table / norms, full_matrices=False)
    return np.asarray((vt.T / np.where(s > 0, s, np.inf)) / norms[:, None])
