"""Several banks of the same order, the records seen through each, and what AICc makes of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tridentify.estimation.likelihood.charted import given
from tridentify.estimation.likelihood.fitted_point import FLOOR
from tridentify.estimation.likelihood.setup.problem import Problem, Variant
from tridentify.models.columns import Layout
from tridentify.models.regression import held_states, stacks_on
from tridentify.numerics.arrays import Array, Complex, Indices
from tridentify.numerics.information import aicc_price
from tridentify.numerics.kept import cached_property
from tridentify.numerics.realization import Cascade


@dataclass(frozen=True, eq=False)
class Banks:
    """Cascades of several sets of poles, and every experiment's triangles on them.

    Attributes
    ----------
    base : Problem
        Whose experiments are filtered.
    poles : (n_banks, q) complex array
    a, b : (n_banks, q, q), (n_banks, q) arrays
    stack : (n_banks, n_triangles, r, n_columns) array
        With rows of zeros where one is shorter.
    which : (n_experiments, n_outputs) int array
        The triangle of each.
    targets : (n_banks, n_experiments, n_outputs, r) array
    counts : (n_outputs,) array
        Samples used.
    """

    base: Problem
    poles: Complex
    a: Array
    b: Array
    stack: Array
    which: Indices
    targets: Array
    counts: Array

    @classmethod
    def of(cls, base: Problem, poles: Complex) -> Banks:
        """The banks of poles (n_banks, q): pairs side by side, real parts negative."""
        from tridentify.models.compiled_regression import cascades

        poles = np.ascontiguousarray(poles, dtype=np.complex128)
        return cls.made(base, poles, *cascades(poles))

    @classmethod
    def made(cls, base: Problem, poles: Complex, a: Array, b: Array) -> Banks:
        """The banks that are made already."""
        known = given(base, None)
        if known is None or base.flat is None:
            return cls(base, poles, a, b, *_stacked(base, a, b, poles))
        from tridentify.estimation.search.compiled_starts import triangles_on

        stack, targets = triangles_on(*known, a, b)
        return cls(base, poles, a, b, stack, base.flat.which, targets, base.flat.counts)

    def bank(self, k: int) -> Cascade:
        """One of them."""
        return Cascade(self.a[k], self.b[k], self.poles[k])

    @cached_property
    def layout(self) -> Layout:
        """Where things stand among the columns."""
        return _layout(self.base, self.b)

    def orders(self, variants: Sequence[Variant], most: int, fewest: int) -> tuple[Indices, Array]:
        """Number of functions by AICc, summed over the outputs, and its value.

        Parameters
        ----------
        variants : sequence of Variant
        most : int
            Of the bank's states, the first so many are functions of the model.
        fewest : int

        Returns
        -------
        orders, criteria : (n_banks, n_variants) arrays
        """
        from tridentify.estimation.search.compiled_starts import orders_of

        base, layout = self.base, self.layout
        n_experiments, n_inputs = len(self.which), base.n_inputs
        nuisance = np.full((len(variants), 2), -1, dtype=np.int64)
        prices = np.empty((len(variants), most))
        for v, variant in enumerate(variants):
            kept = kept_columns(layout, variant)
            nuisance[v, : len(kept)] = kept
            per_order = n_inputs + variant.free * n_experiments
            shared = 1 + len(kept) * n_experiments + n_inputs * base.biproper
            k = base.n_outputs * (per_order * np.arange(1.0, most + 1.0) + shared)
            prices[v] = aicc_price(k, float(self.counts.sum()))
        free = np.array([variant.free for variant in variants])
        floors = FLOOR * np.asarray(base.size, dtype=np.float64)
        orders = np.zeros((len(self.b), len(variants)), dtype=np.int64)
        criteria = np.zeros(orders.shape)
        alone = [v for v, variant in enumerate(variants) if shifts(variant)]
        plain = [v for v in range(len(variants)) if v not in alone]
        for some in [plain] * bool(plain) + [[v] for v in alone]:
            seen = self.stack if some is plain else self.shifted(variants[some[0]])
            orders[:, some], criteria[:, some] = orders_of(
                seen, self.which, self.targets, free[some], nuisance[some], base.biproper,
                n_inputs, layout.order, most, fewest, int(layout.free), self.counts, floors,
                prices[some],
            )  # fmt: skip
        return orders, criteria

    def shifted(self, variant: Variant) -> Array:
        """The stack with a choice's constants put back on the inputs."""
        stack, which = self.stack, self.which
        layout, q = self.layout, self.b.shape[1]
        if not (layout.free and layout.offset):
            raise ValueError("constants need the impulse states and the constant among the columns")
        found, done = stack.copy(), set[int]()
        for e, (constants, experiment) in enumerate(
            zip(variant.constants, self.base.experiments, strict=True)
        ):
            for i, t in enumerate(which[e].tolist()):
                if constants is None or t in done:
                    continue
                done.add(t)
                one, impulse = stack[:, t, :, layout.nuisance.start], stack[:, t, :, :q]
                for j, value in enumerate(constants.tolist()):
                    lead = 0.0 if experiment.leads is None else float(experiment.leads[i, j])
                    held = held_states(self.a, self.b, impulse, one, lead)
                    found[:, t, :, layout.input_states(j)] += value * held
                    found[:, t, :, layout.direct(j)] += value * one
        return found


def _layout(base: Problem, b: Array) -> Layout:
    e = base.experiments[0]
    return Layout(b.shape[1], base.n_inputs, e.free, e.offset, e.drift)


def _stacked(
    base: Problem, a: Array, b: Array, poles: Complex
) -> tuple[Array, Indices, Array, Array]:
    """Stack, places, targets and counts of experiments that machine code is not given at once."""
    of = [stacks_on(e, a, b, poles) for e in base.experiments]
    every = [one for stacks in of for one in stacks]
    n, height = _layout(base, b).n_signals, max(one.rows.shape[1] for one in every)
    size = (len(of), base.n_outputs)
    stack = np.zeros((len(b), len(every), height, n))
    targets = np.zeros((len(b), *size, height))
    which, counts, t = np.zeros(size, dtype=np.int64), np.zeros(size[1]), 0
    for e, stacks in enumerate(of):
        for one in stacks:
            rows = one.rows.shape[1]
            stack[:, t, :rows] = one.rows[:, :, :n]
            for at, i in enumerate(one.outputs):
                which[e, i] = t
                targets[:, e, i, :rows] = one.rows[:, :, n + at]
                counts[i] += one.counts[at]
            t += 1
    return stack, which, targets, counts


def shifts(variant: Variant) -> bool:
    """Whether a choice puts constants back on the inputs."""
    return any(constant is not None and constant.any() for constant in variant.constants)


def kept_columns(layout: Layout, variant: Variant) -> list[int]:
    """The columns of constant and ramp that a choice keeps."""
    one = layout.nuisance.start
    return [one] * variant.offset + [one + layout.offset] * (variant.drift and layout.drift)


def costs(base: Problem, variant: Variant, poles: Complex) -> Array:
    """Minus two log likelihood at several denominators, as of `likelihood.cost`.

    Parameters
    ----------
    base : Problem
        Whose experiments are filtered.
    variant : Variant
        The nuisance terms that are kept.
    poles : (n_places, n_poles) complex array
        At every place, of each denominator in turn; pairs side by side.

    Returns
    -------
    (n_places,) array
    """
    from tridentify.estimation.search.compiled_starts import banks_at, costs_at

    pattern = base.pattern
    poles = np.ascontiguousarray(poles, dtype=np.complex128)
    a, b, bases = banks_at(poles, pattern.orders, max(pattern.orders.tolist()))
    banks = Banks.made(base, poles, a, b)
    nuisance = np.array(kept_columns(banks.layout, variant), dtype=np.int64)
    floors = FLOOR * np.asarray(base.power, dtype=np.float64)
    return costs_at(
        banks.shifted(variant) if shifts(variant) else banks.stack, banks.which, banks.targets,
        int(banks.layout.free), variant.free, nuisance, *pattern, bases, banks.counts, floors,
    )  # fmt: skip
