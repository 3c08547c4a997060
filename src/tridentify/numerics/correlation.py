"""Autocorrelation of a sampled series, gaps allowed, and the products of two at every shift."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.fft import irfft, next_fast_len, rfft

from tridentify.numerics.arrays import Array


def products_at_shifts(one: Array, other: Array) -> Array:
    """``sum_k one(k + s) other(k)`` at every shift ``s = 1 - n .. n - 1``.

    What `scipy.signal.correlate` gives by its method "fft", whose import takes half a second.

    Parameters
    ----------
    one, other : (n,) arrays

    Examples
    --------
    >>> products_at_shifts(np.array([1.0, 2.0]), np.array([1.0, 3.0]))
    array([3., 7., 2.])
    """
    n = 2 * one.size - 1
    length = next_fast_len(n, real=True)
    return np.asarray(irfft(rfft(one, length) * rfft(other[::-1], length), length)[:n])


def autocorrelation(series: npt.ArrayLike, n_lags: int) -> tuple[Array, int]:
    """Normalised autocorrelation ``r(0..n_lags)`` of a series about its mean.

    Parameters
    ----------
    series : array_like, shape (n_samples,)
        ``nan`` marks a missing sample; a product with a missing sample does not count.
    n_lags : int
        Largest lag [samples].

    Returns
    -------
    correlation : ndarray, shape (n_lags + 1,)
        ``r(0) = 1``; all zero for a constant series. The biased estimate: sums of products over
        the sum of squares.
    n_present : int
        Samples that are not missing. Of white noise, ``r(k)`` has the standard deviation
        ``1 / sqrt(n_present)`` for k > 0.

    Examples
    --------
    >>> autocorrelation([1.0, -1.0, 1.0, -1.0], 2)
    (array([ 1.  , -0.75,  0.5 ]), 4)
    """
    values = np.asarray(series, dtype=np.float64)
    present = ~np.isnan(values)
    n_present = int(present.sum())
    mean = values[present].mean() if n_present else 0.0
    centred = np.where(present, values - mean, 0.0)
    energy = float(centred @ centred)
    products = np.zeros(n_lags + 1)
    for k in range(min(n_lags, values.size - 1) + 1):
        products[k] = centred[: values.size - k] @ centred[k:]
    correlation: Array = products / energy if energy > 0 else np.zeros(n_lags + 1)
    return correlation, n_present
