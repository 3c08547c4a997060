"""From the window of a long record to the whole of it (`search.stand_ins`)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from tridentify.estimation.likelihood.cost import (
    Point,
    bank_of,
    evaluate,
    evaluate_variant,
    point_at,
)
from tridentify.estimation.likelihood.fitted_point import TESTED
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import (
    Recorder,
    at_rounding,
    finish,
)
from tridentify.estimation.likelihood.setup.problem import Problem, Variant
from tridentify.estimation.likelihood.setup.triangles import Triangles
from tridentify.estimation.search.found import End
from tridentify.estimation.search.stand_ins import SMALL, free_variant, is_usable, window
from tridentify.models.regression import regress
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.whiteness import is_white

MOST_SHARPENING = 3
"""Steps on a longer window before the whole record is touched."""
LONGER = 24
"""Length of the longer window over that of the first one, `stand_ins.SMALL`: standard errors a
fifth."""
HOPELESS_RATIO = 2.0
"""Looseness over what is asked from which the samples of the whole record will not do either."""


def end_of(base: Problem, variants: Sequence[Variant], near: Point, loosest: float) -> End | None:
    """Where a window's poles lead on the whole record; None where that is no end of use."""
    poles, variant = sharpened(base, near.poles), variants[-1]
    bank = bank_of(base, poles, 2)
    whole = tuple(regress(e, bank.cascade) for e in base.experiments)
    point = point_at(variant.problem(base), Triangles.of(whole, bank, variant))
    if at_rounding(point) or point.looseness > HOPELESS_RATIO * loosest:
        return None
    alone = len(variants) == 1 and _is_all_of(variant, base)
    own = Recorder()
    if alone:
        point = finish(partial(evaluate, variant.problem(base)), point, own)[0]
        poles, whole = point.poles, point.regressions
    return End(near.poles, poles, point, whole, alone, tuple(own.passes))


def _is_all_of(variant: Variant, base: Problem) -> bool:
    """Whether a choice of nuisance terms leaves out none that the problem has, and adds none."""
    own = (variant.free, variant.offset, variant.drift)
    same = all((e.free, e.offset, e.drift) == own for e in base.experiments)
    return same and all(constants is None for constants in variant.constants)


def sharpened(base: Problem, poles: Complex) -> Complex:
    """Poles of a window taken to those of longer ones, so that few steps on the whole are left."""
    total = sum(e.n_samples for e in base.experiments)
    if total >= 4 * LONGER * SMALL:
        piece = window(base, LONGER * SMALL)
        if is_usable(piece):
            at = partial(evaluate_variant, piece, free_variant(piece))
            poles = finish(at, at(poles), Recorder(), MOST_SHARPENING)[0].poles
    return nearer(base, poles) if total >= 16 * SMALL else poles


def nearer(base: Problem, poles: Complex) -> Complex:
    """One Gauss-Newton step on a quarter of a long record: it saves one on the whole."""
    piece = window(base, sum(e.n_samples for e in base.experiments) // 4)
    if not is_usable(piece):
        return poles
    point = evaluate_variant(piece, free_variant(piece), poles)
    return base.admissible(point.step(0.0)[0])[0]


def leaves_white_noise(point: Point) -> bool:
    """Whether the residual and its means over blocks, short and long, pass for white noise."""
    residuals = point.residuals(TESTED)
    longest = max(one.shape[0] for one in residuals) // SMALL
    blocks = sorted({1, max(int(np.sqrt(longest)), 1), max(longest, 1)})
    return all(
        is_white([_block_means(one[:, i], block) for one in residuals])
        for i in range(point.problem.n_outputs)
        for block in blocks
    )


def _block_means(series: Array, block: int) -> Array:
    kept = series.size // block * block
    return np.asarray(series[:kept].reshape(-1, block).mean(axis=1))
