"""Rows whose posterior may have a say in the recommendation.

Candidates with needless poles are those whose posterior is weighed, and weighing it takes most of
the time of a selection. A posterior changes what is said of a candidate (its coefficients and how
well they are known, hence what speaks against it), and hardly what it predicts: held-out
samples are fitted to their likelihood. So all rows are first taken at the likelihood's maximum,
and only those are weighed that the recommendation could turn on.
"""

from __future__ import annotations

import math

from tridentify.judgement.selection.decide import Decision, OrderEvidence
from tridentify.judgement.selection.rule import Contender, adequate, choose, is_alike, is_as_good


def in_question(known: OrderEvidence, found: Decision) -> list[int]:
    """Rows that have to be weighed before the recommendation stands.

    Parameters
    ----------
    known : OrderEvidence
    found : Decision
        From it.

    Returns
    -------
    list of int
        Of the rows that were put off: the recommended one, the best and the likeliest; those that
        could take its place, as they are no larger and predict as well as the best; those that
        could be the likeliest in place of that one; and those that predict better than the best,
        by more than chance beside the recommended one.
    """
    open_ = [k for k, entry in enumerate(known.whole) if entry.put_off]
    place, best = found.verdict.place, found.verdict.best
    if not open_ or place is None or best is None:
        return open_
    likeliest = choose(found.contenders)
    trials = found.trials
    kept = set(_as_likely(found.contenders)) | {place, best, likeliest}
    size = max(trials[k].size for k in (place, likeliest if likeliest is not None else place))
    for k in open_:
        loss = trials[k].unseen.loss
        if not math.isfinite(loss):
            continue
        if trials[k].size <= size and is_as_good(trials[k], trials[best]):
            kept.add(k)
        if loss < trials[best].unseen.loss and not is_as_good(trials[place], trials[k]):
            kept.add(k)
    return [k for k in open_ if k in kept]


def _as_likely(contenders: tuple[Contender, ...]) -> list[int]:
    """Adequate rows beside the smallest of them, with as many poles or unknowns."""
    kept = [k for k, ok in enumerate(adequate(contenders)) if ok]
    if not kept:
        return []
    first = min(kept, key=lambda k: contenders[k].criteria.n_unknowns)
    return [k for k in kept if is_alike(contenders[k], contenders[first])]
