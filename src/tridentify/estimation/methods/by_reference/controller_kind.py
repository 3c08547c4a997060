"""Which kind of controller it was, sampled or continuous: as stated, or as the record tells.

What a controller does between the samples changes the answer, and is not recorded. Where its kind
is not stated, two things tell it. A linear controller that works on the recorded samples leaves
its rule in them, to the last digit (`closed_loop.input_rule`). And the residual of the right kind
has no part that follows the reference, whatever the noise does between the samples; the likelihood
of all of the residual would not do, as the noise is most of it, and the wrong kind may well explain
that better. Where neither tells, the kind is taken as the input is stated to behave, or as
continuous where no rule of the samples makes it, and what the other would make of the coefficients
is said. Where not even the rule is missing, or where it is because the controller is not linear or
reads what is not recorded, neither is likelier than the other: half the square of their distance
joins the covariance, as the mean square of what is off, unless only one of them leaves nothing that
follows the reference. Against a sampled one the record may speak, and for a computer of a few steps
a sample all the same: what the input is late by then is estimated from the two residuals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from tridentify.errors import OptionError, shown
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.closed_loop.between_samples import IN_WORDS, Sampling
from tridentify.estimation.closed_loop.driven import COARSE
from tridentify.estimation.closed_loop.input_rule import InputRule, input_rule
from tridentify.estimation.likelihood.thresholds import CLEARLY
from tridentify.estimation.methods.by_reference.followed import (
    Following,
    followed,
    held_for,
    left_over,
    wider,
)
from tridentify.estimation.methods.by_reference.passes import Rooted
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction

Controller = Literal["unknown", "sampled", "continuous"] | TransferFunction

PLAINLY = 0.3
"""What follows the reference in the residual of one kind beyond that of the other, in variances of
the noise a sample, from which the record speaks against the former: errors of the driven input
between the samples make up to a tenth (120 random loops), a wrong kind mostly 0.6 to 5."""
ASIDE = 0.2
"""Difference of the coefficients under either kind [standard errors] up to which the kind does not
matter: it adds 2 % to the error."""
NEAR_ROOT = 1.0
"""Standard errors that passes still move by, up to which their end tells how far the kind moves it:
where that matters, by several."""
APART = 3.0
"""Difference of the coefficients under either kind [stated standard errors] from which the answer
is wrong beyond its interval if the kind is, so that one that was only assumed is warned of."""
MAY_BE_ZERO = 5.0
"""Stated standard errors within which a plant may integrate; they do not know of a wrong kind."""
OUTLASTS = 3.0
"""Duration of the record in time constants of its slowest mode, up to which that may be none."""


def check_controller(controller: object) -> None:
    """Refuse an unknown kind of controller.

    Raises
    ------
    OptionError
    """
    if isinstance(controller, TransferFunction):
        return
    if controller not in ("unknown", "sampled", "continuous"):
        raise OptionError(
            f"found controller={shown(controller)}; expected 'sampled' (its output is held between "
            "samples), 'continuous', 'unknown' or a TransferFunction; choose one of them"
        )


@dataclass(frozen=True)
class Assumed:
    """The kind of a controller before anything is fitted.

    Attributes
    ----------
    sampling : {"sampled", "continuous"}
    certain : bool
        Whether it was stated, or is seen in the input itself.
    why : str
        What shows it, to be told behind the kind; empty where nothing does.
    even : bool
        Whether the other kind is as likely for all that is known.
    against : str
        What the input shows against a kind that was stated; empty where nothing does.
    missing : InputRule, optional
        What the input shows in place of the rule that it mostly shows of a kind that was stated.
    """

    sampling: Sampling
    certain: bool
    why: str = ""
    even: bool = False
    against: str = ""
    missing: InputRule | None = None

    @property
    def stated(self) -> bool:
        """Whether somebody says so, and not the input."""
        return self.certain and not self.why


def assumed(controller: Controller, records: Sequence[Record], structure: Structure) -> Assumed:
    """How the controller worked: as stated, as the input shows, or as it is stated to behave.

    Parameters
    ----------
    controller : {"unknown", "sampled", "continuous"} or TransferFunction
    records : sequence of Record
    structure : Structure
        Of the plant.
    """
    if isinstance(controller, TransferFunction):
        return Assumed("continuous", True)
    rule = input_rule(records, int(np.max(np.asarray(structure.poles))))
    seen = rule in (InputRule.SAMPLED, InputRule.HELD)
    if controller == "continuous":
        return Assumed(controller, True, against=rule.value if seen else "")
    if controller == "sampled":
        return Assumed(controller, True, missing=None if seen else rule)
    if seen:
        return Assumed("sampled", True, f": {rule.value}")
    held = all(record.behaviour == "zoh" for record in records)
    unruled = rule in (InputRule.NONE, InputRule.UNSEEN)
    kind: Sampling = "sampled" if held and not unruled else "continuous"
    why = f": {rule.value}" if unruled else ""
    return Assumed(kind, False, why, even=rule is not InputRule.NONE)


def of_integrator(taken: Assumed, estimate: Estimate, records: Sequence[Record]) -> Assumed:
    """The kind again, of a plant that may integrate: its loop leaves a rule that is shorter by one.

    Parameters
    ----------
    taken : Assumed
    estimate : Estimate
        With the kind that was taken.
    records : sequence of Record
    """
    rule = InputRule.SAMPLED.value
    if rule not in (taken.why.removeprefix(": "), taken.against) or not may_integrate(
        estimate, records
    ):
        return taken
    poles = int(np.max(np.asarray(estimate.structure.poles)))
    if input_rule(records, poles - 1) is InputRule.SAMPLED:
        return taken
    if taken.stated:
        return replace(taken, against="")
    return Assumed("sampled", False, even=True)


def may_integrate(estimate: Estimate, records: Sequence[Record]) -> bool:
    """Whether a plant may integrate: a static coefficient of zero, or a pole that outlasts records.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
    """
    last = [k for k, name in enumerate(estimate.names) if name.split("[")[0] == "a0"]
    if np.any(np.abs(estimate.theta[last]) <= MAY_BE_ZERO * estimate.std[last]):
        return True
    slowest = min(float(np.min(np.abs(np.roots(den)))) for row in estimate.model.den for den in row)
    return slowest * max(float(one.t[-1] - one.t[0]) for one in records) < OUTLASTS


def opposite(kind: Sampling) -> Sampling:
    """The other kind."""
    return "continuous" if kind == "sampled" else "sampled"


@dataclass(frozen=True, eq=False)
class Compared:
    """What the record says of two kinds.

    Attributes
    ----------
    turned : bool
        Whether the other kind is clearly likelier.
    told : str
        Which was taken, and what speaks for it.
    left : LeftOpen, optional
        What the record does not exclude.
    """

    turned: bool
    told: str
    left: LeftOpen | None = None


def compared(mine: Rooted, other: Rooted, taken_for: Assumed) -> Compared:
    """What the record says of two kinds.

    Parameters
    ----------
    mine, other : Rooted
        The fit with the kind that was assumed, and with the other.
    taken_for : Assumed
        What was assumed.
    """
    kind, even = other.loops[0].sampling, taken_for.even
    words, rival = IN_WORDS[mine.loops[0].sampling], IN_WORDS[kind]
    basis = wider(mine, other)
    mine_left, other_left = (followed(left_over(one), basis) for one in (mine, other))
    own, beside = mine_left.excess, other_left.excess
    plainly = PLAINLY * sum(int(np.isfinite(one.record.y).sum()) for one in mine.loops)
    turns = own - beside > plainly or (even and _alone(other_left, mine_left, mine, other))
    if other.still and (turns or not mine.still):
        against = (
            f"{own:.0f} variances of the noise, more than chance, follow the reference in the "
            f"residual, as {rival} {beside:.0f}"
        )
        against = against if mine.still else "the passes do not end"
        return Compared(True, f"controller taken as {rival}: as {words}, {against}")
    taken = f"controller taken as {words}{taken_for.why}"
    stays = beside - own > plainly or (even and _alone(mine_left, other_left, other, mine))
    # passes at the limit of stability may end nowhere, near a root all the same
    ended = other.still or (even and other.moved < NEAR_ROOT)
    against = f"{taken}; the record speaks against a {kind} one" if stays or not ended else taken
    if kind == "sampled" and other.still and (stays or not even):
        return _faster(mine, other, held_for(mine, other, basis), against)
    if stays or not ended:
        return Compared(False, against)
    away = other.estimate.theta - mine.estimate.theta
    return Compared(False, taken, LeftOpen(away, rival, taken, even))


def _faster(mine: Rooted, other: Rooted, share: float, taken: str) -> Compared:
    """What is to be said of computers of several steps a sample, where one of a single is none."""
    away = share * (other.estimate.theta - mine.estimate.theta)
    rival = f"a computer {1.0 / max(share, 1e-9):.2g} times as fast as the record"
    return Compared(False, taken, LeftOpen(away, rival, taken, even=True, part=1.0))


def _alone(right: Following, wrong: Following, refuted: Rooted, kept: Rooted) -> bool:
    """Whether one kind leaves nothing that follows the reference, and the other plainly does.

    A continuous controller in a fast loop leaves something of what is not known between the
    samples, which does not speak against it.
    """
    fast = any(
        one.driven.rate * float(np.median(np.diff(one.record.t))) > COARSE
        for end in (refuted, kept)
        for one in end.loops
    )
    if refuted.loops[0].sampling == "continuous" and fast:
        return False
    clearly = wrong.size - right.size > 2.0 * CLEARLY
    return clearly and right.is_chance and not wrong.is_chance


@dataclass(frozen=True, eq=False)
class LeftOpen:
    """Another kind that the record does not exclude: the more is said, the more hangs on it.

    Attributes
    ----------
    away : (n,) array
        From the coefficients with the kind that was taken to those with the other.
    rival : str
        The other kind, in words.
    taken : str
        Which was taken and what speaks for it, in words.
    even : bool
        Whether nothing speaks for it, so that the standard errors allow for either.
    part : float
        Root mean square of what is off by not knowing, over ``away``.
    """

    away: Array
    rival: str
    taken: str
    even: bool
    part: float = 1.0 / np.sqrt(2.0)

    def moved(self, mine: Estimate) -> Array | None:
        """What joins the covariance of an estimate with the kind that was taken, if anything."""
        matters = self.even and self._far(mine).max() >= ASIDE
        return self.part * self.away if matters else None

    def said(self, mine: Estimate) -> tuple[str, tuple[Finding, ...]]:
        """What is told, and to be said, in the errors of an estimate with the kind taken."""
        far = self._far(mine)
        k = int(np.argmax(far))
        if far[k] < ASIDE:
            return "the record does not tell, and the coefficients are the same either way", ()
        told = (
            f"the record does not tell; as {self.rival}, {mine.names[k]} would be "
            f"{mine.theta[k] + self.away[k]:.4g} in place of {mine.theta[k]:.4g}"
        )
        either = " of one kind; those that are stated allow for either" if self.even else ""
        finding = Finding(
            "intersample",
            "warning" if far[k] > APART else "note",
            f"{self.taken[0].upper()}{self.taken[1:]}; {told} "
            f"({far[k]:.2g} standard errors{either}).",
            "State how the controller works: controller='sampled' or 'continuous' (--controller).",
        )
        return told, (finding,)

    def _far(self, mine: Estimate) -> Array:
        """(n,) [standard errors] of the kind that was taken, whatever those of the other are."""
        size = mine.std + 1e-12 * np.abs(mine.theta) + 1e-300
        return np.asarray(np.where(mine.std > 0.0, np.abs(self.away) / size, 0.0))
