"""Where the passes begin: parallel models on fixed operators, reduced to the order asked for.

*Laguerre.* For each ``gamma`` on a logarithmic grid from the slowest to the fastest rate the
record can show, the record is filtered once through ``L + n + 1`` Laguerre functions. Functions
are nested, so the residuals of all orders ``1 .. L`` follow from one triangle, and AICc picks
the order; its value at that order ranks the grid.

*Spread.* Where one ``gamma`` cannot serve (poles decades apart, light damping), the operators
are the orthonormal functions on poles spread over the whole band, real or in lightly damped
pairs.

Either parallel model is then turned into poles of ``a`` in two ways, both convex or direct:

1. Step 2 with the paper's kind of filter, ``c = (p + gamma)^(n + 1)``; its functions are the
   next ones of the same bank, so it needs no further pass over the samples.
2. Balanced truncation. The controllability Gramian of the bank is the identity, so with ``Q`` the
   observability Gramian of the fitted weights and ``V`` its ``n`` leading eigenvectors (the
   Hankel singular values are the roots of the eigenvalues) the reduced model has the poles
   ``eig(V' A V)``: always stable, whatever the noise (Moore 1981; Antoulas 2005, section 7.2).

The one with the lower output-error cost is followed. A grid point costs one pass over the
samples; nothing here is iterative.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tridentify.estimation.likelihood.charted import shifts
from tridentify.estimation.likelihood.setup.problem import Problem, Variant
from tridentify.estimation.search.band import (
    SPREAD_DAMPING,
    rate_limits,
    spread_between,
    spread_poles,
)
from tridentify.estimation.search.banks import Banks, kept_columns
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.kept import cached_property
from tridentify.numerics.least_squares import solve, triangle
from tridentify.numerics.realization import Cascade, sort_poles
from tridentify.numerics.slices import Slices, drain

TOGETHER = 4_000  # samples filtered through a bank each; more take some milliseconds at once
PER_DECADE = 3.0
"""Rates of Laguerre functions in a decade: neighbours are a factor of two apart."""
MOST_FUNCTIONS = 12
"""Most Laguerre functions; AICc says how many."""
MOST_SPREAD = 30
"""Poles spread over the band, some nine a decade of a record of a few thousand samples."""


class Reduction(NamedTuple):
    """What `compiled_reduction.reductions` gives."""

    rows: Array
    costs: Array
    together: Complex
    alone: Complex
    shortened: Complex


@dataclass(frozen=True, eq=False)
class ParallelStart:
    """A parallel model on fixed operators, fitted but for its weights.

    Attributes
    ----------
    label : str
        The operators in words.
    base : Problem
        The problem whose experiments are filtered.
    variant : Variant
        How to get from one to the other.
    order : int
        Number of operators.
    criterion : float
        AICc.
    rate : float
        Typical pole of the operators [rad/s].
    filters : tuple of (k,) complex arrays
        The filter ``c`` of Step 2 for each denominator, whose poles follow the operators in the
        bank (empty: no Step 2).
    banks : Banks
    place : int
        Which of them.
    """

    label: str
    base: Problem
    variant: Variant
    order: int
    criterion: float
    rate: float
    filters: tuple[Complex, ...]
    banks: Banks
    place: int

    @property
    def name(self) -> str:
        """In words."""
        return f"{self.label}, order {self.order}"

    @property
    def problem(self) -> Problem:
        """With the nuisance terms that are estimated along; its experiments are the base's."""
        return self.variant.problem(self.base)

    @property
    def bank(self) -> Cascade:
        """The operators, and the poles of the filters."""
        return self.banks.bank(self.place)

    @cached_property
    def reduction(self) -> Reduction:
        """Step 1, and the poles that the model is reduced to in every way."""
        from tridentify.estimation.search.compiled_reduction import reductions

        problem, banks, variant, filters = self.problem, self.banks, self.variant, self.filters
        stack = banks.shifted(variant) if shifts(variant) else banks.stack
        orders, _, group, zeros = problem.pattern
        found = reductions(
            stack[self.place],
            banks.which,
            banks.targets[self.place],
            int(banks.layout.free),
            variant.free,
            np.array(kept_columns(banks.layout, variant), dtype=np.int64),
            self.order,
            problem.biproper,
            self.bank.a,
            self.bank.b,
            group,
            zeros,
            orders,
            np.array([one.size for one in filters], dtype=np.int64),
            np.concatenate(filters) if filters else np.zeros(0, dtype=np.complex128),
            float(sum(e.n_samples for e in problem.experiments)),
            1e-30 * problem.size,
        )
        return Reduction(*found)

    def candidates(self) -> list[Complex]:
        """Admissible poles by Step 2 and by balanced truncation."""
        found = [self.filtered_poles(), self.filtered_poles(alone=True), self.reduced_poles()]
        return [poles for poles in found if poles is not None]

    def filtered_poles(self, *, alone: bool = False) -> Complex | None:
        """Step 2 on the parallel model's output: admissible roots of ``a``.

        Parameters
        ----------
        alone : bool
            Every denominator from its own part of the output, not all from their sum; None where
            there is but one.
        """
        found = self.reduction.alone if alone else self.reduction.together
        return self.problem.admissible(found)[0] if found.size else None

    def reduced_poles(self) -> Complex | None:
        """Balanced truncation of every denominator's part of the parallel model."""
        found = self.reduction.shortened
        return self.problem.admissible(found)[0] if found.size else None


def discrete_poles(base: Problem) -> Complex:
    """Poles of a discrete-time least-squares model of the raw record.

    ``y_k + sum_i a_i y_{k-i} = sum_i b_i u_{k-i} + e`` with one ``a`` for all outputs, solved
    by QR; ``log(z) / dt`` of its roots. Biased by any noise, and useless for much of it, but
    exact without: what the other starts may miss on a clean record of high order, this one
    finds.

    Parameters
    ----------
    base : Problem

    Returns
    -------
    (n,) complex array
        Admissible poles [rad/s].
    """
    n, n_outputs = base.n_poles, base.n_outputs
    scale = np.sqrt(np.where(base.power > 0, base.power, 1.0))
    parts = []
    dt = base.experiments[0].dt
    for e in base.experiments:
        same = e.t is None and math.isclose(e.dt, dt, rel_tol=1e-6)
        if e.n_samples <= 2 * n + 2 or not same:
            continue
        for i in range(n_outputs):
            lags = sliding_window_view(e.sampled[i].direct, n + 1, axis=0)[:, :, ::-1]
            inputs = np.column_stack([lags.reshape(lags.shape[0], -1), np.ones(lags.shape[0])])
            y = sliding_window_view(e.y[:, i] / scale[i], n + 1)[:, ::-1]
            seen = np.isfinite(y).all(axis=1)
            if seen.sum() <= 2 * n:
                continue
            block = np.zeros((int(seen.sum()), inputs.shape[1] * n_outputs))
            block[:, i * inputs.shape[1] : (i + 1) * inputs.shape[1]] = inputs[seen]
            parts.append(np.column_stack([block, y[seen, 1:], y[seen, :1]]))
    if not parts:
        return base.admissible(-np.geomspace(*rate_limits(base), n).astype(np.complex128))[0]
    r = triangle(np.vstack(parts))
    if r.shape[0] < r.shape[1]:
        return base.admissible(-np.geomspace(*rate_limits(base), n).astype(np.complex128))[0]
    corner = r[-n - 1 :, -n - 1 :]
    a = solve(corner[:, :-1], -corner[:, -1]).x
    z = np.roots(np.concatenate([[1.0], a])).astype(np.complex128)
    z = np.where(z.imag == 0, np.abs(z) + 0j, z)
    z = np.where(np.abs(z) < 1e-12, 1e-12 + 0j, z)
    return base.admissible(sort_poles(np.asarray(np.log(z) / dt, dtype=np.complex128)))[0]


def laguerre_starts(base: Problem, variants: Sequence[Variant]) -> list[ParallelStart]:
    """Parallel models over the grid and over choices of nuisance terms, the best by AICc first.

    Parameters
    ----------
    base : Problem
        With every nuisance term that a variant has.
    variants : sequence of Variant
        Choices of nuisance terms.

    Returns
    -------
    list of ParallelStart
        One per grid point and variant.
    """
    return drain(laguerre_slices(base, variants))


def laguerre_slices(base: Problem, variants: Sequence[Variant]) -> Slices[list[ParallelStart]]:
    """`laguerre_starts` in slices, as many as there are grid points."""
    found: list[ParallelStart] = []
    rates = _rates(base)
    together = max(1, TOGETHER // max(1, sum(e.n_samples for e in base.experiments)))
    for first in range(0, rates.size, together):
        some = rates[first : first + together]
        yield from (None for _ in some)
        found += _laguerre(base, variants, some)
    return sorted(found, key=lambda start: start.criterion)


def best_laguerre(base: Problem, variant: Variant) -> ParallelStart:
    """The best of every second point of the grid and of its neighbours: nearly always the best.

    Parameters
    ----------
    base : Problem
    variant : Variant
        Choice of nuisance terms.

    Returns
    -------
    ParallelStart
        To be reduced by balanced truncation: its bank has no filters for Step 2.
    """
    rates = _rates(base)

    def at(places: list[int]) -> dict[int, ParallelStart]:
        models = _laguerre(base, [variant], rates[places], False)
        return dict(zip(places, models, strict=True))

    found = at(list(range(0, rates.size, 2)))
    best = min(found, key=lambda k: found[k].criterion)
    found |= at([k for k in (best - 1, best + 1) if 0 <= k < rates.size])
    return min(found.values(), key=lambda start: start.criterion)


def _rates(base: Problem) -> Array:
    """The grid [rad/s]."""
    return _grid(*rate_limits(base))


@lru_cache(maxsize=32)
def _grid(low: float, high: float) -> Array:
    count = max(4, int(np.ceil(PER_DECADE * np.log10(high / low))) + 1)
    return np.geomspace(low, high, count)


def _laguerre(
    base: Problem, variants: Sequence[Variant], rates: Array, filtered: bool = True
) -> list[ParallelStart]:
    """Points of the grid, with the filters of Step 2 or without."""
    gammas = -rates.astype(np.complex128)
    poles = np.repeat(gammas[:, None], _most(base, MOST_FUNCTIONS), axis=1)
    groups = base.groups if filtered else ()
    filters = [tuple(np.full(g.order + 1, gamma) for g in groups) for gamma in gammas]
    labels = [laguerre_label(rate) for rate in rates]
    return _starts(base, variants, poles, filters, rates.tolist(), labels)


def laguerre_label(rate: float) -> str:
    """The operators in words."""
    return f"Laguerre {rate:.3g} rad/s"


def laguerre_poles(base: Problem) -> tuple[Complex, int]:
    """The whole grid with the filter of one denominator behind, and the number of functions."""
    most = _most(base, MOST_FUNCTIONS)
    return _grid_poles(*rate_limits(base), most + base.n_poles + 1), most


@lru_cache(maxsize=32)
def _grid_poles(low: float, high: float, count: int) -> Complex:
    """For alike records; nobody may write into them."""
    return np.repeat(-_grid(low, high).astype(np.complex128)[:, None], count, axis=1)


def spread_starts(base: Problem, variants: Sequence[Variant]) -> list[ParallelStart]:
    """Parallel models on poles spread over the whole band, the best by AICc first.

    Parameters and result as for `laguerre_starts`.
    """
    return drain(spread_slices(base, variants))


def spread_slices(base: Problem, variants: Sequence[Variant]) -> Slices[list[ParallelStart]]:
    """`spread_starts` in slices, one a damping."""
    low, high = rate_limits(base)
    found: list[ParallelStart] = []
    for damping in SPREAD_DAMPING:
        yield
        poles = spread_poles(base, damping, _most(base, MOST_SPREAD))[None]
        labels = [f"poles spread over the band, damping {damping:g}"]
        rates = [float(np.sqrt(low * high))]
        found += _starts(base, variants, poles, [()], rates, labels, whole=True)
    return sorted(found, key=lambda start: start.criterion)


def enriched_starts(base: Problem, variant: Variant, poles: Complex) -> Slices[list[ParallelStart]]:
    """Parallel models on known poles, twice each, and a spread: what the known ones still miss.

    In slices, one a damping.

    Parameters
    ----------
    base : Problem
    variant : Variant
        Choice of nuisance terms.
    poles : (n,) complex array
        The best so far; also the filter of Step 2.

    Returns
    -------
    list of ParallelStart
        The best by AICc first.
    """
    low, high = rate_limits(base)
    found: list[ParallelStart] = []
    rate, filters = float(np.sqrt(low * high)), base.split(poles)
    for dampings, spread in _spreads(low, high, _most(base, MOST_SPREAD) // 2):
        yield from (None for _ in dampings)
        n = len(dampings)
        operators = np.hstack([np.tile(poles, (n, 2)), spread])
        labels = [f"the poles so far and a spread, damping {damping:g}" for damping in dampings]
        found += _starts(base, [variant], operators, [filters] * n, [rate] * n, labels, whole=True)
    return sorted(found, key=lambda start: start.criterion)


@lru_cache(maxsize=32)
def _spreads(low: float, high: float, count: int) -> list[tuple[list[float], Complex]]:
    """Dampings that give as many poles, and these; nobody may write into them."""
    sets: dict[int, list[float]] = {}
    for damping in SPREAD_DAMPING:
        sets.setdefault(spread_between(low, high, damping, count).size, []).append(damping)
    return [
        (alike, np.stack([spread_between(low, high, one, count) for one in alike]))
        for alike in sets.values()
    ]


def parallel_criteria(problem: Problem, rates: Array, most: int) -> Array:
    """AICc of the best parallel model on up to ``most`` Laguerre functions of each rate."""
    most = _most(problem, most)
    fewest = min(max(group.order for group in problem.groups) + 1, most)
    poles = np.repeat(-rates.astype(np.complex128)[:, None], most, axis=1)
    e = problem.experiments[0]
    same = Variant(e.free, e.offset, e.drift, (None,) * len(problem.experiments))
    return Banks.of(problem, poles).orders([same], most, fewest)[1][:, 0]


def _most(base: Problem, limit: int) -> int:
    samples = sum(e.n_samples for e in base.experiments)
    fewest = max(group.order for group in base.groups) + 1
    return max(fewest, min(limit, samples // (3 * base.n_inputs)))


def _starts(
    base: Problem,
    variants: Sequence[Variant],
    poles: Complex,
    filters: Sequence[tuple[Complex, ...]],
    rates: Sequence[float],
    labels: Sequence[str],
    *,
    whole: bool = False,
) -> list[ParallelStart]:
    """Several banks with as many operators each, every choice of nuisance terms."""
    most = poles.shape[1]
    every = np.hstack([poles, np.stack([_covering(own) for own in filters])])
    fewest = most if whole else fewest_functions(base, most)
    banks, orders, criteria = Banks.ranked(base, every, variants, most, fewest)
    return [
        ParallelStart(label, base, variant, order, criterion, rates[k], filters[k], banks, k)
        for k, (label, own, prices) in enumerate(
            zip(labels, orders.tolist(), criteria.tolist(), strict=True)
        )
        for variant, order, criterion in zip(variants, own, prices, strict=True)
    ]


def fewest_functions(base: Problem, most: int) -> int:
    """That a parallel model has, to be reduced to the poles asked for."""
    return min(max(group.order for group in base.groups) + 1, most)


def _covering(filters: Sequence[Complex]) -> Complex:
    """Poles that hold those of every filter: the longest where they repeat one, else all."""
    if len(filters) < 2:
        return filters[0] if filters else np.zeros(0, dtype=np.complex128)
    longest = max(filters, key=len)
    if all(np.array_equal(longest[: own.size], own) for own in filters):
        return longest
    return np.concatenate(filters)
