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

All places share one pass over the samples. With ``(A_1, B_1)`` the cascade of the poles that stay
and ``(A_s, B_s)`` the section of place ``s``, both driven as in a cascade, the bank

    A = [A_1, 0; -[B_s] B_1', blockdiag(A_s)],  B = [B_1; [B_s]]

branches after ``A_1``; the states of ``A_1`` and of one branch are the orthonormal cascade of that
place. The least-squares problems of all places are then solved as one stack.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tridentify.estimation.likelihood.cost import FLOOR
from tridentify.estimation.likelihood.problem import Problem, Variant
from tridentify.estimation.search.starts import rate_limits
from tridentify.models.regression import Regression, regress
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.realization import Cascade, cascade, side_by_side, sort_poles
from tridentify.numerics.slices import Slices, drain

DAMPINGS = (0.1, 0.5)
"""Light and medium damping, for which the grid's step is 1.4 and 3."""
REAL_STEP = 2.2
"""Ratio of neighbouring real poles: within a factor of 1.5 of one lies every rate."""
FARTHER = 3.0
"""How far beyond the band's fast edge places are tried: to two thirds of the Nyquist frequency."""
TOGETHER = 16  # places; more take some milliseconds at once


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
    held = [cascade(poles[g.poles]) for k, g in enumerate(base.groups) if k != moving]
    bank, states = _branches(kept, places, held)
    whole = tuple(regress(e, bank) for e in base.experiments)
    problem = variant.problem(base)
    regressions = variant.regressions(whole, bank)
    still = iter(_held(held))
    moved = _Spanned(
        states, _krylov(bank.a[states[:, :, None], states[:, None, :]], bank.b[states])
    )
    spanned = [moved if k == moving else next(still) for k in range(len(base.groups))]
    total = np.zeros(len(places))
    for i in range(problem.n_outputs):
        matrix, target = _stacked(problem, regressions, i, spanned, len(places))
        q = np.linalg.qr(matrix)[0]
        rest = target - np.einsum("sij,sj->si", q, np.einsum("sij,i->sj", q, target))
        count = float(sum(r.counts[i] for r in regressions))
        rss = np.einsum("si,si->s", rest, rest)
        total += count * np.log(rss / count + FLOOR * problem.power[i])
    return total


class _Spanned(NamedTuple):
    """One denominator's states and Krylov vectors: of each place, or (1, ...) where it is held."""

    states: NDArray[np.intp]
    krylov: Array


def _held(held: list[Cascade]) -> list[_Spanned]:
    """Of the denominators that do not move, which stand first in the bank."""
    found, first = [], 0
    for one in held:
        states = np.arange(first, first + one.order)[None]
        found.append(_Spanned(states, _krylov(one.a[None], one.b[None])))
        first += one.order
    return found


def _branches(
    kept: Complex, places: list[Complex], held: list[Cascade]
) -> tuple[Cascade, NDArray[np.intp]]:
    """The bank that branches after the kept poles; (n_places, n) states of each place.

    Other denominators stand beside it, at the front.
    """
    trunk = side_by_side([*held, cascade(kept)])
    before = sum(one.order for one in held)
    n, width = trunk.order, places[0].size
    q = n + width * len(places)
    a, b = np.zeros((q, q)), np.zeros(q)
    a[:n, :n], b[:n] = trunk.a, trunk.b
    upper = np.array([place[0] for place in places])
    first = n + width * np.arange(len(places))
    a[first, first] = width * upper.real
    b[first] = np.sqrt(-2.0 * width * upper.real)
    if width == 2:
        a[first, first + 1], a[first + 1, first] = -np.abs(upper), np.abs(upper)
    a[n:, before:n] = -np.outer(b[n:], trunk.b[before:])
    own = n + np.arange(q - n).reshape(len(places), width)
    shared = np.tile(np.arange(before, n), (len(places), 1))
    poles = np.concatenate([trunk.poles, *places])
    return Cascade(a, b, poles, (n, width)), np.hstack([shared, own])


def _krylov(a: Array, b: Array) -> Array:
    """(n_places, n, n) orthonormal Krylov vectors of each place, one a row (Arnoldi)."""
    count, n = b.shape
    found = np.zeros((count, n, n))
    vector = b
    for k in range(n):
        for _ in range(2):
            shares = np.einsum("skj,sj->sk", found[:, :k], vector)
            vector = vector - np.einsum("sk,skj->sj", shares, found[:, :k])
        found[:, k] = vector / np.linalg.norm(vector, axis=1)[:, None]
        vector = np.einsum("sij,sj->si", a, found[:, k])
    return found


def _stacked(
    problem: Problem,
    regressions: tuple[Regression, ...],
    output: int,
    spanned: list[_Spanned],
    count: int,
) -> tuple[Array, Array]:
    """(n_places, rows, unknowns) columns of one output, and its (rows,) target."""
    used = [g.of_output(output) for g in problem.groups]
    parts = []
    for e, regression in enumerate(regressions):
        signals, layout = regression.signals[output], regression.layout
        blocks = []
        for j, m in enumerate(problem.n_zeros[output]):
            g = next(k for k, g in enumerate(problem.groups) if (output, j) in g.channels)
            states, krylov = spanned[g]
            n = states.shape[1]
            first = layout.input_states(j).start
            own = signals[:, first + states].transpose(1, 0, 2)
            block = own @ krylov[:, n - 1 - min(m, n - 1) :].transpose(0, 2, 1)
            blocks.append(_each(block, count))
            if m == n:
                blocks.append(_each(signals[:, [layout.direct(j)]], count))
        for other, one in enumerate(regressions):
            local = []
            if layout.free:
                local = [
                    _each(signals[:, states].transpose(1, 0, 2), count)
                    for (states, _), has in zip(spanned, used, strict=True)
                    if has
                ]
            if one.layout.nuisance.stop > one.layout.nuisance.start:
                local.append(_each(regression.nuisance_signals(output), count))
            blocks += [block if other == e else np.zeros_like(block) for block in local]
        parts.append(np.concatenate(blocks, axis=2))
    target = np.concatenate([r.targets[output] for r in regressions])
    return np.concatenate(parts, axis=1), target


def _each(block: Array, count: int) -> Array:
    """The same columns for every place."""
    return np.broadcast_to(block, (count, *block.shape[-2:]))


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


def _lines(count: int, low: float, high: float) -> Iterator[list[Complex]]:
    """The places for one real pole, or for a pair at each damping."""
    if count == 1:
        yield [np.array([-rate + 0j]) for rate in _grid(low, high, REAL_STEP)]
        return
    for damping in DAMPINGS:
        turn = complex(-damping, np.sqrt(1.0 - damping**2))
        rates = _grid(low, high, 1.0 + 4.0 * damping)
        yield [rate * np.array([turn, turn.conjugate()]) for rate in rates]


def _grid(low: float, high: float, step: float) -> Array:
    return np.geomspace(low, high, int(np.ceil(np.log(high / low) / np.log(step))) + 1)
