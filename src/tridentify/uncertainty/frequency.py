"""Bode magnitude and phase with pointwise bands, to first order in the standard errors.

The derivatives of ``ln G(j omega)`` are those of `tridentify.numerics.delta_method`. The band of
the magnitude is symmetric in the logarithm (in decibel), since that is what is nearly linear in the
coefficients. Reference: L. Ljung, *System Identification*, 2nd ed., sec. 9.4 (1999).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tridentify.estimation.answer.estimate import Estimate
from tridentify.numerics import delta_method
from tridentify.numerics.arrays import Array
from tridentify.uncertainty.checks import factor_of


@dataclass(frozen=True, eq=False)
class ResponseBand:
    """Frequency response with a pointwise confidence band.

    Attributes
    ----------
    omega : ndarray, shape (n_omega,)
        [rad/s].
    magnitude, magnitude_low, magnitude_high : ndarray, shape (n_omega, n_outputs, n_inputs)
        [output units / input units]. From `response_band` the band is symmetric in the logarithm.
    phase, phase_low, phase_high : ndarray, shape (n_omega, n_outputs, n_inputs)
        [rad], unwrapped along omega.
    level : float
    """

    omega: Array
    magnitude: Array
    magnitude_low: Array
    magnitude_high: Array
    phase: Array
    phase_low: Array
    phase_high: Array
    level: float


def frequency_response_std(estimate: Estimate, omega: npt.ArrayLike) -> tuple[Array, Array]:
    """Standard errors of magnitude and phase.

    Parameters
    ----------
    estimate : Estimate
    omega : array_like, shape (n_omega,)
        Angular frequencies [rad/s].

    Returns
    -------
    magnitude_std : ndarray, shape (n_omega, n_outputs, n_inputs)
        Relative to the magnitude [-].
    phase_std : ndarray, shape (n_omega, n_outputs, n_inputs)
        [rad].
    """
    grid = np.atleast_1d(np.asarray(omega, dtype=np.float64))
    shape = (grid.size, len(estimate.output_names), len(estimate.input_names))
    magnitude, phase = np.empty(shape), np.empty(shape)
    for i in range(shape[1]):
        for j in range(shape[2]):
            magnitude[:, i, j], phase[:, i, j] = delta_method.frequency_response_std(
                *estimate.channel(i, j), grid
            )
    return magnitude, phase


def response_covariance(estimate: Estimate, omega: npt.ArrayLike) -> Array:
    """Covariance of real and imaginary part of the frequency response, to first order.

    Parameters
    ----------
    estimate : Estimate
    omega : array_like, shape (n_omega,)
        Angular frequencies [rad/s].

    Returns
    -------
    ndarray, shape (n_omega, n_outputs, n_inputs, 2, 2)
        What `tridentify.numerics.delta_method.confidence_ellipse` draws in the complex plane; not
        finite where the response is not.
    """
    grid = np.atleast_1d(np.asarray(omega, dtype=np.float64))
    response = estimate.model.frequency_response(grid)
    found = np.empty((*response.shape, 2, 2))
    for i in range(response.shape[1]):
        for j in range(response.shape[2]):
            num, den, cov = estimate.channel(i, j)
            slopes = delta_method.frequency_response_slopes(num, den, grid)
            with np.errstate(invalid="ignore", over="ignore"):
                moved = response[:, i, j, None] * slopes
                parts = np.stack([moved.real, moved.imag], axis=1)
                found[:, i, j] = parts @ cov @ parts.transpose(0, 2, 1)
    return found


def response_band(estimate: Estimate, omega: npt.ArrayLike, *, level: float = 0.95) -> ResponseBand:
    """Frequency response of the model with a pointwise confidence band.

    Parameters
    ----------
    estimate : Estimate
    omega : array_like, shape (n_omega,)
        Increasing angular frequencies [rad/s].
    level : float
        Probability that the band holds at each frequency.

    Returns
    -------
    ResponseBand

    Raises
    ------
    OptionError
        The level is no probability, or a frequency is not finite.
    """
    factor = factor_of(level)
    grid = np.atleast_1d(np.asarray(omega, dtype=np.float64))
    response = estimate.model.frequency_response(grid)
    magnitude_std, phase_std = frequency_response_std(estimate, grid)
    magnitude, phase = np.abs(response), np.unwrap(np.angle(response), axis=0)
    # beyond e^300 a band says no more than "anything", and must not overflow
    spread = np.exp(np.minimum(factor * np.nan_to_num(magnitude_std, nan=300.0), 300.0))
    return ResponseBand(
        omega=grid,
        magnitude=magnitude,
        magnitude_low=magnitude / spread,
        magnitude_high=magnitude * spread,
        phase=phase,
        phase_low=phase - factor * phase_std,
        phase_high=phase + factor * phase_std,
        level=level,
    )
