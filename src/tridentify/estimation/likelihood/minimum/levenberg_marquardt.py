"""Levenberg-Marquardt on the reduced output-error cost, to a stationary point.

The step is measured in the likelihood: it is small when the predicted decrease of ``-2 log L``
is, that is when the coefficients move by far less than their standard errors.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tridentify.estimation.answer.estimate import Pass, Status, Step
from tridentify.estimation.likelihood.cost import Point
from tridentify.estimation.likelihood.fitted_point import ROUNDING_SQUARED
from tridentify.estimation.likelihood.held_poles import at_slow_limit
from tridentify.estimation.likelihood.minimum.bend import bend_of
from tridentify.estimation.likelihood.minimum.descent import Descent, Taken
from tridentify.estimation.likelihood.setup.problem import REFLECTED, TOO_FAST, TOO_SLOW, Problem
from tridentify.estimation.likelihood.thresholds import (
    IDLE,
    NEARLY_SETTLED,
    SENSELESS,
    SETTLED,
    SETTLED_LONG,
)
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.slices import Slices, drain

LONG = 50_000
"""Samples from which a step is settled by `thresholds.SETTLED_LONG`: a pass over them takes longer
than all else a step does."""
BESIDE = 0.01
"""Samples to either side of a delay at which the cost itself is looked at."""
TURNS = 3
"""Times that poles and delays are finished in turn where they cannot be together."""
MOST_STEPS = 60
"""Most steps tried, by default; no record of the sensitivity benchmark takes more than half of
them."""


@dataclass(frozen=True)
class Patience:
    """How long steps go on.

    Attributes
    ----------
    most : int
        Most steps tried.
    tolerance : float
        Fall of ``-2 log L`` below which the next step is not worth while.
    """

    most: int = MOST_STEPS
    tolerance: float = SETTLED

    def settled(self, samples: float) -> float:
        """The tolerance for so many samples: on a long record it is not below `SETTLED_LONG`."""
        return self.tolerance if samples < LONG else max(self.tolerance, SETTLED_LONG)


class Recorder:
    """Collects the passes; they are worked out when they are asked for, as few are ever told.

    Parameters
    ----------
    passes : sequence of Pass
        Those before.
    """

    def __init__(self, passes: Sequence[Pass] = ()) -> None:
        self._made = list(passes)
        self._awaited: list[Callable[[int], Pass]] = []

    @property
    def passes(self) -> list[Pass]:
        """All of them, numbered from 1."""
        awaited, self._awaited = self._awaited, []
        for make in awaited:
            self._made.append(make(len(self._made) + 1))
        return self._made

    def add(
        self, point: Point, steps: Callable[[], tuple[Step, ...]], beta_distance: float, note: str
    ) -> None:
        """Add one pass."""

        def made(number: int) -> Pass:
            theta, square = coefficients(point), mean_square(point)
            return Pass(number, steps(), theta, square, beta_distance, point.gradient, note)

        self.later(made)

    def later(self, made: Callable[[int], Pass]) -> None:
        """Add one pass that is worked out, of its number, when it is asked for."""
        self._awaited.append(made)

    def follow(self, taken: Sequence[Taken], end: Point) -> None:
        """Add the steps of machine code that led to a point."""
        self._awaited += [partial(_pass_of, one, end.problem, end.counts) for one in taken]

    def extend(self, other: Recorder) -> None:
        """Append another's passes, numbered on."""
        known = [lambda number, one=one: replace(one, number=number) for one in other._made]
        self._awaited += known + other._awaited


def _pass_of(one: Taken, problem: Problem, counts: Array, number: int) -> Pass:
    lower, cost = one.theta[problem.denominator_places()], float(one.rss.sum() / counts.sum())
    note = f"damping {one.damping:.1e}" if one.damping else ""
    step = Step("output error", lower, cost, one.condition, note)
    square = _mean_square(one.rss, counts)
    return Pass(number, (step,), one.theta, square, np.nan, one.gradient, one.note)


def coefficients(point: Point) -> Array:
    """Physical coefficients in the order of `Structure.names`."""
    from tridentify.models.compiled_steps import coefficients_of

    problem, bank, response = point.problem, point.triangles.bank, point.response
    rows, direct = np.ascontiguousarray(response.rows), np.ascontiguousarray(response.direct)
    found = coefficients_of(bank.poles, rows, direct, *problem.pattern, bank.repeats)
    return np.append(found, problem.delays) if problem.n_delays else found


def mean_square(point: Point) -> float:
    """Residual mean square; the geometric mean over several outputs."""
    return _mean_square(point.rss, point.counts)


def _mean_square(rss: Array, counts: Array) -> float:
    # one by one: they are few
    sizes, total = counts.tolist(), 0.0
    for one, n in zip(rss.tolist(), sizes, strict=True):
        if one == 0.0:
            return 0.0
        total += n * math.log(one / n)
    return math.exp(total / sum(sizes))


def criterion(point: Point, decrease: float = 0.0) -> float:
    """AICc, with residuals below rounding counted as equal.

    Parameters
    ----------
    point : Point
    decrease : float
        Expected fall of ``-2 log L`` by a further step.
    """
    return point.aicc_after(decrease) if decrease else point.aicc


def at_rounding(point: Point) -> bool:
    """Whether the residual is no more than rounding: a noise-free record."""
    return all(point.exact)


def _gain(point: Point, trial: Point) -> float:
    """Fall of `Point.objective`; outputs at rounding count only when all are."""
    pairs = zip(point.exact, trial.exact, strict=True)
    exact = np.array([one and other for one, other in pairs])
    if exact.all() or not exact.any():
        return point.objective - trial.objective
    before, after = np.log(point.variance[~exact]), np.log(trial.variance[~exact])
    return float(point.counts[~exact] @ (before - after))


def finish(
    at: Callable[..., Point],
    point: Point,
    recorder: Recorder | None,
    most: int = MOST_STEPS,
    settled: float | None = None,
) -> tuple[Point, Status, str]:
    """Levenberg-Marquardt on the reduced output-error cost.

    Parameters
    ----------
    at : callable
        Evaluates the cost at admissible poles, and at ``delays`` where they are estimated along.
    point : Point
        Where to begin.
    recorder : Recorder, optional
        Is told every step that is taken.
    most : int
        Most steps tried.
    settled : float, optional
        Fall of ``-2 log L`` below which a further step is not worth while (default: by the number
        of samples).

    Returns
    -------
    point : Point
    status : Status
        Any but `Status.WEAKLY_IDENTIFIABLE`.
    why : str
        In words.
    """
    return drain(finishing(at, point, recorder, most, settled))


def finishing(
    at: Callable[..., Point],
    point: Point,
    recorder: Recorder | None,
    most: int = MOST_STEPS,
    settled: float | None = None,
) -> Slices[tuple[Point, Status, str]]:
    """`finish` in slices, one a step."""
    problem = point.problem
    if settled is None:
        settled = Patience().settled(point.samples)
    exact, now = 0, Descent(at, settled)
    while now.tried < most:
        point, taken = yield from now.running(point, most, ROUNDING_SQUARED)
        if recorder is not None:
            recorder.follow(taken, point)
        if now.is_over or now.tried >= most:
            break
        left = point.decrease()
        if left < settled:
            why = f"the next step would lower -2 log L by {left:.0e}, less than {settled:.0e}"
            return point, status_at(point.held or now.held), why
        yield
        now.tried += 1
        proposed, predicted, delays, change = point.step(now.damping, now.turn())
        poles, note = problem.admissible(proposed)
        trial = at(poles) if delays is None else _late(at, poles, delays, problem)
        gain = _gain(point, trial)
        exact += at_rounding(trial)
        if exact and (gain < SENSELESS * point.samples or exact > 3):
            best = trial if gain > 0 else point
            return best, Status.CONVERGED, "the residual is down to rounding"
        if gain <= 0:
            now.bend = None
            now.damping = max(now.damping * now.growth, 1e-3)
            now.growth *= 2.0
            continue
        if recorder is not None:
            recorder.add(trial, partial(_error_step, trial, now.damping), np.nan, note)
        ratio = gain / predicted
        damping = now.damping * max(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3)
        # what was damped before a pole came to its limit says nothing of the directions left
        now.damping = 0.0 if damping < 1e-6 or trial.held != point.held else damping
        now.bend, bent = None, not note and delays is None
        now.awaited = partial(bend_of, point, change, trial) if bent else None
        point, now.held, now.is_open = trial, note, not exact
        now.growth = 2.0
        now.idle = now.idle + 1 if gain < IDLE else 0
    open_ = point.problem.pinned is None and point.problem.floors is None
    if point.problem.n_delays and open_ and point.problem.kinks().any():
        return _on_a_kink(at, point, recorder, most)
    left = point.decrease()
    held = point.held or now.held
    if held and held != REFLECTED:
        return point, status_at(held), held
    if left < NEARLY_SETTLED:
        return point, Status.CONVERGED, f"a further step would lower -2 log L by {left:.1e}"
    if now.is_over:
        if at_slow_limit(point.poles, problem.slowest).any():
            # rounding hides what is left of the slope where a pole is all but zero
            return point, Status.AT_STABILITY_LIMIT, TOO_SLOW
        lowest = _beside_a_zero(at, point, most) if point.problem.n_delays and open_ else None
        if lowest is not None and lowest.objective < point.objective + NEARLY_SETTLED:
            return lowest, Status.CONVERGED, "no delay and no pole lowers the cost from there"
        return point, Status.STALLED, "no further step lowers the cost"
    return point, Status.MAX_PASSES, f"{most} steps on the output error"


def _late(at: Callable[..., Point], poles: Complex, delays: Array, problem: Problem) -> Point:
    if problem.pinned is None:
        return at(poles, delays=delays)
    return at(poles, delays=delays, pinned=problem.pinned)


def _on_a_kink(
    at: Callable[..., Point], point: Point, recorder: Recorder | None, most: int
) -> tuple[Point, Status, str]:
    """The end where a delay cannot leave a whole number of steps: all else is finished there."""
    problem = point.problem
    kinks, dt = problem.kinks(), problem.experiments[0].dt
    delays = np.where(kinks, np.round(problem.delays / dt) * dt, problem.delays)
    there = at(point.poles, delays=delays, pinned=kinks)
    end, status, why = finish(at, there, recorder, most)
    if end.objective > point.objective + NEARLY_SETTLED:
        return point, Status.STALLED, "no further step lowers the cost"
    return end, status, f"{why}; a delay lies on a whole step, where the cost has a kink"


def _beside_a_zero(at: Callable[..., Point], point: Point, most: int) -> Point | None:
    """The minimum where the columns of a delay and of a zero are alike; None if there is none.

    ``(b1 p + b0) exp(-d p)`` is ``b0 exp(-(d - b1/b0) p)`` to first order in ``b1``, so that at
    ``b1 = 0`` the column of the delay is that of ``b1``. What is left of it beside that one,
    ``c``, vanishes there, but not what the linear model promises of it, ``(r'c)^2 / c'c``: no step
    keeps that promise. The cost is quadratic in the delay all the same, by its second derivatives,
    and where these are positive the minimum lies at ``b1 = 0``, which noise decides. So poles are
    finished with the delays held, and delays by the slope and the bend of the cost itself.
    """
    pinned = np.ones(point.problem.n_inputs, dtype=bool)
    sides = np.eye(pinned.size) * BESIDE * min(e.dt for e in point.problem.experiments)
    least = sides.sum(axis=0)
    if np.any(point.problem.delays < least):
        return None
    for _ in range(TURNS):
        delays = point.problem.delays
        held, status, _ = finish(at, at(point.poles, delays=delays, pinned=pinned), None, most)
        point, left = at(held.poles, delays=delays), 0.0
        for side in sides:
            later, earlier = (
                at(held.poles, delays=delays + by, pinned=pinned).objective for by in (side, -side)
            )
            slope, bend = (later - earlier) / 2.0, later + earlier - 2.0 * held.objective
            if status is not Status.CONVERGED or not bend > 0.0:
                return None
            left += slope**2 / (2.0 * bend)
            delays = delays - slope / bend * side
            if np.any(delays < least):
                return None
        if left < NEARLY_SETTLED:
            return point
        point = at(held.poles, delays=delays)
    return None


def status_at(held: str) -> Status:
    """The status of an end, by the note of what holds it there."""
    if not held or held == REFLECTED:
        return Status.CONVERGED
    return Status.AT_SAMPLING_LIMIT if held == TOO_FAST else Status.AT_STABILITY_LIMIT


def _error_step(point: Point, damping: float) -> tuple[Step]:
    lower = point.problem.lower_coefficients(point.poles)
    cost = float(point.rss.sum() / point.counts.sum())
    note = f"damping {damping:.1e}" if damping else ""
    return (Step("output error", lower, cost, point.condition, note),)
