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
CENTRES = 24
"""Kernels of a proposal, so that a curved posterior is followed."""
NONE = 1e-300
"""Least density of kernels: its logarithm is a number."""
WIDEST = 1.0
"""Largest standard deviation of a kernel along any axis, in log rate and log damping: a factor of
e."""
TEMPERED = 10.0
"""Independent draws for each coordinate from which kernels are placed."""
FLATTEST = 0.02
"""Power of the weights below which they are not flattened further to get there."""
WINDOW = 1.2
"""Of the draws that shape a kernel, in standard deviations of all. With 0.5 a long tail was
followed too slowly: intervals of a hardly damped pair were off for 10 seeds of 16, with 1.2 for
3."""
FLOOR = 1e-6
"""Least variance of a kernel over that of all draws, which keeps it regular."""
PLAIN, TILTED = (0.8, 0.2), (0.5, 0.3, 0.2)
"""Of a round's draws those about what is likely, about what is under the tilts, and as at first."""
NARROWEST = 1e-4
"""The smallest: keeps the kernels regular where all weight is on one draw."""


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
    """A mixture of equally likely Student-t kernels.

    Attributes
    ----------
    centres : (k, d) array
    root : (d, d) or (k, d, d) array
        ``root root'`` is the scale matrix, of all kernels or of each.
    """

    centres: Array
    root: Array

    @property
    def roots(self) -> Array:
        """(k, d, d) roots of the scale matrices."""
        return np.broadcast_to(self.root, (len(self.centres), *self.root.shape[-2:]))

    def draw(self, count: int, generator: np.random.Generator) -> Array:
        """(count, d) draws."""
        d = self.centres.shape[1]
        which = generator.integers(self.centres.shape[0], size=count)
        normal = generator.standard_normal((count, d))
        off = np.einsum("sij,sj->si", self.roots[which], normal)
        shrink = np.sqrt(FREEDOM / generator.chisquare(FREEDOM, count))
        return np.asarray(self.centres[which] + off * shrink[:, None])

    def log_density(self, points: Array) -> Array:
        """(s,) log density."""
        d = self.centres.shape[1]
        inverse = np.linalg.inv(self.roots)
        scaled = inverse @ points.T
        scaled -= inverse @ self.centres[:, :, None]
        near = np.einsum("kds,kds->ks", scaled, scaled)
        # (1 + distance / FREEDOM)^(-(FREEDOM + d) / 2) without a logarithm for each
        near /= FREEDOM
        near += 1.0
        np.reciprocal(near, out=near)
        half, odd = divmod(int(FREEDOM) + d, 2)
        kernels = _power(near, half) * np.sqrt(near) if odd else _power(near, half)
        sizes = np.linalg.slogdet(inverse)[1]
        mixed = np.exp(sizes - sizes.max()) @ kernels / len(sizes)
        constant = gammaln(0.5 * (FREEDOM + d)) - gammaln(0.5 * FREEDOM) + sizes.max()
        constant -= 0.5 * d * np.log(FREEDOM * np.pi)
        return np.asarray(np.log(np.maximum(mixed, NONE)) + constant)


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
        How many independent draws they are worth, by themselves and under every tilt.
    """

    points: Array
    weights: Array
    effective: float


def untilted(points: Array) -> Array:
    """Nothing that the weights are multiplied by: means are those of the density itself."""
    return np.empty((len(points), 0))


def sample(
    density: Callable[[Array], Array],
    first: ProposalMixture,
    count: int,
    goals: Sequence[float],
    generator: np.random.Generator,
    tilts: Callable[[Array], Array] = untilted,
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
    tilts : callable
        (s, d) points to (s, m) logarithms of positive factors ``h`` of the means ``E[f h] / E[h]``
        that are told. Where a factor is large in a tail, such a mean hangs on few draws however
        many the density itself has got: so some kernels are placed by the tilted densities.

    Returns
    -------
    WeightedDraws
    """
    proposal, sources = first, [first]
    densities: list[list[Array]] = [[]]  # of every source, for the draws of every round
    taken: list[int] = []
    points = np.empty((0, 0))
    logs = np.empty(0)
    factors = np.empty((0, 0))
    weights = np.empty(0)
    effective = 0.0
    for goal in goals:
        drawn = proposal.draw(count, generator)
        value = density(drawn)
        value = np.where(np.isfinite(value), value, -np.inf)
        points = drawn if not taken else np.concatenate([points, drawn])
        logs = np.concatenate([logs, value])
        own = tilts(drawn)
        factors = own if not taken else np.concatenate([factors, own])
        for source, known in zip(sources, densities, strict=True):
            known.append(source.log_density(drawn))
        taken.append(drawn.shape[0])
        # every later proposal holds the first as well
        parts = TILTED if factors.shape[1] else PLAIN
        shares = (1.0 - parts[-1]) * np.array(taken) / sum(taken)
        shares[0] += parts[-1]
        mixed = np.logaddexp.reduce(
            [np.concatenate(k) + np.log(s) for k, s in zip(densities, shares, strict=True)], axis=0
        )
        plain = logs - mixed
        weights = normalised(plain)
        tilted = [plain + factor for factor in factors.T]
        sizes = [effective_size(weights), *(effective_size(normalised(one)) for one in tilted)]
        effective = min(sizes) if np.isfinite(logs).any() else 0.0
        if effective >= goal or len(taken) == len(goals):
            break
        needed = TEMPERED * points.shape[1]
        targets = [_tempered(plain, needed)]
        if tilted:
            targets.append(np.mean([_tempered(one, needed) for one in tilted], axis=0))
        kernels = [_adapted(points, target, generator) for target in targets]
        proposal = ProposalMixture((*kernels, first), parts)
        local = tuple(part / (1.0 - parts[-1]) for part in parts[:-1])
        sources.append(ProposalMixture(tuple(kernels), local))
        densities.append([sources[-1].log_density(points)])
    return WeightedDraws(points, weights, effective)


def _tempered(log_weights: Array, needed: float) -> Array:
    """Weights, raised to a power below one until they are worth enough draws."""
    power = 1.0
    weights = normalised(log_weights)
    while effective_size(weights) < needed and power > FLATTEST:
        power *= 0.7
        weights = normalised(power * log_weights)
    return weights


def _adapted(points: Array, weights: Array, generator: np.random.Generator) -> StudentKernels:
    """Kernels on resampled points, each as wide as the draws about it are scattered.

    Several places may differ in shape (a narrow resonance in one, a lag that nothing bounds in the
    other) and one of them may be bent. So each kernel has the covariance about its centre of the
    draws in a window of `WINDOW` standard deviations of all of them: the rounder the fewer draws
    lie there, and that of the window where they are less than two for each coordinate.
    """
    d = points.shape[1]
    mean = weights @ points
    spread = (points - mean).T @ ((points - mean) * weights[:, None])
    values, vectors = np.linalg.eigh(spread)
    values = np.clip(values, NARROWEST**2, WIDEST**2)
    root = vectors * np.sqrt(values)  # of all draws: unit covariance where it is divided by
    chosen = resample(weights, CENTRES, generator)
    scaled = (points - mean) @ (vectors / np.sqrt(values))
    centres = scaled[chosen]
    distance = np.sum(scaled**2, axis=1) + np.sum(centres**2, axis=1)[:, None]
    distance -= 2.0 * centres @ scaled.T
    share = weights * np.exp(-0.5 / WINDOW**2 * distance)
    total = share.sum(axis=1)
    few = (2.0 * d * np.sum(share**2, axis=1) / total**2)[:, None, None]
    unknown = np.maximum(1.0 - 1.0 / few, 0.0)
    share /= total[:, None]
    middle = share @ scaled
    squares = np.einsum("si,sj->sij", scaled, scaled).reshape(-1, d * d)
    local = (share @ squares).reshape(-1, d, d) - np.einsum("ki,kj->kij", middle, middle)
    local += np.einsum("ki,kj->kij", middle - centres, middle - centres)
    size = np.trace(local, axis1=1, axis2=2)[:, None, None] / d
    local = (local + few * size * np.eye(d)) / (1.0 + few)
    local += unknown * (WINDOW**2 * np.eye(d) - local) + FLOOR * np.eye(d)
    return StudentKernels(points[chosen], root @ np.linalg.cholesky(local))


def resample(weights: Array, count: int, generator: np.random.Generator) -> NDArray[np.intp]:
    """Positions of ``count`` equally likely draws (systematic resampling)."""
    positions = (generator.random() + np.arange(count)) / count
    return np.minimum(np.searchsorted(np.cumsum(weights), positions), weights.size - 1)
