r"""Which row is recommended, and why.

*The question.* A candidate with more unknowns always fits better. The lowest AICc asks whether it
predicts better, on average; asked of many candidates at once, it often says yes to one of them by
luck. A superfluous pole can be put anywhere in the band with a zero on top of it, and the best
place fits the noise: the fall of ``-2 log L`` is the largest of many nearly independent
chi-squares, not one of them (Davies 1977, 1987), so that no criterion with a fixed price for each
coefficient holds its promise.

*The rule.* A candidate is *adequate* if no usable candidate with more unknowns explains
significantly more, and the one with the fewest unknowns among the adequate is recommended (of
several, the one with the highest likelihood). "Significantly" is a fall of ``-2 log L`` by

    max(N log(1 + c / (N - k)), d log N),        P(chi2_d > c) = alpha / M

for ``d`` more unknowns. The first is the likelihood-ratio test, exact to the order 1 / N as of an
F test, at ``alpha`` = 5 %, with ``M`` the number of places that new poles have (Bonferroni): two in
each decade between the slowest and the fastest rate the record can show, to the power of their
number. The second is BIC's price; it lets the false alarms vanish as the record grows.

*What disqualifies.* Candidates that failed or whose end is no usable minimum neither are
recommended nor count against others. What is left of the residual after all is looked at too: if
it follows the input, the reason says so, since then no candidate is right.

References: R. Davies, Biometrika 64 (1977) 247-254 and 74 (1987) 33-43. L. Ljung, *System
Identification*, 2nd ed., chapter 16 (1999).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from scipy.special import chdtri

from tridentify.selection.criteria import Criteria

ALPHA = 0.05
PER_DECADE = 2.0


@dataclass(frozen=True)
class Contender:
    """What the rule sees of a row."""

    criteria: Criteria
    n_poles: int
    usable: bool


def needed(few: Contender, many: Contender, decades: float) -> float:
    """Fall of ``-2 log L`` that a larger candidate has to bring.

    Parameters
    ----------
    few, many : Contender
        ``many`` has more unknowns.
    decades : float
        Between the slowest and the fastest rate that the record can show.
    """
    d = many.criteria.n_unknowns - few.criteria.n_unknowns
    n = many.criteria.n_samples
    new = max(many.n_poles - few.n_poles, 0)
    places = max(PER_DECADE * decades, 1.0) ** new
    room = max(n - many.criteria.n_unknowns, 1)
    ratio = n * math.log1p(float(chdtri(d, ALPHA / places)) / room)
    return max(ratio, d * math.log(n))


def adequate(rows: Sequence[Contender], decades: float) -> list[bool]:
    """Whether nothing larger explains significantly more, row by row."""
    found = []
    for few in rows:
        ok = few.usable
        for many in rows if ok else ():
            if not many.usable or many.criteria.n_unknowns <= few.criteria.n_unknowns:
                continue
            fall = few.criteria.deviance - many.criteria.deviance
            ok = ok and fall <= needed(few, many, decades)
        found.append(ok)
    return found


def choose(rows: Sequence[Contender], decades: float) -> int | None:
    """Position of the recommended row; None where no row is usable.

    Examples
    --------
    >>> rows = [Contender(Criteria(k, 500, d), n, True)
    ...         for k, d, n in ((3, 90.0, 1), (5, 10.0, 2), (7, 2.0, 3))]
    >>> choose(rows, 2.0)
    1
    """
    kept = [k for k, ok in enumerate(adequate(rows, decades)) if ok]
    if not kept:
        return None
    return min(kept, key=lambda k: (rows[k].criteria.n_unknowns, rows[k].criteria.deviance))
