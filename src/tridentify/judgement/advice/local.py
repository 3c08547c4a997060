r"""The response at the middle of a window of lines, from a local polynomial or rational model.

.. math:: Y_e(x) = \frac{\sum_j U_{e,j}(x) N_j(x) + T_e(x) + d_e R_e(x)}{1 + d_1 x + d_2 x^2} + V

with polynomials ``N_j`` and ``T_e`` of second degree. A denominator costs one or two unknowns and
follows a resonance inside of the window, which polynomials flatten; it is taken where it lowers
the corrected information criterion clearly. The polynomial model is linear; with a denominator it
starts from linear fits reweighted by the last denominator (Sanathanan and Koerner 1963) and ends
on Gauss-Newton steps on the output error, so that noise does not bias it to first order.

References: R. Pintelon, J. Schoukens, *System Identification: A Frequency Domain Approach*, 2nd
ed., Wiley (2012), chapter 7. T. McKelvey, G. Guerin, SYSID (2012).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.information import aicc_price

DEGREE = 2
"""Of the polynomials: their error over half a window is then of third order."""

DENOMINATORS = (0, 1, 2)
"""Degrees of the denominator: a pole in the window, or two."""

CLEARLY = 10.0
"""Fall of the criterion for which a denominator is taken: one line by chance does not do."""

REWEIGHTED, REFINED = 4, 6
"""Linear fits with new weights, and Gauss-Newton steps."""

LOCAL_CUTOFF = 1e-8
"""Singular values below this share of the largest count as nothing: sums over a dozen lines of a
spectrum carry some eight digits."""
ROUNDING_SQUARED = 1e-26
"""Squares of residuals relative to those of the output that are rounding."""


@dataclass(frozen=True, eq=False)
class Window:
    """Lines around a frequency.

    Attributes
    ----------
    x : (n,) array
        Distance from the middle in half widths.
    inputs : (n, n_inputs) complex array
    output : (n,) complex array
    ends : (n, k) complex array
        Columns of what is no response: ends of the stretches, drifts.
    """

    x: Array
    inputs: Complex
    output: Complex
    ends: Complex

    @property
    def powers(self) -> Array:
        """(n, 3) powers of ``x``."""
        return np.asarray(self.x[:, None] ** np.arange(DEGREE + 1))

    @property
    def responses(self) -> list[Complex]:
        """Columns of every input."""
        return [self.inputs[:, [j]] * self.powers for j in range(self.inputs.shape[1])]


@dataclass(frozen=True, eq=False)
class Local:
    """What a window says.

    Attributes
    ----------
    response : (n_inputs,) complex array
        ``nan`` where the window does not tell it.
    std, coherence : (n_inputs,) arrays
    """

    response: Complex
    std: Array
    coherence: Array


@dataclass(frozen=True, eq=False)
class _Fit:
    weights: Complex
    inverse: Complex
    rss: float
    rank: int
    lost: NDArray[np.bool_]


def local_response(window: Window) -> Local:
    """Fit a window.

    Parameters
    ----------
    window : Window

    Returns
    -------
    Local

    Examples
    --------
    >>> x = np.linspace(-1.0, 1.0, 15)
    >>> u = np.exp(1j * np.arange(15.0) ** 2)
    >>> window = Window(x, u[:, None], (2.0 - 1j * x) * u, np.ones((15, 1), complex))
    >>> bool(np.isclose(local_response(window).response[0], 2.0))
    True
    """
    n, n_inputs = window.inputs.shape
    fits = [found for q in DENOMINATORS if (found := _fit(window, q)) is not None]
    if not fits:
        return Local(
            np.full(n_inputs, np.nan, complex), np.full(n_inputs, np.inf), np.zeros(n_inputs)
        )
    size = float(np.sum(np.abs(window.output) ** 2))
    prices = [_criterion(fit, n, size) + CLEARLY * (k > 0) for k, fit in enumerate(fits)]
    fit = fits[int(np.argmin(prices))]
    variance = fit.rss / (n - fit.rank)
    first = np.arange(n_inputs) * (DEGREE + 1)
    std = np.sqrt(variance * np.sum(np.abs(fit.inverse[first]) ** 2, axis=1))
    unknown = fit.lost[first] | ~np.any(window.inputs, axis=0)
    coherence = np.array([_coherence(window, j, variance) for j in range(n_inputs)])
    return Local(
        np.where(unknown, np.nan, fit.weights[first]),
        np.where(unknown, np.inf, std),
        np.where(unknown, 0.0, coherence),
    )


def _criterion(fit: _Fit, n: int, size: float) -> float:
    """Corrected information criterion of ``n`` complex lines."""
    price = aicc_price(2.0 * fit.rank, 2.0 * n)
    return 2.0 * n * float(np.log(max(fit.rss, ROUNDING_SQUARED * size, 1e-300) / n)) + price


def _fit(window: Window, degree: int) -> _Fit | None:
    """Fit with a denominator of a degree; None where there are too few lines, or no fit."""
    linear = np.hstack([*window.responses, window.ends])
    if window.x.size <= linear.shape[1] + degree:
        return None
    if not degree:
        return _solve(linear, window.output)
    powers = window.x[:, None] ** np.arange(1, degree + 1)
    below = np.zeros(degree, dtype=complex)
    count = linear.shape[1]
    for _ in range(REWEIGHTED):
        weight = 1.0 / (1.0 + powers @ below)
        moved = np.hstack([linear, -window.output[:, None] * powers])
        columns = np.asarray(moved * weight[:, None], dtype=np.complex128)
        fit = _solve(columns, window.output * weight)
        if not np.all(np.isfinite(fit.weights)):
            return None
        weights = fit.weights
        below = weights[count:]
    best: _Fit | None = None
    for _ in range(REFINED):
        divided = 1.0 / (1.0 + powers @ weights[count:])
        shown = (linear @ weights[:count]) * divided
        moved = np.hstack([linear, -shown[:, None] * powers])
        columns = np.asarray(moved * divided[:, None], dtype=np.complex128)
        left = np.asarray(window.output - shown, dtype=np.complex128)
        step = _solve(columns, left)
        rss = float(np.sum(np.abs(left) ** 2))
        if not np.isfinite(rss) or (best is not None and rss >= best.rss):
            break
        best = _Fit(weights, step.inverse, rss, step.rank, step.lost)
        weights = np.asarray(weights + step.weights, dtype=np.complex128)
    return best if best is not None and best.rank < window.x.size else None


def _solve(columns: Complex, target: Complex) -> _Fit:
    """Linear least squares, with a root of the covariance and what cannot be told."""
    norms = np.linalg.norm(columns, axis=0)
    norms = np.where(norms > 0, norms, 1.0)
    left, s, right = np.linalg.svd(columns / norms, full_matrices=False)
    kept = s > LOCAL_CUTOFF * s[0]
    inverse = (right[kept].conj().T / s[kept]) / norms[:, None]
    weights = inverse @ (left[:, kept].conj().T @ target)
    rss = float(np.sum(np.abs(target - columns @ weights) ** 2))
    lost = np.sum(np.abs(right[~kept]) ** 2, axis=0) > LOCAL_CUTOFF
    return _Fit(weights, inverse, rss, int(kept.sum()), lost)


def _coherence(window: Window, input_: int, variance: float) -> float:
    """Share of the variance per degree of freedom that only this input explains."""
    others = [part for k, part in enumerate(window.responses) if k != input_]
    fit = _solve(np.hstack([*others, window.ends]), window.output)
    before = fit.rss / max(window.x.size - fit.rank, 1)
    return float(np.clip(1.0 - variance / before, 0.0, 1.0)) if before > 0 else 0.0
