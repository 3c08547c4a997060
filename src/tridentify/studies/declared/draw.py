"""One draw: simulate, add noise, identify; and what the noise of a cell allows at best.

Inputs and noises by the names that a file calls them by.
"""

from __future__ import annotations

import hashlib
import math
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np
import scipy.linalg

from tridentify.errors import IdentifiabilityError, OptionError, TridentifyError
from tridentify.excitation import Excitation, chirp, doublet, multisine, prbs, three_two_one_one
from tridentify.models.simulate import simulate
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record
from tridentify.studies.cramer_rao import information_factor, output_sensitivities
from tridentify.studies.declared.methods import attempt
from tridentify.studies.declared.nouns import (
    DeclaredInput,
    DeclaredMethod,
    DeclaredNoise,
    Offered,
    StudyCell,
    refusal,
)

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


Row = Mapping[str, Any]
"""One draw by one method, as JSON holds it."""
MOST_COLOURED = 30_000
"""Samples: the bound in coloured noise takes a time that grows with their square, here seconds."""
FEWEST_SAMPLES = 10
"""Samples: fewer than this say nothing of one coefficient and its noise."""


@dataclass(frozen=True, eq=False)
class PreparedCell:
    """What all draws of a cell share.

    Attributes
    ----------
    u, clean : (n_samples,) arrays
        The input, and the output without noise.
    dt : float
        Sampling interval [s].
    std : float
        Of the noise, in units of the output.
    bound : (n_parameters,) array
        Cramer-Rao standard deviations for a known start; zero without noise.
    """

    u: Array
    clean: Array
    dt: float
    std: float
    bound: Array

    def record(self, noise: Array) -> Record:
        """The record with noise of variance one."""
        y = self.clean + self.std * noise
        return Record(self.u, y, dt=self.dt, intersample="zoh")


@lru_cache(maxsize=64)
def prepare(cell: StudyCell) -> PreparedCell:
    """Simulate a cell and compute its bound.

    Parameters
    ----------
    cell : StudyCell

    Returns
    -------
    PreparedCell

    Raises
    ------
    OptionError
        The record cannot be made, or does not determine the coefficients.
    """
    u, dt = samples_of(cell.input), cell.input.dt
    clean = simulate(cell.system.model, Record(u, u, dt=dt, intersample="zoh"))[:, 0]
    if not np.all(np.isfinite(clean)) or not np.any(clean):
        raise OptionError(
            f"found a cell {cell.name} whose output is zero or not finite; expected a response to "
            "the input; choose another input or a stable system"
        )
    std = _noise_std(cell.noise, clean)
    try:
        bound = std * _unit_bound(cell, u, dt)
    except (IdentifiabilityError, np.linalg.LinAlgError) as error:
        told = " ".join(str(error).split())
        raise OptionError(f"in the cell {cell.name}: {told}") from error
    return PreparedCell(u, clean, dt, std, bound)


def draw_row(cell: StudyCell, method: DeclaredMethod, seed: int, draw: int) -> Row:
    """One draw of a cell, identified by one method.

    Parameters
    ----------
    cell : StudyCell
    method : DeclaredMethod
    seed : int
        Of the study.
    draw : int
        Its number, from 0.

    Returns
    -------
    mapping
        ``theta`` is None where there is no answer, ``low`` and ``high`` (ends of the 95 %
        intervals) where the method gives none; ``seconds`` are those of the processor.

    Examples
    --------
    >>> from tridentify.studies.declared.nouns import DeclaredInput, DeclaredSystem
    >>> cell = StudyCell(
    ...     DeclaredSystem("plant", (0.5,), (1.0, 1.0, 3.0)),
    ...     DeclaredInput("step", "step", 0.05, 100),
    ...     DeclaredNoise("none", "white", "ratio", 0.0),
    ... )
    >>> row = draw_row(cell, DeclaredMethod("ours", "three-model"), 0, 0)
    >>> np.round(row["theta"], 6).tolist()
    [1.0, 3.0, 0.5]
    """
    prepared = prepare(cell)
    noise = drawn(cell.noise, generator(cell, seed, draw), prepared.u.size)
    record = prepared.record(noise)
    before = time.process_time()
    # overflow in a failing estimate is counted as a failure, not printed by a process
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        found = _answered(cell, method, record)
    return _row(cell, method, draw, found, time.process_time() - before)


def no_answer(cell: StudyCell, method: DeclaredMethod, draw: int, why: str, seconds: float) -> Row:
    """The row of a draw that went down with its process.

    Parameters
    ----------
    cell : StudyCell
    method : DeclaredMethod
    draw : int
    why : str
    seconds : float
        What it took until then [s].
    """
    return _row(cell, method, draw, _nothing(why), seconds)


def _row(
    cell: StudyCell, method: DeclaredMethod, draw: int, found: Mapping[str, Any], seconds: float
) -> Row:
    where = {"cell": cell.name, "method": method.name, "draw": draw}
    return {**where, **found, "seconds": seconds}


def generator(cell: StudyCell, seed: int, draw: int) -> np.random.Generator:
    """Random numbers of a draw: they depend on nothing but the seed, the cell and the number.

    All methods of a cell see the same noise, and a cell that is added to a study, or a method,
    changes no other.

    Parameters
    ----------
    cell : StudyCell
    seed, draw : int
    """
    mark = hashlib.sha256(cell.name.encode()).digest()
    own = np.random.SeedSequence(seed, spawn_key=(int.from_bytes(mark[:8], "big"), draw))
    return np.random.default_rng(own)


def _answered(cell: StudyCell, method: DeclaredMethod, record: Record) -> dict[str, Any]:
    """The answer, or why there is none: whatever a method does, the study goes on."""
    try:
        answer = attempt(method, cell.system, record)
    except Exception as error:
        told = " ".join(f"{type(error).__name__}: {error}".split())
        return _nothing(told)
    if not np.all(np.isfinite(answer.theta)):
        return _nothing("coefficients are not finite")
    low, high = None, None
    if answer.intervals.size and np.all(np.isfinite(answer.intervals)):
        low, high = answer.intervals.T.tolist()
    return {
        "theta": answer.theta.tolist(),
        "low": low,
        "high": high,
        "status": answer.status,
        "ok": answer.ok,
        "failure": "",
    }


def _nothing(why: str) -> dict[str, Any]:
    none = dict.fromkeys(("theta", "low", "high"))
    return {**none, "status": "", "ok": False, "failure": why}


def _noise_std(noise: DeclaredNoise, clean: Array) -> float:
    if noise.measure == "std":
        return noise.level
    if noise.measure == "ratio":
        return float(noise.level * np.sqrt(np.mean(clean**2)))
    return float(np.std(clean) * 10 ** (-noise.level / 20))


def _unit_bound(cell: StudyCell, u: Array, dt: float) -> Array:
    """Cramer-Rao standard deviations for noise of variance one."""
    columns = output_sensitivities(cell.system.model, u, dt)
    scale = np.linalg.norm(columns, axis=0)
    if u.size < FEWEST_SAMPLES or not np.all(scale > 0):
        raise IdentifiabilityError(
            f"found {u.size} samples with a coefficient that leaves no trace in them; expected at "
            f"least {FEWEST_SAMPLES} that show every coefficient; record longer or excite more"
        )
    columns = columns / scale
    factor = information_factor(columns)
    if cell.noise.kind == ARMA:
        if u.size > MOST_COLOURED:
            raise IdentifiabilityError(
                f"found {u.size} samples in coloured noise; expected at most {MOST_COLOURED}, for "
                "the sake of the Cramer-Rao bound; shorten the record"
            )
        whitened = scipy.linalg.solve_toeplitz(autocorrelation(cell.noise, u.size), columns)
        factor = scipy.linalg.cholesky(columns.T @ whitened)
    inverse = scipy.linalg.solve_triangular(factor, np.eye(scale.size)) / scale[:, None]
    spread = np.sqrt(np.sum(inverse**2, axis=1))
    return np.asarray(spread / math.sqrt(_information_of_shape(cell.noise)))


def _information_of_shape(noise: DeclaredNoise) -> float:
    """Fisher information of location of the density, over that of a Gaussian of equal variance.

    Student's t with ``k`` degrees and scale ``s`` has ``(k + 1) / (k + 3) / s^2``; a variance of
    one makes ``s^2 = (k - 2) / k``.
    """
    if noise.kind != STUDENT:
        return 1.0
    k = float(dict(noise.options)["degrees"])
    return (k + 1) / (k + 3) * k / (k - 2)
