"""The parallel model, fitted once, and starting poles for every candidate from it.

Step 1 (`models.parallel`) asks for no order: a weighted sum of fixed operators, fitted by one
linear least-squares problem, holds all that the record says about any model in their span. So it
is fitted once, on the Laguerre and the spread operators of `search.starts`, and the candidates
share it: balanced truncation (Moore 1981; the controllability Gramian of the operators is the
identity) gives poles of every order ``n`` at the cost of one small eigenvalue problem.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from tridentify.errors import TooFewSamplesError
from tridentify.estimation.likelihood.nuisance import build_base, candidates
from tridentify.estimation.search.starts import ParallelStart, laguerre_starts, spread_starts
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.realization import sort_poles
from tridentify.record.record import Record
from tridentify.structure import Structure

APART = 2.0
"""Ratio of rates from which two Laguerre starts are two."""


@dataclass(frozen=True, eq=False)
class Shared:
    """Parallel models of one record on different operators, the best by AICc first."""

    models: tuple[ParallelStart, ...]

    def seeds(self, order: int) -> tuple[Complex, ...]:
        """Poles of one order by balanced truncation of each model that has as many operators.

        Parameters
        ----------
        order : int

        Returns
        -------
        tuple of (order,) complex arrays
            Stable; not yet held to what a record can show.
        """
        found = (reduced_poles(model, order) for model in self.models)
        return tuple(poles for poles in found if poles is not None)


def shared_models(records: Sequence[Record], structures: Sequence[Structure]) -> Shared | None:
    """Fit the parallel models that serve all candidates with one denominator.

    Parameters
    ----------
    records : sequence of Record
    structures : sequence of Structure

    Returns
    -------
    Shared or None
        None where no candidate can use them.
    """
    sharing = [s for s in structures if s.shared]
    if not sharing:
        return None
    longest = max(s.common_poles for s in sharing)
    first = sharing[0]
    biproper = any(_is_biproper(s, records[0]) for s in sharing)
    for n in range(longest, 0, -1):
        widest = Structure(
            n,
            n if biproper else n - 1,
            delay=0.0 if first.delay == "free" else first.delay,
            offset=first.offset,
            drift=first.drift,
            initial_state=first.initial_state,
        )
        try:
            base, variants = build_base(records, widest, candidates(records, widest))
        except TooFewSamplesError:
            continue
        fullest = variants[-1:]
        laguerre = laguerre_starts(base, fullest)
        spread = spread_starts(base, fullest)
        kept = laguerre[:1]
        kept += [s for s in laguerre if not 1 / APART < s.rate / kept[0].rate < APART][:1]
        kept += spread[:1]
        return Shared(tuple(sorted(kept, key=lambda one: one.criterion)))
    return None


def reduced_poles(model: ParallelStart, order: int) -> Complex | None:
    """Balanced truncation of a parallel model to one denominator."""
    k = model.order
    if k < order:
        return None
    a = model.bank.a[:k, :k]
    c = weighted_rows(model)
    gramian = scipy.linalg.solve_continuous_lyapunov(a.T, -(c.T @ c))
    vectors = np.linalg.eigh(0.5 * (gramian + gramian.T))[1][:, -order:]
    return sort_poles(np.linalg.eigvals(vectors.T @ a @ vectors).astype(np.complex128))


def weighted_rows(model: ParallelStart) -> Array:
    """(n_outputs n_inputs, k) weights of the operators, over the noise, times the input's size.

    The channels count as outputs of one system with one input, whose order is that of the common
    denominator.
    """
    return np.asarray(
        (model.reduction.rows[:, :, : model.order] * scales(model)[:, :, None]).reshape(
            -1, model.order
        )
    )


def scales(model: ParallelStart) -> Array:
    """(n_outputs, n_inputs) root mean square of the input over that of the noise."""
    problem = model.problem
    samples = sum(e.n_samples for e in problem.experiments)
    noise = np.sqrt(model.reduction.costs / samples + 1e-30 * problem.size)
    energy = np.sum([np.sum((e.u - e.u.mean(axis=0)) ** 2, axis=0) for e in problem.experiments], 0)
    size = np.sqrt(energy / samples)
    return np.asarray(np.where(size > 0, size, 1.0)[None, :] / noise[:, None])


def _is_biproper(structure: Structure, record: Record) -> bool:
    zeros = structure.zeros_matrix(record.n_outputs, record.n_inputs)
    return any(m == structure.common_poles for row in zeros for m in row)
