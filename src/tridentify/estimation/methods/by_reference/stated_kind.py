"""A kind of controller that was stated, beside what the record says of it.

What is stated is taken: nobody knows better than who built the loop. But a mistake there is an
answer that is wrong by many of its errors, and looks like any other. Two things in the record speak
against a statement: an input that follows from the recorded samples to the last digit, or is held
over several of them for all to see (`closed_loop.input_rule`), against a continuous controller; and
a residual that follows the reference as stated, and does not under the other kind
(`controller_kind`), against either. Against a sampled one speaks, less clearly, an input that
follows from no samples: one that was measured, and not taken from the controller, carries noise of
its own. Where the samples do not tell (`InputRule`: a rule longer than a sampled controller needs,
as noise that is held for several samples leaves of a continuous one; none that needs memory), the
residual is asked, and what hangs on it said. Then what the other kind makes of the coefficients is
found too, and how far it is away is said, in errors of the answer: those with the noise modelled.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.assemble import Request
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding, Severity
from tridentify.estimation.closed_loop.between_samples import IN_WORDS
from tridentify.estimation.closed_loop.driven import COARSE, Driven, driven
from tridentify.estimation.closed_loop.input_rule import InputRule
from tridentify.estimation.closed_loop.unstable_answer import NotStable, unstable_estimate
from tridentify.estimation.methods.by_reference.controller_kind import (
    APART,
    Assumed,
    compared,
    opposite,
)
from tridentify.estimation.methods.by_reference.passes import Rooted
from tridentify.numerics.arrays import Array

NOTED = 1.0
"""Difference of the coefficients under either kind [stated standard errors] up to which a wrong
statement does no harm beyond the interval."""
FOLLOWS = "what it leaves of the output follows the reference, and what a {} one leaves does not"
WITHOUT_RULE = "no rule of the recorded samples makes the input, nor nearly"
UNTOLD = "the recorded samples do not tell"
MISSING: dict[InputRule, tuple[str, Severity]] = {
    InputRule.NONE: (WITHOUT_RULE, "warning"),
    InputRule.UNSEEN: (WITHOUT_RULE, "note"),
    InputRule.LONGER: (InputRule.LONGER.value, "warning"),
}
"""A sampled controller without a rule: continuous then, or its input was measured with noise; or it
is not linear, or reads what is not recorded, which is no evidence. One whose rule is longer than
the plant's order: continuous in noise that is held for several samples, or of a higher order."""


def findings_as_stated(
    found: Rooted, answer: Estimate, taken: Assumed, other: Callable[[], Rooted]
) -> tuple[Finding, ...]:
    """What is to be said of a kind that was stated, of a stable plant.

    Parameters
    ----------
    found : Rooted
        The root for the kind that was stated, for white noise.
    answer : Estimate
        With its errors, and the noise modelled.
    taken : Assumed
    other : callable
        Gives the root for the other kind.
    """
    if not (taken.against or taken.missing):
        return ()
    try:
        rival = other()
    except TridentifyError:
        return _said(taken, answer, None, follows=False)
    follows = False
    if not taken.against and found.still and rival.still:
        even = taken.missing not in (InputRule.NONE, InputRule.UNSEEN)
        seen = compared(found, rival, replace(taken, certain=False, even=even))
        if even and not (seen.turned or (seen.left and seen.left.said(answer)[1])):
            return ()  # the record speaks against the other kind, or nothing hangs on it
        follows = seen.turned
    away = rival.estimate.theta - found.estimate.theta if rival.still else None
    return _said(taken, answer, away, follows=follows)


def not_stable_as_stated(
    found: NotStable,
    parts: Sequence[Driven],
    taken: Assumed,
    asked: Request,
    coloured: bool,
    say: Callable[[str], None],
) -> NotStable:
    """A plant that is not stable, with what is to be said of the kind that was stated.

    Parameters
    ----------
    found : NotStable
        With that kind.
    parts : sequence of Driven
        What the references drive, per record.
    taken : Assumed
    asked : Request
    coloured : bool
        Whether the noise may have a model.
    say : callable
        Is told what is going on.
    """
    # a continuous controller in a fast loop leaves something of what is not known between samples
    fast = max(one.rate * float(np.median(np.diff(one.record.t))) for one in parts) > COARSE
    follows = found.follows and not (fast and taken.sampling == "continuous")
    if not taken.stated or not (taken.against or taken.missing or follows):
        return found
    kind = opposite(taken.sampling)
    others = [driven(record, between=kind == "continuous") for record in asked.records]
    other = unstable_estimate(others, kind, asked, coloured, say)
    follows = follows and other is not None and not other.follows
    estimate = found.estimate
    away = None if other is None else other.estimate.theta - estimate.theta
    said = _said(taken, estimate, away, follows=follows)
    return replace(found, estimate=replace(estimate, findings=(*estimate.findings, *said)))


def _said(
    taken: Assumed, mine: Estimate, away: Array | None, *, follows: bool
) -> tuple[Finding, ...]:
    """What the record shows against the kind that was stated, and how much hangs on it.

    ``away`` is how far the other kind moves the coefficients.
    """
    kind = opposite(taken.sampling)
    moved, effect = (0.0, "") if away is None else _difference(mine, away, IN_WORDS[kind])
    severity: Severity = "warning"
    if taken.against:
        shown = taken.against
        if away is not None:
            severity = "error" if moved > APART else "warning" if moved > NOTED else "note"
    elif follows:
        shown = FOLLOWS.format(kind)
    elif taken.missing and moved > APART:
        shown, severity = MISSING.get(taken.missing, (UNTOLD, "note"))
    else:
        return ()
    return (
        Finding(
            "intersample",
            severity,
            f"The controller is stated as {IN_WORDS[taken.sampling]}, but {shown}.",
            f"Use controller='{kind}', or leave it to the record (controller='unknown').",
            effect=effect,
        ),
    )


def _difference(mine: Estimate, away: Array, rival: str) -> tuple[float, str]:
    """Of the coefficient that moves most [stated standard errors], and in words."""
    size = mine.std + 1e-12 * np.abs(mine.theta) + 1e-300
    moved = np.where(mine.std > 0.0, np.abs(away) / size, 0.0)
    k = int(np.argmax(moved))
    return float(moved[k]), (
        f"As {rival}, {mine.names[k]} is {mine.theta[k] + away[k]:.4g} in place of "
        f"{mine.theta[k]:.4g} ({moved[k]:.2g} standard errors)."
    )
