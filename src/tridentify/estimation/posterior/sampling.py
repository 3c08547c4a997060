"""Adaptive importance sampling of a density over a few coordinates.

Every round draws from a mixture of Student-t kernels centred on points that the rounds before
found likely (the first from a broad box and from kernels at given points), and all draws are
weighted against the mixture of all rounds together (the balance heuristic), so that a round
that was badly placed costs efficiency but no bias (Cappe et al. 2004; Cornuet et al. 2012; Owen
& Zhou 2000).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from tridentify.numerics.arrays import Array, Flags

FREEDOM = 4.0
"""Degrees of freedom of the kernels: tails heavier than those of what they are to cover, and a
variance."""
CENTRES = 40
"""Kernels of a proposal, so that a curved posterior is followed."""
NONE = 1e-300
"""Least density of kernels: its logarithm is a number."""
WIDEST = 1.0
"""Largest standard deviation of a kernel along any axis, in log rate and log damping: a factor of
e."""
NARROWEST = 1e-4
"""The smallest: keeps the kernels regular where all weight is on one draw."""
LOCAL = 0.9
"""Share of a round's draws from its kernels; the others are from the first proposal, which covers
what no round has found."""


@dataclass(frozen=True, eq=False)
class Box:
    """Uniform draws from an axis-parallel box: ``low``, ``high`` (d,)."""

    low: Array
    high: Array

    def draw(self, count: int, generator: np.random.Generator) -> Array:
        """(count, d) draws."""
        return np.asarray(
            self.low + (self.high - self.low) * generator.random((count, self.low.size))
        )

    def log_density(self, points: Array) -> Array:
        """(s,) log density."""
        inside = np.all((points >= self.low) & (points <= self.high), axis=1)
        return np.where(inside, -np.log(self.high - self.low).sum(), -np.inf)


@dataclass(frozen=True, eq=False)
class StudentKernels:
    """A mixture of equally likely Student-t kernels of one shape.

    Attributes
    ----------
    centres : (k, d) array
    root : (d, d) array
        ``root root'`` is the scale matrix.
    """

    centres: Array
    root: Array

    def draw(self, count: int, generator: np.random.Generator) -> Array:
        """(count, d) draws."""
        d = self.centres.shape[1]
        which = generator.integers(self.centres.shape[0], size=count)
        normal = generator.standard_normal((count, d)) @ self.root.T
        shrink = np.sqrt(FREEDOM / generator.chisquare(FREEDOM, count))
        return np.asarray(self.centres[which] + normal * shrink[:, None])

    def log_density(self, points: Array) -> Array:
        """(s,) log density."""
        d = self.centres.shape[1]
        inverse = np.linalg.inv(self.root)
        scaled, centres = points @ inverse.T, self.centres @ inverse.T
        distance = (
            np.einsum("sd,sd->s", scaled, scaled)[:, None]
            + np.einsum("kd,kd->k", centres, centres)
            - 2.0 * scaled @ centres.T
        )
        # (1 + distance / FREEDOM)^(-(FREEDOM + d) / 2) without a logarithm for each
        near = np.maximum(distance, 0.0, out=distance)
        near /= FREEDOM
        near += 1.0
        np.reciprocal(near, out=near)
        half, odd = divmod(int(FREEDOM) + d, 2)
        kernels = _power(near, half) * np.sqrt(near) if odd else _power(near, half)
        constant = gammaln(0.5 * (FREEDOM + d)) - gammaln(0.5 * FREEDOM)
        constant -= 0.5 * d * np.log(FREEDOM * np.pi) + np.log(np.abs(np.diag(self.root))).sum()
        return np.asarray(np.log(np.maximum(kernels.mean(axis=1), NONE)) + constant)


@dataclass(frozen=True, eq=False)
class PartlyBox:
    """Some coordinates from a box, the others from kernels.

    Attributes
    ----------
    free : (d,) bool array
        Those from the box.
    box : Box
    kernels : StudentKernels
    """

    free: Flags
    box: Box
    kernels: StudentKernels

    def draw(self, count: int, generator: np.random.Generator) -> Array:
        """(count, d) draws."""
        found = np.empty((count, self.free.size))
        found[:, self.free] = self.box.draw(count, generator)
        found[:, ~self.free] = self.kernels.draw(count, generator)
        return found

    def log_density(self, points: Array) -> Array:
        """(s,) log density."""
        rest = self.kernels.log_density(points[:, ~self.free])
        return self.box.log_density(points[:, self.free]) + rest


@dataclass(frozen=True, eq=False)
class ProposalMixture:
    """Several proposals with weights."""

    parts: tuple[Proposal, ...]
    weights: tuple[float, ...]

    def draw(self, count: int, generator: np.random.Generator) -> Array:
        """(about count, d) draws, a fixed share from each part."""
        shares = [max(1, round(count * weight)) for weight in self.weights]
        draws = [part.draw(n, generator) for part, n in zip(self.parts, shares, strict=True)]
        return np.concatenate(draws)

    def log_density(self, points: Array) -> Array:
        """(s,) log density."""
        logs = [
            part.log_density(points) + np.log(weight)
            for part, weight in zip(self.parts, self.weights, strict=True)
        ]
        return np.asarray(np.logaddexp.reduce(logs, axis=0))


Proposal = Box | StudentKernels | PartlyBox | ProposalMixture


def _power(base: Array, exponent: int) -> Array:
    """A whole power of at least one, by squaring."""
    while exponent % 2 == 0:
        base, exponent = base * base, exponent // 2
    found = base
    while exponent > 1:
        base, exponent = base * base, exponent // 2
        if exponent % 2:
            found = found * base
    return found


def normalised(log_weights: Array) -> Array:
    """Weights that add up to one; equal ones where all points are impossible."""
    top = log_weights.max()
    if not np.isfinite(top):
        return np.full(log_weights.shape, 1.0 / log_weights.size)
    weights = np.exp(log_weights - top)
    return np.asarray(weights / weights.sum())


def effective_size(weights: Array) -> float:
    """``1 / sum w^2`` for weights that add up to one (Kish 1965)."""
    return float(1.0 / np.sum(weights**2))


@dataclass(frozen=True, eq=False)
class WeightedDraws:
    """Draws with weights.

    Attributes
    ----------
    points : (s, d) array
    weights : (s,) array
        Adding up to one.
    effective : float
        How many independent draws they are worth.
    """

    points: Array
    weights: Array
    effective: float


def sample(
    density: Callable[[Array], Array],
    first: ProposalMixture,
    count: int,
    goals: Sequence[float],
    generator: np.random.Generator,
) -> WeightedDraws:
    """Draw until the draws are worth enough independent ones, or the rounds run out.

    Parameters
    ----------
    density : callable
        (s, d) points to (s,) log density; ``-inf`` and ``nan`` are impossible points.
    first : ProposalMixture
        The first proposal; it must cover all that is possible.
    count : int
        Draws of a round.
    goals : sequence of float
        For each round, the effective sample size that makes it the last.
    generator : numpy.random.Generator

    Returns
    -------
    WeightedDraws
    """
    proposal = first
    sources: list[Proposal] = [first]
    densities: list[list[Array]] = [[]]  # of every source, for the draws of every round
    taken: list[int] = []
    points = np.empty((0, 0))
    logs = np.empty(0)
    weights = np.empty(0)
    effective = 0.0
    for goal in goals:
        drawn = proposal.draw(count, generator)
        value = density(drawn)
        points = np.concatenate([points, drawn]) if taken else drawn
        logs = np.concatenate([logs, np.where(np.isfinite(value), value, -np.inf)])
        for source, known in zip(sources, densities, strict=True):
            known.append(source.log_density(drawn))
        taken.append(drawn.shape[0])
        shares = LOCAL * np.array(taken) / sum(taken)
        shares[0] += 1.0 - LOCAL
        mixed = np.logaddexp.reduce(
            [np.concatenate(own) + s for own, s in zip(densities, np.log(shares), strict=True)],
            axis=0,
        )
        weights = normalised(logs - mixed)
        effective = effective_size(weights) if np.isfinite(logs).any() else 0.0
        if effective >= goal or len(taken) == len(goals):
            break
        local = _adapted(points, logs - mixed, generator)
        proposal = ProposalMixture((local, first), (LOCAL, 1.0 - LOCAL))
        sources.append(local)
        densities.append([local.log_density(points)])
    return WeightedDraws(points, weights, effective)


def _adapted(points: Array, log_weights: Array, generator: np.random.Generator) -> StudentKernels:
    """Kernels on resampled points; the weights are tempered until they are worth enough."""
    d = points.shape[1]
    needed = 10.0 * d
    power = 1.0
    while effective_size(normalised(power * log_weights)) < needed and power > 0.02:
        power *= 0.7
    weights = normalised(power * log_weights)
    effective = effective_size(weights)
    mean = weights @ points
    spread = (points - mean).T @ ((points - mean) * weights[:, None])
    bandwidth = (4.0 / ((d + 2.0) * max(effective, 2.0))) ** (1.0 / (d + 4.0))
    values, vectors = np.linalg.eigh(spread)
    values = np.clip(values, NARROWEST**2, WIDEST**2)
    root = np.linalg.cholesky((vectors * values) @ vectors.T) * bandwidth
    positions = (generator.random() + np.arange(CENTRES)) / CENTRES
    chosen = np.searchsorted(np.cumsum(weights), positions)
    return StudentKernels(points[np.minimum(chosen, weights.size - 1)], root)


def resample(weights: Array, count: int, generator: np.random.Generator) -> NDArray[np.intp]:
    """Positions of ``count`` equally likely draws (systematic resampling)."""
    positions = (generator.random() + np.arange(count)) / count
    return np.minimum(np.searchsorted(np.cumsum(weights), positions), weights.size - 1)
