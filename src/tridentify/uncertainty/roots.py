"""Poles, zeros and what is read from them, to first order in the standard errors.

See `tridentify.numerics.delta_method` for the derivatives. A repeated root has none, so that its
covariance is not finite; intervals by sampling (`tridentify.uncertainty.sampled`) do not need any.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tridentify.estimation.answer.estimate import Estimate, Parameter
from tridentify.numerics import delta_method
from tridentify.numerics.arrays import Array, Complex
from tridentify.uncertainty.checks import factor_of

Ends = tuple[float, float]


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
    cov: Array

    def ellipse(self, index: int, level: float = 0.95) -> Array:
        """Confidence ellipse around one root, shape (73, 2): real and imaginary part [1/s].

        A real root has an interval instead, since its imaginary part is zero: the ellipse is a
        stroke whose ends are those of the one-dimensional interval.
        """
        factor = factor_of(level)
        root, cov = self.roots[index], self.cov[index]
        centre = np.array([root.real, root.imag])
        if root.imag == 0:
            half = factor * math.sqrt(cov[0, 0])
            stroke: Array = centre + half * np.column_stack((np.linspace(-1, 1, 73), np.zeros(73)))
            return stroke
        return centre + delta_method.confidence_ellipse(cov, level)

    def interval(self, index: int, level: float = 0.95) -> tuple[Ends, Ends]:
        """Intervals of the real and of the imaginary part of one root [1/s].

        Parameters
        ----------
        index : int
        level : float
            Probability that each of the two holds, by itself.

        Returns
        -------
        real, imag : (low, high)
            The imaginary part of a real root is (0, 0).

        Examples
        --------
        >>> region = RootUncertainty(np.array([-1 + 2j]), np.array([np.diag([0.01, 0.04])]))
        >>> [[round(end, 3) for end in part] for part in region.interval(0)]
        [[-1.196, -0.804], [1.608, 2.392]]
        """
        root, cov = self.roots[index], self.cov[index]
        half = factor_of(level) * np.sqrt(np.diag(cov))
        real, imag = float(root.real), float(root.imag)
        wide = float(half[1]) if imag else 0.0
        return (real - float(half[0]), real + float(half[0])), (imag - wide, imag + wide)


def derived(estimate: Estimate) -> tuple[DerivedQuantity, ...]:
    """Natural frequency and damping, real poles and time constants, static gains.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    tuple of DerivedQuantity
        Poles by rising magnitude (once where the denominator is shared), then the gains. Where the
        estimate is a posterior mean, intervals and standard errors are those of its draws.
    """
    return tuple(
        DerivedQuantity(item.name, item.value, item.std, item.unit, item.draws)
        for item in estimate.derived()
    )


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


def _roots(polynomial: Array, cov: Array, *, monic: bool) -> RootUncertainty:
    roots, sensitivity = delta_method.root_sensitivity(polynomial, monic=monic)
    parts = np.stack((sensitivity.real, sensitivity.imag), axis=1)
    with np.errstate(invalid="ignore", over="ignore"):
        return RootUncertainty(roots, parts @ cov @ parts.transpose(0, 2, 1))
