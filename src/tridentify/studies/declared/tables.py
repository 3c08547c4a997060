"""The statistics of a declared study as text."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from itertools import groupby

from tridentify.studies.declared.nouns import DeclaredStudy
from tridentify.studies.declared.statistics import OUTLIER, CoefficientStatistics
from tridentify.writing.layout import printable
from tridentify.writing.layout import short as shorten

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
