"""The study of the paper's aircraft in tables."""

from __future__ import annotations

import math
import textwrap
from collections import Counter
from collections.abc import Sequence

from tridentify.studies.aircraft_numbers import (
    COEFFICIENTS,
    ESTIMATORS,
    FAILED,
    FAR,
    FLAGGED,
    PRINTED,
    TRUTH,
    UNITS,
    AircraftNumbers,
    Condition,
)

WIDTH = 78
PAPERS_SAMPLES = 100
"""Of the record that the paper's table is for, as far as can be told."""
MEANING = "What these numbers can mean: 'The paper's aircraft' in the documentation."


def write_text(result: AircraftNumbers) -> str:
    """Lay out a result.

    Parameters
    ----------
    result : AircraftNumbers

    Returns
    -------
    str
        ASCII, at most 78 columns wide, without a line break at its end.
    """
    blocks = [_head(result)]
    for group in result.by_length():
        blocks += [_coefficient_table(group, k) for k in range(len(COEFFICIENTS))]
        blocks.append(_count_table(group))
    blocks += [_legend(), _estimators(result), _reasons(result), MEANING]
    return "\n\n".join(block for block in blocks if block)


# ------------------------------------------------------------------------------------ tables
def _head(result: AircraftNumbers) -> str:
    return _paragraph(
        "The paper's aircraft, y'' + a1 y' + a0 y = b0 x with a1 = 1, a0 = 3, b0 = 0.5: unit "
        f"step, from rest, white Gaussian noise. {result.draws} noise draws at each level, seed "
        f"{result.seed}; without noise one record."
    )


def _record_name(condition: Condition) -> str:
    duration = condition.n_samples * condition.dt
    return f"{condition.n_samples} samples, {condition.dt:g} s ({duration:g} s)"


def _coefficient_table(group: Sequence[Condition], k: int) -> str:
    title = f"{COEFFICIENTS[k]} [{UNITS[k]}], truth {TRUTH[k]:g}: {_record_name(group[0])}"
    lines = [
        title,
        f"{'noise':>5}  {'bound':>7}  {'estimator':<12}  {'median':>8}  {'16 %':>8}  {'84 %':>8}"
        f"  {'RMSE':>8}  {'printed':>7}",
        "-" * WIDTH,
    ]
    for condition in group:
        for j, summary in enumerate(condition.summaries()):
            first = (f"{condition.ratio:g}", _number(condition.bound[k])) if j == 0 else ("", "")
            printed = PRINTED.get(summary.estimator, {}).get(condition.ratio)
            cells = [
                f"{first[0]:>5}",
                f"{first[1]:>7}",
                f"{summary.estimator:<12}",
                f"{_number(summary.median[k]):>8}",
                f"{_number(summary.low[k]):>8}",
                f"{_number(summary.high[k]):>8}",
                f"{_number(summary.rmse[k]):>8}",
                f"{printed[k]:>7g}" if printed and condition.n_samples == PAPERS_SAMPLES else "",
            ]
            lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


def _count_table(group: Sequence[Condition]) -> str:
    lines = [
        f"What went wrong: {_record_name(group[0])}",
        f"{'noise':>5}  {'estimator':<12}  {'draws':>6}  {'failed':>7}  {'unstable':>8}"
        f"  {'outliers':>8}  {'flagged':>8}",
        "-" * WIDTH,
    ]
    for condition in group:
        for j, summary in enumerate(condition.summaries()):
            ratio = f"{condition.ratio:g}" if j == 0 else ""
            lines.append(
                f"{ratio:>5}  {summary.estimator:<12}  {condition.n_draws:>6}"
                f"  {summary.failed:>7}  {summary.unstable:>8}  {summary.outliers:>8}"
                f"  {summary.flagged:>8}"
            )
    return "\n".join(lines)


def _legend() -> str:
    return _paragraph(
        "noise: standard deviation over the root mean square of the noise-free output. bound: "
        "standard deviation of the Cramer-Rao bound, the least that an unbiased estimator can "
        "have. median, 16 %, 84 %, RMSE: over all draws that gave numbers, unstable ones and "
        "outliers included. printed: the paper's table. failed: an exception, or numbers that are "
        "not finite. unstable: a1 or a0 not positive. outliers: a coefficient farther than "
        f"{FAR:g} bounds from the truth. flagged: the method itself did not call it converged."
    )


def _estimators(result: AircraftNumbers) -> str:
    return _paragraph(
        "Step 2 alone: the series-parallel model on the recorded output. Steps 1-4: the paper "
        f"literally, three operators, gamma {result.gamma:.3g} rad/s, at most {result.passes} "
        "passes. ThreeModel(): the strategy made efficient. All know that the record starts at "
        "rest and has no offset."
    )


def _reasons(result: AircraftNumbers) -> str:
    """What failed, with one draw on which it can be seen, and why the methods flagged."""
    counts: Counter[tuple[str, str, str]] = Counter()
    seen: dict[tuple[str, str, str], str] = {}
    for condition in result.conditions:
        for event in condition.events:
            key = (event.kind, event.estimator, event.reason.split(":")[0])
            counts[key] += 1
            where = f"draw {event.draw} at noise {condition.ratio:g}, {condition.n_samples} samples"
            seen.setdefault(key, where)
    lines = [
        f"{estimator} failed on {count} with {reason}; the first: {seen[kind, estimator, reason]}."
        for (kind, estimator, reason), count in counts.most_common()
        if kind == FAILED
    ]
    for name in ESTIMATORS:
        flags = [
            f"{reason} {count}"
            for (kind, estimator, reason), count in counts.most_common()
            if (kind, estimator) == (FLAGGED, name)
        ]
        if flags:
            lines.append(f"{name} flagged in all: {', '.join(flags)}.")
    return "\n".join(_paragraph(line) for line in lines)


def _number(value: float) -> str:
    """A number in at most eight characters, with three decimals where they fit.

    Examples
    --------
    >>> _number(0.99954), _number(-1234.5), _number(math.nan), _number(-3e7), _number(0.0)
    ('1.000', '-1234.5', '-', '-3.0e+07', '0')
    """
    if not math.isfinite(value):
        return "-"
    size = abs(value)
    if size and not 5e-3 <= size < 1e4:
        return f"{value:.1e}"
    return f"{value:.3f}" if 0 < size < 1e2 else f"{value:.1f}" if size else "0"


def _paragraph(text: str) -> str:
    return textwrap.fill(text, WIDTH, break_long_words=False, break_on_hyphens=False)
