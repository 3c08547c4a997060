"""What the draws of a study say: bias, error over the Cramer-Rao bound, coverage, time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tridentify.numerics.arrays import Array
from tridentify.studies.declared.cells import draws_of, meetings
from tridentify.studies.declared.draw import Row, prepare
from tridentify.studies.declared.nouns import DeclaredMethod, DeclaredStudy, StudyCell

OUTLIER = 10.0
"""Bounds: a draw with a coefficient farther from the truth is counted as an outlier. Of Gaussian
errors at the bound none in 1e22 draws is so far."""


@dataclass(frozen=True)
class CoefficientStatistics:
    """One coefficient by one method in one cell; nan where there is no number.

    Attributes
    ----------
    cell, method, coefficient : str
    truth : float
    draws : int
        That are done.
    failed : int
        Without an answer: an exception, or numbers that are not finite.
    flagged : int
        With an answer that its own status calls not usable; they count in all that follows.
    outliers : int
        With some coefficient farther than `OUTLIER` bounds from the truth.
    bias, bias_error : float
        Mean error over the draws with an answer, in units of the coefficient, and its standard
        error.
    rmse : float
        Root mean square of the errors.
    bound : float
        Cramer-Rao standard deviation, for a known start; zero without noise.
    ratio, ratio_error : float
        ``rmse / bound`` and its standard error.
    ratio_inside : float
        The same without outliers.
    coverage, coverage_error : float
        With noise, the share of the draws whose 95 % interval holds the truth, of those that have
        one, and its standard error (with two successes and two failures added, so that it is
        never zero).
    intervals : int
        Draws with intervals: of those the coverage is.
    seconds : float
        Median time of the processor for one record.
    """

    cell: str
    method: str
    coefficient: str
    truth: float
    draws: int
    failed: int
    flagged: int
    outliers: int
    bias: float
    bias_error: float
    rmse: float
    bound: float
    ratio: float
    ratio_error: float
    ratio_inside: float
    coverage: float
    coverage_error: float
    intervals: int
    seconds: float


def statistics_of(study: DeclaredStudy, rows: Sequence[Row]) -> tuple[CoefficientStatistics, ...]:
    """Statistics of every cell, method and coefficient, in the order of the study.

    Parameters
    ----------
    study : DeclaredStudy
    rows : sequence of mapping
        Draws, in any order; those beyond the number of draws of the study are left out.

    Returns
    -------
    tuple of CoefficientStatistics
    """
    groups = grouped(rows)
    found: list[CoefficientStatistics] = []
    for cell, method in meetings(study):
        own = groups.get((cell.name, method.name), [])
        found += _of_meeting(cell, method, own[: draws_of(study, cell)])
    return tuple(found)


def grouped(rows: Sequence[Row]) -> Mapping[tuple[str, str], list[Row]]:
    """Rows by cell and method, in the order of their draws: sums round alike in any run."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in sorted(rows, key=lambda one: int(one["draw"])):
        groups.setdefault((row["cell"], row["method"]), []).append(row)
    return groups


def _of_meeting(
    cell: StudyCell, method: DeclaredMethod, rows: Sequence[Row]
) -> list[CoefficientStatistics]:
    names, truth = cell.system.coefficients, cell.system.theta
    bound = prepare(cell).bound
    errors = _errors(rows, truth)
    far = np.any(np.abs(errors) > OUTLIER * bound, axis=1) & np.all(bound > 0)
    inside = _insides(rows, truth)
    seconds = float(np.median([row["seconds"] for row in rows])) if rows else math.nan
    return [
        CoefficientStatistics(
            cell=cell.name,
            method=method.name,
            coefficient=name,
            truth=float(truth[k]),
            draws=len(rows),
            failed=len(rows) - len(errors),
            flagged=sum(row["theta"] is not None and not row["ok"] for row in rows),
            outliers=int(far.sum()),
            **_of_errors(errors[:, k], far, float(bound[k])),
            **_coverage(inside[:, k] if bound[k] > 0 else np.empty(0)),
            intervals=len(inside),
            seconds=seconds,
        )
        for k, name in enumerate(names)
    ]


def _errors(rows: Sequence[Row], truth: Array) -> Array:
    """Estimate minus truth of the draws with an answer: (n_answers, n_parameters)."""
    given = [row["theta"] for row in rows if row["theta"] is not None]
    return np.array(given, dtype=np.float64).reshape(-1, truth.size) - truth


def _insides(rows: Sequence[Row], truth: Array) -> Array:
    """Whether the intervals hold the truth: (n_with_intervals, n_parameters)."""
    ends = [(row["low"], row["high"]) for row in rows if row["low"] is not None]
    low, high = np.array(ends, dtype=np.float64).reshape(-1, 2, truth.size).swapaxes(0, 1)
    return np.asarray((low <= truth) & (truth <= high), dtype=np.float64)


def _of_errors(errors: Array, far: NDArray[np.bool_], bound: float) -> dict[str, float]:
    count = errors.size
    rmse = _root(errors)
    spread = float(np.std(errors**2, ddof=1)) if count > 1 else math.nan
    # of a root: half the error of the square over the root
    error = spread / math.sqrt(count) / (2 * rmse) if count > 1 and rmse > 0 else math.nan
    over = 1 / bound if bound > 0 else math.nan
    return {
        "bias": float(np.mean(errors)) if count else math.nan,
        "bias_error": float(np.std(errors, ddof=1) / math.sqrt(count)) if count > 1 else math.nan,
        "rmse": rmse,
        "bound": bound,
        "ratio": rmse * over,
        "ratio_error": error * over,
        "ratio_inside": _root(errors[~far]) * over,
    }


def _root(errors: Array) -> float:
    return float(np.sqrt(np.mean(errors**2))) if errors.size else math.nan


def _coverage(inside: Array) -> dict[str, float]:
    count, held = inside.size, float(inside.sum())
    if not count:
        return {"coverage": math.nan, "coverage_error": math.nan}
    share = (held + 2) / (count + 4)
    return {
        "coverage": held / count,
        "coverage_error": math.sqrt(share * (1 - share) / (count + 4)),
    }
