"""Multisines: sums of sines at chosen multiples of one base frequency, with a low crest factor.

All lines have whole periods in the record, so nothing leaks between them, and every line can be
chosen: the band, the power of each, and which input it belongs to. Several inputs get disjoint
lines, taken in turn (interleaved); over whole periods they are orthogonal in the time domain and in
the frequency domain, so all inputs may move at once, and each covers the whole band (Morelli 2003,
2012). Each period begins where the signal is nearest to zero.

References: E. A. Morelli, *Multiple Input Design for Real-Time Parameter Estimation in the
Frequency Domain*, IFAC SYSID 2003, paper REG-360; E. A. Morelli, Journal of Aircraft 49 (2012)
1070-1086. R. Pintelon & J. Schoukens, *System Identification: A Frequency Domain Approach*, 2nd
ed., Wiley 2012, chapter 5.

*Phases.* Schroeder's (1970) ``phi_k = phi_1 - 2 pi sum_{l<k} (k - l) p_l``, with ``p_l`` the share
of the power in line ``l``, make a sweep within each period: the crest factor is about 1.7 for flat
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

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tridentify.errors import OptionError, shown
from tridentify.excitation.checks import band_of, count, positive, samples_of, vector
from tridentify.excitation.signal import Excitation
from tridentify.numerics.arrays import Array
from tridentify.record.checks.samples import Intersample

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


OVERSAMPLED = 8
"""Times the rate at which the peak of a signal without steps is looked for: between neighbours of
the highest line it rises by 2 percent at the most (``1 - cos(pi / 16)``)."""


def multisine(
    period: float,
    *,
    dt: float,
    band: tuple[float, float] | None = None,
    harmonics: Sequence[int] | Sequence[Sequence[int]] | None = None,
    power: Sequence[float] | Sequence[Sequence[float]] | None = None,
    n_inputs: int = 1,
    amplitude: ArrayLike = 1.0,
    periods: int = 1,
    intersample: Intersample = "zoh",
    seed: int = 0,
) -> Excitation:
    """Sines at multiples of ``2 pi / period`` with phases for a low crest factor.

    Parameters
    ----------
    period : float
        [s], a whole number of sampling intervals.
    dt : float
        Sampling interval [s].
    band : (float, float), optional
        Lowest and highest angular frequency [rad/s]: all lines within, dealt to the inputs in turn.
    harmonics : sequence of int, or one such sequence per input, optional
        In place of `band`: the lines as multiples of the base frequency, no line in two inputs.
    power : sequence of float, or one such sequence per input, optional
        Relative power of each line; equal by default.
    n_inputs : int
        Among which the lines of `band` are dealt.
    amplitude : float or (n_inputs,) array_like
        Largest magnitude of each input.
    periods : int
        How often it is repeated.
    intersample : {"zoh", "foh", "band-limited"}
        What the input will do between the samples. The lines are those of the samples; a held
        input has weaker images of them above half the sampling rate.
    seed : int
        Of the random starts in the search for phases.

    Returns
    -------
    Excitation

    Raises
    ------
    OptionError
        There are no lines, or lines at zero, beyond half the sampling rate, or in two inputs;
        powers do not fit the lines.

    Examples
    --------
    >>> plan = multisine(10.0, dt=0.02, band=(1.0, 12.0), n_inputs=2, amplitude=[0.05, 0.1])
    >>> plan.amplitude.round(6).tolist(), bool(abs(plan.u[:, 0] @ plan.u[:, 1]) < 1e-12)
    ([0.05, 0.1], True)
    """
    dt = positive("dt", dt)
    n = samples_of("period", positive("period", period), dt, exact=True)
    lines = _lines(n, 2.0 * np.pi / (n * dt), band, harmonics, n_inputs)
    weights = _weights(power, lines)
    sizes = vector("amplitude", amplitude)
    if sizes.size not in (1, len(lines)) or np.any(sizes <= 0):
        raise OptionError.found(
            "amplitude=", amplitude, f"a positive number, or one for each of {len(lines)} inputs"
        )
    fine = OVERSAMPLED * n if intersample == "band-limited" else n
    columns = []
    for own, weight, size in zip(
        lines, weights, np.broadcast_to(sizes, (len(lines),)), strict=True
    ):
        kept = weight > 0
        levels = np.sqrt(2.0 * weight[kept])
        phases = low_crest(own[kept], levels, fine, seed)
        peak = np.max(np.abs(signal_of(own[kept], levels, phases, fine)))
        one = signal_of(own[kept], levels, phases, n) * (size / peak)
        columns.append(np.roll(one, -_quietest(one)))
    u = np.tile(np.column_stack(columns), (count("periods", periods), 1))
    sorts = ", ".join(str(own.size) for own in lines)
    return Excitation(u, dt, intersample, f"multisine of {sorts} lines", n)


def _lines(
    n: int,
    base: float,
    band: tuple[float, float] | None,
    harmonics: Sequence[int] | Sequence[Sequence[int]] | None,
    n_inputs: int,
) -> list[Lines]:
    """Rising harmonics of every input."""
    inputs = count("n_inputs", n_inputs)
    if (band is None) == (harmonics is None):
        raise OptionError(
            "found both or neither of band and harmonics; expected one of the two; give the band "
            "in rad/s, or the lines as multiples of the base frequency"
        )
    if band is not None:
        low, high = band_of(band, 0.5 * n * base)
        first, last = int(np.ceil(low / base - 1e-9)), int(np.floor(high / base + 1e-9))
        every = np.arange(max(first, 1), min(last, (n - 1) // 2) + 1)
        if every.size < inputs:
            raise OptionError(
                f"found {every.size} lines between {low:.4g} and {high:.4g} rad/s for {inputs} "
                f"inputs; expected one each at least; lengthen the period (lines lie {base:.4g} "
                "rad/s apart) or widen the band"
            )
        return [every[k::inputs] for k in range(inputs)]
    assert harmonics is not None
    nested = bool(len(harmonics)) and isinstance(harmonics[0], (list, tuple, np.ndarray, range))
    rows = list(harmonics) if nested else [harmonics]
    found = []
    for row in rows:
        given = vector("harmonics", row)  # type: ignore[arg-type]
        whole = np.round(given).astype(np.intp)
        if np.any(given != whole) or np.any(whole < 1) or np.any(2 * whole >= n):
            raise OptionError(
                f"found harmonics={shown(row)}; expected whole numbers from 1 to {(n - 1) // 2}, "
                "below half the sampling rate; correct them"
            )
        found.append(whole)
    together = np.concatenate(found)
    if np.unique(together).size != together.size:
        raise OptionError.found(
            "harmonics=", harmonics, "every line once, in one input only", "drop what is repeated"
        )
    return found


def _weights(
    power: Sequence[float] | Sequence[Sequence[float]] | None, lines: list[Lines]
) -> list[Array]:
    """Shares of the power, by input; lines and powers are put into rising order."""
    if power is None:
        given = [np.ones(own.size) for own in lines]
    else:
        nested = bool(len(power)) and isinstance(power[0], (list, tuple, np.ndarray))
        rows = list(power) if nested else [power]
        given = [vector("power", row, least=0.0) for row in rows]  # type: ignore[arg-type]
    sizes = [own.size for own in lines]
    if [one.size for one in given] != sizes or any(not np.any(one) for one in given):
        raise OptionError(
            f"found power={shown(power)}; expected powers, not all zero, for {sizes} lines by "
            "input; give one number a line"
        )
    found = []
    for k, one in enumerate(given):
        order = np.argsort(lines[k])
        lines[k] = lines[k][order]
        found.append(one[order] / one.sum())
    return found


def _quietest(u: Array) -> int:
    """The sample nearest to zero before which the signal rises."""
    rising = np.flatnonzero((u >= np.roll(u, 1)) | (np.abs(u) == np.min(np.abs(u))))
    return int(rising[np.argmin(np.abs(u[rising]))])
