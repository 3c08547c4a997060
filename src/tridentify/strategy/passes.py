"""Steps 2 to 4 repeated with filter and basis re-adapted.

At ``a_hat`` the bank holds its poles three times. Twice is the basis of Step
1: ``span{p^i / a_hat^2}`` contains the model's output and all its derivatives with respect to
``a`` and ``b``, so the order need not grow with the record. Step 2 fits ``a`` and ``b`` to that
noise-free output with ``c = a_hat`` and gives the next ``a_hat``. The passes end when the
output-error cost stops falling.

A fixed point of these passes solves instrumental-variable equations close to, but for a finite
record not equal to, those of the output-error minimum; `output_error.finish` ends there.
"""

from __future__ import annotations

import numpy as np

from tridentify.estimate import Step
from tridentify.models.parallel import ParallelFit, fit_parallel
from tridentify.models.series import SeriesFit, fit_series
from tridentify.models.series_parallel import fit_series_parallel
from tridentify.numerics.realization import Complex, denominator
from tridentify.output_error.finish import Recorder, at_rounding
from tridentify.output_error.point import Point, evaluate_variant
from tridentify.output_error.problem import Problem, Variant

ENOUGH = 0.5
MOST_ADAPTED = 12


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
