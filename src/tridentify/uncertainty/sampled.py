"""Intervals by sampling: draw coefficients, compute the quantity of each draw, take percentiles.

The delta method replaces a quantity by its tangent. Where a standard error is not small against its
coefficient the tangent is wrong: a damping gets a negative lower end, a repeated pole has no
derivative at all. Drawing ``theta ~ N(theta_hat, cov)`` and reading off the quantiles of the
quantity needs no derivative; what it keeps is the Gaussian shape of the coefficients themselves,
which the parametric bootstrap (`tridentify.uncertainty.bootstrap`) drops as well. The functions
here serve the draws of both.

*Unstable draws.* The coefficients of a stable system may be so uncertain that some draws are
unstable. They are kept: leaving them out would state that the system is known to be stable, and
narrow the intervals. They count as what they are (a negative damping, a growing step response, the
formal static gain ``b_0 / a_0`` and response ``G(j omega)``), and `Sample.n_unstable` says how many
there are. Who does know that the system is stable asks `Sample.stable`.

*Posterior draws* belong to an estimate that is a posterior mean, and their percentiles are those of
its own intervals: the probability outside is shared between the two sides as the draws are
(`numerics.quantiles.around`), so that the estimate lies inside.

References: T. Krinsky & A. L. Robb, Review of Economics and Statistics 68, 715-719 (1986); B. Efron
& R. J. Tibshirani, *An Introduction to the Bootstrap* (1993).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.parameter import checked_level
from tridentify.estimation.answer.trace import freeze_arrays
from tridentify.numerics import delta_method
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.quantiles import ONE_SIGMA, around
from tridentify.numerics.root_draws import stacked_roots
from tridentify.uncertainty.checks import checked_count, checked_times, need_covariance
from tridentify.uncertainty.draws import (
    frequency_values,
    impulse_values,
    root_parts,
    step_values,
    unstable,
)
from tridentify.uncertainty.frequency import ResponseBand
from tridentify.uncertainty.intervals import Kind, intervals, quantiles
from tridentify.uncertainty.step import ImpulseBand, StepBand, direct_terms


@dataclass(frozen=True, eq=False)
class Sample:
    """Draws of the coefficients of an estimate.

    Attributes
    ----------
    estimate : Estimate
    theta : ndarray, shape (n_draws, n_parameters)
        In the order of ``estimate.names``.
    n_unstable : int
        Draws of the original sample with a pole that is not in the open left half plane.
    origin : str
        "covariance", "posterior" or "bootstrap".
    """

    estimate: Estimate
    theta: Array
    n_unstable: int
    origin: str

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def n_draws(self) -> int:
        """Number of draws at hand."""
        return len(self.theta)

    def stable(self) -> Sample:
        """Only the stable draws, for a system that is known to be stable.

        ``n_unstable`` still tells how many there were.
        """
        return replace(self, theta=self.theta[~unstable(self.estimate, self.theta)])


@dataclass(frozen=True, eq=False)
class SampledQuantity:
    """A quantity with its interval from draws.

    Attributes
    ----------
    name : str
    value : float
        At the estimate.
    low, high : float
        Ends of the interval.
    median : float
        Of the draws: its distance from ``value`` is the bias that a curved quantity, or the
        estimator, has.
    spread : float
        Half the width of the interval of 68.27 %: the standard error where the draws are Gaussian,
        and finite where their tails have no variance.
    unit : str
    level : float
    """

    name: str
    value: float
    low: float
    high: float
    median: float
    spread: float
    unit: str
    level: float


@dataclass(frozen=True, eq=False)
class SampledRoots:
    """Roots of one polynomial with intervals of their parts.

    Attributes
    ----------
    roots : ndarray, shape (n,)
        Of the estimate, complex [1/s].
    real_low, real_high, imag_low, imag_high : ndarray, shape (n,)
        [1/s]. An imaginary part of zero within the interval of a pair: draws in which it is real.
    draws : ndarray, shape (n_draws, n)
        Root ``i`` of every draw, complex.
    level : float
    """

    roots: Complex
    real_low: Array
    real_high: Array
    imag_low: Array
    imag_high: Array
    draws: Complex
    level: float


def sample(estimate: Estimate, n_draws: int = 2000, seed: int = 0) -> Sample:
    """Draw coefficients from the normal distribution that the estimate states.

    Parameters
    ----------
    estimate : Estimate
    n_draws : int
        With 2000 draws the ends of a 95 % interval are known to about 4 % of its width.
    seed : int
        Of a generator of its own.

    Returns
    -------
    Sample

    Raises
    ------
    OptionError
        `n_draws` is not a positive, or `seed` not a natural number.
    UnsupportedError
        The estimate has no covariance.

    Notes
    -----
    Where the estimate is a posterior mean, its own draws are taken.

    Examples
    --------
    >>> from tridentify import Record, Structure, TransferFunction, identify, simulate
    >>> rng = np.random.default_rng(0)
    >>> u = np.repeat(rng.choice([-1.0, 1.0], 40), 10)
    >>> y = simulate(TransferFunction([2.0], [1.0, 4.0]), Record(u, u, dt=0.02))[:, 0]
    >>> record = Record(u, y + 0.01 * rng.standard_normal(u.size), dt=0.02)
    >>> draws = sample(identify(record, Structure(1, 0)))
    >>> gain = sampled_derived(draws)[-1]
    >>> draws.n_unstable, gain.name, bool(gain.low < 0.5 < gain.high)
    (0, 'dc gain', True)
    """
    count, own = checked_count("n_draws", n_draws, 1), checked_count("seed", seed, 0)
    rng = np.random.default_rng(own)
    if len(estimate.draws):
        chosen = rng.choice(len(estimate.draws), count, replace=count > len(estimate.draws))
        theta = np.asarray(estimate.draws)[chosen]
        return Sample(estimate, theta, int(unstable(estimate, theta).sum()), "posterior")
    need_covariance(estimate)
    normal = rng.standard_normal((count, len(estimate.names)))
    unit = np.where(estimate.std > 0, estimate.std, 1.0)
    values, vectors = np.linalg.eigh(estimate.cov / np.outer(unit, unit))
    root = unit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    theta = estimate.theta + normal @ root.T
    return Sample(estimate, theta, int(unstable(estimate, theta).sum()), "covariance")


def sampled_coefficients(
    sample: Sample, level: float = 0.95, *, kind: Kind = "percentile"
) -> tuple[SampledQuantity, ...]:
    """Every coefficient with its interval, in the order of ``estimate.names``.

    Parameters
    ----------
    sample : Sample
        From `sample`, or ``bootstrap(...).sample``.
    level : float
        Probability that each interval holds, by itself.
    kind : {"percentile", "basic", "bca"}
        See `tridentify.uncertainty.intervals`; the last two are for draws of a bootstrap.

    Returns
    -------
    tuple of SampledQuantity
    """
    rows = [(p.name, p.value, p.unit) for p in sample.estimate.parameters.values()]
    return _quantities(sample, rows, sample.theta, level, kind)


def sampled_derived(
    sample: Sample, level: float = 0.95, *, kind: Kind = "percentile"
) -> tuple[SampledQuantity, ...]:
    """Natural frequency, damping, real poles, time constants and static gains.

    The quantities, names and order are those of `derived`; the parameters those of
    `sampled_coefficients`.
    """
    rows = [(p.name, p.value, p.unit) for p in sample.estimate.derived()]
    return _quantities(sample, rows, sample.estimate.derived_values(sample.theta), level, kind)


def sampled_poles(
    sample: Sample,
    output: int = 0,
    input_: int = 0,
    *,
    level: float = 0.95,
    kind: Kind = "percentile",
) -> SampledRoots:
    """Poles of one channel with intervals of their real and imaginary parts."""
    den = sample.estimate.channel_draws(sample.theta, output, input_)[1]
    return _roots(sample, den, sample.estimate.model.den[output][input_], level, kind)


def sampled_zeros(
    sample: Sample,
    output: int = 0,
    input_: int = 0,
    *,
    level: float = 0.95,
    kind: Kind = "percentile",
) -> SampledRoots:
    """Zeros of one channel with intervals of their real and imaginary parts."""
    num = sample.estimate.channel_draws(sample.theta, output, input_)[0]
    return _roots(sample, num, sample.estimate.model.num[output][input_], level, kind)


def sampled_response_band(
    sample: Sample, omega: npt.ArrayLike, *, level: float = 0.95, kind: Kind = "percentile"
) -> ResponseBand:
    """Bode magnitude and phase with pointwise bands.

    Parameters
    ----------
    sample : Sample
    omega : array_like, shape (n_omega,)
        Increasing angular frequencies [rad/s].
    level : float
    kind : {"percentile", "basic", "bca"}
        On the logarithm of the magnitude.

    Returns
    -------
    ResponseBand
        A phase counts from the estimate's, within half a turn.
    """
    grid = np.atleast_1d(np.asarray(omega, dtype=np.float64))
    response = sample.estimate.model.frequency_response(grid)
    drawn = frequency_values(sample.estimate, sample.theta, grid)
    magnitude, phase = np.abs(response), np.unwrap(np.angle(response), axis=0)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ratio = drawn / response
        turned = np.angle(ratio)
        low, high = _ends(sample, np.log(np.abs(ratio)), np.zeros(magnitude.shape), level, kind)
        ends = magnitude * np.exp(low), magnitude * np.exp(high)
    back, ahead = _ends(sample, turned, np.zeros(magnitude.shape), level, kind)
    return ResponseBand(grid, magnitude, *ends, phase, phase + back, phase + ahead, level)


def sampled_step_band(
    sample: Sample, t: npt.ArrayLike, level: float = 0.95, *, kind: Kind = "percentile"
) -> StepBand:
    """Step response with a pointwise band; times as in `step_band`.

    Raises
    ------
    OptionError
        The level is no probability, or the times do not rise.
    UnsupportedError
        A delay was estimated.
    """
    return StepBand(*_over_time(sample, t, level, kind, step_values), level)


def _over_time(
    sample: Sample,
    t: npt.ArrayLike,
    level: float,
    kind: Kind,
    values: Callable[[Estimate, Array, Array], Array],
) -> tuple[Array, Array, Array, Array]:
    """Times, response of the estimate, and the band of the draws."""
    estimate, times = sample.estimate, checked_times(t)
    centre = values(estimate, np.asarray(estimate.theta)[None], times)[0]
    drawn = values(estimate, sample.theta, times)
    return times, centre, *_ends(sample, drawn, centre, level, kind)


def sampled_impulse_band(
    sample: Sample, t: npt.ArrayLike, level: float = 0.95, *, kind: Kind = "percentile"
) -> ImpulseBand:
    """Impulse response with a pointwise band; times as in `impulse_band`.

    Raises
    ------
    OptionError
        The level is no probability, or the times do not rise.
    UnsupportedError
        A delay was estimated.
    """
    band = _over_time(sample, t, level, kind, impulse_values)
    return ImpulseBand(*band, direct_terms(sample.estimate), level)


def _ends(
    sample: Sample, values: Array, at: Array, level: float, kind: Kind
) -> tuple[Array, Array]:
    """`intervals`; of a posterior mean those that the estimate itself has."""
    if kind == "percentile" and sample.origin == "posterior":
        return around(values, at, checked_level(level))
    return intervals(values, at, level, kind)


def _quantities(
    sample: Sample, rows: list[tuple[str, float, str]], values: Array, level: float, kind: Kind
) -> tuple[SampledQuantity, ...]:
    at = np.array([row[1] for row in rows])
    ends = _ends(sample, values, at, level, kind)
    (middle,) = quantiles(values, np.full((1, len(rows)), 0.5))
    below, above = _ends(sample, values, at, ONE_SIGMA, "percentile")
    numbers = np.stack([*ends, middle, 0.5 * (above - below)], axis=1).tolist()
    return tuple(
        SampledQuantity(name, float(value), low, high, median, spread, unit, level)
        for (name, value, unit), (low, high, median, spread) in zip(rows, numbers, strict=True)
    )


def _roots(
    sample: Sample, polynomials: Array, reference: Array, level: float, kind: Kind
) -> SampledRoots:
    lead = int(np.flatnonzero(reference)[0]) if np.any(reference) else len(reference) - 1
    centre = delta_method.root_sensitivity(reference[lead:], monic=False)[0]
    drawn = root_parts(stacked_roots(polynomials[:, lead:]), centre)
    real = _ends(sample, drawn.real, centre.real, level, kind)
    imag = _ends(sample, drawn.imag, centre.imag, level, kind)
    own = centre.imag != 0
    low, high = np.where(own, imag[0], 0.0), np.where(own, imag[1], 0.0)
    return SampledRoots(centre, real[0], real[1], low, high, drawn, level)
