"""The study of the paper's aircraft in words: tables, and what the paper's numbers can mean."""

from __future__ import annotations

import math
import textwrap
from collections import Counter
from collections.abc import Sequence

import numpy as np

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
    EstimatorSummary,
    closer_by_chance,
)

WIDTH = 78
LOUD = 1.0
"""From this noise on the tails of an estimator on the likelihood are worth a paragraph."""
LIGHT = 0.1
"""A damping below this is light; that of the truth is 0.29."""
PAPERS_SAMPLES, PAPERS_RATIO_OF_SAMPLES = 100, 2.5
"""5 s at 0.02 s are 2.5 times the 100 samples that the paper speaks of."""


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
    blocks += [_legend(), _estimators(result), _reasons(result)]
    blocks += [_tails(result), *_meaning(result)]
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
                f"{printed[k]:>7g}" if printed and _is_papers(condition) else "",
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


def _tails(result: AircraftNumbers) -> str:
    """What is left of heavy tails in loud noise, with the counts of this run."""
    loud = [condition for condition in result.conditions if condition.ratio >= LOUD]
    counts = [_count_tails(condition) for condition in loud]
    if not any(far for far, _, _ in counts):
        return ""
    listed = "; ".join(
        f"{far} of {condition.n_draws} at noise {condition.ratio:g}, {condition.n_samples} samples "
        f"({light} lightly damped, {silent} not flagged)"
        for condition, (far, light, silent) in zip(loud, counts, strict=True)
    )
    return _paragraph(
        f"What is left of tails in {ESTIMATORS[2]} at noise {LOUD:g} and more: the maximum of the "
        "likelihood is often a fast mode with little damping that rings along with the noise, or "
        "a very fast one that follows the first samples. There the mean of all models that "
        "explain the record takes its place (the posterior mean), so that such a draw counts only "
        "if hardly any other model explains the record as well. Outliers in this run: "
        f"{listed}; lightly damped is a damping below {LIGHT:g}. The price is bias towards "
        "slower and, for a step, less damped models; the intervals of the posterior allow for it."
    )


def _count_tails(condition: Condition) -> tuple[int, int, int]:
    """Outliers of the efficient strategy: all, lightly damped ones, those not flagged."""
    name, theta = ESTIMATORS[2], condition.theta[2]
    far = np.any(np.abs(theta - np.array(TRUTH)) > FAR * condition.bound, axis=1)
    a1, a0 = theta[:, 0], np.maximum(theta[:, 1], 0.0)
    light = far & (a1 < 2.0 * LIGHT * np.sqrt(a0))
    flagged = {e.draw for e in condition.events if (e.estimator, e.kind) == (name, FLAGGED)}
    silent = sum(int(draw) not in flagged for draw in np.flatnonzero(far))
    return int(np.count_nonzero(far)), int(np.count_nonzero(light)), silent


# ------------------------------------------------------------------------------------ meaning
def _meaning(result: AircraftNumbers) -> list[str]:
    """Paragraphs about the printed numbers, with the figures of this run."""
    short = [c for c in result.conditions if _is_papers(c) and c.ratio in PRINTED[ESTIMATORS[1]]]
    noisy = [condition for condition in short if condition.ratio]
    blocks = [_paragraph("WHAT THE PAPER'S NUMBERS CAN MEAN"), _what_is_open()]
    if noisy:
        blocks += [_closeness(noisy), _shares(noisy)]
    trends = [_noisy(group) for group in result.by_length()]
    if all(len(group) > 1 for group in trends):
        blocks.append(_trend(trends))
    blocks.append(_intersample(result))
    return blocks


def _what_is_open() -> str:
    return _paragraph(
        "The paper prints one number for each noise level, and neither gamma nor what its "
        "noise/signal ratio divides by. 5 s at its 0.02 s are 250 samples, not its 100; here 100 "
        "samples are 0.05 s apart. So its table cannot be repeated digit by digit, and nothing "
        "here has been tuned towards it."
    )


def _closeness(noisy: Sequence[Condition]) -> str:
    """How near to the truth the printed strategy column is, in units of the bound."""
    column = PRINTED[ESTIMATORS[1]]
    truth = np.array(TRUTH)
    errors = np.array([np.abs(column[c.ratio] - truth) / c.bound for c in noisy])
    listed = "; ".join(
        f"{condition.ratio:g}: "
        + ", ".join(f"{name} {e:.2f}" for name, e in zip(COEFFICIENTS, row, strict=True))
        for condition, row in zip(noisy, errors, strict=True)
    )
    distances = [float(c.distance(np.array(column[c.ratio]))) for c in noisy]
    chance = closer_by_chance(distances)
    denser = closer_by_chance([d * math.sqrt(PAPERS_RATIO_OF_SAMPLES) for d in distances])
    rms = float(np.sqrt(np.mean(errors**2)))
    verdict = (
        "closer to the truth than any unbiased estimator can be on average"
        if rms < 1
        else "no closer to the truth than an unbiased estimator can be on average"
    )
    return _paragraph(
        f"The printed column 'Steps 1-4' is {verdict} at this noise. In standard deviations of "
        f"the bound it is off by, level by level, {listed}; root mean square {rms:.2f}, where an "
        "estimator on the bound has 1. An efficient unbiased estimator comes so close at "
        f"{_levels(noisy)} together, all coefficients counted, with a probability of "
        f"{chance:.1g} ({denser:.1g} if the record had 250 samples). So either its noise was "
        "smaller than in this reading, or its records were favourable ones. Whichever it was, "
        "single realisations show neither the bias nor the spread of a method, and not what the "
        "next record will give."
    )


def _levels(noisy: Sequence[Condition]) -> str:
    return "this level" if len(noisy) == 1 else f"these {len(noisy)} levels"


def _shares(noisy: Sequence[Condition]) -> str:
    column = PRINTED[ESTIMATORS[1]]
    parts = []
    for j, name in enumerate(ESTIMATORS):
        shares = [c.share_as_close(j, float(c.distance(np.array(column[c.ratio])))) for c in noisy]
        parts.append(f"{name} " + ", ".join(_percent(share) for share in shares))
    ratios = ", ".join(f"{c.ratio:g}" for c in noisy)
    return _paragraph(
        f"In this run, at noise {ratios}, the share of draws at least as close to the truth as "
        "the printed 'Steps 1-4' (all coefficients together, in the metric of the bound): "
        + "; ".join(parts)
        + "."
    )


def _trend(groups: Sequence[Sequence[Condition]]) -> str:
    """What the medians do with growing noise."""
    sentences = []
    for group in groups:
        first, last = group[0], group[-1]
        parts = []
        for j, name in enumerate(ESTIMATORS):
            begin, end = first.summary(j).median, last.summary(j).median
            pair = [f"{_number(begin[k])} to {_number(end[k])}" for k in (0, 1)]
            parts.append(f"{name} a1 {pair[0]}, a0 {pair[1]}")
        sentences.append(
            f"Medians from noise {first.ratio:g} to {last.ratio:g}, {_record_name(first)}: "
            + "; ".join(parts)
            + "."
        )
    # sqrt(pi / 2): standard error of a median over that of a mean, Gaussian draws
    known = math.sqrt(math.pi / 2.0 / groups[0][-1].n_draws)
    return _paragraph(
        "The pattern that the paper sees is that Step 2 alone falls with the noise and the "
        f"strategy does not. {' '.join(sentences)} With this many draws the median of an "
        f"estimator on the bound would be known to about {known:.2g} bounds."
    )


def _intersample(result: AircraftNumbers) -> str:
    quiet = [condition for condition in result.conditions if not condition.ratio]
    if not quiet:
        return ""
    worst = [max(_relative_error(c.summary(j)) for c in quiet) for j in range(len(ESTIMATORS))]
    listed = ", ".join(f"{name} {error:.1e}" for name, error in zip(ESTIMATORS, worst, strict=True))
    return _paragraph(
        f"Without noise the largest relative error of a coefficient is: {listed}. Step 2 alone "
        "has to assume what the output does between its samples (here straight lines); the "
        "others filter only the input, which is known between the samples."
    )


def _relative_error(summary: EstimatorSummary) -> float:
    return float(np.max(np.abs(summary.median / np.array(TRUTH) - 1.0)))


def _is_papers(condition: Condition) -> bool:
    """Whether the record is the one that the paper's table is for, as far as can be told."""
    return condition.n_samples == PAPERS_SAMPLES


def _noisy(group: Sequence[Condition]) -> list[Condition]:
    return sorted((c for c in group if c.ratio), key=lambda condition: condition.ratio)


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


def _percent(share: float) -> str:
    """A share with as many digits as it has meaning.

    Examples
    --------
    >>> _percent(0.5), _percent(0.0123), _percent(1e-5)
    ('50 %', '1.2 %', '0.001 %')
    """
    return f"{100 * share:.2g} %" if share < 0.1 else f"{100 * share:.0f} %"


def _paragraph(text: str) -> str:
    return textwrap.fill(text, WIDTH, break_long_words=False, break_on_hyphens=False)
