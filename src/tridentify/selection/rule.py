r"""Which row is recommended, and why.

*The question.* A candidate with more unknowns always fits better. The lowest AICc asks whether it
predicts better, on average; asked of many candidates at once, it often says yes to one of them by
luck. A superfluous pole can be put anywhere in the band with a zero on top of it, and the best
place fits the noise: the fall of ``-2 log L`` is the largest of many nearly independent
chi-squares, not one of them (Davies 1977, 1987), and a price of two for each unknown, or little
more, is too low for it.

*The rule.* A candidate is *adequate* if no usable candidate with more unknowns explains
significantly more, that is unless ``-2 log L`` falls by more than

    N log(1 + d log N / (N - k)),

for ``d`` more unknowns, ``k`` in all: the price of BIC (Schwarz 1978), which lets the false alarms
vanish as the record grows, with the factor of an F test where ``N`` is small. Of the adequate
candidates the one with the fewest unknowns is recommended, of several the one with the highest
likelihood.

*Known coefficients.* An adequate candidate whose poles the record hardly determines (a section's
coefficient has a standard error of half its natural size and more) stands back if another adequate
one has poles that are known: a pole that cancels with a zero, or one at the origin that stands for
a drift of the noise, looks like that.

*What disqualifies.* Candidates that failed or whose end is no usable minimum neither are
recommended nor count against others. What is left of the residual after all is looked at too: if
it follows the input, the reason says so, since then no candidate is right.

*Measured* over random plants of order 1 to 4 (damped and resonant, with zeros, a tenth of them not
minimum-phase), records of 100 to 2,000 samples with PRBS, step and doublet at 20, 10 and 5 dB and a
third with autoregressive noise: `tests/statistical/test_selection.py`.

References: R. Davies, Biometrika 64 (1977) 247-254 and 74 (1987) 33-43. G. Schwarz, Annals of
Statistics 6 (1978) 461-464. L. Ljung, *System Identification*, 2nd ed., chapter 16 (1999).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from tridentify.selection.criteria import Criteria


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
