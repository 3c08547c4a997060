"""One draw: simulate, add noise, identify; and what the noise of a cell allows at best."""

from __future__ import annotations

import hashlib
import math
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import scipy.linalg

from tridentify.errors import IdentifiabilityError, OptionError
from tridentify.models.simulate import simulate
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record
from tridentify.studies.cramer_rao import information_factor, output_sensitivities
from tridentify.studies.declared.methods import attempt
from tridentify.studies.declared.nouns import DeclaredMethod, DeclaredNoise, StudyCell
from tridentify.studies.declared.signals import ARMA, STUDENT, autocorrelation, drawn, samples_of

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
    return {
        "cell": cell.name,
        "method": method.name,
        "draw": draw,
        **found,
        "seconds": time.process_time() - before,
    }


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
    return {
        "cell": cell.name,
        "method": method.name,
        "draw": draw,
        **_nothing(why),
        "seconds": seconds,
    }


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
    return {
        "theta": None,
        "low": None,
        "high": None,
        "status": "",
        "ok": False,
        "failure": why,
    }


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
