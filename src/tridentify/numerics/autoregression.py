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
coefficients are then improved on the exact likelihood of those that are there, ``-2 log L = n
log(sum e_k^2 / n) + sum log d_k`` with ``d_k`` the variances of the innovations, by its own
derivatives (`numerics.incomplete`).

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
from functools import cache, lru_cache
from typing import Any

import numpy as np
from scipy.linalg import toeplitz

from tridentify.numerics.arrays import Array, Flags, Indices
from tridentify.numerics.incomplete import Incomplete
from tridentify.numerics.levinson import autocovariance, stationary_polynomial
from tridentify.numerics.recent import recent

PER_COEFFICIENT = 10
"""Samples for each coefficient: with fewer the information criterion does not hold."""
PER_DECADE = 10.0
"""Coefficients for each decade of the number of samples: ``10 log10 N``."""
NEARLY_ONE = 1.0 - 1e-5
"""Largest reflection coefficient: the process stays stationary."""
PREDICTED = 1e-8
"""Share of the power: what is left below it is rounding."""
FEW_GAINS = 8
"""Series whose gains are kept: outputs and experiments in turn."""
REMEMBERED = 64
"""Processes whose covariance is kept: one model whitens every column of every pass."""


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


def _burg(forward: Array, gaps: Indices, stretches: Indices, found: Array, power: Array) -> int:
    """Burg's recursion; gives the number of orders. ``forward`` is used up.

    Of order ``p`` the forward error of sample ``t`` stands at ``forward[t]``, the backward one of
    ``t - 1`` at ``behind[t - p - 1]``, in place. Both are zero where a sample of theirs is missing.
    """
    n, behind = forward.size, forward.copy()
    for p in range(found.size):
        count = 0
        for length in stretches:
            count += max(length - p - 1, 0)
        if count < PER_COEFFICIENT or power[p] < PREDICTED * power[0]:
            return p
        for gap in gaps:
            if gap + p + 1 < n:
                forward[gap + p + 1] = 0.0
            if gap - p - 1 >= 0:
                behind[gap - p - 1] = 0.0
        ahead, pairs = forward[p + 1 :], n - p - 1
        product, energy = 0.0, 0.0
        for t in range(pairs):
            product += ahead[t] * behind[t]
            energy += ahead[t] * ahead[t] + behind[t] * behind[t]
        k = -2.0 * product / energy if energy > 0.0 else 0.0
        k = min(max(k, -NEARLY_ONE), NEARLY_ONE)
        for t in range(pairs):
            one, other = ahead[t], behind[t]
            ahead[t], behind[t] = one + k * other, other + k * one
        found[p] = k
        power[p + 1] = power[p] * (1.0 - k * k)
    return found.size


@cache
def _compiled() -> tuple[Callable[..., Any], ...]:
    """The loops as machine code (compiled at the first call, afterwards read from disk)."""
    import numba

    from tridentify.numerics.compiled import load_alone

    vector, table = numba.float64[::1], numba.float64[:, ::1]
    flags, places = numba.boolean[::1], numba.int64[::1]
    signatures = (
        numba.int64(vector, flags, table, numba.int64, table, vector),
        numba.int64(vector, places, places, vector, vector),
    )
    found: list[Any] = []
    # sums may be taken in any order, which lets the processor take several samples at once
    order = {"reassoc", "nsz", "contract"}
    for signature, loop in zip(signatures, (_gains, _burg), strict=True):
        try:
            made: Any = numba.njit(cache=True, fastmath=order)(loop)
            load_alone(made)
        except (AttributeError, RuntimeError):  # no folder can hold it, or another numba
            made = numba.njit(fastmath=order)(loop)
        made.compile(signature)
        made.disable_compile()
        found.append(made)
    return tuple(found)


@lru_cache(maxsize=REMEMBERED)
def _stationary(a: bytes) -> Array:
    """Covariance of ``p`` samples in a row, for innovations of variance one."""
    given = np.frombuffer(a)
    return toeplitz(autocovariance(given, given.size - 1)) if given.size else np.zeros((0, 0))


Gains = tuple[Array, Array, Array, int, float]


def _gains_from(a: Array, seen: Flags, state: Array, run: int) -> Gains:
    """Gains and variances of the next samples, state and run behind them, sum of logarithms."""
    if run >= a.size and seen.all():
        # the past stays known: of the gains only the mark of that is looked at
        return np.full((seen.size, 1), -1.0), np.ones(seen.size), state, run, 0.0
    gain, scale, state = np.zeros((seen.size, a.size)), np.ones(seen.size), state.copy()
    run = int(_compiled()[0](a, seen, state, run, gain, scale))
    return gain, scale, state, run, float(np.sum(np.log(scale)))


_first_gains = recent(FEW_GAINS)(_gains_from)
"""From the start of a series: residual, derivatives and added columns ask one after the other."""


def gains(a: Array, seen: Flags) -> tuple[Array, Array, float]:
    """What `kernels.whitening.innovate` is given for a whole series.

    Parameters
    ----------
    a : (p,) array
        Not empty.
    seen : (n_samples,) bool array

    Returns
    -------
    gain, scale : arrays
        Kalman gains and variances of the innovations.
    log_scale : float
        As of `Whitener`.
    """
    own = np.array(a, dtype=np.float64)
    mask = np.ascontiguousarray(seen)
    gain, scale, _, _, log_scale = _first_gains(own, mask, _stationary(own.tobytes()), 0)
    return gain, scale, log_scale


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
        self._state = _stationary(self._a.tobytes())
        self._run, self._begun = 0, False
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
        from tridentify.numerics.kernels.whitening import innovate

        mask = np.ascontiguousarray(seen)
        told = _gains_from if self._begun else _first_gains
        gain, scale, self._state, self._run, log_scale = told(self._a, mask, self._state, self._run)
        self._begun = True
        self.log_scale += log_scale
        innovate(self._a, mask, gain, scale, rows, self._past, found)
        return found


def whiten_columns(columns: Sequence[Array], seen: Sequence[Flags], a: Array) -> Array:
    """Innovations of columns of several series, one below the other.

    Parameters
    ----------
    columns : sequence of (n_samples, k) arrays
        What stands where a sample is missing does not matter; finite elsewhere.
    seen : sequence of (n_samples,) bool arrays
        Which samples are there; the others give zeros.
    a : (p,) array

    Returns
    -------
    (n_samples of all, k) array
        Column after column in memory.

    Examples
    --------
    >>> columns, seen = np.array([[1.0, 2.0], [np.nan, 4.0]]), np.array([True, False])
    >>> whiten_columns([columns, columns[:1]], [seen, seen[:1]], np.zeros(0)).tolist()
    [[1.0, 2.0], [0.0, 0.0], [1.0, 2.0]]
    """
    k = columns[0].shape[1]
    found, at = np.empty((k, sum(mask.size for mask in seen))), 0
    for one, mask in zip(columns, seen, strict=True):
        rows = found[:, at : at + mask.size]
        rows[:] = one.T if mask.all() else np.where(mask, one.T, 0.0)
        if a.size:
            Whitener(a, k).apply(rows.copy(), mask, rows)
        at += mask.size
    return found.T


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
    filled = np.where(seen, values, 0.0)
    found, power = np.zeros(most), np.zeros(most + 1)
    power[0] = float(filled @ filled) / max(int(seen.sum()), 1)
    gaps = np.flatnonzero(~seen)
    stretches = np.diff(np.concatenate([[-1], gaps, [seen.size]])) - 1
    reached = int(_compiled()[1](filled, gaps, stretches, found, power))
    return found[:reached], power[: reached + 1]


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
    if any(np.isnan(one).any() for one in series):
        exact = Incomplete(series, reflection.size)
        if order is None:
            order = _order(exact.deviances(reflection), exact.count, fewest)
        # samples that all stand alone have no reflection coefficients, whatever order is asked for
        first = reflection[:order]
        return stationary_polynomial(exact.best(first) if first.size else first)
    if order is None:
        n = sum(one.size for one in series)
        order = _order(n * np.log(np.maximum(power, 1e-300)), n, fewest)
    return stationary_polynomial(reflection[:order])


def _order(fits: Array, n: int, fewest: int) -> int:
    """Order of least AICc, from the fits ``-2 log L`` of the orders ``0, 1, ...``."""
    unknowns = np.arange(fits.size) + 1.0
    room = np.maximum(n - unknowns - 1.0, 0.5)
    criterion = fits + 2.0 * unknowns * n / room
    fewest = min(fewest, fits.size - 1)
    return int(np.argmin(criterion[fewest:])) + fewest
