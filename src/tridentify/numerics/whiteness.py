"""Whether a residual is white noise, and whether it is noise at all."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import Whitener, most_coefficients, whiten
from tridentify.numerics.least_squares import solve

FALSE_ALARMS = 0.01
"""Of the tests on white noise: one record in a hundred."""
DENSE, SPARSE = 8, 14
"""Lags from one on that are all looked at, and how many are from there to a quarter of the record,
each a fixed factor beyond the last: colour is either near or slow."""


def is_white(series: Sequence[Array], rate: float = FALSE_ALARMS) -> bool:
    """Whether series pass for white noise about zero.

    Parameters
    ----------
    series : sequence of (n_samples,) arrays
        ``nan`` marks a missing sample.
    rate : float
        Probability that white noise does not pass.

    Returns
    -------
    bool

    Notes
    -----
    The portmanteau statistic of Ljung & Box (Biometrika 65, 1978, 297-303), with the number of
    pairs of samples that are there at each lag, over the first 1, 4, 16, ... lags and over
    `most_coefficients`: few lags tell weak noise of short memory, many lags the rest. Each gets
    an equal part of ``rate``. The residual of an output-error fit needs no correction for the
    coefficients of the system (Pierce, Biometrika 59, 1972, 411-426).

    Examples
    --------
    >>> e = np.random.default_rng(0).standard_normal(500)
    >>> is_white([e]), is_white([e[1:] + 0.5 * e[:-1]])
    (True, False)
    """
    n = sum(int(np.isfinite(one).sum()) for one in series)
    n_lags = most_coefficients(n)
    if n_lags == 0:
        return True
    complete = n == sum(one.size for one in series)
    filled = [np.ascontiguousarray(one) if complete else np.nan_to_num(one) for one in series]
    seen = [] if complete else [np.isfinite(one).astype(np.float64) for one in series]
    power = sum(float(one @ one) for one in filled) / n
    if power == 0:
        return True
    every = range(1, n_lags + 1)
    products, pairs = np.zeros(n_lags), np.zeros(n_lags)
    for one in filled:
        products += np.correlate(np.append(one, np.zeros(n_lags)), one)[1:]
        pairs += np.maximum(one.size - np.arange(1.0, n_lags + 1.0), 0.0) if complete else 0.0
    for one in seen:
        pairs += [float(one[lag:] @ one[:-lag]) for lag in every]
    terms = (products / power) ** 2 / np.where(pairs > 0.0, pairs, np.inf)
    last, limits = _limits(n_lags, rate)
    return bool(np.all(np.cumsum(terms)[last] < limits))


@lru_cache(maxsize=64)
def _limits(n_lags: int, rate: float) -> tuple[NDArray[np.intp], Array]:
    """The last lags that are looked at, from zero, and what white noise stays below there."""
    lags = np.array(sorted({*(4**k for k in range(10) if 4**k < n_lags), n_lags}), dtype=np.intp)
    return lags - 1, np.asarray(chdtri(lags.astype(np.float64), rate / lags.size), np.float64)


def input_share(residual: Array, u: Array, a: Array) -> tuple[float, float, int]:
    """How much of a whitened residual follows the input.

    Parameters
    ----------
    residual : (n_samples,) array
        ``nan`` marks a missing sample.
    u : (n_samples, n_inputs) array
    a : (p,) array
        What whitens the residual.

    Returns
    -------
    share : float
        Of the sum of squares, less what chance explains; about 0 for noise, at most 1.
    statistic : float
        The sum of squares explained over the variance.
    dimension : int
        Degrees of freedom of its chi-square distribution if the residual is noise.

    Notes
    -----
    Noise does not know the input. The residual is projected on the inputs, whitened alike, with
    delays of 0 to 7 samples and on up to a quarter of the record in steps that grow (Ljung,
    *System Identification*, 2nd ed., section 16.6, 1999).

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> u, e = rng.standard_normal((400, 1)), rng.standard_normal(400)
    >>> [round(input_share(y, u, np.zeros(0))[0], 1) for y in (e, e + u[:, 0])]
    [0.0, 0.5]
    """
    n = residual.size
    grown = np.geomspace(DENSE, max(n // 4, DENSE), SPARSE).astype(int)
    delays = [int(k) for k in np.unique([*range(DENSE), *grown]) if k < n]
    moved = u - u[0]
    rows = np.hstack([np.pad(moved, ((k, 0), (0, 0)))[:n] for k in delays]).T
    seen = np.isfinite(residual)
    columns = Whitener(a, rows.shape[0]).apply(rows, seen).T
    innovations = np.nan_to_num(whiten(residual, a)[0])
    basis = solve(columns, innovations).basis
    dimension, count = basis.shape[1], int(seen.sum())
    total = float(innovations @ innovations)
    if total == 0 or count <= dimension:
        return 0.0, 0.0, dimension
    followed = float(np.sum((basis.T @ innovations) ** 2)) / total
    share = 1.0 - (1.0 - followed) * count / (count - dimension)
    return max(share, 0.0), followed * count, dimension
