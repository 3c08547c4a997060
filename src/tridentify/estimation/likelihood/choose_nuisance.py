"""Which nuisance terms a record needs: every serious choice is finished, and AICc decides.

At given poles one pass over the samples serves all choices (`likelihood.setup.nuisance`), and a
Gauss-Newton step predicts how far each would still fall. The most promising is finished on the
output error; then the next one, as long as its prediction is below the lowest AICc reached.
Predictions that turn out wrong are made anew at the poles just found. So the choice that is
reported has the lowest AICc of all that were finished, and none that was not finished promised
a lower one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from types import MappingProxyType

import numpy as np

from tridentify.estimation.answer.estimate import Status
from tridentify.estimation.likelihood.cost import (
    Point,
    bank_of,
    evaluate,
    evaluate_variant,
    point_at,
)
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import (
    Recorder,
    at_rounding,
    criterion,
    finishing,
)
from tridentify.estimation.likelihood.question import Question
from tridentify.estimation.likelihood.setup.nuisance import Nuisances
from tridentify.estimation.likelihood.setup.problem import Problem, Variant
from tridentify.estimation.likelihood.setup.triangles import Triangles
from tridentify.estimation.likelihood.thresholds import EQUAL, TRUSTED
from tridentify.models.regression import Regression, regress
from tridentify.numerics.arrays import Complex
from tridentify.numerics.slices import Slices, drain

SHORT = 2_000
"""Samples up to which machine code filters them again for each choice: that takes less time than to
take a choice's triangle from one of all."""


@dataclass(frozen=True, eq=False)
class Finished:
    """One choice of nuisance terms on its stationary point.

    Attributes
    ----------
    nuisances : Nuisances
    point : Point
    status : Status
    why : str
        How it ended.
    criterion : float
        AICc.
    recorder : Recorder
        Its passes.
    """

    nuisances: Nuisances
    point: Point
    status: Status
    why: str
    criterion: float
    recorder: Recorder


@dataclass(frozen=True, eq=False)
class Decided:
    """The choice of lowest AICc.

    Attributes
    ----------
    best : Finished
    decisions : tuple of str
        What was decided and why; empty where there was nothing to decide.
    seed : int
        Position of the seed that was followed.
    """

    best: Finished
    decisions: tuple[str, ...]
    seed: int


@dataclass(frozen=True, eq=False)
class Predicted:
    """One choice at given poles, and the AICc it promises."""

    point: Point
    criterion: float


def decide(
    question: Question,
    seeds: Sequence[Complex],
    known: Mapping[bytes, tuple[Regression, ...]] = MappingProxyType({}),
    reached: Point | None = None,
) -> Decided:
    """Finish what is worth finishing and choose.

    Parameters
    ----------
    question : Question
    seeds : sequence of (n,) complex arrays
        Poles to begin with.
    known : mapping
        Triangles of the question's base that exist already, by the bytes of the seed.
    reached : Point, optional
        The fit of the only choice at the only seed.
    """
    return drain(deciding(question, seeds, known, reached))


def deciding(
    question: Question,
    seeds: Sequence[Complex],
    known: Mapping[bytes, tuple[Regression, ...]] = MappingProxyType({}),
    reached: Point | None = None,
) -> Slices[Decided]:
    """`decide` in slices."""
    base, variants, choices = question.base, question.variants, question.choices
    if reached is None:
        promised, seed = yield from _predict(base, variants, seeds, known)
    else:
        promised, seed = [Predicted(reached, criterion(reached))], 0
    done: dict[int, Finished] = {}
    while len(done) < len(choices):
        k = min(
            (k for k in range(len(choices)) if k not in done), key=lambda k: promised[k].criterion
        )
        best = min(done.values(), key=lambda one: one.criterion, default=None)
        if best is not None and best.criterion <= promised[k].criterion:
            break
        question.say(f"output error ({choices[k].label})")
        yield
        problem = question.chosen(choices[k])
        at: Callable[..., Point] = partial(evaluate, problem)
        same = _same_input(problem, base, variants[k])
        # the variant holds the inputs of the base: what is simulated later needs its own
        point = promised[k].point
        start = point.carried_to(problem) if same else at(point.poles)
        light = same and base.limits is None and _is_short(base)
        if light:
            at = partial(evaluate_variant, base, variants[k])
        patience, recorder = question.patience, Recorder()
        settled = patience.settled(start.samples)
        steps = finishing(at, start, recorder, patience.most, settled)
        point, status, why = yield from steps
        point = point.carried_to(problem) if light else point
        done[k] = Finished(choices[k], point, status, why, criterion(point), recorder)
        surprised = abs(done[k].criterion - promised[k].criterion) > EQUAL
        if len(done) < len(choices) and (surprised or at_rounding(point)):
            promised, _ = yield from _predict(base, variants, [point.poles], known)
    best = min(done.values(), key=lambda one: one.criterion)
    table = [done[k].criterion if k in done else promised[k].criterion for k in range(len(choices))]
    return Decided(best, decisions_in_words(choices, best, table), seed)


def _predict(
    base: Problem,
    variants: Sequence[Variant],
    seeds: Sequence[Complex],
    known: Mapping[bytes, tuple[Regression, ...]],
) -> Slices[tuple[list[Predicted], int]]:
    """Every choice one Gauss-Newton step ahead of the best seed; and which seed that is."""
    found = []
    for poles in seeds:
        at, own = _at(base, poles, known), list[Point]()
        for v in variants:
            yield
            own.append(at(v))
        found.append(own)
    lowest = [min(point.objective for point in points) for points in found]
    seed = lowest.index(min(lowest))
    points = found[seed]
    if len(points) == 1:  # nothing is compared with it
        return [Predicted(points[0], criterion(points[0]))], seed
    exact = any(at_rounding(point) for point in points)
    trusted = np.inf if exact else TRUSTED * points[0].samples
    promised = []
    for point in points:
        yield
        promised.append(Predicted(point, criterion(point, min(point.decrease(), trusted))))
    return promised, seed


def _at(
    base: Problem, poles: Complex, known: Mapping[bytes, tuple[Regression, ...]]
) -> Callable[[Variant], Point]:
    """The fit of each choice at some poles."""
    bank, light = bank_of(base, poles, 2), _is_short(base)

    @cache
    def whole() -> tuple[Regression, ...]:
        found = known.get(poles.tobytes())
        return found or tuple(regress(e, bank.cascade) for e in base.experiments)

    def at(variant: Variant) -> Point:
        if light and not any(constant is not None for constant in variant.constants):
            return evaluate_variant(base, variant, poles)
        return point_at(variant.problem(base), Triangles.of(whole(), bank, variant))

    return at


def _is_short(base: Problem) -> bool:
    return base.flat is not None and sum(e.n_samples for e in base.experiments) <= SHORT


def _same_input(problem: Problem, base: Problem, variant: Variant) -> bool:
    """Whether the variant's points are the problem's: both count the input from one value."""
    for own, whole, constants in zip(
        problem.experiments, base.experiments, variant.constants, strict=True
    ):
        shift = np.zeros(own.u.shape[1]) if constants is None else constants
        if not np.array_equal(own.u[0], whole.u[0] + shift):
            return False
    return True


def decisions_in_words(
    choices: Sequence[Nuisances], best: Finished, table: Sequence[float]
) -> tuple[str, ...]:
    """What was decided between choices, and by how much; empty where there was but one.

    Parameters
    ----------
    choices : sequence of Nuisances
    best : Finished
    table : sequence of float
        AICc of each choice, reached or promised.
    """
    if len(choices) == 1:
        return ()
    others = sorted(
        (k for k in range(len(choices)) if choices[k] is not best.nuisances), key=lambda k: table[k]
    )
    listed = "; ".join(f"{choices[k].label} {table[k] - best.criterion:+.1f}" for k in others)
    return (best.nuisances.told(f"lowest AICc ({listed})"),)
