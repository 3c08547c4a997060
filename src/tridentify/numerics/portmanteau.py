"""Autocorrelation of the residual of a fit, with the moments that the fit leaves it.

The residual of a fit with ``p`` unknowns is ``r = M e``, ``M = I - Q Q'``. For white Gaussian
``e`` the autocorrelation ``r(k) = r' L_k r / r' r``, with ``L_k`` the symmetric matrix that picks
the pairs of samples ``k`` apart which are both there, is independent of ``r' r``, so that exactly

    E r(k)   = t / m,                         t = tr(M L_k) = - tr(Q' L_k Q)
    E r(k)^2 = (t^2 + 2 s) / (m (m + 2)),     s = tr(M L_k M L_k),   m = N - p

(Pitman 1937; Durbin & Watson 1950 for lag one). Both traces need only ``Q``. A step response with
its slow derivatives shifts all correlations of a short record by ``-p / N``; Ljung and Box's
formula, which is this one without ``Q``, takes that for a colour.

Where the noise has an autoregressive model of order ``p``, fitted to the same samples, its
correlations lose the directions ``psi(k - j), j = 1 .. p``, with ``psi`` the impulse response of
the model (Box & Pierce 1970); they are projected off, and the degrees of freedom are what is left.
Coefficients of the system need no such correction when the noise is independent of the input
(Pierce 1972).

Sums of squares of scaled correlations have a longer tail than chi-square in a short record, the
longer the more lags. Their mean and variance are taken from draws of white noise put through the
same projection, and a scaled chi-square with these is used.

References: E. Pitman, Proc. Cambridge Phil. Soc. 33 (1937) 212-222. J. Durbin & G. Watson,
Biometrika 37 (1950) 409-428. G. Box & D. Pierce, J. American Statistical Association 65 (1970)
1509-1526. G. Ljung & G. Box, Biometrika 65 (1978) 297-303. D. Pierce, Biometrika 59 (1972) 411-426.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.special import chdtrc

from tridentify.numerics.arrays import Array

DRAWS = 1000
SHORT, LONG_SERIES = 500, 5_000


class Autocorrelation(NamedTuple):
    """Of the lags ``1 .. K``.

    Attributes
    ----------
    value : (K,) array
        As computed.
    mean, std : (K,) arrays
        Of a residual of white noise; ``std`` is zero where no pair of samples is there.
    """

    value: Array
    mean: Array
    std: Array


def autocorrelation_of_fit(
    residuals: Sequence[Array], seen: Sequence[Array], bases: Sequence[Array], n_lags: int
) -> Autocorrelation:
    """Autocorrelation of a residual and what white noise would leave.

    Parameters
    ----------
    residuals : sequence of (n,) arrays
        One for each experiment; zero where a sample is missing.
    seen : sequence of (n,) arrays
        One where a sample is there, else zero.
    bases : sequence of (n, p) arrays
        Rows of ``Q`` for each experiment.
    n_lags : int

    Returns
    -------
    Autocorrelation

    Examples
    --------
    >>> e = np.array([1.0, -1.0, 1.0, -1.0])
    >>> found = autocorrelation_of_fit([e], [np.ones(4)], [np.full((4, 1), 0.5)], 1)
    >>> found.value.tolist(), found.mean.round(3).tolist()
    ([-0.75], [-0.25])
    """
    power = sum(float(one @ one) for one in residuals)
    p = bases[0].shape[1]
    m = sum(float(one.sum()) for one in seen) - p
    # beside N the traces are of the size of p: half the digits are more than enough of a long one
    kind = np.float64 if m + p < SHORT else np.float32
    small: list[NDArray[Any]] = [np.ascontiguousarray(q, dtype=kind) for q in bases]
    sizes = [np.einsum("ij,ij->i", q, q).astype(np.float64) for q in small]
    value, mean, std = np.zeros((3, n_lags))
    for k in range(1, n_lags + 1):
        product, pairs, twice = 0.0, 0.0, 0.0
        table = np.zeros((p, p))
        for r, there, q, size in zip(residuals, seen, small, sizes, strict=True):
            if r.size <= k:
                continue
            product += float(r[k:] @ r[:-k])
            pairs += float(there[k:] @ there[:-k])
            table += q[k:].T @ q[:-k]
            # the rows k before and k after each sample that is there, added and squared
            twice += float(there[:-k] @ size[k:] + there[k:] @ size[:-k])
            if r.size > 2 * k:
                ends = np.einsum("ij,ij->i", q[2 * k :], q[: -2 * k])
                twice += 2.0 * float(there[k:-k] @ ends)
        table = 0.5 * (table + table.T)
        trace = -float(np.trace(table))
        square = max(0.5 * pairs - 0.5 * twice + float(np.sum(table * table)), 0.0)
        value[k - 1] = product / power if power > 0 else 0.0
        if pairs and m > 0:
            mean[k - 1] = trace / m
            second = (trace**2 + 2.0 * square) / (m * (m + 2.0))
            std[k - 1] = np.sqrt(max(second - (trace / m) ** 2, 0.0))
    return Autocorrelation(value, mean, std)


class Portmanteau(NamedTuple):
    """Ljung-Box statistics over the first lags.

    Attributes
    ----------
    lags : tuple of int
        How many lags each takes.
    statistics, p_values : tuple of float
    freedom : tuple of int
    """

    lags: tuple[int, ...]
    statistics: tuple[float, ...]
    freedom: tuple[int, ...]
    p_values: tuple[float, ...]

    @property
    def p_value(self) -> float:
        """Of all together (Bonferroni)."""
        return min(1.0, len(self.p_values) * min(self.p_values, default=1.0))


def portmanteau(found: Autocorrelation, noise: Array, spread: Array | None = None) -> Portmanteau:
    """Ljung-Box tests over few lags and over all, for weak noise of short memory and for the rest.

    Parameters
    ----------
    found : Autocorrelation
    noise : (p,) array
        Coefficients of the autoregressive model that whitened the residual; empty for none.
    spread : (n_tests, 2) array, optional
        Mean and variance of the statistics (`spread_of_statistics`); by default those of
        chi-square, which has too short a tail for a short record.

    Returns
    -------
    Portmanteau

    Examples
    --------
    >>> e = np.random.default_rng(0).standard_normal(500)
    >>> found = autocorrelation_of_fit([e], [np.ones(500)], [np.zeros((500, 0))], 20)
    >>> portmanteau(found, np.zeros(0)).p_value > 0.01
    True
    """
    projections = _projections(found.std > 0, noise)
    values = _statistics(found.value[None, :], found, projections)[0]
    freedom = np.array([one.dimension for one in projections], dtype=np.float64)
    if spread is None:
        spread = np.stack([freedom, 2.0 * freedom], axis=1)
    mean, variance = spread[:, 0], spread[:, 1]
    p_values = chdtrc(2.0 * mean**2 / variance, values * 2.0 * mean / variance)
    return Portmanteau(
        tuple(one.lags for one in projections),
        tuple(values.tolist()),
        tuple(one.dimension for one in projections),
        tuple(np.asarray(p_values).tolist()),
    )


def spread_of_statistics(
    found: Autocorrelation, noise: Array, seen: Sequence[Array], bases: Sequence[Array]
) -> Array | None:
    """Mean and variance of the statistics for white Gaussian noise and this very fit, by draws.

    The draws are always the same ones. In long records, where chi-square serves, None.

    Parameters
    ----------
    found, noise
        As for `portmanteau`.
    seen, bases
        As for `autocorrelation_of_fit`.

    Returns
    -------
    (n_tests, 2) array or None
    """
    total = sum(one.size for one in seen)
    if total > LONG_SERIES:
        return None
    e = _draws(DRAWS if total < SHORT else DRAWS // 4, total) * np.concatenate(
        seen, dtype=np.float32
    )
    q = np.vstack(bases, dtype=np.float32)
    e -= (e @ q) @ q.T
    products = np.zeros((e.shape[0], found.value.size))
    for one in np.split(e, np.cumsum([one.size for one in seen])[:-1], axis=1):
        size = next_fast_len(one.shape[1] + found.value.size + 1, real=True)
        half = rfft(one, size, axis=1)
        own = irfft(half.real**2 + half.imag**2, size, axis=1)[
            :, 1 : min(found.value.size, one.shape[1] - 1) + 1
        ]
        products[:, : own.shape[1]] += own
    values = products / np.sum(e * e, axis=1, keepdims=True)
    statistics = _statistics(values, found, _projections(found.std > 0, noise))
    return np.stack([statistics.mean(axis=0), statistics.var(axis=0)], axis=1)


@lru_cache(maxsize=2)
def _draws(count: int, total: int) -> NDArray[np.float32]:
    """White Gaussian noise, always the same; kept for the tests of one record."""
    found = np.random.default_rng(0).standard_normal((count, total)).astype(np.float32)
    found.flags.writeable = False
    return found


class _Projection(NamedTuple):
    """Of the first ``lags`` correlations: what a noise model took of them."""

    lags: int
    dimension: int
    lost: Array


def _projections(there: NDArray[np.bool_], noise: Array) -> list[_Projection]:
    n_lags, p = there.size, noise.size
    psi = np.zeros(n_lags + 1)
    psi[0] = 1.0
    for k in range(1, n_lags + 1):
        own = min(k, p)
        psi[k] = -float(noise[:own] @ psi[k - 1 :: -1][:own])
    lost = np.zeros((n_lags, p))
    for j in range(1, min(p, n_lags) + 1):
        lost[j - 1 :, j - 1] = psi[: n_lags - j + 1]
    sizes = sorted({*(p + 4**k for k in range(10) if p + 4**k < n_lags), n_lags})
    found = []
    for size in sizes:
        columns = lost[:size] * there[:size, None]
        u, s, _ = np.linalg.svd(columns, full_matrices=False)
        u = u[:, s > 1e-8 * s[0]] if s.size and s[0] > 0 else u[:, :0]
        dimension = int(there[:size].sum()) - u.shape[1]
        if dimension > 0:
            found.append(_Projection(size, dimension, u))
    return found


def _statistics(values: Array, found: Autocorrelation, projections: list[_Projection]) -> Array:
    """(n_draws, n_tests) sums of squares of the scaled correlations ``values`` (n_draws, K)."""
    there = found.std > 0
    z = np.where(there, (values - found.mean) / np.where(there, found.std, 1.0), 0.0)
    columns = []
    for one in projections:
        left = z[:, : one.lags]
        columns.append(np.sum((left - (left @ one.lost) @ one.lost.T) ** 2, axis=1))
    return np.stack(columns, axis=1) if columns else np.zeros((z.shape[0], 0))
