"""One explanation, fitted from given poles: Levenberg-Marquardt and the noise model in turn.

Explanations are compared by ``-2 log L`` with a noise model of each one's own, of equal orders: a
model that was fitted along with a wrong explanation has taken some of what it misses for noise,
and would speak for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tridentify.errors import TridentifyError
from tridentify.estimation.likelihood.cost import Point, evaluate
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import finish
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.judgement.causes.attempts.present import Present
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.autoregression import deviance, fit_autoregression, whiten
from tridentify.numerics.information import aicc_price

MOST_STEPS = 25
"""Levenberg-Marquardt steps between two noise models: enough to see which explanation is best."""

ROUNDS = 2
"""Noise models: the first still carries what the start missed."""

ROUNDING = 1e-20
"""Mean square of a residual over that of the output, below which it is rounding."""


class Part(NamedTuple):
    """``-2 log L`` and residual energy on some of the samples."""

    deviance: float
    energy: float


class Limited(NamedTuple):
    """Recorded outputs, residuals and outputs, (n_samples, n_outputs) per experiment."""

    recorded: tuple[Array, ...]
    residuals: tuple[Array, ...]
    outputs: tuple[Array, ...]


@dataclass(frozen=True, eq=False)
class Attempt:
    """Where an explanation ended.

    Attributes
    ----------
    point : Point
    deviance : float
        ``-2 log L``, up to a constant that explanations of the same samples share.
    unknowns : int
        Coefficients, nuisance terms, and those of the noise.
    limited : Limited, optional
        What was recorded and what is left of it, where that is not the point's own: an output that
        reached a limit is compared with what the limit leaves of the point's.
    """

    point: Point
    deviance: float
    unknowns: int
    limited: Limited | None = None

    def residuals(self) -> tuple[Array, ...]:
        """(n_samples, n_outputs) per experiment, not whitened; ``nan`` where one is missing."""
        return self.point.residuals() if self.limited is None else self.limited.residuals

    def standardised(self) -> tuple[Array, ...]:
        """The same over the noise of each experiment, where these have levels of their own."""
        pairs = zip(self.point.problem.experiments, self.residuals(), strict=True)
        return tuple(e.standardised(one) for e, one in pairs)

    def outputs(self) -> tuple[Array, ...]:
        """(n_samples, n_outputs) per experiment, as they would be recorded."""
        return self.point.outputs() if self.limited is None else self.limited.outputs

    @property
    def count(self) -> float:
        """Samples of all outputs."""
        if self.limited is None:
            return float(self.point.counts.sum())
        return float(sum(np.isfinite(one).sum() for one in self.limited.residuals))

    @property
    def energy(self) -> float:
        """Geometric mean over the outputs of the residual's sums of squares, whitened."""
        if self.limited is not None:
            return self.on([np.isfinite(one) for one in self.limited.residuals]).energy
        n = self.point.counts
        rss = self.point.rss + ROUNDING * n * self.point.problem.size
        return float(np.exp(n @ np.log(rss) / n.sum()))

    def on(self, masks: Sequence[NDArray[np.bool_]]) -> Part:
        """The same end, judged on some of its samples alone.

        Parameters
        ----------
        masks : sequence of (n_samples, n_outputs) bool arrays
            Per experiment, the samples that count.
        """
        noise = self.point.problem.noise
        deviances, energies, counts = [], [], []
        for i in range(self.point.problem.n_outputs):
            series = [
                np.where(mask[:, i], one[:, i], np.nan)
                for mask, one in zip(masks, self.standardised(), strict=True)
            ]
            a = noise[i] if noise else np.zeros(0)
            whitened = [whiten(one, a)[0] for one in series]
            n = sum(int(np.isfinite(one).sum()) for one in whitened)
            rss = sum(float(np.nansum(one**2)) for one in whitened)
            least = ROUNDING * float(self.point.problem.size[i])
            plain = n * float(np.log(rss / max(n, 1) + least))
            deviances.append(deviance(series, a) if a.size else plain)
            energies.append(rss + n * least)
            counts.append(n)
        n_all = np.array(counts, dtype=np.float64)
        return Part(sum(deviances), float(np.exp(n_all @ np.log(energies) / n_all.sum())))

    @property
    def criterion(self) -> float:
        """AICc."""
        return self.deviance + aicc_price(float(self.unknowns), self.count)

    @property
    def fits(self) -> Array:
        """(n_outputs,) NRMSE [percent], each experiment about its own mean."""
        return np.asarray(100.0 * (1.0 - np.sqrt(self.raw_energy / self.spread)))

    @cached_property
    def raw_energy(self) -> Array:
        """(n_outputs,) sums of squares of the residual, not whitened."""
        found = np.zeros(self.point.problem.n_outputs)
        for residual in self.residuals():
            found = found + np.nansum(residual**2, axis=0)
        return found

    @cached_property
    def spread(self) -> Array:
        """(n_outputs,) sums of squares of the outputs about their means; ``nan`` for none."""
        found = np.zeros(self.point.problem.n_outputs)
        own = tuple(experiment.y for experiment in self.point.problem.experiments)
        outputs = own if self.limited is None else self.limited.recorded
        for recorded, residual in zip(outputs, self.residuals(), strict=True):
            y = np.where(np.isfinite(residual), recorded, np.nan)
            found = found + np.nansum((y - np.nanmean(y, axis=0)) ** 2, axis=0)
        return np.where(found > 0, found, np.nan)


def promise(present: Present, poles: Complex) -> float:
    """``-2 log L`` a sample that a Gauss-Newton step leads to expect, the noise model held.

    Infinite where the explanation cannot be had.
    """
    try:
        problem = present.problem()
        point = evaluate(problem, problem.admissible(poles)[0])
        return (point.objective - point.decrease()) / float(point.counts.sum())
    except (TridentifyError, np.linalg.LinAlgError, FloatingPointError):
        return float("inf")


def attempt(
    problem: Problem,
    starts: Sequence[Complex],
    orders: Sequence[int],
    *,
    steps: int = MOST_STEPS,
    rounds: int = ROUNDS,
    hopeless: float = np.inf,
) -> Attempt | None:
    """Fit an explanation from the most promising of several starts.

    Parameters
    ----------
    problem : Problem
        Whitened by a first model of the noise, or not.
    starts : sequence of (n_poles,) complex arrays
        [rad/s].
    orders : sequence of int
        Of each output's autoregression; zero for white noise.
    steps : int
        Most Levenberg-Marquardt steps a round.
    rounds : int
        Noise models that are fitted.
    hopeless : float
        ``-2 log L`` that a step must promise to fall below, or none is made.

    Returns
    -------
    Attempt or None
        None where the explanation cannot be had on these records, or is hopeless.
    """
    if not np.all(problem.size > 0.0):
        # a part of a record, all zeros: any coefficients explain it
        return None
    try:
        points = [evaluate(problem, problem.admissible(one)[0]) for one in starts]
        promised = [one.objective - one.decrease() for one in points]
        best = min(range(len(points)), key=promised.__getitem__)
        if promised[best] > hopeless:
            return None
        start = points[best]
        point = finish(partial(evaluate, problem), start, None, steps)[0]
        noise = point.problem.noise
        for _ in range(rounds if any(orders) else 0):
            noise = tuple(
                fit_autoregression(_series(point, i), p, p) if p else np.zeros(0)
                for i, p in enumerate(orders)
            )
            whitened = point.problem.whitened(noise)
            at = partial(evaluate, whitened)
            point = finish(at, at(point.poles), None, steps)[0]
    except (TridentifyError, np.linalg.LinAlgError, FloatingPointError):
        return None
    problem = point.problem
    unknowns = problem.n_coefficients + problem.n_nuisance + problem.n_outputs + sum(orders)
    return Attempt(point, deviance_at(point, noise), unknowns)


def deviance_at(point: Point, noise: Sequence[Array]) -> float:
    """``-2 log L``; a residual that is rounding counts as of one size.

    Parameters
    ----------
    point : Point
    noise : sequence of (p,) arrays
        Model of each output's noise that whitened it; empty where all are white.
    """
    found = 0.0
    for i in range(point.problem.n_outputs):
        if noise and noise[i].size:
            found += deviance(_series(point, i), noise[i])
            continue
        n = float(point.counts[i])
        found += n * float(np.log(point.rss[i] / n + ROUNDING * point.problem.size[i]))
    return found


def _series(point: Point, output: int) -> list[Array]:
    return [np.ascontiguousarray(one[:, output]) for one in point.standardised()]
