"""Noise like that of an estimate, for the parametric bootstrap.

White noise needs a variance. Coloured noise is autoregressive, ``e_k + d_1 e_{k-1} + ... + d_p
e_{k-p} = w_k`` with white ``w``. Its first p values are drawn from the stationary distribution: the
state ``x = (e_k, ..., e_{k-p+1})`` obeys ``x_{k+1} = F x_k + g w``, whose covariance solves ``P = F
P F' + g g'`` (a discrete Lyapunov equation), so that no run-in is needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from tridentify.errors import UnsupportedError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.numerics.arrays import Array


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Independent Gaussian noise on every output.

    Attributes
    ----------
    deviation : ndarray, shape (n_outputs,)
        Standard deviation of the noise, coloured or not [output units].
    levels : tuple of ndarray, shape (n_outputs,) each
        The same for every experiment; empty where it is one for all.
    autoregression : tuple of ndarray
        For every output the coefficients ``(d_1, ..., d_p)``; empty for white noise.

    Examples
    --------
    >>> model = NoiseModel(np.array([1.0]), (np.array([-0.9]),))
    >>> noise = model.draw(np.random.default_rng(0), 20000)
    >>> noise.shape, round(float(noise.std()), 1)
    ((20000, 1), 1.0)
    """

    deviation: Array
    autoregression: tuple[Array, ...]
    levels: tuple[Array, ...] = ()

    @classmethod
    def of(cls, estimate: Estimate) -> NoiseModel:
        """The noise that the estimate found: its levels, and its colour where it has one.

        Raises
        ------
        UnsupportedError
            An autoregression is not stationary.
        """
        for row in estimate.noise_model:
            if np.any(np.abs(np.roots([1.0, *row])) >= 1.0):
                raise UnsupportedError(
                    f"found the noise model {row.round(6).tolist()}, which is not stationary; "
                    "expected one that is; identify with noise='white', and a drift or an offset"
                )
        deviation = np.sqrt(estimate.noise_variance)
        return cls(deviation, estimate.noise_model, estimate.noise_levels)

    def draw(self, rng: np.random.Generator, n_samples: int, experiment: int = 0) -> Array:
        """Noise of one experiment, shape (n_samples, n_outputs) [output units]."""
        from scipy.signal import lfilter, lfiltic  # slow to import, seldom needed

        noise = rng.standard_normal((n_samples, self.deviation.size))
        for i, row in enumerate(self.autoregression):
            if row.size:
                root, spread = _stationary(row)
                start = lfiltic([1.0], [1.0, *row], root @ rng.standard_normal(row.size))
                noise[:, i] = lfilter([1.0], [1.0, *row], noise[:, i], zi=start)[0] / spread
        deviation = self.levels[experiment] if self.levels else self.deviation
        return np.asarray(noise * deviation, dtype=np.float64)


def _stationary(row: Array) -> tuple[Array, float]:
    """Square root of the covariance of ``(e_k, ..., e_{k-p+1})`` for white noise of variance 1.

    And the standard deviation of ``e_k``.
    """
    p = row.size
    step = np.eye(p, k=-1)
    step[0] = -row
    drive = np.zeros((p, p))
    drive[0, 0] = 1.0
    covariance = scipy.linalg.solve_discrete_lyapunov(step, drive)
    values, vectors = np.linalg.eigh(covariance)
    root = np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
    return root, float(np.sqrt(covariance[0, 0]))
