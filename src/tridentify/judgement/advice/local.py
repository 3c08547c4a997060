r"""The response at the middle of windows of lines, from a local polynomial or rational model.

.. math:: Y_e(x) = \frac{\sum_j U_{e,j}(x) N_j(x) + T_e(x) + d_e R_e(x)}{1 + d_1 x + d_2 x^2} + V

with polynomials ``N_j`` and ``T_e`` of second degree. A denominator costs one or two unknowns and
follows a resonance inside of the window, which polynomials flatten; it is taken where it lowers
the corrected information criterion clearly. The polynomial model is linear; with a denominator it
starts from linear fits reweighted by the last denominator (Sanathanan and Koerner 1963) and ends
on Gauss-Newton steps on the output error, so that noise does not bias it to first order.

Windows of about as many lines are solved together, with rows and columns of zeros where one has
fewer: one by one the calls took three times as long as the numbers.

References: R. Pintelon, J. Schoukens, *System Identification: A Frequency Domain Approach*, 2nd
ed., Wiley (2012), chapter 7. T. McKelvey, G. Guerin, SYSID (2012).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tridentify.numerics.arrays import Array, Complex, Flags
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


TOGETHER = 24
"""Windows that are solved together: neighbours, so that few of their rows are zeros."""


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


@dataclass(frozen=True, eq=False)
class Local:
    """What windows say.

    Attributes
    ----------
    response : (n_windows, n_inputs) complex array
        ``nan`` where a window does not tell it.
    std, coherence : (n_windows, n_inputs) arrays
    """

    response: Complex
    std: Array
    coherence: Array


@dataclass(frozen=True, eq=False)
class _Stack:
    """Several windows; ``responses`` (windows, lines, n_inputs, powers) are columns of inputs."""

    x: Array
    output: Complex
    responses: Complex
    ends: Complex
    lines: NDArray[np.intp]
    unknowns: NDArray[np.intp]

    @classmethod
    def of(cls, windows: Sequence[Window]) -> _Stack:
        lines = np.array([window.x.size for window in windows])
        widths = np.array([window.ends.shape[1] for window in windows])
        size, n_inputs = (len(windows), int(lines.max())), windows[0].inputs.shape[1]
        x, output = np.zeros(size), np.zeros(size, dtype=complex)
        responses = np.zeros((*size, n_inputs, DEGREE + 1), dtype=complex)
        ends = np.zeros((*size, int(widths.max())), dtype=complex)
        for k, (window, n, wide) in enumerate(zip(windows, lines, widths, strict=True)):
            x[k, :n], output[k, :n], ends[k, :n, :wide] = window.x, window.output, window.ends
            powers = window.x[:, None, None] ** np.arange(DEGREE + 1)
            responses[k, :n] = window.inputs[:, :, None] * powers
        return cls(x, output, responses, ends, lines, widths + n_inputs * (DEGREE + 1))

    def columns(self, leave: int | None = None) -> Complex:
        """All of the linear model, or all but those of an input."""
        kept = self.responses if leave is None else np.delete(self.responses, leave, axis=2)
        return np.concatenate([kept.reshape(*self.x.shape, -1), self.ends], axis=2)


@dataclass(eq=False)
class _Fits:
    """Fits of several windows; ``size`` are the squares in the rows of a root of the covariance."""

    weights: Complex
    size: Array
    rss: Array
    rank: NDArray[np.intp]
    lost: Flags

    def take(self, at: NDArray[np.intp], other: _Fits, of: NDArray[np.intp]) -> None:
        """Some of the windows from another fit of these; unknowns that come last may be more."""
        for name, own in vars(self).items():
            own[at] = getattr(other, name)[(of, *map(slice, own.shape[1:]))]


def local_responses(windows: Sequence[Window]) -> Local:
    """Fit windows.

    Parameters
    ----------
    windows : sequence of Window
        Of the same inputs.

    Returns
    -------
    Local

    Examples
    --------
    >>> x = np.linspace(-1.0, 1.0, 15)
    >>> u = np.exp(1j * np.arange(15.0) ** 2)
    >>> window = Window(x, u[:, None], (2.0 - 1j * x) * u, np.ones((15, 1), complex))
    >>> bool(np.isclose(local_responses([window]).response[0, 0], 2.0))
    True
    """
    parts = [_told(windows[k : k + TOGETHER]) for k in range(0, len(windows), TOGETHER)]
    return Local(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def _told(windows: Sequence[Window]) -> tuple[Complex, Array, Array]:
    """Response, standard error and coherence."""
    stack = _Stack.of(windows)
    size = np.sum(np.abs(stack.output) ** 2, axis=1)
    fits = [_fitted(stack, degree) for degree in DENOMINATORS]
    prices = [_criterion(fit, stack.lines, size) + CLEARLY * (k > 0) for k, fit in enumerate(fits)]
    best = np.argmin(prices, axis=0)
    count = stack.responses.shape[2]
    first = np.arange(count) * (DEGREE + 1)
    chosen = fits[0]
    for degree, fit in enumerate(fits):
        at = np.flatnonzero(best == degree)
        chosen.take(at, fit, at)
    fitted = np.isfinite(chosen.rss)[:, None]
    variance = chosen.rss / np.maximum(stack.lines - chosen.rank, 1)
    unknown = ~fitted | chosen.lost[:, first] | ~np.any(stack.responses[..., 0], axis=1)
    with np.errstate(invalid="ignore"):
        std = np.sqrt(variance[:, None] * chosen.size[:, first])
        coherence = np.column_stack([_coherence(stack, j, variance) for j in range(count)])
    return (
        np.where(unknown, np.nan, chosen.weights[:, first]),
        np.where(unknown, np.inf, std),
        np.where(unknown, 0.0, coherence),
    )


def _criterion(fit: _Fits, n: NDArray[np.intp], size: Array) -> Array:
    """Corrected information criteria of complex lines; infinite where there is no fit."""
    price = np.array([aicc_price(2.0 * rank, 2.0 * k) for rank, k in zip(fit.rank, n, strict=True)])
    least = np.maximum(ROUNDING_SQUARED * size, 1e-300)
    return np.asarray(2.0 * n * np.log(np.maximum(fit.rss, least) / n) + price)


def _fitted(stack: _Stack, degree: int) -> _Fits:
    """Fits with a denominator of a degree; ``rss`` is infinite where there are too few lines."""
    linear = stack.columns()
    enough = stack.lines > stack.unknowns + degree
    fits = _solve(linear, stack.output) if not degree else _rational(stack, linear, degree)
    fits.rss = np.where(enough & (fits.rank < stack.lines), fits.rss, np.inf)
    return fits


def _rational(stack: _Stack, linear: Complex, degree: int) -> _Fits:
    """From reweighted linear fits down to the output error."""
    powers = stack.x[:, :, None] ** np.arange(1, degree + 1)
    count = linear.shape[2]
    below = np.zeros((stack.x.shape[0], degree), dtype=complex)
    moved = np.concatenate([linear, -stack.output[:, :, None] * powers], axis=2)
    for _ in range(REWEIGHTED):
        weight = 1.0 / (1.0 + _times(powers, below))
        fits = _solve(moved * weight[:, :, None], stack.output * weight)
        below = fits.weights[:, count:]
    weights, active = fits.weights.copy(), np.arange(stack.x.shape[0])
    fits.rss = np.full(active.size, np.inf)
    for _ in range(REFINED):
        divided = 1.0 / (1.0 + _times(powers[active], weights[active, count:]))
        shown = _times(linear[active], weights[active, :count]) * divided
        moved = np.concatenate([linear[active], -shown[:, :, None] * powers[active]], axis=2)
        left = stack.output[active] - shown
        step = _solve(moved * divided[:, :, None], left)
        change, step.weights = step.weights, weights[active]
        step.rss = np.sum(np.abs(left) ** 2, axis=1)
        better = np.flatnonzero(step.rss < fits.rss[active])
        active = active[better]
        if not active.size:
            break
        fits.take(active, step, better)
        weights[active] += change[better]
    return fits


def _times(columns: Complex | Array, weights: Complex) -> Complex:
    return np.asarray((columns @ weights[:, :, None])[:, :, 0])


def _solve(columns: Complex, target: Complex) -> _Fits:
    """Linear least squares, with what cannot be told; columns without numbers tell nothing."""
    usable = np.all(np.isfinite(columns), axis=(1, 2))
    columns = np.where(usable[:, None, None], columns, 0.0)
    norms = np.linalg.norm(columns, axis=1)
    norms = np.where(norms > 0, norms, 1.0)
    left, s, right = np.linalg.svd(columns / norms[:, None], full_matrices=False)
    kept = s > LOCAL_CUTOFF * s[:, :1]
    right = right.conj()
    inverse = np.where(kept, 1.0 / np.where(kept, s, 1.0), 0.0)
    told = _times(left.conj().swapaxes(1, 2), target) * inverse
    weights = _times(right.swapaxes(1, 2), told) / norms
    rss = np.sum(np.abs(target - _times(columns, weights)) ** 2, axis=1)
    parts = np.abs(right) ** 2
    size = np.sum(parts * inverse[:, :, None] ** 2, axis=1) / norms**2
    lost = np.sum(parts * ~kept[:, :, None], axis=1) > LOCAL_CUTOFF
    return _Fits(weights, size, np.where(usable, rss, np.inf), kept.sum(axis=1), lost)


def _coherence(stack: _Stack, input_: int, variance: Array) -> Array:
    """Share of the variance per degree of freedom that only this input explains."""
    fit = _solve(stack.columns(leave=input_), stack.output)
    before = fit.rss / np.maximum(stack.lines - fit.rank, 1)
    share = 1.0 - variance / np.where(before > 0, before, 1.0)
    return np.where(before > 0, np.clip(share, 0.0, 1.0), 0.0)
