"""The local curvature at a point: covariance of everything that is estimated there.

With ``J`` the derivatives of the outputs, each divided by its noise standard deviation, with
respect to every unknown (``alpha``, ``b``, free responses, offsets, drifts), ``cov = (J'
J)^{-1}`` is the Cramer-Rao bound for white Gaussian noise of the estimated variance, and the
covariance of the maximum-likelihood estimate for long records. It is formed from the SVD of
``J`` with unit columns. Where the noise has a model (`noise.noise_model`), ``J`` is that of
the whitened outputs and the variance that of the innovations. ``a = c (1 + alpha X)`` and ``b / c =
beta X + d`` are linear in the unknowns at ``c = a``, so the physical coefficients take it over by
one matrix product.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tridentify.errors import UnsupportedOrderError
from tridentify.estimation.likelihood.cost import Point
from tridentify.estimation.likelihood.fitted_point import ROUNDING_SQUARED
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import coefficients
from tridentify.estimation.likelihood.scores import ScoreScatter, scatter_of_scores
from tridentify.numerics.arrays import Array
from tridentify.numerics.kept import cached_property

SINGULAR = 1e12
"""Condition of the scaled derivatives from which rounding decides the coefficients."""


@dataclass(frozen=True, eq=False)
class Curvature:
    """The inverse of the information at a point.

    Attributes
    ----------
    point : Point
    noise : (n_outputs,) array
        Variances that the derivatives are weighted with.
    root : (n_unknowns, k) array
        ``root root'`` is the covariance of all unknowns.
    condition : float
        Of the derivatives with unit columns.
    layout : dict
        Which unknowns stand where.
    physical : (n_coefficients, n_unknowns) array
        How the physical coefficients move with the unknowns.
    reacts : bool
        Whether the inputs hold past noise (the direct route).
    """

    point: Point
    noise: Array
    root: Array
    condition: float
    layout: dict[object, slice]
    physical: Array
    reacts: bool = False

    @classmethod
    def at(cls, point: Point, noise: Array | None = None, held: Array | None = None) -> Curvature:
        """The curvature at a point.

        Parameters
        ----------
        point : Point
        noise : (n_outputs,) array, optional
            In place of the residual variances there.
        held : (k, n_coefficients) array, optional
            Combinations of the coefficients that do not move.
        """
        given = point.rss / degrees_of_freedom(point) if noise is None else noise
        matrix, output = point.jacobian()
        rows = matrix / np.sqrt(np.maximum(given, 1e-300))[output][:, None]
        norms = np.sqrt(np.einsum("ij,ij->j", rows, rows))
        norms = np.where(norms > 0, norms, 1.0)
        rows = rows / norms
        physical = physical_transform(point, norms.size)
        free = None
        if held is not None and held.size:
            fixed = (held @ physical) / norms
            fixed /= np.linalg.norm(fixed, axis=1, keepdims=True)
            free = np.linalg.qr(fixed.T, mode="complete")[0][:, held.shape[0] :]
            rows = rows @ free
        _, s, vt = np.linalg.svd(rows, full_matrices=False)
        condition = float(s[0] / s[-1]) if s[-1] > 0 else np.inf
        root = vt.T / np.where(s > 0, s, np.inf)
        root = (root if free is None else free @ root) / norms[:, None]
        return cls(point, given, root, condition, point.width, physical)

    @cached_property
    def along(self) -> Array:
        """(n_coefficients, k) array: its product with itself is their covariance."""
        return np.asarray(self.physical @ self.root)

    @property
    def covariance(self) -> Array:
        """(n_coefficients, n_coefficients), of the physical coefficients."""
        return np.asarray(self.along @ self.along.T)

    @property
    def std(self) -> Array:
        """(n_coefficients,) standard errors."""
        return np.asarray(np.linalg.norm(self.along, axis=1))

    @cached_property
    def scatter(self) -> ScoreScatter | None:
        """What the scores say of the covariance (`likelihood.scores`)."""
        return scatter_of_scores(self.point, self.root, self.noise, self.reacts, self.along)

    def refuse_undetermined(self) -> None:
        """Refuse coefficients that the samples cannot tell apart, or only rounding determines.

        The latter are superfluous poles without noise.

        Raises
        ------
        UnsupportedOrderError
        """
        problem = self.point.problem
        poles = [group.order for group in problem.groups]
        order = poles[0] if len(poles) == 1 else poles
        if self.condition > SINGULAR:
            raise UnsupportedOrderError(
                f"found score columns of condition {self.condition:.1e} with {order} poles; "
                f"expected coefficients that the record can tell apart (below {SINGULAR:.0e}); "
                "lower the number of poles or zeros, or excite the system more richly"
            )
        floor = ROUNDING_SQUARED * problem.size
        if np.all(self.noise > floor):
            return
        a = problem.denominator_places()
        std = Curvature.at(self.point, np.maximum(self.noise, floor)).std[a]
        if np.any(std > 0.5 * np.abs(coefficients(self.point)[a])):
            raise UnsupportedOrderError(
                f"found a record without noise that does not determine {order} poles; expected an "
                "order that the record needs; lower the number of poles"
            )


def output_rss(point: Point) -> Array:
    """(n_outputs,) sums of squares of the residual as it is, neither whitened nor weighted."""
    weighted = any(e.scale is not None for e in point.problem.experiments)
    if not (weighted or any(a.size for a in point.problem.noise)):
        return point.rss
    return np.asarray(np.sum([np.nansum(one**2, axis=0) for one in point.residuals()], axis=0))


def taken(point: Point, output: int) -> list[Array]:
    """Series whose products are the covariance that the fit took from the noise of one output."""
    root = Curvature.at(point).root
    pairs = zip(point.problem.experiments, point.sensitivities(root, output), strict=True)
    moved = [one / e.scale_of(output) for e, one in pairs]
    return [one[:, k] for one in moved for k in range(root.shape[1])]


def degrees_of_freedom(point: Point) -> Array:
    """(n_outputs,) samples less unknowns, those of the noise model included.

    A denominator is split evenly among the outputs that share it.
    """
    own = point.linear.sizes.astype(np.float64)
    shared = np.zeros(own.size)
    for group in point.problem.groups:
        outputs = sorted({i for i, _ in group.channels})
        shared[outputs] += group.order / len(outputs)
    shared += point.problem.n_delays / own.size
    sizes = [a.size for a in point.problem.noise]
    noise = np.array(sizes or np.zeros(own.size), dtype=np.float64)
    return np.asarray(np.maximum(point.counts - own - shared - noise, 1.0))


def physical_transform(point: Point, width: int) -> Array:
    """d(physical coefficients) / d(unknowns)."""
    from tridentify.estimation.likelihood.compiled.curvature import physical_of

    problem, bank, keys = point.problem, point.triangles.bank, point.width
    starts = np.array([keys[i, ("b", 0)].start for i in range(problem.n_outputs)], dtype=np.int64)
    found = physical_of(bank.poles, *problem.pattern, bank.basis, starts, width)
    if not problem.n_delays:
        return found
    delays = np.zeros((problem.n_delays, width))
    delays[:, keys["delay"]] = np.eye(problem.n_delays)
    return np.vstack([found, delays])


def physical_map(point: Point) -> tuple[Array, dict[object, slice]]:
    """How the physical coefficients move with the unknowns of `Point.jacobian`.

    Parameters
    ----------
    point : Point

    Returns
    -------
    map : (n_coefficients, n_unknowns) array
    layout : dict
        Which unknowns stand where.
    """
    keys = point.width
    width = max(place.stop for place in keys.values())
    return physical_transform(point, width), keys
