"""Rows that may have a say in the recommendation, and those that get less than a whole search.

Candidates with needless poles are those whose posterior is weighed, and weighing it takes most of
the time of a selection. A posterior changes what is said of a candidate (its coefficients and how
well they are known, hence what speaks against it), and hardly what it predicts: held-out
samples are fitted to their likelihood. So all rows are first taken at the likelihood's maximum,
and only those are weighed that the recommendation could turn on.

A candidate that leaves far more than the best one, in the likelihood and on held-out samples, has
coloured residuals of its own making, and a search that gives them a noise model takes longer than
any other. Such a row is searched with white noise alone: not left as the comparison has it, whose
few starts may have ended in a minimum that is not the least.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from tridentify.judgement.selection.decide import Decision, OrderEvidence, unseen_errors
from tridentify.judgement.selection.rule import (
    LARGE,
    TWICE,
    Contender,
    adequate,
    choose,
    is_alike,
    is_as_good,
)
from tridentify.judgement.selection.table import SelectionTable

FAR = 0.5
"""Deviance a sample above the lowest, on the same terms, from which a candidate is far behind: its
noise has 1.65 times the power. Candidates that are only somewhat too small stay below."""


def far_behind(table: SelectionTable) -> list[int]:
    """Rows that explain far less than the best one (`FAR`).

    Parameters
    ----------
    table : SelectionTable
    """
    known = [(k, one) for k, one in enumerate(table.criteria) if one is not None]
    least = min((one.deviance / one.n_samples for _, one in known), default=math.inf)
    far = [k for k, one in known if one.deviance / one.n_samples > least + FAR]
    return [k for k in far if table.entries[k].shared]


def not_beaten(known: OrderEvidence, among: Sequence[int]) -> list[int]:
    """Those of some rows that do not leave far more of held-out samples than the best row.

    One that could not be estimated is among them.

    Parameters
    ----------
    known : OrderEvidence
    among : sequence of int
    """
    losses = [unseen_errors(held, known.judges).loss for held in known.held]
    least = min((loss for loss in losses if math.isfinite(loss)), default=math.inf)
    most = max(TWICE * least, least + LARGE)
    return [k for k in among if known.whole[k].estimate is None or not losses[k] > most]


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
