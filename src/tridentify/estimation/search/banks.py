"""Several banks of the same order, the records seen through each, and what AICc makes of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from tridentify.estimation.likelihood.charted import Given, given, shifts
from tridentify.estimation.likelihood.fitted_point import FLOOR
from tridentify.estimation.likelihood.setup.problem import Problem, Variant
from tridentify.models.columns import Layout
from tridentify.models.regression import held_states, stacks_on
from tridentify.numerics.arrays import Array, Complex, Flags, Indices
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

    @classmethod
    def ranked(
        cls, base: Problem, poles: Complex, variants: Sequence[Variant], most: int, fewest: int
    ) -> tuple[Banks, Indices, Array]:
        """The banks of poles as of `of`, and what `orders` makes of them, where it can in one call.

        Parameters
        ----------
        base : Problem
        poles : (n_banks, q) complex array
        variants, most, fewest
            As of `orders`.
        """
        asked = asked_of(base, variants, most)
        if asked is None:
            found = cls.of(base, poles)
            return found, *found.orders(variants, most, fewest)
        from tridentify.estimation.search.compiled_beginning import ranked

        poles = np.ascontiguousarray(poles, dtype=np.complex128)
        known, choices, prices, scales = asked
        models = ranked(*known, choices, poles, base.biproper, most, fewest, scales, prices)
        return cls.told(base, poles, models), *models[4:]

    @classmethod
    def told(cls, base: Problem, poles: Complex, models: tuple[Any, ...]) -> Banks:
        """The banks that `compiled_beginning.ranked` has told of."""
        a, b, stack, targets = models[:4]
        assert base.flat is not None
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
        n_inputs = base.n_inputs
        nuisance = np.full((len(variants), 1 + layout.drift), -1, dtype=np.int64)
        for v, variant in enumerate(variants):
            kept = kept_columns(layout, variant)
            nuisance[v, : len(kept)] = kept
        prices = prices_of(base, variants, most, float(self.counts.sum()))
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


class Asked(NamedTuple):
    """What `compiled_beginning.ranked` is given of a problem and choices of nuisance terms.

    Attributes
    ----------
    known : Given
        The problem with all terms.
    choices : tuple
        As `compiled_beginning.CHOICES` says.
    prices : (n_variants, most) array
        Of the unknowns, by the number of functions.
    scales : (2, n_outputs) array
        Samples, and what is added to a mean square.
    """

    known: Given
    choices: tuple[Flags, Indices, Array]
    prices: Array
    scales: Array


def asked_of(base: Problem, variants: Sequence[Variant], most: int) -> Asked | None:
    """The same for up to so many functions; None where machine code does not serve a choice."""
    key = tuple(variants)
    if key not in base.charted:
        base.charted[key] = _asked_of(base, variants)
    found: Asked | None = base.charted[key]
    return found and found._replace(prices=prices_of(base, variants, most))


def _asked_of(base: Problem, variants: Sequence[Variant]) -> Asked | None:
    """But for the prices."""
    known, flat = given(base, None), base.flat
    if known is None or flat is None or any(given(base, one) is None for one in variants):
        return None
    e, none = base.experiments[0], np.zeros(base.n_inputs)
    frees, kept = np.zeros(len(variants), dtype=np.bool_), np.full((len(variants), 1 + e.drift), -1)
    constants = np.zeros((len(variants), len(base.experiments), base.n_inputs))
    for v, variant in enumerate(variants):
        own = [0] * variant.offset
        own += [e.offset + k for k in range(min(variant.drift, e.drift))]
        frees[v], kept[v, : len(own)] = variant.free, own
        if shifts(variant):
            constants[v] = [none if one is None else one for one in variant.constants]
    scales = np.stack([flat.counts, FLOOR * base.size])
    return Asked(known, (frees, kept, constants), np.zeros((0, 0)), scales)


def prices_of(
    base: Problem, variants: Sequence[Variant], most: int, samples: float | None = None
) -> Array:
    """(n_variants, most) what unknowns cost, by the number of functions."""
    e, n_experiments, n_outputs = base.experiments[0], len(base.experiments), base.n_outputs
    if samples is None:
        assert base.flat is not None
        samples = float(base.flat.counts.sum())
    rows = []
    for one in variants:
        kept = one.offset + min(one.drift, e.drift)
        per_order = base.n_inputs + one.free * n_experiments
        shared = 1 + kept * n_experiments + base.n_inputs * base.biproper
        rows.append(_prices(n_outputs * per_order, n_outputs * shared, most, samples))
    return np.array(rows)


@lru_cache(maxsize=64)
def _prices(per_order: int, shared: int, most: int, samples: float) -> Array:
    """For one choice; nobody may write into them."""
    return aicc_price(per_order * np.arange(1.0, most + 1.0) + shared, samples)


def kept_columns(layout: Layout, variant: Variant) -> list[int]:
    """The columns of constant and drift that a choice keeps."""
    one = layout.nuisance.start
    first = one + layout.offset
    return [one] * variant.offset + [*range(first, first + min(variant.drift, layout.drift))]


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
