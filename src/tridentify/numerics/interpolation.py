"""A band-limited input between its samples, and the states that it drives.

A signal without content above half the sampling rate is ``u(t) = sum_m u_m sinc(t / h - m)``
(Shannon 1949). The sum is cut to ``2 HALF`` samples around ``t`` with a Kaiser window,

    phi(x) = sinc(x) (I_0(beta sqrt(1 - (x / HALF)^2)) - 1) / (I_0(beta) - 1),   |x| < HALF,

divided by ``sum_m phi(x - m)`` so that constants stay constants. Up to about 0.85 of half the
sampling rate what is cut off is below 1e-6 of the amplitude (Kaiser 1974; Crochiere & Rabiner,
Multirate Digital Signal Processing, 1983, section 4.3). Before the first and after the last sample,
where nothing is known, the signal is continued by reflection through its end point, ``2 u_0 -
u_m``; within about ten samples of an end it is therefore less exact.

Within one interval the sum is a polynomial to rounding, ``u = sum_p c_p (s / h)^p`` up to `DEGREE`,
made of its values at Chebyshev points. The ``c_p`` are those of Taylor, at most ``pi^p / p!`` times
the amplitude, do not depend on the state equation and are made once. With ``v_p = c_p`` at the
beginning, ``h v_p' = (p + 1) v_{p+1}`` and ``v_0 = u``, so

    int_0^h e^{A (h - s)} B (s / h)^p ds = the upper right block of exp([[h A, h B e_0'], [0, N]])

with ``N`` the matrix of these equations (Van Loan 1978): a band-limited input costs one exponential
and one product more than a held one.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.polynomial import chebyshev

from tridentify.numerics.arrays import Array
from tridentify.numerics.discretize import weight_of
from tridentify.numerics.exponential import exponential

HALF = 32
"""Samples to either side, and the window's shape: together 1e-6 of the amplitude up to 0.85 of half
the sampling rate."""
BETA = 12.0
DEGREE = 13
"""Of the polynomial in one interval: the next coefficient of a signal at half the sampling rate,
``J_14(pi / 2)``, is 1e-12 of its amplitude."""
FEWEST = 8
"""Samples from which an input is taken for band-limited: fewer tell nothing of its band."""
PASS = 0.7
"""Share of the new Nyquist rate that passes unchanged."""
ATTENUATION = 80.0
"""Decibels by which what would fold back is weakened."""


def kernel(x: Array) -> Array:
    """The windowed sinc, zero from ``HALF`` on.

    Examples
    --------
    >>> kernel(np.array([0.0, 1.0, 40.0])).round(12).tolist()
    [1.0, 0.0, 0.0]
    """
    inside = np.sqrt(np.maximum(1.0 - (x / HALF) ** 2, 0.0))
    window = (np.i0(BETA * inside) - 1.0) / (np.i0(BETA) - 1.0)
    return np.asarray(np.sinc(x) * window)


def between(u: Array, places: Array) -> Array:
    """Values at ``k + place`` for every sample ``k``.

    Parameters
    ----------
    u : (n,) array
    places : (m,) array
        Between -1 and 1.

    Returns
    -------
    (n, m) array

    Examples
    --------
    >>> t = np.arange(200.0)
    >>> error = between(np.sin(0.9 * t), np.array([0.4]))[:, 0] - np.sin(0.9 * (t + 0.4))
    >>> bool(np.abs(error[60:-60]).max() < 1e-6)
    True
    """
    more = HALF + 1
    extended = np.pad(u, more, mode="reflect", reflect_type="odd")
    windows = sliding_window_view(extended, 2 * more + 1)
    weights = kernel(places[None, :] - np.arange(-more, more + 1)[:, None])
    return np.asarray(windows @ (weights / weights.sum(axis=0)))


def nodes() -> Array:
    """(DEGREE + 1,) Chebyshev points of an interval from 0 to 1."""
    return np.asarray(0.5 + 0.5 * chebyshev.chebpts1(DEGREE + 1))


def coefficients(values: Array) -> Array:
    """(n, DEGREE + 1) coefficients of the powers of polynomials through values at the `nodes`."""
    vandermonde = chebyshev.chebvander(chebyshev.chebpts1(DEGREE + 1), DEGREE)
    return np.asarray(np.linalg.solve(vandermonde, values.T).T @ _powers())


@cache
def _powers() -> Array:
    """Coefficients of the powers in the Chebyshev polynomials of an interval from 0 to 1."""
    found = np.zeros((DEGREE + 1, DEGREE + 1))
    own = [np.polynomial.Polynomial([1.0]), np.polynomial.Polynomial([-1.0, 2.0])]
    for p in range(DEGREE + 1):
        if p > 1:
            own.append(2.0 * own[1] * own[-1] - own[-2])
        found[p, : own[p].coef.size] = own[p].coef
    return found


def moments(a: Array, b: Array, length: float) -> tuple[Array, Array]:
    """``e^{A h}`` and ``int_0^h e^{A (h - s)} B (s / h)^p ds``.

    Parameters
    ----------
    a : (q, q) array
    b : (q,) array
    length : float
        ``h`` [s].

    Returns
    -------
    transition : (q, q) array
    drive : (q, DEGREE + 1) array

    Examples
    --------
    >>> transition, drive = moments(-np.eye(1), np.ones(1), 0.5)
    >>> bool(np.allclose(drive[0, 0], 1 - np.exp(-0.5), rtol=1e-13))
    True
    """
    q = b.size
    block = np.zeros((q + DEGREE + 1, q + DEGREE + 1))
    block[:q, :q] = a * length
    block[q:, q:] = np.diag(np.arange(1.0, DEGREE + 1), 1)
    # the drive is linear in b, whose size is that of the unit of time: it is not to be squared
    weight = weight_of(block[:q, :q], length * b)
    block[:q, q] = (length / weight) * b
    whole = exponential(block)
    return np.ascontiguousarray(whole[:q, :q]), np.ascontiguousarray(weight * whole[:q, q:])


def drive(transition: Array, upper: int, inputs: Array, state: Array, out: Array) -> None:
    """Run ``x_{k+1} = F x_k + input_k``.

    Parameters
    ----------
    transition : (q, q) array
    upper : int
        Non-zero diagonals above the main one.
    inputs : (q, count) array
    state : (q,) array
        At the first sample; on return the one after the last.
    out : (q, count) array
    """
    from tridentify.numerics.kernels.driven import driven

    driven(transition, upper, np.ascontiguousarray(inputs), state, out)


def lowpass(factor: int, intersample: str) -> Array:
    """Weights that filter a sampled signal as a function of time to below a lower Nyquist rate.

    A windowed sinc (`PASS` to 1 of the new Nyquist rate, 80 dB) convolved with what the signal does
    between its samples: a box (held), a triangle (straight lines) or nothing (samples of a
    band-limited signal). The filter is the same function of time for all three, so that an input
    and an output filtered by it keep their relation.

    Parameters
    ----------
    factor : int
        Ratio of the rates.
    intersample : {"zoh", "foh", "band-limited"}

    Returns
    -------
    (2 m + 1,) array
        Weights of the samples ``m`` before to ``m`` after; their sum is one.

    Examples
    --------
    >>> held, plain = lowpass(4, "zoh"), lowpass(4, "band-limited")
    >>> lag = (np.arange(held.size) - held.size // 2) @ held
    >>> round(float(lag), 6), round(float(plain.sum()), 12)
    (-0.5, 1.0)
    """
    width = (1.0 - PASS) / factor
    half = math.ceil((ATTENUATION - 8.0) / (2.285 * np.pi * width) / 2.0) + 1
    cut = 0.5 * (1.0 + PASS) / factor
    beta = 0.1102 * (ATTENUATION - 8.7)
    x, weights = np.polynomial.legendre.leggauss(16)
    lags = np.arange(-half, half + 1, dtype=np.float64)
    if intersample == "band-limited":
        places, shares = np.zeros(1), np.ones(1)
    elif intersample == "zoh":
        # sample m lasts from its instant to the next one
        places, shares = 0.5 + 0.5 * x, 0.5 * weights
    else:
        places = np.concatenate([-0.5 + 0.5 * x, 0.5 + 0.5 * x])
        shares = np.concatenate([0.5 * weights] * 2) * (1.0 - np.abs(places))
    at = lags[:, None] + places
    window = np.i0(beta * np.sqrt(np.maximum(1.0 - (at / (half + 1)) ** 2, 0.0)))
    found = (np.sinc(cut * at) * window) @ shares
    return np.asarray(found / found.sum())
