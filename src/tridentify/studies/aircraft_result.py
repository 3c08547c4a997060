"""The result of the study of the paper's aircraft: its numbers, and the text about them.

What the study of the paper's aircraft found, as numbers; `studies.aircraft` is the study.

The study of the paper's aircraft in tables.
"""

from __future__ import annotations

import math
import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from tridentify.estimation.answer.trace import Status
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record
from tridentify.studies.declared.draw import Row, drawn, generator, prepare
from tridentify.studies.declared.methods import PAPER
from tridentify.studies.declared.nouns import StudyCell, cells
from tridentify.studies.declared.result import DeclaredResult, grouped

COEFFICIENTS = ("a1", "a0", "b0")
"""In the order of ``theta``; ``b0`` is the paper's b."""
UNITS = ("1/s", "1/s^2", "1/s^2")
TRUTH = (1.0, 3.0, 0.5)
"""``a1``, ``a0`` and ``b0`` of the paper's aircraft."""
ESTIMATORS = ("Step 2 alone", "Steps 1-4", "ThreeModel()")
RATIOS = (0.0, 0.5, 1.0, 2.0, 3.0)
"""Noise over signal in the paper's table."""
_OF_STEP_2 = (
    (1.0, 1.01, 0.71, 0.16, 0.02),
    (3.0, 3.15, 2.69, 1.56, 1.39),
    (0.5, 0.517, 0.6, 0.49, 0.53),
)
_OF_ALL_STEPS = (
    (1.0, 1.1, 1.14, 0.96, 0.95),
    (3.0, 3.1, 3.15, 2.82, 3.22),
    (0.5, 0.516, 0.52, 0.48, 0.58),
)
PRINTED: Mapping[str, Mapping[float, tuple[float, float, float]]] = MappingProxyType(
    {
        name: MappingProxyType(dict(zip(RATIOS, zip(*rows, strict=True), strict=True)))
        for name, rows in zip(ESTIMATORS, (_OF_STEP_2, _OF_ALL_STEPS), strict=False)
    }
)
"""The paper's table: estimator -> noise/signal -> coefficients in our order."""
FAILED, FLAGGED = "failed", "flagged"
FAR = 5.0
"""An outlier is farther from the truth than so many standard deviations of the bound."""


@dataclass(frozen=True)
class Event:
    """A draw on which an estimator failed, or which it flagged: ``reason`` says why."""

    estimator: str
    draw: int
    kind: str
    reason: str


@dataclass(frozen=True, eq=False)
class EstimatorSummary:
    """One estimator at one condition.

    ``median``, ``low``, ``high`` (16 and 84 % quantiles) and ``rmse`` are (3,) arrays over the
    draws that gave numbers. ``failed`` counts draws without numbers, ``unstable`` those whose
    model is not stable, ``outliers`` those with a coefficient farther than `FAR` bounds from the
    truth, and ``flagged`` those which the method itself did not call converged.
    """

    estimator: str
    median: Array
    low: Array
    high: Array
    rmse: Array
    failed: int
    unstable: int
    outliers: int
    flagged: int


@dataclass(frozen=True, eq=False)
class Condition:
    """One record length at one noise level.

    Parameters
    ----------
    example : Record
        The record of draw 0.
    ratio : float
        Noise standard deviation over the root mean square of the noise-free output.
    noise_std : float
        In units of the output.
    bound : (3,) array
        Standard deviations of the Cramer-Rao bound; zero without noise.
    theta : (n_estimators, n_draws, 3) array
        Estimates; ``nan`` where an estimator failed.
    events : tuple of Event
        Failures, and what the methods flagged, in the order of the draws.
    """

    example: Record
    ratio: float
    noise_std: float
    bound: Array
    theta: Array
    events: tuple[Event, ...]

    @property
    def n_samples(self) -> int:
        """Of every record."""
        return self.example.n_samples

    @property
    def dt(self) -> float:
        """Step [s]."""
        assert self.example.dt is not None
        return self.example.dt

    @property
    def n_draws(self) -> int:
        """Records at this condition."""
        return int(self.theta.shape[1])

    def summary(self, estimator: int) -> EstimatorSummary:
        """Summarise one estimator.

        Parameters
        ----------
        estimator : int
            Place in `ESTIMATORS`.

        Returns
        -------
        EstimatorSummary
        """
        name, every = ESTIMATORS[estimator], self.theta[estimator]
        found = every[np.all(np.isfinite(every), axis=1)]
        truth = np.array(TRUTH)
        rows = found if found.size else np.full((1, truth.size), np.nan)
        low, median, high = np.quantile(rows, [0.16, 0.5, 0.84], axis=0)
        far = np.abs(found - truth) > FAR * self.bound
        return EstimatorSummary(
            name,
            median,
            low,
            high,
            np.sqrt(np.mean((rows - truth) ** 2, axis=0)),
            failed=len(every) - len(found),
            unstable=int(np.count_nonzero(np.any(found[:, :2] <= 0, axis=1))),
            outliers=int(np.count_nonzero(np.any(far, axis=1))) if self.ratio else 0,
            flagged=sum(event.estimator == name and event.kind == FLAGGED for event in self.events),
        )

    def summaries(self) -> tuple[EstimatorSummary, ...]:
        """One for each estimator."""
        return tuple(self.summary(j) for j in range(len(ESTIMATORS)))


@dataclass(frozen=True, eq=False)
class AircraftResult:
    """All numbers of the study of the paper's aircraft.

    Parameters
    ----------
    seed, draws : int
        As asked for.
    gamma : float
        Of the paper's operators [rad/s].
    passes : int
        Most repetitions of the paper's Steps 2 to 4.
    conditions : tuple of Condition
        Record length by record length, and there ratio by ratio.
    """

    seed: int
    draws: int
    gamma: float
    passes: int
    conditions: tuple[Condition, ...]

    @classmethod
    def of(cls, found: DeclaredResult) -> AircraftResult:
        """What a declared study of the paper's aircraft, by its three estimators, has found.

        Parameters
        ----------
        found : DeclaredResult

        Returns
        -------
        AircraftResult
        """
        study, rows = found.study, grouped(found.rows)
        paper = dict(next(one.options for one in study.methods if one.kind == PAPER))
        conditions = tuple(_condition(cell, study.seed, rows) for cell in cells(study))
        return cls(study.seed, study.draws, paper["gamma"], paper["passes"], conditions)

    def by_length(self) -> tuple[tuple[Condition, ...], ...]:
        """Group the conditions by the record length, in their order."""
        groups: dict[tuple[int, float], list[Condition]] = {}
        for condition in self.conditions:
            groups.setdefault((condition.n_samples, condition.dt), []).append(condition)
        return tuple(tuple(group) for group in groups.values())

    def table(self) -> str:
        """Text: the tables, the failures, and what the paper's numbers can mean.

        Returns
        -------
        str
            Plain ASCII, at most 78 columns wide.
        """
        return write_text(self)

    def to_dict(self) -> dict[str, Any]:
        """Numbers for machines.

        Returns
        -------
        dict
            ``conditions`` is a list with one entry for each record length and ratio, and there
            ``estimators`` a list; a number that does not exist is None.
        """
        return {
            "schema": 1,
            "study": "aircraft",
            "seed": self.seed,
            "draws": self.draws,
            "gamma": self.gamma,
            "passes": self.passes,
            "coefficients": list(COEFFICIENTS),
            "units": list(UNITS),
            "truth": list(TRUTH),
            "conditions": [_condition_dict(condition) for condition in self.conditions],
        }


def _condition(
    cell: StudyCell, seed: int, rows: Mapping[tuple[str, str], Sequence[Row]]
) -> Condition:
    """One cell of the study with all that its draws gave, draw by draw."""
    prepared = prepare(cell)
    example = prepared.record(drawn(cell.noise, generator(cell, seed, 0), prepared.u.size))
    every = [rows.get((cell.name, name), ()) for name in ESTIMATORS]
    theta = [[row["theta"] or [math.nan] * len(TRUTH) for row in own] for own in every]
    events = tuple(
        Event(row["method"], row["draw"], FAILED if row["theta"] is None else FLAGGED, _why(row))
        for at_once in zip(*every, strict=True)
        for row in at_once
        if row["theta"] is None or row["status"] != Status.CONVERGED.name
    )
    ratio, std, bound = cell.noise.level, prepared.std, prepared.bound
    return Condition(example, ratio, std, bound, np.array(theta, dtype=np.float64), events)


def _why(row: Row) -> str:
    return str(row["failure"] or Status[row["status"]].value)


def _condition_dict(condition: Condition) -> dict[str, Any]:
    return {
        "n_samples": condition.n_samples,
        "dt": condition.dt,
        "ratio": condition.ratio,
        "noise_std": condition.noise_std,
        "draws": condition.n_draws,
        "cramer_rao_std": condition.bound.tolist(),
        "estimators": [
            {
                "name": summary.estimator,
                "median": _numbers(summary.median),
                "quantile_16": _numbers(summary.low),
                "quantile_84": _numbers(summary.high),
                "rmse": _numbers(summary.rmse),
                "failed": summary.failed,
                "unstable": summary.unstable,
                "outliers": summary.outliers,
                "flagged": summary.flagged,
                "printed": _printed(summary.estimator, condition.ratio),
            }
            for summary in condition.summaries()
        ],
        "events": [asdict(event) for event in condition.events],
    }


def _numbers(values: Array) -> list[float | None]:
    return [value if math.isfinite(value) else None for value in values.tolist()]


def _printed(estimator: str, ratio: float) -> list[float] | None:
    printed = PRINTED.get(estimator, {}).get(ratio)
    return None if printed is None else list(printed)


WIDTH = 78
PAPERS_SAMPLES = 100
"""Of the record that the paper's table is for, as far as can be told."""
MEANING = "What these numbers can mean: 'The paper's aircraft' in the documentation."


def write_text(result: AircraftResult) -> str:
    """Lay out a result.

    Parameters
    ----------
    result : AircraftResult

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
def _head(result: AircraftResult) -> str:
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


def _estimators(result: AircraftResult) -> str:
    return _paragraph(
        "Step 2 alone: the series-parallel model on the recorded output. Steps 1-4: the paper "
        f"literally, three operators, gamma {result.gamma:.3g} rad/s, at most {result.passes} "
        "passes. ThreeModel(): the strategy made efficient. All know that the record starts at "
        "rest and has no offset."
    )


def _reasons(result: AircraftResult) -> str:
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
