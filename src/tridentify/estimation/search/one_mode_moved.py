"""Another place for one pole or pair, the others held: the way out of a local minimum.

The output-error cost has many minima. Those that a search ends in by mistake are mostly of one
kind: all of the model is right but one mode, and that one was spent on the noise or on a detail
while a weak resonance elsewhere goes unexplained. A test with a rich parallel model does not see
it, as such a mode lowers ``-2 log L`` by 10 or 50 and the parallel model pays ``2 k`` for its ``k``
functions. A scan does: with the other poles held, one pair is taken round the whole band, at
light and at medium damping, and a real pole likewise. Numerators and nuisance terms are
eliminated at every place (variable projection; Golub & Pereyra 1973), so the cost along such a
line is exact, and its local minima that come near the best cost are the starts worth following.

The step of the grid is twice the half-power bandwidth, ``w (1 + 4 zeta)`` from ``w``: a mode
between two places is within ``2 zeta w`` of one.

Every place is a small bank of its own; those of one line are filtered and solved in one call.
"""

from __future__ import annotations

import itertools
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from tridentify.estimation.likelihood.setup.problem import Problem, Variant
from tridentify.estimation.search.band import rate_limits
from tridentify.estimation.search.banks import costs
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.realization import sort_poles
from tridentify.numerics.slices import Slices, drain

DAMPINGS = (0.1, 0.5)
"""Light and medium damping, for which the grid's step is 1.4 and 3."""
REAL_STEP = 2.2
"""Ratio of neighbouring real poles: within a factor of 1.5 of one lies every rate."""
FARTHER = 3.0
"""How far beyond the band's fast edge places are tried: to two thirds of the Nyquist frequency."""
TOGETHER = 16  # places; of long records more take some milliseconds at once


class Move(NamedTuple):
    """A local minimum along a line: its cost, and the poles that moved, then and before."""

    objective: float
    place: Complex
    before: Complex
    poles: Complex


def moved_poles(base: Problem, variant: Variant, poles: Complex) -> list[Move]:
    """Local minima of the cost along every line on which one pole or pair moves.

    Parameters
    ----------
    base : Problem
        Whose experiments are filtered.
    variant : Variant
        The nuisance terms that are kept.
    poles : (n,) complex array
        Where a search ended; of each denominator slow to fast with pairs side by side.

    Returns
    -------
    list of Move
        The lowest first; the objective is that of `likelihood.cost`.
    """
    return drain(moving_poles(base, variant, poles))


def moving_poles(base: Problem, variant: Variant, poles: Complex) -> Slices[list[Move]]:
    """`moved_poles` in slices, ``TOGETHER`` places in each."""
    low, high = rate_limits(base)
    found: list[Move] = []
    for k, denominator in enumerate(base.groups):
        own = poles[denominator.poles]
        for group in _groups(own):
            kept = np.delete(own, group)
            lines = _lines(len(group), low, FARTHER * high)
            for line in lines:
                parts = []
                for first in range(0, len(line), TOGETHER):
                    yield
                    some = line[first : first + TOGETHER]
                    parts.append(place_costs(base, variant, kept, some, (k, poles)))
                along = np.concatenate(parts)
                around = np.concatenate([[np.inf], along, [np.inf]])
                for at in np.flatnonzero((along <= around[:-2]) & (along < around[2:])):
                    moved = poles.copy()
                    moved[denominator.poles] = sort_poles(np.concatenate([kept, line[at]]))
                    whole = base.admissible(moved)[0]
                    found.append(Move(float(along[at]), line[at], own[list(group)], whole))
    return sorted(found, key=lambda one: one.objective)


def place_costs(
    base: Problem,
    variant: Variant,
    kept: Complex,
    places: list[Complex],
    whole_poles: tuple[int, Complex] | None = None,
) -> Array:
    """(n_places,) minus two log likelihood with the kept poles and those of each place.

    Parameters
    ----------
    base : Problem
    variant : Variant
    kept : (n - width,) complex array
        Poles of the denominator that moves, but for those that do.
    places : list of (width,) complex arrays
    whole_poles : (int, (n_poles,) complex array), optional
        Which denominator moves, and the poles of all (default: there is only one).
    """
    moving, poles = (0, kept) if whole_poles is None else whole_poles
    before, after = base.groups[moving].first, base.groups[moving].poles.stop
    rest = kept if whole_poles is None else np.concatenate([poles[:before], kept])
    beyond = poles[after:] if whole_poles is not None else kept[:0]
    sets = [np.concatenate([rest, place, beyond]) for place in places]
    return costs(base, variant, np.stack(sets))


def _groups(poles: Complex) -> list[tuple[int, ...]]:
    """Which poles move together: a pair, two real poles that could become one, a single real pole.

    Of more than two real poles those that are neighbours, and the two at the ends.
    """
    pairs: list[tuple[int, ...]] = [(k, k + 1) for k in range(poles.size) if poles[k].imag > 0]
    real = [int(k) for k in np.flatnonzero(poles.imag == 0)]
    pairs += itertools.pairwise(real)
    if len(real) > 2:
        pairs.append((real[0], real[-1]))
    return pairs + [(k,) for k in real]


@lru_cache(maxsize=16)
def _lines(count: int, low: float, high: float) -> tuple[list[Complex], ...]:
    """The places for one real pole, or for a pair at each damping; the same for alike records."""
    if count == 1:
        return ([np.array([-rate + 0j]) for rate in _grid(low, high, REAL_STEP)],)
    turns = (complex(-damping, np.sqrt(1.0 - damping**2)) for damping in DAMPINGS)
    grids = (_grid(low, high, 1.0 + 4.0 * damping) for damping in DAMPINGS)
    return tuple(
        [rate * np.array([turn, turn.conjugate()]) for rate in rates]
        for turn, rates in zip(turns, grids, strict=True)
    )


def _grid(low: float, high: float, step: float) -> Array:
    return np.geomspace(low, high, int(np.ceil(np.log(high / low) / np.log(step))) + 1)
