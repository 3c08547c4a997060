"""What a declared study found.

What the draws of a study say: bias, error over the Cramer-Rao bound, coverage, time.

The statistics of a declared study as text.
"""

from __future__ import annotations

import math
import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tridentify.numerics.arrays import Array
from tridentify.studies.declared.draw import Row, prepare
from tridentify.studies.declared.nouns import (
    DeclaredMethod,
    DeclaredStudy,
    StudyCell,
    draws_of,
    meetings,
)
from tridentify.studies.declared.results import key_of
from tridentify.writing.layout import printable
from tridentify.writing.layout import short as shorten
from tridentify.writing.views import pandas_frame

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


WIDTH = 100
SHORTEST, LONGEST = 12, 36
"""Characters of the column of methods."""
MOST_REASONS = 8
"""Lines of reasons for failures; the others are in the file of the draws."""
MISSING = "-"
LEGEND = (
    "bias: mean error over the draws with an answer, in % of the coefficient. RMSE/bound: root "
    "mean square error over the Cramer-Rao standard deviation for a known start, +- its standard "
    "error; inside: the same without outliers, draws with a coefficient more than "
    f"{OUTLIER:g} bounds off (out). cover: share of the 95 % intervals that hold the truth, +- its "
    "standard error. none: draws without an answer; bad: whose status is not usable. ms: median "
    "time of the processor."
)
HEAD = (
    ("method", 0),
    ("", 4),
    ("draws", 6),
    ("bias %", 11),
    ("RMSE/bound", 17),
    ("inside", 8),
    ("cover %", 12),
    ("out", 5),
    ("none", 5),
    ("bad", 4),
    ("ms", 7),
)


def write_table(
    study: DeclaredStudy,
    statistics: Sequence[CoefficientStatistics],
    failures: Mapping[str, int],
) -> str:
    """Lay out the statistics, a block for each cell.

    Parameters
    ----------
    study : DeclaredStudy
    statistics : sequence of CoefficientStatistics
    failures : mapping of str to int
        Reasons of draws without an answer, with their numbers.

    Returns
    -------
    str
        Without a line break at its end.
    """
    told = f"Study {study.name}: {study.draws} draws a cell, seed {study.seed}. "
    blocks = [textwrap.fill(told + " ".join(study.description.split()), WIDTH)]
    longest = max((len(printable(row.method)) for row in statistics), default=0)
    size = min(max(longest, SHORTEST), LONGEST)
    for cell, rows in groupby(statistics, lambda row: row.cell):
        blocks.append(_block(cell, list(rows), size))
    return "\n\n".join([*blocks, textwrap.fill(LEGEND, WIDTH), *_reasons(failures)])


def _block(cell: str, rows: Sequence[CoefficientStatistics], size: int) -> str:
    head = _laid_out([title for title, _ in HEAD], size)
    lines = [printable(cell), head, "-" * len(head)]
    for _, own in groupby(rows, lambda row: row.method):
        lines += [_laid_out(_cells(row, number == 0), size) for number, row in enumerate(own)]
    return "\n".join(lines)


def _laid_out(cells: Sequence[str], size: int) -> str:
    """The first cell to the left, in so many characters, the others to the right."""
    rest = (cell.rjust(width) for cell, (_, width) in zip(cells[1:], HEAD[1:], strict=True))
    return (shorten(cells[0], size).ljust(size) + "".join(rest)).rstrip()


def _cells(row: CoefficientStatistics, first: bool) -> list[str]:
    """One coefficient; what holds for the method stands in its first line."""
    counts = (row.outliers, row.failed, row.flagged)
    return [
        printable(row.method) if first else "",
        row.coefficient,
        str(row.draws) if first else "",
        _number(100 * row.bias / row.truth if row.truth else math.nan, 4),
        _with_error(row.ratio, row.ratio_error, 4),
        _number(row.ratio_inside, 4),
        _with_error(100 * row.coverage, 100 * row.coverage_error, 3),
        *((str(count) if count else MISSING) if first else "" for count in counts),
        f"{1e3 * row.seconds:.1f}" if first and math.isfinite(row.seconds) else "",
    ]


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}g}" if math.isfinite(value) else MISSING


def _with_error(value: float, error: float, digits: int) -> str:
    if not math.isfinite(value):
        return MISSING
    return f"{value:.{digits}g} +- {_number(error, 2)}"


def _reasons(failures: Mapping[str, int]) -> list[str]:
    """The most frequent reasons of failures, one a line."""
    if not failures:
        return []
    ordered = sorted(failures.items(), key=lambda item: (-item[1], item[0]))
    lines = ["Draws without an answer:"]
    for reason, count in ordered[:MOST_REASONS]:
        lines.append(f"{count:6d}  {printable(textwrap.shorten(reason, WIDTH - 8))}")
    if len(ordered) > MOST_REASONS:
        lines.append(f"        and {len(ordered) - MOST_REASONS} other reasons")
    return ["\n".join(lines)]


@dataclass(frozen=True, eq=False)
class DeclaredResult:
    """Draws of a declared study, and what they say.

    Attributes
    ----------
    study : DeclaredStudy
    rows : tuple of mapping
        One a cell, method and draw, sorted by these: ``theta``, ``low`` and ``high`` (ends of the
        95 % intervals), ``status``, ``ok``, ``failure`` and ``seconds``.
    statistics : tuple of CoefficientStatistics
        One a cell, method and coefficient, in the order of the study.
    """

    study: DeclaredStudy
    rows: tuple[Row, ...]
    statistics: tuple[CoefficientStatistics, ...]

    @classmethod
    def of(cls, study: DeclaredStudy, rows: Sequence[Row]) -> DeclaredResult:
        """Sum up draws.

        Parameters
        ----------
        study : DeclaredStudy
        rows : sequence of mapping
            In any order; draws beyond those of the study are left out.
        """
        own = tuple(sorted((row for row in rows if row["draw"] < study.draws), key=key_of))
        return cls(study, own, statistics_of(study, own))

    @property
    def failures(self) -> Mapping[str, int]:
        """Reasons of draws without an answer, with their numbers."""
        return Counter(row["failure"] for row in self.rows if row["failure"])

    def table(self) -> str:
        """Text for people, ASCII, a block for each cell."""
        return write_table(self.study, self.statistics, self.failures)

    def to_frame(self) -> Any:
        """Statistics as a pandas data frame.

        Returns
        -------
        pandas.DataFrame
            A row for each cell, method and coefficient; columns as in `statistics`.

        Raises
        ------
        MissingDependencyError
            pandas is not installed.
        """
        names = [field.name for field in fields(CoefficientStatistics)]
        return pandas_frame({n: [getattr(row, n) for row in self.statistics] for n in names})

    def to_dict(self) -> dict[str, Any]:
        """Numbers for machines; None where there is no number."""
        return {
            "study": self.study.name,
            "draws": self.study.draws,
            "settings": dict(self.study.settings()),
            "statistics": [_plain(asdict(row)) for row in self.statistics],
            "failures": dict(self.failures),
        }


def _plain(row: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in row.items()
    }
