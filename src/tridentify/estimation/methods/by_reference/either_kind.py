"""A plant that is not stable under either kind of controller, where nobody states the kind.

As for stable plants (`controller_kind`): the estimate is that of the kind that is assumed, or that
of the other where the errors of the former follow the references and those of the latter do not.
Where neither speaks against itself, what the other kind makes of the coefficients is said, and
joins the covariance where it is as likely.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from tridentify.estimation.answer.assemble import Request
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.closed_loop.between_samples import IN_WORDS
from tridentify.estimation.closed_loop.driven import driven
from tridentify.estimation.closed_loop.unstable_answer import NotStable, unstable_estimate
from tridentify.estimation.likelihood.answer import widened_by
from tridentify.estimation.methods.by_reference.controller_kind import (
    Assumed,
    Compared,
    LeftOpen,
    may_integrate,
    opposite,
)
from tridentify.estimation.methods.by_reference.followed import follows
from tridentify.estimation.methods.by_reference.passes import Rooted


def of_either_kind(
    found: NotStable,
    taken_for: Assumed,
    asked: Request,
    coloured: bool,
    say: Callable[[str], None],
) -> NotStable:
    """What is found of a plant that is not stable, with what the other kind makes of it.

    Parameters
    ----------
    found : NotStable
        With the kind that was assumed.
    taken_for : Assumed
    asked : Request
    coloured : bool
        Whether the noise may have a model.
    say : callable
        Is told what is going on.

    Returns
    -------
    NotStable
    """
    kind = opposite(taken_for.sampling)
    words, rival = IN_WORDS[taken_for.sampling], IN_WORDS[kind]
    parts = [driven(record, between=kind == "continuous") for record in asked.records]
    other = unstable_estimate(parts, kind, asked, coloured, say)
    if other is None:
        none = f"as {rival}, no such plant{taken_for.why}"
        return _told(_in_doubt(found, none) if taken_for.even else found, none)
    if taken_for.even and found.follows and not other.follows:
        return _told(other, f"as {words}, what is left follows the reference")
    if other.follows and not found.follows:
        return _told(found, f"the record speaks against a {kind} one")
    taken = f"controller taken as {words}{taken_for.why}"
    mine = found.estimate
    left = LeftOpen(other.estimate.theta - mine.theta, rival, taken, taken_for.even)
    told, findings = left.said(mine)
    if (away := left.moved(mine)) is not None:
        cov, draws = widened_by(mine.cov, mine.draws, (away,))
        found = replace(found, estimate=replace(mine, cov=cov, draws=draws))
    whole = replace(found.estimate, findings=(*found.estimate.findings, *findings))
    return _told(replace(found, estimate=whole), told)


def _in_doubt(found: NotStable, none: str) -> NotStable:
    """What is found with one kind alone, where nothing speaks for that: a stable one is tried."""
    said = Finding(
        "intersample",
        "warning",
        f"The record does not tell how the controller works, and the answer hangs on it: {none} "
        "is found, that is one that integrates or is unstable.",
        "State how the controller works: controller='sampled' or 'continuous' (--controller).",
    )
    mine = found.estimate
    whole = replace(mine, findings=(*mine.findings, said))
    return replace(found, estimate=whole, unseen=True)


def beside_stable(
    found: Rooted,
    taken_for: Assumed,
    asked: Request,
    coloured: bool,
    say: Callable[[str], None],
) -> NotStable | Compared | None:
    """What the other kind makes of a plant that is found stable, but may integrate.

    The wrong kind makes a slow pole of an integrator, and fits to stable models would keep the
    other kind from showing it.

    Parameters
    ----------
    found : Rooted
        Of a stable plant, with the kind that was assumed.
    taken_for : Assumed
    asked : Request
    coloured : bool
        Whether the noise may have a model.
    say : callable
        Is told what is going on.

    Returns
    -------
    NotStable, Compared or None
        The plant with the other kind, where the record speaks for that; what is to be said of
        both where it does not tell; none where the other kind finds no such plant.
    """
    if not may_integrate(found.estimate, asked.records):
        return None
    kind = opposite(taken_for.sampling)
    parts = [driven(record, between=kind == "continuous") for record in asked.records]
    other = unstable_estimate(parts, kind, asked, coloured, say)
    if other is None or other.follows:
        return None
    words, rival = IN_WORDS[taken_for.sampling], IN_WORDS[kind]
    if follows(found):
        return _told(other, f"as {words}, what is left follows the reference")
    taken = f"controller taken as {words}{taken_for.why}"
    away = other.estimate.theta - found.estimate.theta
    return Compared(False, taken, LeftOpen(away, rival, taken, taken_for.even))


def _told(found: NotStable, *words: str) -> NotStable:
    estimate = found.estimate
    return replace(found, estimate=replace(estimate, trace=estimate.trace.told(*words)))
