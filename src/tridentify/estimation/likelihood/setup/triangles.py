"""The triangles of all experiments of a problem as one stack, and which of their columns count."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tridentify.estimation.likelihood.setup.bank import Bank
from tridentify.estimation.likelihood.setup.problem import Variant
from tridentify.models.columns import Layout, Regression
from tridentify.models.experiment import Experiment
from tridentify.models.regression import regressions_in
from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.kept import cached_property


@dataclass(frozen=True, eq=False)
class Triangles:
    """What a linear fit reads (`compiled_cost`).

    Attributes
    ----------
    variant : Variant, optional
        Which nuisance terms are kept (default: all).
    bank : Bank
    stack : (n_triangles, r, n_columns) array
        With rows of zeros where one is shorter.
    which : (n_experiments, n_outputs) int array
        The triangle of each.
    targets : (n_experiments, n_outputs, r) array
    layout : Layout
        Of the columns of ``stack``.
    free : bool
    nuisance : (k,) int array
        The columns of constant and ramp that are kept.
    counts : (n_outputs,) array
        Samples used.
    experiments : tuple of Experiment
        What they were made of.
    given : tuple of Regression
        The same one by one; empty where they are made of the stack when somebody asks.
    """

    variant: Variant | None
    bank: Bank
    stack: Array
    which: Indices
    targets: Array
    layout: Layout
    free: bool
    nuisance: Indices
    counts: Array
    experiments: tuple[Experiment, ...] = ()
    given: tuple[Regression, ...] = ()

    @classmethod
    def of(
        cls, whole: Sequence[Regression], bank: Bank, variant: Variant | None = None
    ) -> Triangles:
        """The triangles of all experiments on a bank.

        Parameters
        ----------
        whole : sequence of Regression
        bank : Bank
        variant : Variant, optional
            Which of the nuisance terms to keep.
        """
        whole, kept = tuple(whole), variant
        if variant is not None and any(c is not None and c.any() for c in variant.constants):
            # constants go into the columns themselves
            whole, kept = variant.regressions(whole, bank.cascade), None
        layout = whole[0].layout
        first, terms = layout.n_signals - layout.drift, layout if kept is None else kept
        nuisance = [first - 1] * (layout.offset and terms.offset)
        nuisance += range(first, first + min(layout.drift, terms.drift))
        stack, which, targets = _stacked(whole)
        columns = np.array(nuisance, dtype=np.int64)
        counts = np.array(np.sum([one.counts for one in whole], axis=0), dtype=np.float64)
        own = kept, bank, stack, which, targets, layout, terms.free, columns, counts
        return cls(*own, given=whole)

    @cached_property
    def whole(self) -> tuple[Regression, ...]:
        """Experiment by experiment, with all columns that there are."""
        if self.given:
            return self.given
        return regressions_in(self.experiments, self.layout, self.stack, self.targets)

    @property
    def of_base(self) -> bool:
        """Whether they are those of the problem that the variant is a part of."""
        return self.variant is not None

    @property
    def kept(self) -> Layout:
        """Of the columns that count."""
        all_, own = self.layout, self.variant
        if own is None:
            return all_
        return Layout(all_.order, all_.n_inputs, own.free, own.offset, own.drift)

    @cached_property
    def columns(self) -> Indices:
        """Which columns of the stack count: those of `kept`."""
        layout = self.layout
        first = layout.order if layout.free and not self.free else 0
        return np.concatenate([np.arange(first, layout.nuisance.start), self.nuisance])

    @cached_property
    def regressions(self) -> tuple[Regression, ...]:
        """The columns that count, experiment by experiment."""
        if self.variant is None:
            return self.whole
        return self.variant.regressions(self.whole, self.bank.cascade)

    def unstacked(self, series: Array) -> Array:
        """Rows of all experiments of one output, without those that only fill up."""
        height = self.stack.shape[1]
        parts = [
            series[e * height : e * height + one.targets[0].size]
            for e, one in enumerate(self.whole)
        ]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _stacked(whole: Sequence[Regression]) -> tuple[Array, Indices, Array]:
    """Different triangles, which of them each output of each experiment has, and the targets."""
    n_outputs, first = len(whole[0].targets), whole[0].signals[0]
    if len(whole) == 1 and all(one is first for one in whole[0].signals):
        which = np.zeros((1, n_outputs), dtype=np.int64)
        return np.array(first, order="C")[None], which, np.array(whole[0].targets)[None]
    places: dict[int, int] = {}
    different: list[Array] = []
    which = np.zeros((len(whole), n_outputs), dtype=np.int64)
    for e, regression in enumerate(whole):
        for i, signals in enumerate(regression.signals):
            if id(signals) not in places:
                places[id(signals)] = len(different)
                different.append(signals)
            which[e, i] = places[id(signals)]
    height = max(one.shape[0] for one in different)
    stack = np.zeros((len(different), height, different[0].shape[1]))
    targets = np.zeros((*which.shape, height))
    for k, one in enumerate(different):
        stack[k, : one.shape[0]] = one
    for e, regression in enumerate(whole):
        for i, target in enumerate(regression.targets):
            targets[e, i, : target.size] = target
    return stack, which, targets
