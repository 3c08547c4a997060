"""Autoregressive noise: its estimation from a residual, its order, and the exact whitening.

The noise of one output is modelled as

    v(k) + a_1 v(k-1) + ... + a_p v(k-p) = e(k),                e white,

which any stationary noise with a spectral density obeys as closely as wanted for large enough
``p``. Everything needed of it is taken from ``p`` reflection coefficients ``|k_i| < 1``: they
keep the model stationary whatever the data (Levinson-Durbin; Kay 1988, chapter 6).

*Whitening.* With ``S`` the covariance of the samples that are there, for ``e`` of variance
one, and ``S = L D L'`` (``L`` of unit diagonal), the rows of ``D^{-1/2} L^{-1} Z`` are
uncorrelated where those of ``Z`` have covariance ``S``, and their sums of squares are those of
generalised least squares. The product is the sequence of innovations of a Kalman filter whose
state is the last ``p`` samples, begun on the stationary covariance (Jones 1980): the first
``p`` samples and those after a gap get what is exactly theirs, and from ``p`` samples without
a gap onwards the state is known and the filter is the polynomial itself. The gains do not
depend on the data, so all columns share them.

*Estimation.* Burg's recursion on the stretches without gaps (Burg 1975): it minimises the sum
of the squares of the forward and backward prediction errors one order after the other, gives
all orders at once in time ``O(N p)`` and is always stationary. Where samples are missing the
coefficients are then improved on the exact likelihood of those that are there: with ``d_k``
the variances of the innovations, ``-2 log L = n log(sum e_k^2 / n) + sum log d_k`` has the
minimum of the sum of squares of ``e_k prod d^(1 / 2n)``.

*What the fit took.* A residual is smaller than the noise where the fit had freedom, so its model
makes the noise too small there and the standard errors with it. For generalised least squares on
columns ``X`` the covariance of the residual is ``S - X C X'``, with ``C`` that of the unknowns.
The columns of ``X C^{1/2}`` therefore enter the sums of products beside the residual. This is the
step of the EM algorithm for the restricted likelihood (Harville 1977; Dempster, Laird & Rubin
1977).

*Order.* AICc, which for a noise that is no autoregression of finite order is efficient
(Shibata 1980; Hurvich & Tsai 1989), up to ``10 log10 N``.

References: S. Kay, *Modern Spectral Estimation*, Prentice Hall (1988). R. Jones,
Technometrics 22 (1980) 389-395. J. Burg, *Maximum Entropy Spectral Analysis*, Stanford (1975).
R. Shibata, Annals of Statistics 8 (1980) 147-164. C. Hurvich & C.-L. Tsai, Biometrika 76
(1989) 297-307. D. Harville, J. American Statistical Association 72 (1977) 320-338. A. Dempster,
N. Laird & D. Rubin, J. Royal Statistical Society B 39 (1977) 1-38.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz
from scipy.optimize import least_squares

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

PER_COEFFICIENT = 10
PER_DECADE = 10.0
NEARLY_ONE = 1.0 - 1e-5
PREDICTED = 1e-8


def most_coefficients(n_samples: int) -> int:
    """Highest order worth trying: ``10 log10 N``, with ten samples for each coefficient.

    Examples
    --------
    >>> [most_coefficients(n) for n in (5, 100, 1000, 1000000)]
    [0, 10, 30, 60]
    """
    if n_samples < 2 * PER_COEFFICIENT:
        return 0
    return min(n_samples // PER_COEFFICIENT, int(PER_DECADE * math.log10(n_samples) + 1e-9))


def polynomial(reflection: Array) -> Array:
    """``a_1 .. a_p`` from reflection coefficients (Levinson's recursion).

    Examples
    --------
    >>> polynomial(np.array([-0.5, 0.2])).round(12).tolist()
    [-0.6, 0.2]
    """
    a = np.zeros(0)
    for k in reflection:
        a = np.append(a + k * a[::-1], k)
    return a


def reflections(a: Array) -> Array:
    """Reflection coefficients of ``a_1 .. a_p``: all below one in size if it is stationary.

    Examples
    --------
    >>> reflections(np.array([-0.6, 0.2])).round(12).tolist()
    [-0.5, 0.2]
    """
    found = np.zeros(a.size)
    for p in range(a.size, 0, -1):
        k = a[p - 1]
        found[p - 1] = k
        if abs(k) >= 1.0:
            return np.full(found.size, np.nan)
        a = (a[: p - 1] - k * a[: p - 1][::-1]) / (1.0 - k * k)
    return found


def autocovariance(a: Array, n_lags: int) -> Array:
    """``r(0) .. r(n_lags)`` of the stationary process, for innovations of variance one.

    Parameters
    ----------
    a : (p,) array
    n_lags : int

    Examples
    --------
    >>> autocovariance(np.array([-0.5]), 2).round(6).tolist()
    [1.333333, 0.666667, 0.333333]
    """
    k = reflections(np.asarray(a, dtype=np.float64))
    if np.isnan(k).any():
        raise ValueError("found a process that is not stationary; expected roots inside the circle")
    r = np.zeros(n_lags + 1)
    r[0] = 1.0 / float(np.prod(1.0 - k * k))
    inner, variance = np.zeros(0), float(r[0])
    for lag in range(1, n_lags + 1):
        if lag <= k.size:
            r[lag] = -k[lag - 1] * variance - float(inner @ r[lag - 1 : 0 : -1])
            inner = np.append(inner + k[lag - 1] * inner[::-1], k[lag - 1])
            variance *= 1.0 - k[lag - 1] ** 2
        else:
            r[lag] = -float(a @ r[lag - 1 : lag - a.size - 1 : -1]) if lag > a.size else 0.0
    return r


def _gains(a: Array, seen: Flags, state: Array, run: int, gain: Array, scale: Array) -> int:
    """Kalman gains over a block; a sample whose past is fully known gets the gain -1.

    ``state`` (p, p), the covariance of the last samples, newest first, is carried on, and so is
    the number of samples without a gap, which is returned.
    """
    p = a.size
    first = np.empty(p)
    for t in range(seen.size):
        if run >= p:
            # the past is known: the polynomial itself, or a first step into a gap
            scale[t] = 1.0
            gain[t, 0] = -1.0
            if seen[t]:
                continue
            state[:, :] = 0.0
            state[0, 0] = 1.0
            gain[t, 0] = 0.0
            run = 0
            continue
        total = 1.0
        for i in range(p):
            value = 0.0
            for j in range(p):
                value -= state[i, j] * a[j]
            first[i] = value
            total -= a[i] * value
        # no forecast beats the one from the whole past; rounding may say so near the unit circle
        total = max(total, 1.0)
        for i in range(p - 1, 0, -1):
            for j in range(p - 1, 0, -1):
                state[i, j] = state[i - 1, j - 1]
        state[0, 0] = total
        for i in range(1, p):
            state[0, i] = first[i - 1]
            state[i, 0] = first[i - 1]
        if seen[t]:
            scale[t] = total
            for i in range(p):
                gain[t, i] = state[i, 0] / total
            for i in range(p):
                for j in range(p):
                    state[i, j] -= gain[t, i] * gain[t, j] * total
            run += 1
        else:
            scale[t] = 1.0
            gain[t, 0] = 0.0
            run = 0
    return run


def _innovate(
    a: Array, seen: Flags, gain: Array, scale: Array, rows: Array, past: Array, out: Array
) -> None:
    """Innovations of every row over a block; ``past`` (n_rows, p), oldest first, is carried on."""
    p, count = a.size, seen.size
    line, total = np.empty(p + count), np.empty(count)
    for c in range(rows.shape[0]):
        line[:p] = past[c]
        line[p:] = rows[c, :count]
        t = 0
        while t < count:
            stop = t
            while stop < count and gain[stop, 0] == -1.0:
                stop += 1
            total[t:stop] = line[p + t : p + stop]
            for k in range(1, p + 1):
                total[t:stop] += a[k - 1] * line[p + t - k : p + stop - k]
            t = stop
            if t == count:
                break
            expected = 0.0
            for k in range(1, p + 1):
                expected -= a[k - 1] * line[p + t - k]
            if seen[t]:
                surprise = line[p + t] - expected
                total[t] = surprise / np.sqrt(scale[t])
                line[p + t] = expected
                for k in range(p):
                    line[p + t - k] += gain[t, k] * surprise
            else:
                total[t] = 0.0
                line[p + t] = expected
            t += 1
        out[c, :count] = total
        past[c] = line[count:]


@cache
def _compiled() -> tuple[Callable[..., int], Callable[..., None]]:
    """Both loops as machine code (compiled at the first call, afterwards read from disk)."""
    import numba

    vector, table = numba.float64[::1], numba.float64[:, ::1]
    strided, flags = numba.float64[:, :], numba.boolean[::1]
    signatures = (
        numba.int64(vector, flags, table, numba.int64, table, vector),
        numba.void(vector, flags, table, vector, strided, table, strided),
    )
    found: list[Any] = []
    for signature, loop in zip(signatures, (_gains, _innovate), strict=True):
        try:
            found.append(numba.njit(signature, cache=True)(loop))
        except RuntimeError:  # no folder on this machine can hold the cache
            found.append(numba.njit(signature)(loop))
    return found[0], found[1]


class Whitener:
    """Turns columns of one output into their innovations, block by block.

    Parameters
    ----------
    a : (p,) array
        Of a stationary process; empty for white noise.
    n_columns : int

    Attributes
    ----------
    log_scale : float
        Sum of the logarithms of the innovations' variances so far: the log determinant of the
        covariance of the samples that are there, for innovations of variance one.

    Examples
    --------
    >>> whitener = Whitener(np.array([-0.5]), 1)
    >>> whitener.apply(np.array([[2.0, 2.0, 3.0]]), np.array([True, True, True])).round(3).tolist()
    [[1.732, 1.0, 2.0]]
    """

    def __init__(self, a: Array, n_columns: int) -> None:
        self._a = np.array(a, dtype=np.float64)
        p = self._a.size
        self._state = toeplitz(autocovariance(self._a, p - 1)) if p else np.zeros((0, 0))
        self._run = 0
        self._past = np.zeros((n_columns, p))
        self.log_scale = 0.0

    def apply(self, rows: Array, seen: Flags, out: Array | None = None) -> Array:
        """Innovations of the next samples.

        Parameters
        ----------
        rows : (n_columns, >= count) array
            One row a column of the regression; what stands at a missing sample does not matter
            as long as it is finite.
        seen : (count,) bool array
            Which samples are there; the others give zeros.
        out : (n_columns, >= count) array, optional
            Where the result goes; not ``rows``.

        Returns
        -------
        (n_columns, count) array
        """
        count, p = seen.size, self._a.size
        found = np.empty((rows.shape[0], count)) if out is None else out
        if p == 0:
            np.multiply(rows[:, :count], seen, out=found[:, :count])
            return found
        gains, innovate = _compiled()
        gain, scale = np.zeros((count, p)), np.ones(count)
        mask = np.ascontiguousarray(seen)
        self._run = int(gains(self._a, mask, self._state, self._run, gain, scale))
        self.log_scale += float(np.sum(np.log(scale)))
        innovate(self._a, mask, gain, scale, rows, self._past, found)
        return found


def whiten(series: Array, a: Array) -> tuple[Array, float]:
    """Innovations of one series, divided by their relative standard deviations.

    Parameters
    ----------
    series : (n_samples,) array
        ``nan`` marks a missing sample.
    a : (p,) array

    Returns
    -------
    innovations : (n_samples,) array
        White with the variance of ``e``; ``nan`` where a sample is missing.
    log_scale : float
        See `Whitener`.

    Examples
    --------
    >>> whiten(np.array([2.0, 2.0, 3.0]), np.array([-0.5]))[0].round(3).tolist()
    [1.732, 1.0, 2.0]
    """
    seen = np.isfinite(series)
    whitener = Whitener(a, 1)
    found = whitener.apply(np.where(seen, series, 0.0)[None, :], seen)[0]
    return np.where(seen, found, np.nan), whitener.log_scale


def burg(series: Sequence[Array], most: int) -> tuple[Array, Array]:
    """Burg's recursion over the stretches without gaps of one or several series.

    Parameters
    ----------
    series : sequence of (n_samples,) arrays
        ``nan`` marks a missing sample. No mean is taken off.
    most : int
        Highest order.

    Returns
    -------
    reflection : (q,) array
        ``q <= most``; fewer where no stretch is long enough.
    power : (q + 1,) array
        Mean-square prediction error of the orders ``0 .. q``.

    Examples
    --------
    >>> reflection, power = burg([0.5 ** np.arange(20)], 1)
    >>> reflection.round(3).tolist()
    [-0.8]
    """
    values = np.concatenate([part for one in series for part in (one, [np.nan])][:-1])
    seen = np.isfinite(values)
    forward = np.where(seen, values, 0.0)
    backward = forward.copy()
    power = [float(forward @ forward) / max(int(seen.sum()), 1)]
    found: list[float] = []
    whole = seen
    for _ in range(most):
        ahead, behind = forward[1:], backward[:-1]
        whole = whole[1:] & seen[: whole.size - 1]
        if whole.sum() < PER_COEFFICIENT or power[-1] < PREDICTED * power[0]:
            break
        complete = bool(whole.all())
        ahead = ahead if complete else np.where(whole, ahead, 0.0)
        behind = behind if complete else np.where(whole, behind, 0.0)
        energy = float(ahead @ ahead + behind @ behind)
        k = -2.0 * float(ahead @ behind) / energy if energy > 0 else 0.0
        k = min(max(k, -NEARLY_ONE), NEARLY_ONE)
        forward, backward = ahead + k * behind, behind + k * ahead
        found.append(k)
        power.append(power[-1] * (1.0 - k * k))
    return np.array(found), np.array(power)


def deviance(series: Sequence[Array], a: Array) -> float:
    """``-2 log L`` up to a constant, the innovations' variance at its best value."""
    energy, log_scale, n = 0.0, 0.0, 0
    for one in series:
        innovations, scale = whiten(one, a)
        seen = innovations[np.isfinite(innovations)]
        energy += float(seen @ seen)
        log_scale += scale
        n += seen.size
    return n * math.log(max(energy / max(n, 1), 1e-300)) + log_scale


def fit_autoregression(
    series: Sequence[Array],
    most: int,
    order: int | None = None,
    fewest: int = 0,
    taken: Sequence[Array] = (),
) -> Array:
    """Coefficients ``a_1 .. a_p`` of the noise, their number by AICc.

    Parameters
    ----------
    series : sequence of (n_samples,) arrays
        Residuals of one output, one for each experiment; ``nan`` marks a missing sample.
    most : int
        Highest order.
    order : int, optional
        The order, where it is settled already.
    fewest : int
        Lowest order.
    taken : sequence of (n_samples,) arrays
        What the fit took from the noise: series whose products are added to those of the
        residuals (see above).

    Returns
    -------
    (p,) array
        Of a stationary process; empty for white noise.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> v = np.zeros(2000)
    >>> for k in range(1, 2000):
    ...     v[k] = 0.8 * v[k - 1] + rng.standard_normal()
    >>> fit_autoregression([v], 20).round(1).tolist()
    [-0.8]
    """
    reflection, power = burg([*series, *taken], most if order is None else order)
    gaps = any(np.isnan(one).any() for one in series)
    n = sum(int(np.isfinite(one).sum()) for one in series)
    if order is None:
        order = _order(series, reflection, power, n, gaps, fewest)
    a = polynomial(reflection[:order])
    return _improved(series, a) if gaps and a.size else a


def _order(
    series: Sequence[Array], reflection: Array, power: Array, n: int, gaps: bool, fewest: int
) -> int:
    """Order of least AICc."""
    orders = np.arange(power.size)
    if gaps:
        fits = [deviance(series, polynomial(reflection[:p])) for p in orders]
    else:
        fits = list(n * np.log(np.maximum(power, 1e-300)))
    unknowns = orders + 1.0
    room = np.maximum(n - unknowns - 1.0, 0.5)
    criterion = np.array(fits) + 2.0 * unknowns * n / room
    fewest = min(fewest, power.size - 1)
    return int(np.argmin(criterion[fewest:])) + fewest


def _improved(series: Sequence[Array], a: Array) -> Array:
    """The coefficients of highest exact likelihood near the given ones."""

    def errors(unbound: Array) -> Array:
        b = polynomial(np.tanh(unbound))
        parts, log_scale = [], 0.0
        for one in series:
            innovations, scale = whiten(one, b)
            parts.append(innovations[np.isfinite(innovations)])
            log_scale += scale
        joined = np.concatenate(parts)
        return np.asarray(joined * math.exp(0.5 * log_scale / joined.size))

    start = np.arctanh(np.clip(reflections(a), -NEARLY_ONE, NEARLY_ONE))
    found = least_squares(errors, start, xtol=1e-8, max_nfev=30)
    return polynomial(np.clip(np.tanh(found.x), -NEARLY_ONE, NEARLY_ONE))
