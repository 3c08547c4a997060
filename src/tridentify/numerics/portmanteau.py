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

References: E. Pitman, Proc. Cambridge Phil. Soc. 33 (1937) 212-222. J. Durbin & G. Watson,
Biometrika 37 (1950) 409-428. G. Box & D. Pierce, J. American Statistical Association 65 (1970)
1509-1526. G. Ljung & G. Box, Biometrika 65 (1978) 297-303. D. Pierce, Biometrika 59 (1972) 411-426.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

Array = NDArray[np.float64]


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
    value, mean, std = np.zeros((3, n_lags))
    for k in range(1, n_lags + 1):
        product, pairs, twice = 0.0, 0.0, 0.0
        table = np.zeros((p, p))
        for r, there, q in zip(residuals, seen, bases, strict=True):
            if r.size <= k:
                continue
            product += float(r[k:] @ r[:-k])
            pairs += float(there[k:] @ there[:-k])
            table += q[k:].T @ q[:-k]
            moved = np.zeros_like(q)
            moved[:-k] += q[k:]
            moved[k:] += q[:-k]
            twice += 0.25 * float(np.sum((moved * there[:, None]) ** 2))
        table = 0.5 * (table + table.T)
        trace = -float(np.trace(table))
        square = max(0.5 * pairs - 2.0 * twice + float(np.sum(table * table)), 0.0)
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
    there = found.std > 0
    z = np.where(there, (found.value - found.mean) / np.where(there, found.std, 1.0), 0.0)
    n_lags, p = z.size, noise.size
    psi = np.zeros(n_lags + 1)
    psi[0] = 1.0
    for k in range(1, n_lags + 1):
        own = min(k, p)
        psi[k] = -float(noise[:own] @ psi[k - 1 :: -1][:own])
    lost = np.zeros((n_lags, p))
    for j in range(1, p + 1):
        lost[j - 1 :, j - 1] = psi[: n_lags - j + 1]
    sizes = sorted({*(p + 4**k for k in range(10) if p + 4**k < n_lags), n_lags})
    lags, statistics, freedom, p_values = [], [], [], []
    for size in sizes:
        known = there[:size]
        left, columns = z[:size][known], lost[:size][known]
        if p:
            u, s, _ = np.linalg.svd(columns, full_matrices=False)
            u = u[:, s > 1e-8 * s[0]] if s.size and s[0] > 0 else u[:, :0]
            left = left - u @ (u.T @ left)
            columns = u
        dimension = int(known.sum()) - columns.shape[1]
        if dimension < 1:
            continue
        lags.append(size)
        statistics.append(float(left @ left))
        freedom.append(dimension)
        p_values.append(float(chdtrc(dimension, left @ left)))
    return Portmanteau(tuple(lags), tuple(statistics), tuple(freedom), tuple(p_values))
