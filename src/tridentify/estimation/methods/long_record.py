"""The output error of a record that is longer than memory: a reading of it for every step.

Step 4 needs of the samples only the triangle on the bank of each denominator, and that is added up
part by part (`models.chunked`). All else is what is done in memory: the choices of nuisance terms
and their AICc, steps to the stationary point, its curvature. So this begins from poles that a
stretch of the record gave, and from those of the record averaged over blocks; the better of the two
over all samples is followed. At the end steps are taken as they are, while each promises less than
the one before: over so many samples differences of the cost itself drown in its rounding.

A reading holds every choice of nuisance terms (`setup.nuisance`), so the choice costs none of
its own.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from tridentify.errors import DelayError, IdentifiabilityError, TooFewSamplesError
from tridentify.estimation.answer.assemble import Request, assemble
from tridentify.estimation.answer.estimate import Estimate, Status, Trace
from tridentify.estimation.likelihood.answer import Ending, solved_at
from tridentify.estimation.likelihood.choose_nuisance import Finished, decisions_in_words
from tridentify.estimation.likelihood.cost import Point, bank_of, evaluate_variant
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import (
    Patience,
    Recorder,
    criterion,
    finish,
)
from tridentify.estimation.likelihood.question import Say
from tridentify.estimation.likelihood.setup.linear_columns import linear_blocks
from tridentify.estimation.likelihood.setup.nuisance import (
    SLACK,
    Nuisances,
    open_choices,
    reference_of,
)
from tridentify.estimation.likelihood.setup.problem import Problem, Variant
from tridentify.estimation.likelihood.thresholds import TRUSTED
from tridentify.models.chunked import ChunkedExperiment, Parts
from tridentify.models.regression import Regression, regress
from tridentify.models.response import ColumnBlocks
from tridentify.numerics.arrays import Array, Complex
from tridentify.record.long_record import LongRecord
from tridentify.record.long_survey import Survey
from tridentify.record.record import Record
from tridentify.structure import Structure

EXPECTED = 9
"""Readings that an estimate takes, as a rule: two to survey, one for each of two starts, five for
the steps. Only the time that remains is told by it."""

PAUSE = 1.0
"""Time between two words about a reading [s]."""

MOST_SINGLE = 4
"""Steps at the end that are taken as they are: each squares what the one before left."""

EXACT = 1e-13
"""Fall of ``-2 log L`` that a step promises when the end is exact: 3e-7 standard errors."""


@dataclass(eq=False)
class Readings:
    """The record as a supply of parts that tells how far it is and what time remains.

    Attributes
    ----------
    record : LongRecord
    say : callable
    done : int
        Readings so far.
    """

    record: LongRecord
    say: Say
    done: int = 0
    _last: float = field(default_factory=time.monotonic)
    _spent: float = 0.0
    _told: float = 0.0

    def parts(self) -> Parts:
        """One reading of inputs and outputs."""
        self._last = time.monotonic()
        yield from self.record.parts(self.told)
        self.done += 1

    def told(self, samples: int) -> None:
        """Say how far this reading is, at most once a `PAUSE`."""
        now = time.monotonic()
        self._spent += now - self._last
        self._last = now
        if now - self._told < PAUSE:
            return
        self._told = now
        share = samples / self.record.n_samples
        whole = self.done + share
        left = self._spent / whole * max(EXPECTED - whole, 1.0 - share)
        self.say(
            f"reading {self.done + 1} of the record ({self.record.n_samples:,} samples): "
            f"{100 * share:.0f} %, about {in_words(left)} left"
        )


def in_words(seconds: float) -> str:
    """A time that remains, roughly.

    Examples
    --------
    >>> in_words(4.2), in_words(200.0), in_words(9000.0)
    ('5 s', '4 min', '2.5 h')
    """
    if seconds < 90.0:
        return f"{int(seconds) + 1} s"
    return f"{int(seconds / 60.0) + 1} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


@dataclass(frozen=True, eq=False)
class LongQuestion:
    """What is asked of a long record, resolved: as `likelihood.question.Question`.

    Attributes
    ----------
    head : Record
        The first samples, with the behaviour of the inputs.
    structure : Structure
    choices : tuple of Nuisances
    base : Problem
        Holds every choice; its one experiment is read part by part.
    variants : tuple of Variant
    """

    head: Record
    structure: Structure
    choices: tuple[Nuisances, ...]
    base: Problem
    variants: tuple[Variant, ...]

    @classmethod
    def of(
        cls,
        record: LongRecord,
        survey: Survey,
        behaviour: str,
        structure: Structure,
        noise: tuple[Array, ...],
        supply: Readings,
    ) -> LongQuestion:
        """Resolve what the structure leaves open.

        Raises
        ------
        ConstantInputError, DelayError, TooFewSamplesError
            As `Question.of`.
        """
        head = record.head.settled(behaviour)
        at_zero = not np.any(survey.first)
        choices = tuple(open_choices(structure, head, survey.still, at_zero=at_zero))
        references = [reference_of(head, choice) for choice in choices]
        # counted from the first value wherever a choice does: that keeps the columns small
        shift = next((one for one in references if np.any(one)), np.zeros(survey.first.size))
        delays = np.array(structure.delay_matrix(survey.power.size, survey.first.size))
        start = _first_explained(record, structure, float(delays.max()))
        experiment = ChunkedExperiment(
            np.ascontiguousarray(head.u[:2] - shift),
            np.array(head.y[:2]),
            record.dt,
            behaviour,
            free=any(one.initial_state in ("free", "equilibrium") for one in choices),
            offset=any(one.offset for one in choices),
            drift=max(one.drift for one in choices),
            noise=noise,
            delays=delays if np.any(delays) else None,
            start=start,
            samples=record.n_samples,
            supply=supply,
            shift=shift,
            gappy=tuple((survey.missing > 0).tolist()),
        )
        zeros = structure.zeros_matrix(survey.power.size, survey.first.size)
        power = _power(record, survey, start)
        base = Problem.scaled([experiment], structure.poles, zeros, power, survey.size)
        seen = int((record.n_samples - survey.missing).min()) - start
        unknowns = base.n_coefficients + base.n_nuisance
        if seen < unknowns + 3:
            raise TooFewSamplesError(
                f"found {seen} output samples for {unknowns} unknowns; expected at least "
                f"{unknowns + 3}; record longer or lower the orders"
            )
        variants = tuple(
            Variant(
                choice.initial_state == "free",
                choice.offset,
                choice.drift,
                (shift - reference if np.any(shift != reference) else None,),
            )
            for choice, reference in zip(choices, references, strict=True)
        )
        return cls(head, structure, choices, base, variants)


def _power(record: LongRecord, survey: Survey, start: int) -> Array:
    """Mean squares of the outputs about their means, without the samples before ``start``."""
    if not start:
        return survey.power
    moved = record.outputs(0, start) - survey.mean
    seen = (record.n_samples - survey.missing).astype(np.float64)
    left = np.maximum(seen - np.isfinite(moved).sum(axis=0), 1.0)
    spread = seen * survey.power - np.nansum(moved**2, axis=0)
    return np.asarray(np.maximum(spread - np.nansum(moved, axis=0) ** 2 / left, 0.0) / left)


def _first_explained(record: LongRecord, structure: Structure, longest: float) -> int:
    """As `nuisance.first_explained`, on uniform time."""
    if longest and longest >= (1.0 - SLACK) * record.duration:
        raise DelayError(
            f"found a delay of {longest:.6g} s and a record of {record.duration:.6g} s; expected a "
            "delay shorter than the record, which shows nothing of a later response; correct the "
            "delay or its unit, or record longer"
        )
    if structure.initial_state not in ("free", "auto"):
        return 0
    return max(int(np.ceil(longest / record.dt - SLACK)), 0)


def long_estimate(
    record: LongRecord,
    survey: Survey,
    began: Estimate,
    seeds: Sequence[Complex],
    patience: Patience,
    readings: Readings,
) -> Estimate:
    """The estimate over all samples, from poles that parts of them gave.

    Parameters
    ----------
    record : LongRecord
    survey : Survey
    began : Estimate
        That of a stretch: structure, behaviour of the inputs, and model of the noise.
    seeds : sequence of (n,) complex arrays
        Poles to begin from.
    patience : Patience
    readings : Readings

    Raises
    ------
    IdentifiabilityError
        The record does not determine the coefficients.
    """
    structure = began.structure
    noise = began.noise_model if any(a.size for a in began.noise_model) else ()
    question = LongQuestion.of(record, survey, began.intersample, structure, noise, readings)
    best, decisions = _decided(question, seeds, patience)
    end = _to_the_end(question, best)
    told = (*decisions, *_told(noise))
    trace = Trace(tuple(end.recorder.passes), (), told, end.why)
    ending = Ending(end.point, end.nuisances, end.status, end.criterion, trace)
    rss = _plain_rss(question, end) if noise else None
    solved = solved_at(ending, [question.head], structure, judged=False, rss=rss)
    asked = Request(
        (question.head,), structure, began.method, record.n_samples, record.dt, survey.fingerprint
    )
    return assemble(asked, solved)


def _told(noise: tuple[Array, ...]) -> tuple[str, ...]:
    if not noise:
        return ()
    orders = ", ".join(str(a.size) for a in noise)
    return (f"noise taken for an autoregression of order {orders}, found on the stretch",)


def _admissible(question: LongQuestion, seeds: Sequence[Complex]) -> list[Complex]:
    return [question.base.admissible(np.asarray(one, dtype=np.complex128))[0] for one in seeds]


def _points(question: LongQuestion, poles: Complex) -> list[Point]:
    """Every choice at the same poles: one reading, or none where it was made."""
    return [evaluate_variant(question.base, one, poles) for one in question.variants]


def _promise(point: Point) -> float:
    """AICc that one more step promises."""
    most = TRUSTED * float(point.counts.sum())
    return criterion(point, min(point.step(0.0).decrease, most))


def _decided(
    question: LongQuestion, seeds: Sequence[Complex], patience: Patience
) -> tuple[Finished, tuple[str, ...]]:
    """The choice of lowest AICc on its stationary point, and what was decided."""
    found = [_points(question, poles) for poles in _admissible(question, seeds)]
    points = min(found, key=lambda one: min(point.objective for point in one))
    done: dict[int, Finished] = {}
    while True:
        table = [
            done[k].criterion if k in done else _promise(point) for k, point in enumerate(points)
        ]
        k = int(np.argmin(table))
        if k in done:
            best = done[k]
            return best, decisions_in_words(question.choices, best, table)
        recorder = Recorder()
        at = partial(evaluate_variant, question.base, question.variants[k])
        settled = patience.settled(points[k].counts.sum())
        point, status, why = finish(at, points[k], recorder, patience.most, settled)
        choice = question.choices[k]
        done[k] = Finished(choice, point, status, why, criterion(point), recorder)
        points = _points(question, point.poles)


def _to_the_end(question: LongQuestion, best: Finished) -> Finished:
    """Steps as they are, while each promises less than the one before."""
    if best.status is not Status.CONVERGED:
        return best
    variant = question.variants[question.choices.index(best.nuisances)]
    point = best.point
    for _ in range(MOST_SINGLE):
        step = point.step(0.0)
        if step.decrease < EXACT:
            break
        poles, note = question.base.admissible(step.poles)
        other = evaluate_variant(question.base, variant, poles)
        if note or not other.step(0.0).decrease < step.decrease:
            break
        point = other
    return replace(best, point=point, criterion=criterion(point))


def _plain_rss(question: LongQuestion, end: Finished) -> Array:
    """(n_outputs,) sums of squares of the residual as it is, not whitened: one more reading."""
    point, variant = end.point, question.variants[question.choices.index(end.nuisances)]
    base = question.base.whitened(())
    bank = bank_of(base, point.poles, 2).cascade
    whole: tuple[Regression, ...] = tuple(regress(e, bank) for e in base.experiments)
    (regression,) = variant.regressions(whole, bank)
    found = []
    for i, fit in enumerate(point.fits):
        columns = ColumnBlocks()
        blocks = linear_blocks(point.problem, point.branches, regression, 0, i)
        columns.add(blocks, regression.targets[i])
        matrix, target = columns.assemble()
        residual = target - matrix @ fit.solution.x
        found.append(float(residual @ residual))
    return np.array(found)


def poles_of_seed(estimate: Estimate) -> Complex:
    """The poles of an estimate, group by group, as a place to begin from.

    Raises
    ------
    IdentifiabilityError
        Its poles are not all finite.
    """
    model, structure = estimate.model, estimate.structure
    rows = model.den if not structure.shared else [[model.den[0][0]]]
    found = np.concatenate([np.roots(one) for row in rows for one in row])
    if not np.all(np.isfinite(found)):
        raise IdentifiabilityError(
            "found poles that are not finite on a stretch of the record; expected a model that it "
            "determines; lower the orders"
        )
    return np.asarray(found, dtype=np.complex128)
