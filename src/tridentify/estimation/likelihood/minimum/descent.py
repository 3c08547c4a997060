"""Steps on the cost that machine code takes (`compiled_descent`), as far as it goes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from tridentify.estimation.likelihood.charted import Given, given, limits_of
from tridentify.estimation.likelihood.cost import FAR, Point, evaluate, evaluate_variant
from tridentify.estimation.likelihood.fitted_point import FLOOR
from tridentify.estimation.likelihood.minimum.bend import LEAST_BEND, MOST_BEND
from tridentify.estimation.likelihood.setup.problem import REFLECTED, TOO_FAST
from tridentify.estimation.likelihood.step import Bend
from tridentify.estimation.likelihood.thresholds import IDLE
from tridentify.numerics.arrays import Array
from tridentify.numerics.kept import cached_property
from tridentify.numerics.realization import APART
from tridentify.numerics.slices import Slices

TOGETHER = 4_000
"""Samples that the steps of one call go through, all told: some milliseconds."""
MOST_DAMPED = 1e8
"""Damping of steps that are too short to tell anything."""
ONE_MORE = 0.1
"""Fall of ``-2 log L`` promised below which one step mostly is the last: Python takes it, as its
point is wanted anyway."""
NOTES = "", REFLECTED, TOO_FAST
"""What was done to the poles of a step."""


class Taken(NamedTuple):
    """A step that was taken, for the trace: coefficients, and what `Pass` tells."""

    theta: Array
    rss: Array
    condition: float
    gradient: float
    damping: float
    note: str


@dataclass(eq=False)
class Descent:
    """Where steps on the cost stand: what machine code and `levenberg_marquardt` hand each other.

    Attributes
    ----------
    at : callable
        Gives the cost; machine code knows it as a `partial` of `evaluate` or `evaluate_variant`.
    settled : float
        Fall of ``-2 log L`` below which a step is not worth while.
    damping, growth : float
        And what it grows by where a step fails.
    held : str
        What was done to the poles of the last step.
    idle, tried : int
        Steps in turn that gained next to nothing, and steps tried.
    bend : Bend, optional
        What the last step told.
    is_open : bool
        Whether machine code can do anything from here.
    awaited : callable, optional
        Gives ``bend`` where it has not been worked out: after the last step nobody asks.
    """

    at: Callable[..., Point]
    settled: float
    damping: float = 0.0
    growth: float = 2.0
    held: str = ""
    idle: int = 0
    tried: int = 0
    bend: Bend | None = None
    is_open: bool = True
    awaited: Callable[[], Bend | None] | None = None

    def turn(self) -> Bend | None:
        """What the last step tells, worked out for the next one."""
        if self.awaited is not None:
            self.bend, self.awaited = self.awaited(), None
        return self.bend

    @property
    def is_over(self) -> bool:
        """Whether no further step lowers the cost."""
        return self.idle > 2 or self.damping > MOST_DAMPED

    @cached_property
    def given(self) -> Given | None:
        """What machine code is given of the cost; None where it does not know it."""
        return _told(self.at)

    def running(self, point: Point, most: int, exact: float) -> Slices[tuple[Point, list[Taken]]]:
        """As many steps as machine code can take.

        Parameters
        ----------
        point : Point
            Where it begins.
        most : int
            Most steps tried.
        exact : float
            Residual power over the output's that is rounding.

        Returns
        -------
        point : Point
        taken : list of Taken
        """
        problem, counts, taken = point.problem, point.counts, list[Taken]()
        least = self.settled if self.tried else max(self.settled, ONE_MORE)
        if not self.is_open or problem.limits is not None or point.decrease() < least:
            return point, taken
        if self.given is None:
            self.is_open = False
            return point, taken
        from tridentify.estimation.likelihood.compiled.descent import descend

        far, n_poles = FAR * point.samples, problem.n_poles
        scales = np.stack([counts, FLOOR * problem.power, exact * problem.size * counts])
        limits = limits_of(problem)
        rules = np.array([self.settled, IDLE, far, LEAST_BEND, MOST_BEND, APART, MOST_DAMPED])
        direction, excess = self.turn() or (np.zeros(n_poles), np.nan)
        state, seen = np.array([self.damping, self.growth, excess]), point.seen
        direction, poles = np.array(direction), point.poles
        now: Any = point.rss, *seen[:2], *seen[2][1:6]
        together = max(1, TOGETHER // sum(e.n_samples for e in problem.experiments))
        while self.is_open and self.tried < most:
            yield
            count = min(together, most - self.tried)
            self.is_open, tried, done, self.idle, note, poles, now, thetas, costs, told = descend(
                *self.given, scales, limits, rules, poles, now, state, direction,
                self.idle, count,
            )  # fmt: skip
            self.tried += tried
            self.held = NOTES[note] if done else self.held
            for theta, rss, row in zip(thetas[:done], costs, told.tolist(), strict=False):
                condition, gradient, damping, did = row
                taken.append(Taken(theta, rss, condition, gradient, damping, NOTES[int(did)]))
        self.is_open = False
        self.damping, self.growth, excess = state.tolist()
        self.bend = None if np.isnan(excess) else Bend(direction, excess)
        return (self.at(poles) if taken else point), taken


def _told(at: Callable[..., Point]) -> Given | None:
    if not isinstance(at, partial) or at.keywords:
        return None
    if at.func not in (evaluate, evaluate_variant):
        return None
    problem, variant = (*at.args, None)[:2]
    return given(problem, variant)
