"""Phases of a multisine for a low crest factor.

Schroeder's phases (1970) ``phi_k = phi_1 - 2 pi sum_{l<k} (k - l) p_l``, with ``p_l`` the share of
the power in line ``l``, make a sweep within each period: the crest factor is about 1.7 for flat
spectra. From there the norms ``L_p`` of the signal are minimised over the phases one after the
other, ``p = 4, 16, 64, 256`` (Guillaume, Schoukens, Pintelon & Kollar 1991): the norm tends to the
peak as ``p`` grows, and is smooth where the peak is not. With ``u = Re sum_k c_k exp(i (w_k t +
phi_k))`` the gradient of ``sum_t u^p`` takes one Fourier transform of ``u^(p-1)``. For spectra of a
few lines Schroeder's phases are a poor start, so random ones are tried beside them, and what is
lowest in the peak is kept, whatever the norm says.

References: M. R. Schroeder, IEEE Trans. Information Theory 16 (1970) 85-89. P. Guillaume, J.
Schoukens, R. Pintelon & I. Kollar, IEEE Trans. Instrumentation and Measurement 40 (1991) 982-989.
E. Van der Ouderaa, J. Schoukens & J. Renneboog, IEEE Trans. Instrumentation and Measurement 37
(1988) 145-147.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tridentify.numerics.arrays import Array

Lines = NDArray[np.intp]

NORMS = (4, 16, 64, 256)
"""As in Guillaume et al.: each norm is smooth at the end of the one before."""
STEPS = 60
"""Quasi-Newton steps for each norm: the next norm goes on from there."""
FEW_LINES = 24
"""Up to here Schroeder's phases are a poor start, and a descent costs milliseconds."""
STARTS_OF_FEW = 6
"""Schroeder's phases and random ones."""
STARTS = 2
"""The same for many lines: one random start beside Schroeder's phases."""


def signal_of(harmonics: Lines, amplitudes: Array, phases: Array, n: int) -> Array:
    """(n,) one period of ``sum_k A_k cos(2 pi k t / n + phi_k)``.

    Parameters
    ----------
    harmonics : (m,) int array
        Below ``n / 2``.
    amplitudes, phases : (m,) array
    n : int
        Samples of a period.
    """
    lines = np.zeros(n // 2 + 1, dtype=np.complex128)
    lines[harmonics] = 0.5 * n * amplitudes * np.exp(1j * phases)
    return np.asarray(np.fft.irfft(lines, n))


def schroeder(amplitudes: Array) -> Array:
    """(m,) Schroeder's phases for lines in rising order.

    Examples
    --------
    >>> (schroeder(np.ones(3)) / np.pi).round(3).tolist()
    [0.0, -0.667, -2.0]
    """
    power = amplitudes**2 / np.sum(amplitudes**2)
    below = np.concatenate([[0.0], np.cumsum(power)[:-1]])
    # sum_{l<k} (k - l) p_l, built up by one more share of all lines below with every step
    return np.asarray(-2.0 * np.pi * np.cumsum(below))


def crest(u: Array) -> float:
    """Largest magnitude over root mean square."""
    return float(np.max(np.abs(u)) / np.sqrt(np.mean(u**2)))


def low_crest(harmonics: Lines, amplitudes: Array, n: int, seed: int = 0) -> Array:
    """Phases whose signal has a low crest factor at ``n`` samples a period.

    Parameters
    ----------
    harmonics : (m,) int array
        Rising, from 1 to below ``n / 2``.
    amplitudes : (m,) array
        Positive.
    n : int
    seed : int
        Of the random starts.

    Returns
    -------
    (m,) array
        Never worse than Schroeder's.

    Examples
    --------
    >>> lines, flat = np.arange(1, 32), np.ones(31)
    >>> u = signal_of(lines, flat, low_crest(lines, flat, 512), 512)
    >>> crest(u) < 1.45 < 1.6 < crest(signal_of(lines, flat, schroeder(flat), 512))
    True
    """
    start = schroeder(amplitudes)
    rng = np.random.default_rng(seed)
    more = STARTS_OF_FEW if harmonics.size <= FEW_LINES else STARTS
    starts = [start, *(rng.uniform(0, 2 * np.pi, harmonics.size) for _ in range(more - 1))]
    best, least = start, crest(signal_of(harmonics, amplitudes, start, n))
    if harmonics.size == 1:
        return best
    for phases in starts:
        for norm in NORMS:
            phases = _descended(harmonics, amplitudes, phases, n, norm)
            now = crest(signal_of(harmonics, amplitudes, phases, n))
            if now < least:
                best, least = phases, now
    return best


def _descended(harmonics: Lines, amplitudes: Array, phases: Array, n: int, norm: int) -> Array:
    """Phases of a lower ``L_norm``, by a quasi-Newton descent on its logarithm."""
    size = np.sqrt(0.5 * np.sum(amplitudes**2))

    def objective(now: Array) -> tuple[float, Array]:
        u = signal_of(harmonics, amplitudes, now, n) / size
        top = float(np.max(np.abs(u)))
        # powers of what is at most one, so that none overflows
        raised = np.abs(u / top) ** (norm - 2)
        total = float(np.sum(raised * (u / top) ** 2))
        lines = np.fft.rfft(raised * (u / top))[harmonics]
        slope = np.imag(np.conj(lines) * np.exp(1j * now))
        gradient = -amplitudes / size * slope / (top * total)
        return np.log(top) + np.log(total) / norm, gradient

    # slow to import, seldom needed
    from scipy.optimize import minimize

    answer = minimize(objective, phases, jac=True, method="L-BFGS-B", options={"maxiter": STEPS})
    return np.asarray(answer.x)
