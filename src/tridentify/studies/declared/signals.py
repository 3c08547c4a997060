"""Inputs and noises by the names that a file calls them by."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache
from types import MappingProxyType
from typing import Any

import numpy as np

from tridentify.errors import OptionError, TridentifyError
from tridentify.excitation import Excitation, chirp, doublet, multisine, prbs, three_two_one_one
from tridentify.numerics.arrays import Array
from tridentify.studies.declared.nouns import DeclaredInput, DeclaredNoise, Offered, refusal

STEP = "step"
PLANNED: Mapping[str, Callable[..., Excitation]] = MappingProxyType(
    {
        "prbs": prbs,
        "multisine": multisine,
        "3211": three_two_one_one,
        "doublet": doublet,
        "chirp": chirp,
    }
)
INPUTS = (STEP, *PLANNED)
"""Kinds of inputs: a unit step at the first sample, and those of `tridentify.excitation`."""
_NOT_OFFERED = ("dt", "n_inputs", "intersample")
WHITE, STUDENT, ARMA = "white", "student", "arma"
NOISES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {WHITE: (), STUDENT: ("degrees",), ARMA: ("ar", "ma")}
)
"""Kinds of noise with their options: Gaussian; heavy tails; Gaussian, ``ar(q) v = ma(q) e``."""
FORGOTTEN = 1e-10
"""What is left of the start of coloured noise when the record begins: below the rounding of a
simulation over 10,000 samples."""
LONGEST_BURN_IN = 100_000
"""Samples: a pole within 2e-4 of the unit circle needs them, longer than records are."""


def input_options(kind: str) -> Offered:
    """Options of a kind of input, besides ``dt`` and ``samples``.

    Examples
    --------
    >>> input_options("doublet")
    Offered(names=('amplitude', 'width', 'for_frequency', 'lead', 'tail'), needed=('amplitude',))
    """
    return Offered(("amplitude",)) if kind == STEP else Offered.by(PLANNED[kind], but=_NOT_OFFERED)


@cache
def samples_of(signal: DeclaredInput) -> Array:
    """The input.

    Parameters
    ----------
    signal : DeclaredInput

    Returns
    -------
    (n_samples,) array

    Raises
    ------
    OptionError
        An option has a value that is not offered, or the signal is shorter than its record.
    """
    options = dict(signal.options)
    if signal.kind == STEP:
        return np.full(signal.samples or 0, float(options.get("amplitude", 1.0)))
    try:
        u = PLANNED[signal.kind](dt=signal.dt, **options).u[:, 0]
    except (TridentifyError, TypeError, ValueError) as error:
        raise refusal(f"[inputs.{signal.name}]", error) from error
    if signal.samples is not None and signal.samples > u.size:
        raise OptionError(
            f"[inputs.{signal.name}]: found samples={signal.samples} of a signal of {u.size}; "
            "expected at most that; lengthen the signal or leave samples out"
        )
    return np.array(u[: signal.samples])


def drawn(noise: DeclaredNoise, rng: np.random.Generator, n_samples: int) -> Array:
    """Noise of variance one.

    Parameters
    ----------
    noise : DeclaredNoise
    rng : numpy.random.Generator
    n_samples : int

    Returns
    -------
    (n_samples,) array

    Examples
    --------
    >>> noise = DeclaredNoise("v", "white", "std", 0.1)
    >>> drawn(noise, np.random.default_rng(0), 4).shape
    (4,)
    """
    from scipy.signal import lfilter

    if noise.kind == WHITE:
        return rng.standard_normal(n_samples)
    if noise.kind == STUDENT:
        degrees = dict(noise.options)["degrees"]
        return np.asarray(rng.standard_t(degrees, n_samples) / math.sqrt(degrees / (degrees - 2)))
    ar, ma = polynomials(noise)
    response = _impulse_response(noise)
    e = rng.standard_normal(n_samples + response.size)
    v = lfilter(ma, ar, e)[response.size :]
    return np.asarray(v / np.sqrt(response @ response))


def autocorrelation(noise: DeclaredNoise, n_samples: int) -> Array:
    """First row of the covariance matrix over a record, for a variance of one.

    Parameters
    ----------
    noise : DeclaredNoise
    n_samples : int

    Returns
    -------
    (n_samples,) array

    Examples
    --------
    >>> noise = DeclaredNoise("v", "arma", "std", 0.1, (("ar", (1.0, -0.5)), ("ma", (1.0,))))
    >>> autocorrelation(noise, 3)
    array([1.  , 0.5 , 0.25])
    """
    from scipy.signal import fftconvolve

    response = _impulse_response(noise)
    both = fftconvolve(response, response[::-1])[response.size - 1 :]
    row = np.zeros(n_samples)
    size = min(n_samples, both.size)
    row[:size] = both[:size] / both[0]
    return row


def polynomials(noise: DeclaredNoise) -> tuple[Array, Array]:
    """``ar`` and ``ma``, ascending powers of the delay, both beginning with one unless stated."""
    options: dict[str, Any] = dict(noise.options)
    return np.array(options.get("ar", (1.0,))), np.array(options.get("ma", (1.0,)))


@cache
def _impulse_response(noise: DeclaredNoise) -> Array:
    """Until it is forgotten."""
    from scipy.signal import lfilter

    ar, ma = polynomials(noise)
    slowest = float(np.max(np.abs(np.roots(ar)), initial=0.0))
    if slowest >= 1.0:
        raise OptionError(
            f"[noises.{noise.name}]: found ar with a root of size {slowest:.4g}; expected all "
            "inside the unit circle; choose coefficients of a stationary process"
        )
    lasting = math.log(FORGOTTEN) / math.log(slowest) if slowest > 0 else 0.0
    size = ma.size + ar.size + math.ceil(lasting)
    if size > LONGEST_BURN_IN:
        raise OptionError(
            f"[noises.{noise.name}]: found ar with a root of size {slowest:.8g}; expected one that "
            f"is forgotten within {LONGEST_BURN_IN} samples; choose faster noise"
        )
    return np.asarray(lfilter(ma, ar, np.eye(1, size)[0]))
