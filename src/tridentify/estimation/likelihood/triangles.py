"""The triangles of all experiments of a problem as one stack, and which of their columns count."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tridentify.estimation.likelihood.bank import Bank
from tridentify.estimation.likelihood.problem import Variant
from tridentify.models.regression import Layout, Regression
from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.kept import cached_property


@dataclass(frozen=True, eq=False)
class Triangles:
    """What a linear fit reads (`compiled_cost`).

    Attributes
    ----------
    whole : tuple of Regression
        With all columns that there are.
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
    """

    whole: tuple[Regression, ...]
    variant: Variant | None
    bank: Bank
    stack: Array
    which: Indices
    targets: Array
    layout: Layout
    free: bool
    nuisance: Indices

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
        last, terms = layout.n_signals - 1, layout if kept is None else kept
        nuisance = [last - layout.drift] * (layout.offset and terms.offset)
        nuisance += [last] * (layout.drift and terms.drift)
        stack, which, targets = _stacked(whole)
        columns = np.array(nuisance, dtype=np.int64)
        return cls(whole, kept, bank, stack, which, targets, layout, terms.free, columns)

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
    def regressions(self) -> tuple[Regression, ...]:
        """The columns that count, experiment by experiment."""
        if self.variant is None:
            return self.whole
        return self.variant.regressions(self.whole, self.bank.cascade)

    @cached_property
    def counts(self) -> Array:
        """(n_outputs,) samples used."""
        table = [one.counts for one in self.whole]
        return np.array(table[0] if len(table) == 1 else np.sum(table, axis=0), dtype=np.float64)

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
