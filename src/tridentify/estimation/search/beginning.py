"""The beginning of the search of a short record, in one call of machine code.

Laguerre models of the whole grid, the best of them turned into poles, and the adapted passes from
there: what `search.starts` and `search.passes` do piece by piece, where a record is long, has
several denominators, or machine code is not given its samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tridentify.estimation.likelihood.charted import given, limits_of, told
from tridentify.estimation.likelihood.cost import Point, evaluate_variant
from tridentify.estimation.likelihood.minimum.descent import TOGETHER
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import Recorder
from tridentify.estimation.likelihood.setup.problem import Problem, Variant
from tridentify.estimation.likelihood.thresholds import PASS_HELPED
from tridentify.estimation.search.banks import Banks, asked_of
from tridentify.estimation.search.passes import MOST_ADAPTED, record, scales_of
from tridentify.estimation.search.starts import (
    ParallelStart,
    Reduction,
    fewest_functions,
    laguerre_label,
    laguerre_poles,
)
from tridentify.numerics.arrays import Complex
from tridentify.numerics.kept import cached_property


@dataclass(eq=False)
class Begun:
    """What machine code has told of the beginning.

    Attributes
    ----------
    base : Problem
    variants : sequence of Variant
    models : tuple
        As of `compiled_beginning.ranked`.
    poles : (n_banks, q) complex array
        Of the banks.
    best : tuple of int
        Bank and choice of nuisance terms of the best model.
    reduction : Reduction
        What it was reduced to.
    first : (n_poles,) complex array
        Where the passes began.
    point : Point
        Where they led.
    recorder : Recorder
        The passes.
    """

    base: Problem
    variants: Sequence[Variant]
    models: tuple[Any, ...]
    poles: Complex
    best: tuple[int, int]
    reduction: Reduction
    first: Complex
    point: Point
    recorder: Recorder = field(default_factory=Recorder)

    @property
    def variant(self) -> Variant:
        """The nuisance terms of the best model."""
        return self.variants[self.best[1]]

    @property
    def criterion(self) -> float:
        """AICc of the best model."""
        return float(self.models[5][self.best])

    @property
    def name(self) -> str:
        """The best model in words."""
        k, order = self.best[0], int(self.models[4][self.best])
        return f"{laguerre_label(-self.poles[k, 0].real)}, order {order}"

    @cached_property
    def starts(self) -> list[ParallelStart]:
        """All models, the best by AICc first."""
        most = self.poles.shape[1] - self.base.n_poles - 1
        banks = Banks.told(self.base, self.poles, self.models)
        found = []
        for k, own in enumerate(self.poles):
            for v, variant in enumerate(self.variants):
                order, criterion = int(self.models[4][k, v]), float(self.models[5][k, v])
                rate, filters = -float(own[0].real), (own[most:].copy(),)
                label = laguerre_label(rate)
                start = ParallelStart(
                    label, self.base, variant, order, criterion, rate, filters, banks, k
                )
                found.append(start)
        return sorted(found, key=lambda start: start.criterion)


def begun(base: Problem, variants: Sequence[Variant]) -> Begun | None:
    """The beginning; None where it is to be made piece by piece.

    Parameters
    ----------
    base : Problem
        With every nuisance term that a variant has.
    variants : sequence of Variant
        Choices of nuisance terms.
    """
    samples = sum(e.n_samples for e in base.experiments)
    if len(base.groups) > 1 or samples * MOST_ADAPTED > TOGETHER:
        return None
    poles, most = laguerre_poles(base)
    asked = asked_of(base, variants, most)
    if asked is None:
        return None
    from tridentify.estimation.search import compiled_beginning

    known, choices, prices, scales = asked
    counts, floors, exact = scales_of(base)
    scales = np.stack([counts, scales[1], floors, exact])
    fewest = fewest_functions(base, most)
    models, best, reduction, first, passes, at, fit = compiled_beginning.begun(
        *known, choices, poles, base.biproper, most, fewest, scales, prices, float(samples),
        limits_of(base), PASS_HELPED, MOST_ADAPTED,
    )  # fmt: skip
    k, v = best.tolist()
    variant = variants[v]
    own = given(base, variant)
    assert own is not None
    if own.is_shifted:
        point = evaluate_variant(base, variant, at)
    else:
        triangles, linear = told(base, variant, own, at, 2, fit)
        point = Point(variant.problem(base), triangles.bank.poles, triangles, linear)
    found = Begun(base, variants, models, poles, (k, v), Reduction(*reduction), first, point)
    record(found.recorder, base, variant, passes[2][: passes[1]], passes[3])
    return found
