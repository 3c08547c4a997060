"""The impulse response with a pointwise band, to first order in the standard errors.

It is the time derivative of the step response, and so are its derivatives by the coefficients
(`tridentify.numerics.delta_method.impulse_response`), exact at any time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tridentify.estimation.answer.estimate import Estimate
from tridentify.numerics import delta_method
from tridentify.numerics.arrays import Array
from tridentify.uncertainty.checks import checked_times, factor_of
from tridentify.uncertainty.step import over_time


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
    factor, times = factor_of(level), checked_times(t)
    response, std = over_time(estimate, times, delta_method.impulse_response)
    half = factor * std
    return ImpulseBand(
        times, response, response - half, response + half, direct_terms(estimate), level
    )


def direct_terms(estimate: Estimate) -> Array:
    """What each output does at once of a jump of each input, shape (n_outputs, n_inputs)."""
    rows = zip(estimate.model.num, estimate.model.den, strict=True)
    return np.array(
        [
            [num[0] if num.size == den.size else 0.0 for num, den in zip(nums, dens, strict=True)]
            for nums, dens in rows
        ]
    )
