"""The bank that a cost is worked out on: the poles of every denominator, several times over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tridentify.estimation.likelihood.setup.problem import Pattern
from tridentify.models.response import Branch
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.kept import cached_property
from tridentify.numerics.realization import Cascade, DegreeBasis


@dataclass(frozen=True, eq=False)
class Bank:
    """Poles repeated, a cascade for each denominator beside the others.

    Attributes
    ----------
    pattern : Pattern
    poles : (n_poles,) complex array
        Once, group by group.
    repeats : int
    cascade : Cascade
        All states (q).
    basis : (n_poles, largest order) array
        Each group's numerators sorted by degree.
    leading : (n_poles,) array
        Leading coefficients of the basis.
    maps : flat array
        How the filter of each group answers to the states of its bank.
    """

    pattern: Pattern
    poles: Complex
    repeats: int
    cascade: Cascade
    basis: Array
    leading: Array
    maps: Array

    @classmethod
    def of(cls, pattern: Pattern, poles: Complex, repeats: int) -> Bank:
        """The bank of admissible poles.

        Raises
        ------
        ValueError
            If a pole is not in the open left half plane or a pair is torn apart.
        """
        from tridentify.numerics.kernels.cascades import bank_parts

        poles = np.ascontiguousarray(poles, dtype=np.complex128)
        parts = bank_parts(poles, pattern.orders, repeats, max(pattern.orders.tolist()))
        return cls.made(pattern, poles, repeats, *parts)

    @classmethod
    def made(
        cls,
        pattern: Pattern,
        poles: Complex,
        repeats: int,
        a: Array,
        b: Array,
        basis: Array,
        leading: Array,
        maps: Array,
    ) -> Bank:
        """The bank whose parts are there, as of `numerics.kernels.cascades.bank_parts`."""
        orders = pattern.orders
        if orders.size == 1:
            every = np.concatenate([poles] * repeats)
        else:
            starts = zip(pattern.firsts.tolist(), orders.tolist(), strict=True)
            every = np.concatenate([np.tile(poles[at : at + n], repeats) for at, n in starts])
        return cls(pattern, poles, repeats, Cascade(a, b, every), basis, leading, maps)

    @cached_property
    def branches(self) -> tuple[Branch, ...]:
        """The part of the bank that belongs to each denominator."""
        pattern, found = self.pattern, []
        starts = zip(
            pattern.firsts.tolist(), pattern.orders.tolist(), pattern.channels, strict=True
        )
        for g, (at, n, channels) in enumerate(starts):
            poles = slice(at, at + n)
            states = slice(at * self.repeats, (at + n) * self.repeats)
            a, b, every = self.cascade
            own = Cascade(np.ascontiguousarray(a[states, states]), b[states], every[states])
            basis = DegreeBasis(self.basis[poles, :n], self.leading[poles])
            found.append(Branch(self.inners[g], own, basis, states, poles, channels))
        return tuple(found)

    @cached_property
    def inners(self) -> tuple[Cascade, ...]:
        """The poles of each denominator once: the first states of its part of the bank."""
        found = []
        for first, n in zip(
            self.pattern.firsts.tolist(), self.pattern.orders.tolist(), strict=True
        ):
            at = first * self.repeats
            a = np.ascontiguousarray(self.cascade.a[at : at + n, at : at + n])
            found.append(Cascade(a, self.cascade.b[at : at + n], self.poles[first : first + n]))
        return tuple(found)
