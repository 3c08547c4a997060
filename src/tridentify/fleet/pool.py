r"""Units of one kind: the population that they come from, and what it says of each of them.

The coefficients of a unit are ``phi = log(theta)`` where all units have them of one sign (as
damping, stiffness and gain have), else ``theta``; they scatter about a mean, ``phi ~ N(mu, S)``. A
short record says little of its unit, and its own estimate and standard errors are those of a skewed
likelihood. So not the estimates are pooled but the likelihoods: near any point a unit says
``|r - J (phi - phi_0)|^2 / s^2`` (`fleet.local`), which is ``A = J'J / s^2`` and ``A phi_0 + J'r /
s^2``. With these

* a unit's posterior is Gaussian, of precision ``A + S^-1``;
* ``mu`` and ``S`` are those of the highest likelihood, by expectation and maximisation (empirical
  Bayes; Dempster, Laird & Rubin 1977), over a few numbers a unit;
* how far a unit is from the others, ``d^2 = u' (A + A S A)^-1 u`` with its score ``u`` at ``mu``,
  is distributed as ``n F(n, samples - unknowns)`` if it is one of them.

Units beyond a limit of that distance deviate: they have no part in ``mu`` and ``S``, and nothing is
pulled in. The derivatives are taken anew where each unit is after every round (as in the
first-order conditional method of Lindstrom & Bates 1990), which is where the population lets it be,
not where its noise would take it.

Some hundred short records do not tell ``S`` to a few per cent, and intervals that take it for known
are too short. So the intervals of the units are means over ``mu`` and ``S`` drawn from what the
fleet says of them (Gibbs sampling with a uniform prior of the spreads; Gelman 2006).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tridentify.errors import TooFewSamplesError
from tridentify.fleet.local import Piece
from tridentify.numerics.arrays import Array
from tridentify.writing.layout import first_of, format_table

FALSE_ALARMS = 0.002
"""Share of sound units that are said to deviate: two in a thousand, well below the 0.5 % at which a
list of them is read no more."""

ROUNDS = 3
"""Passes over the fleet; the third moves the population by less than a tenth of its errors."""

MOST_STEPS = 2000
"""Steps of expectation and maximisation a round."""

STILL = 1e-4
"""Change of ``S`` over its size in a step, below which it stands still."""

DRAWS = 1000
"""Populations that are averaged over."""

UNUSED = 100
"""Draws before them, which still remember where they began."""

MANY = 20_000
"""Units from which the population is known well enough to be taken for known."""

LEAST = 1e-4
"""Scatter of the units over the variance of what a typical one tells, below which it is none: a
hundredth of its standard error. Keeps covariances regular where units do not differ."""

FEWEST = 10
"""Units for each coefficient: fewer tell no covariance of a population."""

TAILS = 4.0
"""Degrees of freedom of the weights in the first round: units far off count little before it is
known how far the others scatter."""

ONE_SIGN = 0.98
"""Share of the units that have a coefficient of one sign, where it is taken as a logarithm; the
estimate of a poor record may have any."""

MOST_SHOWN = 10
"""Units that deviate, named in a summary."""

Look = Callable[[Mapping[str, Sequence[float]]], Mapping[str, Piece]]


@dataclass(frozen=True, eq=False)
class Pool:
    """A population and its members.

    Attributes
    ----------
    names : tuple of str
    mean : ndarray, shape (n,)
        Of the population: the median where ``logarithmic``.
    covariance : ndarray, shape (n, n)
        Of the coefficients among the units; of their logarithms where ``logarithmic``.
    logarithmic : ndarray of bool, shape (n,)
    keys : tuple of str
        Of the units, sorted.
    own : ndarray, shape (n_units, n)
        Their own estimates; nan where there is none.
    shrunk : ndarray, shape (n_units, n)
        Their estimates in the light of the others; of units that deviate, their own.
    low, high : ndarray, shape (n_units, n)
        Ends of the 95 % intervals of ``shrunk``.
    distance : ndarray, shape (n_units,)
        From the population: the probability that a member is further away.
    deviating : ndarray of bool, shape (n_units,)
    """

    names: tuple[str, ...]
    mean: Array
    covariance: Array
    logarithmic: NDArray[np.bool_]
    keys: tuple[str, ...]
    own: Array
    shrunk: Array
    low: Array
    high: Array
    distance: Array
    deviating: NDArray[np.bool_]

    @property
    def spread(self) -> Array:
        """(n,) standard deviations among the units: relative where ``logarithmic``."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def outliers(self) -> tuple[str, ...]:
        """Keys of the units that deviate, the furthest first."""
        order = np.argsort(self.distance, kind="stable")
        return tuple(self.keys[k] for k in order if self.deviating[k])

    def columns(self) -> dict[str, Any]:
        """A column a quantity, a row a unit."""
        found: dict[str, Any] = {"key": list(self.keys)}
        for k, name in enumerate(self.names):
            found |= {
                name: self.shrunk[:, k],
                f"{name}_low": self.low[:, k],
                f"{name}_high": self.high[:, k],
                f"{name}_own": self.own[:, k],
            }
        return found | {"distance": self.distance, "deviating": self.deviating}

    def table(self) -> list[tuple[str, ...]]:
        """Coefficient, centre and spread, for people."""
        return [
            (name, f"{m:.5g}", f"{100 * s:.2g} %" if log else f"{s:.2g}")
            for name, m, s, log in zip(
                self.names, self.mean.tolist(), self.spread.tolist(), self.logarithmic, strict=True
            )
        ]

    def summary(self) -> str:
        """Text for people."""
        found = first_of(self.outliers, MOST_SHOWN)
        told = f"{len(self.outliers)} of {len(self.keys)} units deviate"
        head = f"population: {told}{': ' if found else ''}{found}"
        return "\n".join(
            [head, "", *format_table(("coefficient", "centre", "spread"), self.table())]
        )

    def to_dict(self) -> dict[str, Any]:
        """The population, ready for JSON."""
        return {
            "names": list(self.names),
            "mean": self.mean.tolist(),
            "covariance": self.covariance.tolist(),
            "logarithmic": self.logarithmic.tolist(),
            "units": len(self.keys),
            "deviating": list(self.outliers),
        }


@dataclass(frozen=True, eq=False)
class _Said:
    """What the units say of ``phi``: precision (N, n, n), precision times place (N, n), freedom."""

    precision: Array
    weighted: Array
    freedom: Array

    @cached_property
    def least(self) -> Array:
        """(n, n) scatter below which no fleet can tell it from none."""
        typical = np.median(np.einsum("kii->ki", self.precision), axis=0)
        return np.diag(LEAST / np.maximum(typical, 1e-300))


@dataclass(frozen=True, eq=False)
class _Population:
    mu: Array
    scatter: Array


def pooled(look: Look, names: Sequence[str], own: Mapping[str, Sequence[float]]) -> Pool:
    """The population of units, and every unit in its light.

    Parameters
    ----------
    look : callable
        A pass over the fleet: what each unit says near coefficients of its own.
    names : sequence of str
    own : mapping of str to sequence of float
        Key -> the unit's own estimate; empty where it has none.

    Raises
    ------
    TooFewSamplesError
        There are too few units for a population.
    """
    known = np.array([values for values in own.values() if len(values)]).reshape(-1, len(names))
    if len(known) < FEWEST * len(names):
        raise TooFewSamplesError(
            f"found {len(known)} units with an estimate for {len(names)} coefficients; expected at "
            f"least {FEWEST * len(names)} to tell how they scatter; leave --pool out"
        )
    signs, logarithmic = _signs(known)
    scale = _Scale(signs, logarithmic)
    centre = np.median(known[scale.admits(known)], axis=0)
    keys = sorted(own)
    phi = np.tile(scale.inward(centre), (len(keys), 1))
    population, alike = None, np.ones(len(keys), dtype=bool)
    for _ in range(ROUNDS):
        theta = scale.outward(phi)
        pieces = look({key: row for key, row in zip(keys, theta.tolist(), strict=True)})
        kept = [k for k, key in enumerate(keys) if key in pieces]
        keys, phi, alike, theta = [keys[k] for k in kept], phi[kept], alike[kept], theta[kept]
        said = _said([pieces[key] for key in keys], phi, scale.slope(theta))
        # about where the search begins, as wide as a unit alone is uncertain
        population = population or _Population(phi[0], said.least / LEAST)
        population, alike, tail = _settled(said, population, alike)
        phi, variance = _posterior(said, population)
    assert population is not None
    if len(keys) < MANY:
        population, phi, variance = _drawn(said, population, alike)
        tail = _tail(said, population)
        alike = tail > FALSE_ALARMS
    return _pool(names, keys, own, scale, population, phi, variance, alike, tail, said)


@dataclass(frozen=True, eq=False)
class _Scale:
    """Between coefficients and what is taken as Gaussian."""

    signs: Array
    logarithmic: NDArray[np.bool_]

    def admits(self, theta: Array) -> NDArray[np.bool_]:
        wrong = (theta * self.signs <= 0.0) & self.logarithmic
        return np.asarray(~np.any(wrong, axis=1))

    def inward(self, theta: Array) -> Array:
        safe = np.where(self.logarithmic, np.abs(theta), 1.0)
        return np.where(self.logarithmic, np.log(safe), theta)

    def outward(self, phi: Array) -> Array:
        grown = self.signs * np.exp(np.where(self.logarithmic, phi, 0.0))
        return np.where(self.logarithmic, grown, phi)

    def slope(self, theta: Array) -> Array:
        """D theta / d phi."""
        return np.where(self.logarithmic, theta, 1.0)


def _signs(known: Array) -> tuple[Array, NDArray[np.bool_]]:
    signs = np.where(np.median(known, axis=0) >= 0.0, 1.0, -1.0)
    return signs, np.mean(known * signs > 0.0, axis=0) >= ONE_SIGN


def _said(pieces: Sequence[Piece], phi: Array, slope: Array) -> _Said:
    """Precisions and places, on the scale that is Gaussian."""
    n = phi.shape[1]
    precision, weighted = np.zeros((len(pieces), n, n)), np.zeros((len(pieces), n))
    freedom = np.zeros(len(pieces))
    for k, piece in enumerate(pieces):
        left = piece.counts - piece.own - piece.shared
        # what no coefficients explain is the noise, wherever the derivatives were taken
        rest = [_unexplained(one) for one in piece.triangles]
        variance = np.maximum(rest / np.maximum(left, 1.0), 1e-300)
        for one, v in zip(piece.triangles, variance, strict=True):
            scores = one[:, :-1] * slope[k]
            precision[k] += scores.T @ scores / v
            weighted[k] += scores.T @ one[:, -1] / v
        weighted[k] += precision[k] @ phi[k]
        freedom[k] = max(float(left.sum()), 1.0)
    return _Said(precision, weighted, freedom)


def _unexplained(one: Array) -> float:
    scores, residual = one[:, :-1], one[:, -1]
    left = residual - scores @ np.linalg.lstsq(scores, residual, rcond=1e-10)[0]
    return float(left @ left)


def _posterior(said: _Said, population: _Population) -> tuple[Array, Array]:
    """Means (N, n) and covariances (N, n, n) of the units."""
    prior = np.linalg.inv(population.scatter)
    variance = np.linalg.inv(said.precision + prior)
    mean = np.einsum("kij,kj->ki", variance, said.weighted + prior @ population.mu)
    return mean, variance


def _distance(said: _Said, population: _Population) -> Array:
    """(N,) squared distance of what each unit says from the population."""
    score = said.weighted - said.precision @ population.mu
    spread = said.precision + said.precision @ population.scatter @ said.precision
    size = np.sqrt(np.maximum(np.einsum("kii->ki", spread), 1e-300))
    unit = spread / size[:, :, None] / size[:, None, :]
    whole = np.linalg.pinv(unit, rcond=1e-12, hermitian=True)
    scaled = score / size
    return np.asarray(np.einsum("ki,kij,kj->k", scaled, whole, scaled))


def _tail(said: _Said, population: _Population) -> Array:
    """(N,) probability that a member of the population is further away."""
    from scipy.special import fdtrc

    n = population.mu.size
    return np.asarray(fdtrc(n, said.freedom, _distance(said, population) / n))


def _settled(
    said: _Said, population: _Population, alike: NDArray[np.bool_]
) -> tuple[_Population, NDArray[np.bool_], Array]:
    """The most likely population of the units that do not deviate from it."""
    n = population.mu.size

    def by_distance(found: _Population) -> Array:
        return np.asarray((TAILS + n) / (TAILS + _distance(said, found)))

    population = _climbed(said, population, by_distance)
    tail = _tail(said, population)
    alike = tail > FALSE_ALARMS
    for _ in range(20):
        weights = alike.astype(np.float64)
        population = _climbed(said, population, _constant(weights))
        tail = _tail(said, population)
        now = tail > FALSE_ALARMS
        if np.array_equal(now, alike):
            break
        alike = now
    return population, alike, tail


def _constant(weights: Array) -> Callable[[_Population], Array]:
    return lambda _: weights


def _climbed(
    said: _Said, population: _Population, weigh: Callable[[_Population], Array]
) -> _Population:
    """Steps of expectation and maximisation until the scatter stands still."""
    for _ in range(MOST_STEPS):
        weights = weigh(population)
        total = float(weights.sum())
        mean, variance = _posterior(said, population)
        mu = weights @ mean / total
        off = mean - mu
        scatter = np.einsum("k,ki,kj->ij", weights, off, off)
        scatter = (scatter + np.einsum("k,kij->ij", weights, variance)) / total
        moved = np.linalg.norm(scatter - population.scatter) / np.linalg.norm(scatter)
        population = _Population(mu, 0.5 * (scatter + scatter.T) + said.least)
        if moved < STILL:
            break
    return population


def _drawn(
    said: _Said, population: _Population, alike: NDArray[np.bool_]
) -> tuple[_Population, Array, Array]:
    """Population and units, averaged over what is not known of the population."""
    random = np.random.default_rng(0)
    count, n = int(alike.sum()), population.mu.size
    mus, scatters = np.zeros((DRAWS, n)), np.zeros((DRAWS, n, n))
    means, squares = np.zeros_like(said.weighted), np.zeros_like(said.precision)
    for draw in range(-UNUSED, DRAWS):
        mean, variance = _posterior(said, population)
        root = np.linalg.cholesky(0.5 * (variance + variance.transpose(0, 2, 1))[alike])
        noise = random.standard_normal((count, n))
        phi = mean[alike] + np.einsum("kij,kj->ki", root, noise)
        off = phi - phi.mean(axis=0)
        # inverse Wishart, as the inverse of a product of normal draws
        inner = np.linalg.cholesky(np.linalg.inv(off.T @ off + count * said.least))
        drawn = random.standard_normal((count - 2, n)) @ inner.T
        scatter = np.asarray(np.linalg.inv(drawn.T @ drawn))
        step = np.linalg.cholesky(scatter / count) @ random.standard_normal(n)
        population = _Population(phi.mean(axis=0) + step, scatter)
        if draw >= 0:
            mus[draw], scatters[draw] = population.mu, scatter
            means += mean / DRAWS
            squares += (variance + mean[:, :, None] * mean[:, None, :]) / DRAWS
    spread = squares - means[:, :, None] * means[:, None, :]
    return _Population(mus.mean(axis=0), scatters.mean(axis=0)), means, spread


def _pool(
    names: Sequence[str],
    keys: Sequence[str],
    own: Mapping[str, Sequence[float]],
    scale: _Scale,
    population: _Population,
    phi: Array,
    variance: Array,
    alike: NDArray[np.bool_],
    tail: Array,
    said: _Said,
) -> Pool:
    blank = [np.nan] * len(names)
    alone = np.array([list(own[key]) or blank for key in keys], dtype=np.float64)
    std = np.sqrt(np.einsum("kii->ki", variance))
    # a unit that deviates is told by its own record alone
    apart = ~alike & np.all(np.isfinite(alone), axis=1) & scale.admits(alone)
    phi = np.where(apart[:, None], scale.inward(np.where(apart[:, None], alone, 1.0)), phi)
    single = np.linalg.pinv(said.precision, rcond=1e-12, hermitian=True)
    std = np.where(apart[:, None], np.sqrt(np.abs(np.einsum("kii->ki", single))), std)
    ends = [scale.outward(phi + side * 1.959964 * std) for side in (-1.0, 1.0)]
    return Pool(
        tuple(names),
        scale.outward(population.mu),
        population.scatter,
        scale.logarithmic,
        tuple(keys),
        alone,
        scale.outward(phi),
        np.minimum(*ends),
        np.maximum(*ends),
        tail,
        ~alike,
    )
