"""What is asked of some records, resolved once: what the steps of the strategy hand to each other.

A question holds the records, the structure, the choices of nuisance terms that the structure leaves
open, and the one problem that contains them all. It is not changed: on whitened samples, or with
delays that may move, it is another question.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from tridentify.estimation.likelihood.cost import Point
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import Patience
from tridentify.estimation.likelihood.setup.nuisance import Nuisances, build, build_base, candidates
from tridentify.estimation.likelihood.setup.problem import Problem, Variant
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record
from tridentify.structure import Structure

Say = Callable[[str], None]


def silently(words: str) -> None:
    """Tell nobody."""


@dataclass(frozen=True, eq=False)
class Question:
    """Records and a structure, made ready for the estimators.

    Attributes
    ----------
    records : tuple of Record
    structure : Structure
        With delays that are known.
    choices : tuple of Nuisances
        Of offset, drift and initial state, the leanest first.
    base : Problem
        Holds every choice.
    variants : tuple of Variant
        Each choice as a part of ``base``.
    patience : Patience
        With the steps on the output error, for each choice.
    say : callable
        Is told what is going on.
    """

    records: tuple[Record, ...]
    structure: Structure
    choices: tuple[Nuisances, ...]
    base: Problem
    variants: tuple[Variant, ...]
    patience: Patience
    say: Say

    @classmethod
    def of(
        cls,
        records: Sequence[Record],
        structure: Structure,
        *,
        patience: Patience = Patience(),  # noqa: B008 - frozen
        say: Say = silently,
    ) -> Question:
        """Resolve what the structure leaves open.

        Raises
        ------
        ConstantInputError, TooFewSamplesError, DelayError
            As `nuisance.candidates`.
        """
        choices = candidates(records, structure)
        base, variants = build_base(records, structure, choices)
        return cls(tuple(records), structure, choices, base, variants, patience, say)

    @property
    def held(self) -> Question:
        """With delays that stay where they are."""
        return replace(self, base=self.base.freed(None))

    def delayed(self, delays: Array) -> Question:
        """With other delays [s], one an input."""
        return replace(self, base=self.base.delayed(delays))

    def freed(self, limits: Array | None) -> Question:
        """With delays that are estimated along, up to limits [s]."""
        return replace(self, base=self.base.freed(limits))

    def ended(self, point: Point) -> Question:
        """With the delays of an end, where they are estimated along."""
        return self if self.base.limits is None else self.delayed(point.problem.delays)

    def whitened(self, noise: Sequence[Array]) -> Question:
        """On samples whitened by autoregressions, one an output."""
        return replace(self, base=self.base.whitened(tuple(noise)))

    def variant_of(self, nuisances: Nuisances) -> Variant:
        """A choice as a part of the base."""
        return self.variants[self.choices.index(nuisances)]

    def chosen(self, nuisances: Nuisances) -> Problem:
        """The problem of one choice alone."""
        shifted = nuisances.initial_state == "free" and nuisances.offset
        if len(self.choices) == 1 and not shifted:
            return self.base
        problem = build(self.records, self.structure, nuisances).whitened(self.base.noise)
        if self.base.limits is not None:
            problem = problem.delayed(self.base.delays).freed(self.base.limits)
        return problem
