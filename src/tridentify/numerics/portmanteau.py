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
longer the more lags: correlations of one draw that are large are large together, as
``cov(r(j)^2, r(k)^2)`` is about ``4 / m`` of the product of their variances. So the sum of ``d`` of
them has the mean ``d`` and the variance ``2 d (1 + 2 (d + 2) / m)`` (Davies, Triggs & Newbold 1977
have ``d - 5``). That is a chi-square over another one, independent of it, with ``m / 2 + 4``
degrees of freedom: an F distribution, scaled to the mean. A fit that takes what is slow leaves
neighbouring lags correlated, by ``C``, say; then ``d`` is ``tr(C)^2 / tr(C^2)``.

References: E. Pitman, Proc. Cambridge Phil. Soc. 33 (1937) 212-222. J. Durbin & G. Watson,
Biometrika 37 (1950) 409-428. N. Davies, C. Triggs & P. Newbold, Biometrika 64 (1977) 517-522. G.
Box & D. Pierce, J. American Statistical Association 65 (1970)
1509-1526. G. Ljung & G. Box, Biometrika 65 (1978) 297-303. D. Pierce, Biometrika 59 (1972) 411-426.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from tridentify.numerics.arrays import Array, Flags

SHORT = 500
"""Samples below which the traces are worked out with all digits."""


class Autocorrelation(NamedTuple):
    """Of the lags ``1 .. K``.

    Attributes
    ----------
    value : (K,) array
        As computed.
    mean, std : (K,) arrays
        Of a residual of white noise; ``std`` is zero where no pair of samples is there.
    together : (K, K) array
        Correlations of the values at two lags.
    freedom : float
        Samples less unknowns.
    """

    value: Array
    mean: Array
    std: Array
    together: Array
    freedom: float


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
    value, trace = np.zeros((2, n_lags))
    tables, square = np.zeros((n_lags, p * p)), np.zeros((n_lags, n_lags))
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
        tables[k - 1], trace[k - 1] = table.ravel(), -float(np.trace(table))
        value[k - 1] = product / power if power > 0 else 0.0
        square[k - 1, k - 1] = 0.5 * pairs - 0.5 * twice if pairs else np.nan
    apart = ~np.eye(n_lags, dtype=bool)
    if p:
        parts = np.stack([_shifted(q, n_lags) for q in small])
        square[apart] = -2.0 * parts.sum(axis=0)[apart]
    square += tables @ tables.T
    return _moments(value, trace, square, m)


def spread_of_products(residuals: Sequence[Array], n_lags: int) -> Array:
    """Variance of each autocorrelation over that of noise of one size.

    Where large samples meet large ones at some lags, as those of held noise do, products there
    scatter by more (Lo & MacKinlay, Review of Financial Studies 1 (1988) 41-66).

    Parameters
    ----------
    residuals : sequence of (n,) arrays
        One for each experiment; zero where a sample is missing.
    n_lags : int

    Examples
    --------
    >>> spread_of_products([np.tile([1.0, 0.0], 500)], 2).round(2).tolist()
    [0.0, 2.0]
    """
    squares = [one**2 for one in residuals]
    mean = sum(float(one.sum()) for one in squares) / sum(one.size for one in squares)
    found = np.zeros(n_lags)
    for k in range(1, n_lags + 1):
        rows = [(one[k:], one[:-k]) for one in squares if one.size > k]
        count = sum(a.size for a, _ in rows)
        found[k - 1] = sum(float(a @ b) for a, b in rows) / max(count * mean**2, 1e-300)
    return found


def _shifted(q: NDArray[Any], n_lags: int) -> Array:
    """(K, K) ``tr(Q' L_j L_k Q)`` of one experiment, ``L_k q`` being ``(q(t + k) + q(t - k)) / 2``.

    All samples count as there, which matters beside the diagonal only little.
    """
    n = q.shape[0]
    found = np.zeros((n_lags, n_lags))
    for apart in range(min(2 * n_lags, n - 1) + 1):
        own = np.einsum("ij,ij->i", q[apart:], q[: n - apart])
        sums = np.concatenate([[0.0], np.cumsum(own, dtype=np.float64)])
        if 0 < apart < n_lags:
            j = np.arange(1, n_lags - apart + 1)
            k = j + apart
            # both later, and both earlier, as far as samples go
            both = sums[-1] - sums[np.minimum(j, n - apart)] + sums[np.maximum(n - k, 0)]
            found[j - 1, k - 1] += both
            found[k - 1, j - 1] += both
        j = np.arange(max(apart - n_lags, 1), min(n_lags, apart - 1) + 1)
        found[j - 1, apart - j - 1] += 2.0 * sums[-1]
    return np.asarray(0.25 * found)


def _moments(value: Array, trace: Array, square: Array, m: float) -> Autocorrelation:
    """Means, standard deviations and correlations from the traces."""
    mean, cov = np.zeros(value.size), np.zeros(square.shape)
    if m > 0:
        mean = np.where(np.isfinite(np.diag(square)), trace / m, 0.0)
        cov = (np.outer(trace, trace) + 2.0 * square) / (m * (m + 2.0))
        cov = np.nan_to_num(cov - np.outer(trace, trace) / m**2)
    std = np.sqrt(np.maximum(np.diag(cov), 0.0))
    size = np.where(std > 0, std, 1.0)
    together = np.clip(cov / np.outer(size, size), -1.0, 1.0)
    return Autocorrelation(value, mean, std, together, m)


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


def portmanteau(found: Autocorrelation, noise: Array) -> Portmanteau:
    """Ljung-Box tests over few lags and over all, for weak noise of short memory and for the rest.

    Parameters
    ----------
    found : Autocorrelation
    noise : (p,) array
        Coefficients of the autoregressive model that whitened the residual; empty for none.

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
    values, (mean, spread) = _statistics(found, projections)
    freedom, other = mean**2 / spread, max(found.freedom, 0.0) / 2.0 + 4.0
    p_values = fdtrc(freedom, other, values / mean * other / (other - 2.0))
    return Portmanteau(
        tuple(one.lags for one in projections),
        tuple(values.tolist()),
        tuple(one.dimension for one in projections),
        tuple(np.asarray(p_values).tolist()),
    )


class _Projection(NamedTuple):
    """Of the first ``lags`` correlations: what a noise model took of them."""

    lags: int
    dimension: int
    lost: Array


def _projections(there: Flags, noise: Array) -> list[_Projection]:
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


def _statistics(found: Autocorrelation, projections: list[_Projection]) -> tuple[Array, Array]:
    """Sums of squares of the scaled correlations, and traces of their covariance and its square."""
    there = found.std > 0
    z = np.where(there, (found.value - found.mean) / np.where(there, found.std, 1.0), 0.0)
    sums, traces = [], []
    for one in projections:
        kept = np.eye(one.lags) - one.lost @ one.lost.T
        left = kept @ z[: one.lags]
        cov = kept @ found.together[: one.lags, : one.lags] @ kept
        sums.append(float(left @ left))
        traces.append((float(np.trace(cov)), float(np.sum(cov * cov))))
    return np.array(sums), np.array(traces).reshape(-1, 2).T
