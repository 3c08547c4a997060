"""Where the passes begin: parallel models on Laguerre functions, over a grid of their pole.

For each ``gamma`` on a logarithmic grid from the slowest to the fastest rate the record can
show, the record is filtered once through ``L + n + 1`` Laguerre functions. Functions are
nested, so the residuals of all orders ``1 .. L`` follow from one triangle, and AICc picks the
order; its value at that order ranks the grid. The orthonormal functions with the filter's poles
appended are again Laguerre functions with the same ``gamma``, so Step 2 with ``c = (p +
gamma)^(n + 1)`` needs no further pass over the samples.

A grid point costs one pass; nothing here is iterative and every problem is convex.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tridentify.methods.problem import Problem, Variant
from tridentify.models.parallel import fit_parallel
from tridentify.models.series_parallel import fit_series_parallel
from tridentify.numerics.least_squares import triangle
from tridentify.numerics.realization import Cascade, Complex, cascade
from tridentify.regression import Regression, regress

Array = NDArray[np.float64]

PER_DECADE = 4.0
MOST_FUNCTIONS = 12
SLOW_EDGE = 3.0
FAST_EDGE = 0.7


@dataclass(frozen=True, eq=False)
class ParallelStart:
    """A parallel model on Laguerre functions, fitted but for its weights.

    Attributes
    ----------
    problem : Problem
        With the nuisance terms that were estimated along; its experiments are those of the base.
    base : Problem
        The problem whose experiments are filtered.
    variant : Variant
        How to get from one to the other.
    gamma : float
        [rad/s]
    order : int
        Number of functions.
    criterion : float
        AICc.
    bank : Cascade
    regressions : tuple of Regression
        On ``bank``.
    """

    problem: Problem
    base: Problem
    variant: Variant
    gamma: float
    order: int
    criterion: float
    bank: Cascade
    regressions: tuple[Regression, ...]

    @property
    def name(self) -> str:
        """In words."""
        return f"Laguerre {self.gamma:.3g} rad/s, order {self.order}"

    def poles(self) -> Complex:
        """Steps 1 and 2: admissible roots of ``a``."""
        problem, n = self.problem, self.problem.n_poles
        rows = np.eye(self.order, self.bank.order)
        direct = np.zeros(self.order)
        if problem.biproper:
            rows = np.vstack([rows, np.zeros(self.bank.order)])
            direct = np.append(direct, 1.0)
        parallel = fit_parallel(
            self.regressions, rows, direct, free_rows=np.eye(self.order, self.bank.order)
        )
        samples = sum(e.n_samples for e in problem.experiments)
        weights = 1.0 / np.sqrt(parallel.cost / samples + 1e-30 * problem.power)
        filter_bank = cascade(np.full(n + 1, -self.gamma, dtype=np.complex128))
        step = fit_series_parallel(
            self.regressions,
            self.bank,
            parallel.response,
            filter_bank,
            n,
            problem.n_zeros,
            weights,
        )
        return problem.admissible(step.poles)[0]


def gamma_grid(problem: Problem) -> Array:
    """Laguerre poles to try [rad/s]: from 3 / T to 0.7 / dt."""
    low = SLOW_EDGE / max(e.duration for e in problem.experiments)
    high = FAST_EDGE / min(e.dt for e in problem.experiments)
    if high <= low:
        return np.array([np.sqrt(low * high)])
    count = max(4, int(np.ceil(PER_DECADE * np.log10(high / low))) + 1)
    return np.geomspace(low, high, count)


def laguerre_starts(base: Problem, variants: Sequence[Variant]) -> list[ParallelStart]:
    """Parallel models over the grid and over choices of nuisance terms, the best by AICc first.

    Parameters
    ----------
    base : Problem
        With every nuisance term that a variant has.
    variants : sequence of Variant
        Choices of nuisance terms.

    Returns
    -------
    list of ParallelStart
        One per grid point and variant.
    """
    samples = sum(e.n_samples for e in base.experiments)
    n = base.n_poles
    most = max(n + 1, min(MOST_FUNCTIONS, samples // (3 * base.n_inputs)))
    found = []
    for gamma in gamma_grid(base):
        bank = cascade(np.full(most + n + 1, -gamma, dtype=np.complex128))
        whole = tuple(regress(e, bank) for e in base.experiments)
        for variant in variants:
            problem = variant.problem(base)
            regressions = variant.regressions(whole, bank)
            order, criterion = _order(problem, regressions, most, samples)
            found.append(
                ParallelStart(
                    problem, base, variant, float(gamma), order, criterion, bank, regressions
                )
            )
    found.sort(key=lambda start: start.criterion)
    return found


def _order(
    problem: Problem, regressions: Sequence[Regression], most: int, samples: int
) -> tuple[int, float]:
    """Number of functions by AICc, summed over the outputs, and its value."""
    fewest = min(problem.n_poles + 1, most)
    total = np.zeros(most)
    for i in range(problem.n_outputs):
        rss = sum((_nested(r, i, most, problem.biproper) for r in regressions), np.zeros(most))
        total += samples * np.log(rss / samples + 1e-30 * problem.size[i])
    layout = regressions[0].layout
    per_order = problem.n_outputs * (layout.n_inputs + layout.free * len(regressions))
    shared = problem.n_outputs * (1 + (layout.offset + layout.drift) * len(regressions))
    k = per_order * np.arange(1, most + 1) + shared
    room = np.maximum(samples * problem.n_outputs - k - 1.0, 0.5)
    criterion = total + 2.0 * k + 2.0 * k * (k + 1.0) / room
    best = int(np.argmin(criterion[fewest - 1 :])) + fewest
    return best, float(criterion[best - 1])


def _nested(regression: Regression, output: int, most: int, biproper: bool) -> Array:
    """(most,) residual sums of squares with the first 1, 2, ... functions of every channel."""
    layout = regression.layout
    s = regression.signals[output]
    q = layout.order
    channels = layout.n_inputs + layout.free
    index = list(range(layout.nuisance.start, layout.nuisance.stop))
    if biproper:
        index += [layout.direct(j) for j in range(layout.n_inputs)]
    fixed = len(index)
    for k in range(most):
        index += [c * q + k for c in range(channels)]
    stacked = np.column_stack([s[:, index], regression.targets[output]])
    last = triangle(stacked)[:, -1]
    last = np.pad(last, (0, max(0, len(index) + 1 - last.size)))
    tail = np.append(np.cumsum(last[::-1] ** 2)[::-1], 0.0)
    return np.asarray(tail[fixed + channels * np.arange(1, most + 1)])
