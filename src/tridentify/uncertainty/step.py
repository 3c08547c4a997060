"""Step and impulse responses with a pointwise band, to first order in the standard errors.

Response and derivatives are exact at any time (`tridentify.numerics.delta_method.step_response`);
those to an impulse are the time derivatives of those to a step;
the realisation is the orthonormal cascade on the estimated poles, so that the conditioning does not
depend on how fast, how slow or how far apart they are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tridentify.estimation.answer.estimate import Estimate
from tridentify.models.simulate import realize
from tridentify.numerics import delta_method
from tridentify.numerics.arrays import Array
from tridentify.uncertainty.checks import checked_times, factor_of

Formula = Callable[..., tuple[Array, Array]]


@dataclass(frozen=True, eq=False)
class StepBand:
    """Response to a unit step of each input at time zero, from rest, with a pointwise band.

    Attributes
    ----------
    t : ndarray, shape (n_times,)
        [s].
    response, low, high : ndarray, shape (n_times, n_outputs, n_inputs)
        [output units] for a step of one input unit.
    level : float
    """

    t: Array
    response: Array
    low: Array
    high: Array
    level: float


@dataclass(frozen=True, eq=False)
class ImpulseBand:
    """Response to a unit impulse of each input at time zero, from rest, with a pointwise band.

    Attributes
    ----------
    t : ndarray, shape (n_times,)
        [s].
    response, low, high : ndarray, shape (n_times, n_outputs, n_inputs)
        [output units / (input units s)].
    direct : ndarray, shape (n_outputs, n_inputs)
        Weight of the impulse in the response itself, where there are as many zeros as poles
        [output units / input units]; it is not part of ``response``.
    level : float
    """

    t: Array
    response: Array
    low: Array
    high: Array
    direct: Array
    level: float


def step_band(estimate: Estimate, t: npt.ArrayLike, level: float = 0.95) -> StepBand:
    """Step response of the model with a pointwise confidence band, by the delta method.

    Parameters
    ----------
    estimate : Estimate
    t : array_like, shape (n_times,)
        Rising times [s]; the step comes at zero.
    level : float
        Probability that the band holds at each time.

    Returns
    -------
    StepBand

    Raises
    ------
    OptionError
        The level is no probability, or the times do not rise.

    Examples
    --------
    >>> from tridentify import Record, Structure, TransferFunction, identify, simulate
    >>> rng = np.random.default_rng(0)
    >>> u = np.repeat(rng.choice([-1.0, 1.0], 40), 10)
    >>> y = simulate(TransferFunction([2.0], [1.0, 4.0]), Record(u, u, dt=0.02))[:, 0]
    >>> record = Record(u, y + 0.01 * rng.standard_normal(u.size), dt=0.02)
    >>> band = step_band(identify(record, Structure(1, 0)), [0.0, 1.0])
    >>> bool(band.low[1, 0, 0] < 0.5 * (1 - np.exp(-4.0)) < band.high[1, 0, 0])
    True
    """
    return StepBand(*_band(estimate, t, level, delta_method.step_response), level)


def _band(
    estimate: Estimate, t: npt.ArrayLike, level: float, formula: Formula
) -> tuple[Array, Array, Array, Array]:
    """Times, response, and its band to first order."""
    factor, times = factor_of(level), checked_times(t)
    response, std = over_time(estimate, times, formula)
    return times, response, response - factor * std, response + factor * std


def impulse_band(estimate: Estimate, t: npt.ArrayLike, level: float = 0.95) -> ImpulseBand:
    """Impulse response of the model with a pointwise confidence band, by the delta method.

    Parameters
    ----------
    estimate : Estimate
    t : array_like, shape (n_times,)
        Rising times [s]; the impulse comes at zero.
    level : float
        Probability that the band holds at each time.

    Returns
    -------
    ImpulseBand

    Raises
    ------
    OptionError
        The level is no probability, or the times do not rise.

    Examples
    --------
    >>> from tridentify import Record, Structure, TransferFunction, identify, simulate
    >>> rng = np.random.default_rng(0)
    >>> u = np.repeat(rng.choice([-1.0, 1.0], 40), 10)
    >>> y = simulate(TransferFunction([2.0], [1.0, 4.0]), Record(u, u, dt=0.02))[:, 0]
    >>> record = Record(u, y + 0.01 * rng.standard_normal(u.size), dt=0.02)
    >>> band = impulse_band(identify(record, Structure(1, 0)), [0.0, 0.5])
    >>> bool(band.low[1, 0, 0] < 2.0 * np.exp(-2.0) < band.high[1, 0, 0])
    True
    """
    band = _band(estimate, t, level, delta_method.impulse_response)
    return ImpulseBand(*band, direct_terms(estimate), level)


def direct_terms(estimate: Estimate) -> Array:
    """What each output does at once of a jump of each input, shape (n_outputs, n_inputs)."""
    rows = zip(estimate.model.num, estimate.model.den, strict=True)
    return np.array(
        [
            [num[0] if num.size == den.size else 0.0 for num, den in zip(nums, dens, strict=True)]
            for nums, dens in rows
        ]
    )


def over_time(estimate: Estimate, times: Array, formula: Formula) -> tuple[Array, Array]:
    """Response of every channel to something at time zero, with standard errors to first order.

    Parameters
    ----------
    estimate : Estimate
    times : ndarray, shape (n_times,)
        [s].
    formula : callable
        ``formula(num, den, realization, times)`` gives the response (n_times,) and its derivatives
        by the coefficients and the delay, as those of `tridentify.numerics.delta_method`.

    Returns
    -------
    response, std : ndarray, shape (n_times, n_outputs, n_inputs)
    """
    shape = (times.size, len(estimate.output_names), len(estimate.input_names))
    response, std = np.empty(shape), np.empty(shape)
    for i in range(shape[1]):
        for j in range(shape[2]):
            num, den, cov = estimate.channel(i, j)
            value, jacobian = formula(num, den, powers_of(den), times - estimate.model.delay[i, j])
            response[:, i, j] = value
            std[:, i, j] = delta_method.standard_deviation(jacobian, cov)
    return response, std


def powers_of(den: Array) -> tuple[Array, Array, Array]:
    """State equation with the poles of ``den`` whose outputs are ``p^{n-1} / den .. 1 / den``.

    Examples
    --------
    >>> a, b, c = powers_of(np.array([1.0, 3.0, 2.0]))
    >>> (c @ np.linalg.solve(1j * np.eye(2) - a, b)).round(12)  # at s = j: s / den, 1 / den
    array([0.3+0.1j, 0.1-0.3j])
    """
    n = den.size - 1
    a, b, c, _, _ = realize(den, list(np.eye(n)))
    return a, b, c
