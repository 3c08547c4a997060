r"""Which row is recommended, and why.

Two questions, since simulated records have a true order and measured ones have none.

*Does the likelihood speak?* A candidate with more unknowns always fits better. The lowest AICc asks
whether it predicts better, on average; asked of many candidates at once, it often says yes to one
of them by luck. A superfluous pole can be put anywhere in the band with a zero on top of it, and
the best place fits the noise: the fall of ``-2 log L`` is the largest of many nearly independent
chi-squares, not one of them (Davies 1977, 1987). So a candidate is *adequate* if no usable
candidate with more unknowns lowers ``-2 log L`` by more than

    N log(1 + d log N / (N - k)),

for ``d`` more unknowns, ``k`` in all: the price of BIC (Schwarz 1978) with the factor of an F test
where ``N`` is small. Of the adequate candidates the one with the fewest unknowns is the
*likeliest*; those whose poles the record hardly determines stand back. It is to be believed if it
*explains* the record: it is sound and its residual does not follow the input.

*What does a measured record support?* There every candidate is wrong, and enough samples refute all
but the largest. Wanted is the smallest *sound* candidate (`soundness`: not at a limit, its
coefficients determined, no time constant far beyond the record) that predicts what it has not seen
as well as the best sound one: the sum of squares of the held-out errors (`held_out`) is above the
best one's by no more than one standard error of that difference. The errors are paired, block by
block: what gusts and drift do to both cancels, so that the difference is known far better than
either (the rule of one standard error, Breiman et al. 1984, on differences).

*Both together.* Where the likeliest candidate explains the record and predicts held-out samples no
worse than the one that the second question names (compared on errors whitened by its noise model),
it is recommended; else the latter is. Where no candidate explains the record, or only one that is
itself not sharply known, a difference of less than one percent of the output's size buys no poles
either: the wrong structure alone leaves more than that.

*Measured*: on random systems in `benchmarks/trust.py` and `tests/statistical/test_selection.py`; on
gusts, and on drifts and a stiffening spring (where it still buys poles), in
`tests/statistical/test_selection_wrong_worlds.py`.

References: R. Davies, Biometrika 64 (1977) 247-254 and 74 (1987) 33-43. G. Schwarz, Annals of
Statistics 6 (1978) 461-464. L. Breiman, J. Friedman, R. Olshen, C. Stone, *Classification and
Regression Trees*, section 3.4.3 (1984). L. Ljung, *System Identification*, 2nd ed., chapter 16
(1999).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tridentify.selection.criteria import Criteria

Array = NDArray[np.float64]

POINT = 1.0
"""Held-out fit [percent of the output's size] that is no reason for more coefficients where no
candidate explains the record."""


@dataclass(frozen=True)
class Contender:
    """What the rule sees of a row; ``known`` says that the record determines its poles."""

    criteria: Criteria
    n_poles: int
    usable: bool
    known: bool = True


def needed(few: Contender, many: Contender) -> float:
    """Fall of ``-2 log L`` that a larger candidate has to bring.

    Parameters
    ----------
    few, many : Contender
        ``many`` has more unknowns.
    """
    d = many.criteria.n_unknowns - few.criteria.n_unknowns
    n = many.criteria.n_samples
    room = max(n - many.criteria.n_unknowns, 1)
    return n * math.log1p(d * math.log(n) / room)


def adequate(rows: Sequence[Contender]) -> list[bool]:
    """Whether nothing larger explains significantly more, row by row."""
    found = []
    for few in rows:
        ok = few.usable
        for many in rows if ok else ():
            if not many.usable or many.criteria.n_unknowns <= few.criteria.n_unknowns:
                continue
            fall = few.criteria.deviance - many.criteria.deviance
            ok = ok and fall <= needed(few, many)
        found.append(ok)
    return found


def choose(rows: Sequence[Contender]) -> int | None:
    """Position of the recommended row; None where no row is usable.

    Examples
    --------
    >>> rows = [Contender(Criteria(k, 500, d), n, True)
    ...         for k, d, n in ((3, 90.0, 1), (5, 10.0, 2), (7, 2.0, 3))]
    >>> choose(rows)
    1
    """
    kept = [k for k, ok in enumerate(adequate(rows)) if ok]
    kept = [k for k in kept if rows[k].known] or kept
    if not kept:
        return None
    return min(kept, key=lambda k: (rows[k].criteria.n_unknowns, rows[k].criteria.deviance))


@dataclass(frozen=True, eq=False)
class Trial:
    """A candidate on samples that it has not seen.

    Attributes
    ----------
    size : int
        Coefficients that are not held.
    losses : (n_blocks,) array
        Sums of squares of its held-out errors, each output over its spread; empty where it has
        none.
    whitened : (n_blocks,) array
        The same of errors whitened by the noise model of the likeliest candidate.
    sound : bool
        Whether nothing speaks against recommending it.
    usable : bool
        Whether it could be recommended if nothing better is there.
    """

    size: int
    losses: Array
    whitened: Array
    sound: bool
    usable: bool


@dataclass(frozen=True)
class Verdict:
    """The recommended row, and what decided.

    Attributes
    ----------
    place : int or None
    best : int or None
        The eligible candidate that predicts held-out samples best.
    by : {"likelihood", "held-out", "size", "none"}
        "size": a further percent would buy the larger ones.
    sound : bool
        Whether it is sound.
    """

    place: int | None
    best: int | None
    by: str
    sound: bool


def recommend(
    trials: Sequence[Trial], likeliest: int | None, *, explains: bool, sharp: bool
) -> Verdict:
    """Combine likelihood and held-out prediction.

    Parameters
    ----------
    trials : sequence of Trial
    likeliest : int or None
        `choose` of them.
    explains : bool
        Whether it is sound and its residual does not follow the input.
    sharp : bool
        Whether its coefficients are known to where the likelihood is as good as Gaussian.

    Examples
    --------
    >>> losses = [np.full(20, 0.010), np.full(20, 0.002), np.full(20, 0.00199)]
    >>> trials = [Trial(2 * k + 2, one, one, True, True) for k, one in enumerate(losses)]
    >>> recommend(trials, 2, explains=False, sharp=True).place
    1
    """
    judged = [k for k, one in enumerate(trials) if one.usable and one.losses.size]
    eligible = [k for k in judged if trials[k].sound] or judged
    if not eligible:
        by = "none" if likeliest is None else "likelihood"
        return Verdict(likeliest, None, by, likeliest is not None and trials[likeliest].sound)
    best = min(eligible, key=lambda k: float(trials[k].losses.sum()))
    as_good = [k for k in eligible if _as_good(trials[k].losses, trials[best].losses)]
    place, by = _smallest(trials, as_good), "held-out"
    if likeliest is not None and explains and likeliest in judged:
        own, other = trials[likeliest], trials[place]
        larger = own.size > other.size
        difference = float(np.sum(own.whitened - other.whitened))
        if difference <= (0.0 if larger else _scatter(own.whitened - other.whitened)):
            place, by = likeliest, "likelihood"
    if not (explains and sharp):
        near = [k for k in eligible if _points(trials[k]) - _points(trials[best]) <= POINT]
        small = _smallest(trials, near)
        if trials[small].size < trials[place].size:
            place, by = small, "size"
    return Verdict(place, best, by, trials[place].sound)


def _smallest(trials: Sequence[Trial], among: Sequence[int]) -> int:
    return min(among, key=lambda k: (trials[k].size, float(trials[k].losses.sum())))


def _scatter(differences: Array) -> float:
    """Standard error of a sum of differences, block by block."""
    return float(np.std(differences, ddof=1) * math.sqrt(differences.size))


def _as_good(losses: Array, best: Array) -> bool:
    difference = losses - best
    return float(difference.sum()) <= _scatter(difference)


def _points(trial: Trial) -> float:
    """Root mean square of the held-out errors over the spread of the outputs [percent]."""
    return 100.0 * math.sqrt(float(trial.losses.sum()))
