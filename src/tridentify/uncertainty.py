"""What the covariance of the coefficients says about frequency response, poles and gains.

Everything is the delta method with analytic derivatives (`tridentify.numerics.delta_method`): exact
to first order in the standard errors. Where a standard error is not small against its coefficient,
read the bands as an order of magnitude.

References: L. Ljung, *System Identification*, 2nd ed., sec. 9.4 (1999).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
import numpy.typing as npt

from tridentify.estimate import Estimate, Parameter
from tridentify.numerics import delta_method

Real = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class DerivedQuantity(Parameter):
    """A quantity that follows from the coefficients, with its standard error.

    Named "natural frequency", "damping", "real pole", "time constant" or "dc gain"; numbered where
    there are several, followed by ``[output,input]`` where there are several channels.

    Examples
    --------
    >>> low, high = DerivedQuantity("damping", 0.3, 0.01, "-").interval(0.95)
    >>> round(low, 4), round(high, 4)
    (0.2804, 0.3196)
    """


@dataclass(frozen=True, eq=False)
class ResponseBand:
    """Frequency response with a pointwise confidence band.

    Attributes
    ----------
    omega : ndarray, shape (n_omega,)
        [rad/s].
    magnitude, magnitude_low, magnitude_high : ndarray, shape (n_omega, n_outputs, n_inputs)
        [output units / input units]. The band is symmetric in the logarithm.
    phase, phase_low, phase_high : ndarray, shape (n_omega, n_outputs, n_inputs)
        [rad], unwrapped along omega.
    level : float
    """

    omega: Real
    magnitude: Real
    magnitude_low: Real
    magnitude_high: Real
    phase: Real
    phase_low: Real
    phase_high: Real
    level: float


@dataclass(frozen=True, eq=False)
class RootUncertainty:
    """Roots of one polynomial in the complex plane.

    Attributes
    ----------
    roots : ndarray, shape (n,)
        Complex [1/s].
    cov : ndarray, shape (n, 2, 2)
        Covariance of (real, imaginary) part; not finite at a repeated root.
    """

    roots: Complex
    cov: Real

    def ellipse(self, index: int, level: float = 0.95) -> Real:
        """Confidence ellipse around one root, shape (73, 2): real and imaginary part [1/s].

        A real root has an interval instead, since its imaginary part is zero: the ellipse is a
        stroke whose ends are those of the one-dimensional interval.
        """
        root, cov = self.roots[index], self.cov[index]
        centre = np.array([root.real, root.imag])
        if root.imag == 0:
            half = NormalDist().inv_cdf((1 + level) / 2) * math.sqrt(cov[0, 0])
            stroke: Real = centre + half * np.column_stack((np.linspace(-1, 1, 73), np.zeros(73)))
            return stroke
        return centre + delta_method.confidence_ellipse(cov, level)


def frequency_response_std(estimate: Estimate, omega: npt.ArrayLike) -> tuple[Real, Real]:
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
    """
    grid = np.atleast_1d(np.asarray(omega, dtype=np.float64))
    response = estimate.model.frequency_response(grid)
    magnitude_std, phase_std = frequency_response_std(estimate, grid)
    factor = NormalDist().inv_cdf((1 + level) / 2)
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


def derived(estimate: Estimate) -> tuple[DerivedQuantity, ...]:
    """Natural frequency and damping, real poles and time constants, static gains.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    tuple of DerivedQuantity
        Poles by rising magnitude (once where the denominator is shared), then the gains.
    """
    return tuple(DerivedQuantity(*row) for row in estimate.derived_rows())


def poles(estimate: Estimate, output: int = 0, input_: int = 0) -> RootUncertainty:
    """Poles of one channel with the covariance of their real and imaginary parts."""
    _, den, cov = estimate.channel(output, input_)
    n = len(den) - 1
    return _roots(den, cov[:n, :n], monic=True)


def zeros(estimate: Estimate, output: int = 0, input_: int = 0) -> RootUncertainty:
    """Zeros of one channel with the covariance of their real and imaginary parts."""
    num, den, cov = estimate.channel(output, input_)
    n = len(den) - 1
    lead = int(np.flatnonzero(num)[0]) if np.any(num) else len(num) - 1
    return _roots(num[lead:], cov[n + lead : -1, n + lead : -1], monic=False)


def _roots(polynomial: Real, cov: Real, *, monic: bool) -> RootUncertainty:
    roots, sensitivity = delta_method.root_sensitivity(polynomial, monic=monic)
    parts = np.stack((sensitivity.real, sensitivity.imag), axis=1)
    with np.errstate(invalid="ignore", over="ignore"):
        return RootUncertainty(roots, parts @ cov @ parts.transpose(0, 2, 1))
