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

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tridentify.estimate import Pass, Status, Step
from tridentify.methods.point import Point, evaluate
from tridentify.methods.problem import Problem, Variant
from tridentify.models.parallel import ParallelFit, fit_parallel
from tridentify.models.series import SeriesFit, fit_series
from tridentify.models.series_parallel import fit_series_parallel
from tridentify.numerics.realization import Complex, cascade, denominator, numerators
from tridentify.regression import regress

Array = NDArray[np.float64]

SETTLED = 1e-7
ROUNDING = 1e-24
ENOUGH = 0.5
MOST_ADAPTED = 12
MOST_STEPS = 40


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
    problem = variant.problem(base)
    best: Point | None = None
    worse = 0
    note = ""
    for _ in range(most):
        bank = cascade(np.tile(poles, 3))
        whole = tuple(regress(e, bank) for e in base.experiments)
        point = evaluate(problem, poles, 3, variant.regressions(whole, bank))
        parallel = parallel_model(point)
        step = fit_series_parallel(
            point.regressions,
            point.bank,
            parallel.response,
            point.inner,
            problem.n_poles,
            problem.n_zeros,
            point.weights,
        )
        recorder.add(
            point,
            (
                Step(
                    "parallel",
                    parallel.beta.ravel(),
                    float(parallel.cost.sum()),
                    parallel.condition,
                    f"{parallel.beta.shape[2]} orthonormal functions on the poles of a, twice each",
                ),
                Step(
                    "series-parallel",
                    denominator(step.poles)[1:],
                    step.cost,
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
        poles, note = problem.admissible(step.poles)
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
    )


def at_rounding(point: Point) -> bool:
    """Whether the residual is no more than rounding: a noise-free record."""
    return bool(np.all(point.rss / point.counts < ROUNDING * point.problem.size))


def finish(
    problem: Problem, start: Point | Complex, recorder: Recorder, most: int = MOST_STEPS
) -> tuple[Point, Status, str]:
    """Levenberg-Marquardt on the reduced output-error cost.

    Returns
    -------
    point : Point
    status : Status
        `Status.CONVERGED`, `Status.AT_STABILITY_LIMIT`, `Status.MAX_PASSES` or `Status.STALLED`.
    why : str
        In words.
    """
    point = start if isinstance(start, Point) else evaluate(problem, start)
    damping, held = 0.0, ""
    exact = 0
    for _ in range(most):
        poles, predicted = point.step(damping)
        if predicted < SETTLED and damping < 1e-3:
            return point, _settled(held), "the next step would lower -2 log L by less than 1e-7"
        poles, note = problem.admissible(poles)
        trial = evaluate(problem, poles)
        gain = point.objective - trial.objective
        if at_rounding(trial):
            exact += 1
        if exact and (gain < 0.5 * point.counts.sum() or exact > 3):
            best = trial if gain > 0 else point
            return best, Status.CONVERGED, "the residual is down to rounding"
        if gain > -1e-9 * abs(point.objective):
            point, held = trial, note
            recorder.add(point, (_error_step(point, damping),), np.nan, note)
            damping = 0.0 if damping < 1e-6 else damping * (0.1 if gain > 0.25 * predicted else 2.0)
            continue
        damping = max(10.0 * damping, 1e-3)
        if damping > 1e8:
            status = Status.CONVERGED if predicted < 1e-3 else Status.STALLED
            return point, _settled(held) if held else status, "no smaller step lowers the cost"
    return point, Status.MAX_PASSES, f"{most} steps on the output error"


def _settled(held: str) -> Status:
    return Status.AT_STABILITY_LIMIT if held else Status.CONVERGED


def _error_step(point: Point, damping: float) -> Step:
    condition = max(fit.solution.condition for fit in point.fits)
    note = f"damping {damping:.1e}" if damping else ""
    return Step(
        "output error", denominator(point.poles)[1:], float(point.rss.sum()), condition, note
    )
