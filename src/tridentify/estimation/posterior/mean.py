"""Where the likelihood's maximum is not the answer: the mean over the posterior.

On short, noisy records the maximum-likelihood estimate is heavy-tailed: poles run off to where
the record is blind. No unbiased estimator helps there; what helps is to weigh all denominators
that explain the record. With the reference prior of `posterior.surface` that takes no tuning.

*Loss.* Which mean? An error in ``a_{n-k}`` matters relative to ``w^k``, ``w`` the geometric mean of
the pole magnitudes: time has no natural unit. The estimate that minimises the expected squared
relative error is Pitman's for a scale (Pitman 1939; Lehmann & Casella 1998, section 3.3),

    a_{n-k} = E[a_{n-k} w^{-2k}] / E[w^{-2k}],

finite although the plain mean is not, since the far tail of fast poles weighs next to nothing. It
scales exactly with the unit of time. Where poles lie decades apart one ``w`` does not measure them
all: a fast pair that the record hardly sees would pull along a slow one that it sees well. So with
three poles and more the mean is also taken section by section, each with a ``w`` of its own, and of
the two the one that explains the record better counts. ``b`` and the nuisance terms are then the
least-squares ones at this denominator.

*When.* The maximum is kept where the posterior is as good as Gaussian: where no coefficient of
a section ``p^2 + c p + d`` (neighbouring poles, `posterior.many_cascades`) has a standard error
above a tenth of its natural size, ``max(c, sqrt d, 1/T)`` and its square. Both estimates then agree
within a fraction of a standard error. Elsewhere, and where the search ended at a limit, the
posterior decides. Where a usable maximum explains the record far better than the mean, the likely
models lie on a curve and their mean beside it (little noise, needless poles): the maximum is kept,
or the likely model nearest to the mean counts where the posterior is asked for. The maximum is also
kept where the record sees a pole slower than the prior assumes: plants that integrate.

*Uncertainty.* Intervals lie between quantiles of posterior draws, of which a volume prior of
Jeffreys' kind makes each cover as stated to first order (Welch & Peers 1963). The mean is no
median: by its loss it lies low in a skewed posterior, and in noise of three times the signal one
in ten lies outside of an interval with equal tails. So the tails are shared as the draws are
(`numerics.quantiles.around`), which every monotone function maps onto its own interval: one for a
coefficient and what is read off it. The standard error shown is half the width of the interval of
68.3 %, as the second moment may not exist. Where the scores scatter more than the likelihood says
(`likelihood.scores`), the draws are drawn apart from the mean by so much
(`posterior.maximum_or_mean`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from statistics import NormalDist

import numpy as np
from scipy.special import ndtri

from tridentify.estimation.likelihood.cost import evaluate
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.estimation.posterior.first_draws import SEVERAL, first_draws
from tridentify.estimation.posterior.many_cascades import Sections, coordinates
from tridentify.estimation.posterior.sampling import (
    WeightedDraws,
    resample,
    sample,
)
from tridentify.estimation.posterior.surface import SLOWEST, Surface, surface, unit_of
from tridentify.numerics.arrays import Array, Complex, Indices
from tridentify.numerics.quantiles import ONE_SIGMA, around
from tridentify.numerics.realization import denominator, sort_poles

SEED = 0
"""Of the draws; with another one the mean moves by about a twentieth of its standard error."""
LONGEST = 5_000
"""Samples up to which the posterior is weighed: thousands of denominators are fitted to all of
them."""
VAGUE = 0.1
"""Standard error over natural size of a section's coefficient below which the posterior is as good
as Gaussian: mean and maximum agree within a fraction of a standard error."""
DRAWS = 1_000
"""Draws that are kept: 25 of them lie beyond each end of an interval of 95 %."""
ROUND = 1_000
"""Denominators fitted in a round."""
ENOUGH = 400.0
"""Independent draws, under the weights of the mean as well, that end the sampling in the first
rounds, one round a pole: the mean is off by 1 / 20 of a standard error."""
SOME = 100.0
"""Independent draws that end it later: the mean is off by a tenth of a standard error."""
MORE = 7
"""Rounds after the first ones, a round a pole: they bound the time."""
TOO_FEW = 5.0
"""Independent draws below which nothing is said: not even a standard deviation is known to a
third."""
AT_LEAST = 20.0
"""Independent draws that end the last rounds: a standard deviation is known to a sixth."""
LAST = 24
"""Rounds after those, where draws are still too few: in loud noise hundreds of narrow resonances
each explain some of it, and all of them together are to be weighed."""
CLEARLY = 2.0
"""-2 log L by which one mean explains the record better than the other, a likelihood ratio of e. By
less they are as good, and which of them it is would be left to the draws."""
SURE = 2.0
"""Standard errors between a pole and what the record excludes."""
NORMAL = NormalDist()

STILL = 1e-15
"""Least damping ratio of a root: the rounding of its real part."""


@dataclass(frozen=True, eq=False)
class Posterior:
    """What all denominators together say.

    Attributes
    ----------
    poles : (n,) complex array
        Of the mean denominator; admissible.
    draws : (n_draws, n_parameters) array
        Equally likely coefficients, in the order of `Structure.names`.
    effective : float
        How many independent draws the evaluated denominators are worth.
    evaluated : int
        Denominators evaluated.
    """

    poles: Complex
    draws: Array
    effective: float
    evaluated: int

    @property
    def usable(self) -> bool:
        """Whether the draws say anything."""
        return self.effective >= TOO_FEW

    def nearest(self, problem: Problem) -> Complex:
        """(n,) poles of the draw that is nearest to the mean, for where the likely lie on a curve.

        Distances are in standard deviations of the denominator's coefficients.
        """
        a, mean = self.draws[:, : self.poles.size], denominator(self.poles)[1:]
        low, high = np.quantile(a, (NORMAL.cdf(-1.0), NORMAL.cdf(1.0)), axis=0)
        off = np.sum(((a - mean) / np.maximum(0.5 * (high - low), 1e-150)) ** 2, axis=1)
        roots = np.roots(np.append(1.0, a[np.argmin(off)]))
        return problem.admissible(sort_poles(roots.astype(np.complex128)))[0]

    def covariance_about(self, theta: Array) -> Array:
        """(n_parameters, n_parameters) of the coefficients given, by quantiles and ranks.

        Standard deviations are half the intervals of 68.3 %, correlations those of the normal
        scores, so that no far draw dominates.
        """
        low, high = around(self.draws, theta, ONE_SIGMA)
        ranks = np.argsort(np.argsort(self.draws, axis=0), axis=0) + 0.5
        scores = ndtri(ranks / self.draws.shape[0])
        correlation = np.atleast_2d(np.corrcoef(scores, rowvar=False))
        std = 0.5 * (high - low)
        return np.asarray(correlation * np.outer(std, std))


def is_short(problem: Problem) -> bool:
    """Whether the record is short enough to weigh thousands of denominators."""
    return sum(e.n_samples for e in problem.experiments) <= LONGEST


@dataclass(frozen=True)
class Vague:
    """The section ``p^2 + c p + d`` (or the factor ``p + s``) that a record determines worst.

    Attributes
    ----------
    share : float
        Standard error of one of its coefficients over the natural size of that.
    frequency : float
        Where its poles lie [rad/s].
    quantity : str
        In words, which coefficient it is.
    """

    share: float
    frequency: float
    quantity: str


@dataclass(frozen=True)
class _Seen:
    """A section ``p^2 + c p + d``, or a factor ``p + d`` (``c`` is zero), with standard errors."""

    c: float
    d: float
    std_c: float
    std_d: float
    pair: bool


def _seen(poles: Complex, cov: Array) -> list[_Seen]:
    """Sections with what the covariance (n, n) of ``a_{n-1} .. a_0`` says of them.

    ``delta a = sum_i delta f_i prod_{j != i} f_j`` over the factors ``f_i``: linear in what changes
    of them.
    """
    factors = _factors(poles)
    n = len(cov)
    if len(factors) > 1:
        columns = []
        for i, own in enumerate(factors):
            rest = reduce(np.convolve, factors[:i] + factors[i + 1 :])
            columns += [np.pad(rest, (k, own.size - 2 - k)) for k in range(own.size - 1)]
        matrix = np.array(columns).T
        scale = np.abs(matrix).max(axis=1, keepdims=True)
        inverse = np.linalg.pinv(matrix / scale) / scale.T
        cov = inverse @ cov @ inverse.T
    std = [math.sqrt(max(value, 0.0)) for value in np.diagonal(cov).tolist()]
    found = [
        _Seen(float(own[1]), float(own[2]), std[2 * i], std[2 * i + 1], True)
        for i, own in enumerate(factors[: n // 2])
    ]
    return [*found, _Seen(0.0, float(factors[-1][1]), 0.0, std[-1], False)] if n % 2 else found


def _factors(poles: Complex) -> list[Array]:
    """The sections and the factor of one pole, as `many_cascades.coordinates` pairs real poles."""
    real = sorted(-z.real for z in poles.tolist() if z.imag == 0)
    found = [(1.0, -2.0 * z.real, abs(z) ** 2) for z in poles.tolist() if z.imag > 0]
    paired = len(real) // 2 * 2
    pairs = zip(real[0:paired:2], real[1:paired:2], strict=True)
    found += [(1.0, slow + fast, slow * fast) for slow, fast in pairs]
    return [np.array(one) for one in (*found, *((1.0, rate) for rate in real[paired:]))]


def vaguest(poles: Complex, cov: Array, longest: float) -> Vague:
    """The section whose coefficient has the largest standard error over its natural size.

    Parameters
    ----------
    poles : (n,) complex array
    cov : (n, n) array
        Covariance of ``a_{n-1} .. a_0``.
    longest : float
        Length of the record [s].
    """
    found = []
    for one in _seen(poles, cov):
        if not one.pair:
            found.append(Vague(one.std_d / max(one.d, 1.0 / longest), one.d, "rate"))
            continue
        w = float(np.sqrt(one.d))
        found.append(Vague(one.std_c / max(one.c, w, 1.0 / longest), w, "sum"))
        size = max(one.d, one.c / longest, 1.0 / longest**2)
        found.append(Vague(one.std_d / size, w, "product"))
    return max(found, key=lambda one: one.share)


def is_slower_than_assumed(poles: Complex, cov: Array, longest: float) -> bool:
    """Whether the record sees a pole where the prior says that there is none.

    The prior takes the slowest pole for faster than one over the record's length. Plants that
    integrate have one at zero: where the likelihood excludes (by two standard errors) that it is
    any faster, the mean would be the prior's word against the record's.

    Parameters
    ----------
    poles, cov, longest
        As of `vaguest`.

    Examples
    --------
    >>> is_slower_than_assumed(np.array([-1e-4 + 0j]), np.array([[0.01]]), 20.0)
    False
    >>> is_slower_than_assumed(np.array([-1e-4 + 0j]), np.array([[1e-4]]), 20.0)
    True
    """
    edge = SLOWEST / longest
    return any(
        one.d + SURE * one.std_d < (edge * max(one.c, edge) if one.pair else edge)
        for one in _seen(poles, cov)
    )


def vagueness(poles: Complex, cov: Array, longest: float) -> float:
    """Largest standard error of a section's coefficient over its natural size (`vaguest`)."""
    return vaguest(poles, cov, longest).share


def posterior(problem: Problem, near: Sequence[tuple[Complex, Array | None]]) -> Posterior:
    """Weigh all denominators.

    Parameters
    ----------
    problem : Problem
        With its nuisance terms and noise model decided.
    near : sequence of (poles, covariance)
        Ends of searches, to place the first draws; covariance (n, n) of ``a_{n-1} .. a_0``, or
        None where there is none.
    """
    n, unit = problem.n_poles, unit_of(problem)
    generator = np.random.default_rng(SEED)
    seen: list[Surface] = []

    def density(phi: Array) -> Array:
        found = surface(problem, phi)
        seen.append(found)
        return found.log_density

    def tilts(phi: Array) -> Array:
        size = np.log(Sections.of(phi, n).geometric_mean())
        return np.asarray(-2.0 * size[:, None] * order)

    order = np.arange(1, n + 1)
    goals = (ENOUGH,) * n + (SOME,) * (MORE - 1) + (TOO_FEW,) + (AT_LEAST,) * LAST
    first = first_draws(problem, near)
    drawn = sample(density, first, ROUND, goals, generator, tilts)
    whole = Surface.joined(seen)
    mean = _pitman(whole.denominators, whole.scale, drawn.weights, order)
    roots = sort_poles(np.roots(np.concatenate([[1.0], mean])).astype(np.complex128))
    poles, _ = problem.admissible(roots / unit)
    draws = _draws(problem, drawn, whole, generator)
    found = Posterior(poles, draws, drawn.effective, drawn.weights.size)
    if n < SEVERAL:
        return found
    apart, _ = problem.admissible(_by_sections(drawn) / unit)
    costs = [evaluate(problem, one).objective for one in (poles, apart)]
    return found if costs[0] <= costs[1] + CLEARLY else replace(found, poles=apart)


def _pitman(values: Array, scale: Array, weights: Array, order: Indices) -> Array:
    """``E[value scale^(-2 order)] / E[scale^(-2 order)]`` for the columns of ``values``."""
    middle = np.exp(weights @ np.log(scale))
    share = weights[:, None] * (scale / middle)[:, None] ** (-2.0 * order)
    return np.asarray((share * values).sum(axis=0) / share.sum(axis=0))


def _by_sections(drawn: WeightedDraws) -> Complex:
    """Poles of the product of the means of the sections.

    The slow pair of one denominator is no section of another one that has a slow pole beside a
    resonance. So only those count that have as many real poles as most.
    """
    n = drawn.points.shape[1]
    real = np.sum(Sections.of(drawn.points, n).roots().imag == 0, axis=1)
    most = real == np.argmax(np.bincount(real, drawn.weights))
    phi, weights = _ordered(drawn.points[most]), drawn.weights[most] / drawn.weights[most].sum()
    means = []
    for k in range(n // 2):
        w, zeta = np.exp(phi[:, 2 * k]), np.exp(phi[:, 2 * k + 1])
        c, d = _pitman(np.column_stack([2.0 * zeta * w, w * w]), w, weights, np.arange(1, 3))
        means += [np.log(np.sqrt(d)), np.log(0.5 * c / np.sqrt(d))]
    if n % 2:
        rate = np.exp(phi[:, -1])
        means.append(float(np.log(_pitman(rate[:, None], rate, weights, np.arange(1, 2))[0])))
    return sort_poles(Sections.of(np.array([means]), n).roots()[0])


def _ordered(points: Array) -> Array:
    """(s, n) coordinates of the same denominators, real poles neighbours, slow sections first."""
    roots = Sections.of(points, points.shape[1]).roots()
    # they are stable; the rounding of a swing that does not decay may say otherwise
    roots = np.minimum(roots.real, -STILL * np.abs(roots)) + 1j * roots.imag
    phi = np.empty(roots.shape)
    real = (roots.imag == 0).sum(axis=1)
    for count in np.unique(real):
        some = np.flatnonzero(real == count)
        phi[some] = coordinates(roots[some])
    last = 2 * (roots.shape[1] // 2)
    pairs = phi[:, :last].reshape(len(phi), -1, 2)
    slow_first = np.argsort(pairs[:, :, 0], axis=1)
    ordered = np.take_along_axis(pairs, slow_first[:, :, None], axis=1).reshape(len(phi), -1)
    return np.concatenate([ordered, phi[:, last:]], axis=1)


def _draws(
    problem: Problem, drawn: WeightedDraws, whole: Surface, generator: np.random.Generator
) -> Array:
    """Equally likely physical coefficients; ``b`` with its own scatter about least squares."""
    n, unit = problem.n_poles, unit_of(problem)
    chosen = resample(drawn.weights, DRAWS, generator)
    normal = generator.standard_normal((DRAWS, whole.numerators.shape[1]))
    b = whole.numerators[chosen] + np.einsum("sij,sj->si", whole.roots[chosen], normal)
    degrees = np.concatenate(
        [n - np.arange(m, -1, -1) for row in problem.n_zeros for m in row]
    ).astype(np.float64)
    a = whole.denominators[chosen] / unit ** np.arange(1, n + 1)
    return np.concatenate([a, b / unit**degrees], axis=1)
