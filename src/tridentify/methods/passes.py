"""Steps 2 to 4 repeated with filter and basis re-adapted, then the finish on the output error.

*Adapted passes.* At ``a_hat`` the bank holds its poles three times. Twice is the basis of Step
1: ``span{p^i / a_hat^2}`` contains the model's output and all its derivatives with respect to
``a`` and ``b``, so the order need not grow with the record. Step 2 fits ``a`` and ``b`` to that
noise-free output with ``c = a_hat`` and gives the next ``a_hat``. The passes end when the
output-error cost stops falling.

*Finish.* A fixed point of these passes solves instrumental-variable equations close to, but for
a finite record not equal to, those of the output-error minimum. Levenberg-Marquardt steps on
the reduced cost (`methods.point`) end on a stationary point of it. The step is measured in the
likelihood: it is small when the predicted decrease of ``-2 log L`` is, that is when the
coefficients move by far less than their standard errors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tridentify.estimate import Pass, Status, Step
from tridentify.methods.point import Point, evaluate_variant
from tridentify.methods.problem import REFLECTED, TOO_FAST, Problem, Variant
from tridentify.models.parallel import ParallelFit, fit_parallel
from tridentify.models.series import SeriesFit, fit_series
from tridentify.models.series_parallel import fit_series_parallel
from tridentify.numerics.realization import Complex, denominator, numerators

Array = NDArray[np.float64]

SETTLED = 1e-7
SETTLED_LONG = 1e-5
LONG = 50_000
ROUNDING = 1e-22
ENOUGH = 0.5
MOST_ADAPTED = 12
MOST_STEPS = 60
NEARLY = 1e-3
IDLE = 1e-6


@dataclass(eq=False)
class Recorder:
    """Collects the passes."""

    passes: list[Pass] = field(default_factory=list)

    def add(self, point: Point, steps: tuple[Step, ...], beta_distance: float, note: str) -> None:
        """Add one pass, numbered from 1."""
        self.passes.append(
            Pass(
                len(self.passes) + 1,
                steps,
                coefficients(point),
                mean_square(point),
                beta_distance,
                point.gradient,
                note,
            )
        )

    def extend(self, other: Recorder) -> None:
        """Append another's passes, numbered on."""
        for one in other.passes:
            self.passes.append(replace(one, number=len(self.passes) + 1))


def coefficients(point: Point) -> Array:
    """Physical coefficients in the order of `Structure.names`: ``a``, then each ``b``."""
    problem, n = point.problem, point.problem.n_poles
    a = denominator(point.poles)
    table = numerators(point.poles)
    parts = [a[1:]]
    for i in range(problem.n_outputs):
        for j, m in enumerate(problem.n_zeros[i]):
            proper = point.response.rows[i, j, :n] @ table
            full = np.concatenate([[0.0], proper]) + point.response.direct[i, j] * a
            parts.append(full[n - m :])
    return np.concatenate(parts)


def mean_square(point: Point) -> float:
    """Residual mean square; the geometric mean over several outputs."""
    variance = point.rss / point.counts
    if np.any(variance == 0):
        return 0.0
    return float(np.exp(point.counts @ np.log(variance) / point.counts.sum()))


def adapt(
    base: Problem, variant: Variant, poles: Complex, recorder: Recorder, most: int = MOST_ADAPTED
) -> Point:
    """Adapted passes from given poles; the best point met.

    Parameters
    ----------
    base : Problem
        Whose experiments are filtered.
    variant : Variant
        The nuisance terms that are kept.
    poles : (n,) complex array
        Admissible.
    recorder : Recorder
        Is told every pass.
    most : int
        Most passes.
    """
    best: Point | None = None
    worse = 0
    note = ""
    for _ in range(most):
        point = evaluate_variant(base, variant, poles, 3)
        parallel = parallel_model(point)
        step = fit_series_parallel(
            point.regressions,
            point.bank,
            parallel.response,
            point.inner,
            base.n_poles,
            base.n_zeros,
            point.weights,
        )
        recorder.add(
            point,
            (
                Step(
                    "parallel",
                    parallel.beta.ravel(),
                    float(parallel.cost.sum() / point.counts.sum()),
                    parallel.condition,
                    f"{parallel.beta.shape[2]} orthonormal functions on the poles of a, twice each",
                ),
                Step(
                    "series-parallel",
                    denominator(step.poles)[1:],
                    step.cost / float(point.counts.sum()),
                    step.condition,
                    "filter 1/a of the pass before",
                ),
            ),
            np.nan,
            note,
        )
        gain = np.inf if best is None else best.objective - point.objective
        if best is None or gain > 0:
            best = point
        worse = worse + 1 if gain < ENOUGH else 0
        if worse >= 1 + (gain < 0) or at_rounding(point):
            break
        poles, note = base.admissible(step.poles)
    assert best is not None
    return best


def parallel_model(point: Point) -> ParallelFit:
    """Step 1 on the poles of ``a_hat``, twice each."""
    q, n = point.bank.order, point.problem.n_poles
    rows = np.eye(2 * n, q)
    direct = np.zeros(2 * n)
    if point.problem.biproper:
        rows = np.vstack([rows, np.zeros(q)])
        direct = np.append(direct, 1.0)
    return fit_parallel(point.regressions, rows, direct, free_rows=np.eye(2 * n, q))


def series_model(point: Point) -> SeriesFit:
    """Step 3 with the orthonormal functions on the poles of ``a_hat``."""
    n = point.problem.n_poles
    return fit_series(
        point.regressions,
        point.bank,
        point.response,
        point.inner,
        np.eye(n),
        np.zeros(n),
        free_rows=np.eye(n, point.bank.order),
        weights=point.weights,
    )


def at_rounding(point: Point) -> bool:
    """Whether the residual is no more than rounding: a noise-free record."""
    return bool(np.all(point.rss / point.counts < ROUNDING * point.problem.size))


def finish(
    at: Callable[[Complex], Point], point: Point, recorder: Recorder, most: int = MOST_STEPS
) -> tuple[Point, Status, str]:
    """Levenberg-Marquardt on the reduced output-error cost.

    Parameters
    ----------
    at : callable
        Evaluates the cost at admissible poles.
    point : Point
        Where to begin.
    recorder : Recorder
        Is told every step that is taken.
    most : int
        Most steps tried.

    Returns
    -------
    point : Point
    status : Status
        Any but `Status.WEAKLY_IDENTIFIABLE`.
    why : str
        In words.
    """
    problem = point.problem
    settled = SETTLED if point.counts.sum() < LONG else SETTLED_LONG
    damping, growth, held, exact, idle = 0.0, 2.0, "", 0, 0
    for _ in range(most):
        left = point.step(0.0)[1]
        if left < settled:
            why = f"the next step would lower -2 log L by {left:.0e}, less than {settled:.0e}"
            return point, _settled(held), why
        poles, predicted = point.step(damping)
        poles, note = problem.admissible(poles)
        trial = at(poles)
        gain = point.objective - trial.objective
        exact += at_rounding(trial)
        if exact and (gain < 0.5 * point.counts.sum() or exact > 3):
            best = trial if gain > 0 else point
            return best, Status.CONVERGED, "the residual is down to rounding"
        if gain <= 0:
            damping = max(damping * growth, 1e-3)
            growth *= 2.0
            if damping > 1e8:
                break
            continue
        recorder.add(trial, (_error_step(trial, damping),), np.nan, note)
        point, held = trial, note
        ratio = gain / predicted
        damping *= max(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3)
        damping = 0.0 if damping < 1e-6 else damping
        growth = 2.0
        idle = idle + 1 if gain < IDLE else 0
        if idle > 2:
            break
    left = point.step(0.0)[1]
    if held:
        return point, _settled(held), held
    if left < NEARLY:
        return point, Status.CONVERGED, f"a further step would lower -2 log L by {left:.1e}"
    if idle > 2 or damping > 1e8:
        return point, Status.STALLED, "no further step lowers the cost"
    return point, Status.MAX_PASSES, f"{most} steps on the output error"


def _settled(held: str) -> Status:
    if not held or held == REFLECTED:
        return Status.CONVERGED
    return Status.AT_SAMPLING_LIMIT if held == TOO_FAST else Status.AT_STABILITY_LIMIT


def _error_step(point: Point, damping: float) -> Step:
    condition = max(fit.solution.condition for fit in point.fits)
    note = f"damping {damping:.1e}" if damping else ""
    return Step(
        "output error",
        denominator(point.poles)[1:],
        float(point.rss.sum() / point.counts.sum()),
        condition,
        note,
    )
