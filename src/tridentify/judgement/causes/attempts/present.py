"""The present explanation of some records, and others made from it by a change of one thing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tridentify.estimation.likelihood.setup.nuisance import Nuisances, build, with_terms
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.numerics.arrays import Array, Complex
from tridentify.record.record import Record
from tridentify.structure import Structure

Zeros = tuple[tuple[int, ...], ...]


@dataclass(frozen=True, eq=False)
class Present:
    """A model on some records: what other explanations are made from.

    Attributes
    ----------
    records : tuple of Record
        With the behaviour of their inputs settled.
    order : int or tuple of tuples of int
        Numbers of poles, as in `Structure`.
    zeros : tuple of tuples of int
        ``[output][input]``.
    delay : (n_outputs, n_inputs) array
        [s].
    nuisances : Nuisances
    noise : tuple of (p,) arrays
        Autoregressive coefficients of each output's noise.
    poles : (n_poles,) complex array
        [rad/s], group by group.
    """

    records: tuple[Record, ...]
    order: int | tuple[tuple[int, ...], ...]
    zeros: Zeros
    delay: Array
    nuisances: Nuisances
    noise: tuple[Array, ...]
    poles: Complex

    @classmethod
    def of(
        cls,
        records: Sequence[Record],
        structure: Structure,
        delay: Array,
        nuisances: Nuisances,
        noise: Sequence[Array],
        poles: Complex,
    ) -> Present:
        """With the orders of a structure."""
        shape = records[0].n_outputs, records[0].n_inputs
        zeros = tuple(tuple(row) for row in structure.zeros_matrix(*shape))
        order = structure.poles
        if not isinstance(order, int):
            order = tuple(tuple(row) for row in order)
        return cls(
            tuple(records), order, zeros, np.array(delay), nuisances, tuple(noise), np.array(poles)
        )

    def is_same(self, other: Present) -> bool:
        """Whether other explanations made from this one are those of the other."""
        mine, others = (
            [one.delay, one.poles, *one.noise, *(a for r in one.records for a in (r.t, r.u, r.y))]
            for one in (self, other)
        )
        alike = (self.order, self.zeros) == (other.order, other.zeros)
        alike &= self.nuisances == other.nuisances
        alike &= [r.behaviour for r in self.records] == [r.behaviour for r in other.records]
        pairs = zip(mine, others, strict=False)
        return bool(
            alike
            and len(mine) == len(others)
            and all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)
        )

    @property
    def orders(self) -> tuple[int, ...]:
        """Of the noise models."""
        return tuple(a.size for a in self.noise) if self.has_noise else (0,) * self.n_outputs

    @property
    def has_noise(self) -> bool:
        """Whether the noise has a model that the samples allow."""
        even = all(record.dt is not None for record in self.records)
        return even and any(a.size for a in self.noise)

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return self.records[0].n_outputs

    @property
    def step(self) -> float:
        """Typical sampling interval [s]."""
        first = self.records[0]
        return float(np.median(np.diff(first.t))) if first.dt is None else float(first.dt)

    def problem(self) -> Problem:
        """What the estimators work on."""
        delay = tuple(map(tuple, self.delay.tolist()))
        structure = with_terms(self.order, self.zeros, delay, self.nuisances)
        problem = build(self.records, structure, self.nuisances)
        return problem.whitened(self.noise) if self.has_noise else problem

    def acted(self, j: int, signal: Callable[[Record], Array]) -> Present:
        """The same where something else acted than one of the recorded inputs.

        Parameters
        ----------
        j : int
            Which one.
        signal : callable
            Gives, for a record, the (n_samples,) array of what acted.
        """
        records = []
        for record in self.records:
            u = np.array(record.u)
            u[:, j] = signal(record)
            records.append(record._derive(u=u))
        return replace(self, records=tuple(records))

    def with_inputs(self, extra: Sequence[Array], name: str, zeros: int) -> Present:
        """The same with one more input.

        Parameters
        ----------
        extra : sequence of (n_samples,) arrays
            Per experiment.
        name : str
            Of the input; marked where a channel is called so.
        zeros : int
            Of its numerator.
        """
        records = []
        while name in (*self.records[0].input_names, *self.records[0].output_names):
            name += "'"
        for record, own in zip(self.records, extra, strict=True):
            scale = float(np.max(np.abs(own), initial=0.0)) or 1.0
            u = np.column_stack([record.u, own / scale])
            records.append(
                Record(
                    u,
                    record.y,
                    t=record.t,
                    intersample=record.intersample,
                    **record._loop,
                    input_names=(*record.input_names, name),
                    output_names=record.output_names,
                )._weighed(record._noise_scale)
            )
        return replace(
            self,
            records=tuple(records),
            zeros=tuple((*row, zeros) for row in self.zeros),
            delay=np.column_stack([self.delay, np.zeros(self.n_outputs)]),
        )
