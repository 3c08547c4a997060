"""Which kind of controller it was, sampled or continuous: as stated, or as the record tells.

What a controller does between the samples changes the answer, and is not recorded. Where its kind
is not stated it is taken as the input is stated to behave, and the other kind is tried: the fit of
either has a likelihood, and mostly the record tells the two apart by nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tridentify.errors import OptionError, shown
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.closed_loop.between_samples import IN_WORDS, Sampling
from tridentify.estimation.methods.passes import Rooted, deviance
from tridentify.record.record import Record
from tridentify.transfer_function import TransferFunction

Controller = Literal["unknown", "sampled", "continuous"] | TransferFunction

PLAINLY = 0.3
"""Difference of ``-2 log L`` a sample from which the record speaks for one kind of controller:
noise of the driven input between the samples, or its colour, may make a tenth by itself, a wrong
kind makes 4."""
ASIDE = 0.2
"""Difference of the coefficients under either kind [standard errors] up to which the kind does not
matter: it adds 2 % to the error."""
APART = 3.0
"""Difference of the coefficients under either kind [standard errors] from which one of the two is
wrong beyond its interval, so that a kind which was only assumed is to be warned of."""
COARSE = 0.3
"""Rate of the loop times sampling interval from which what a continuous controller does between the
samples counts: standard errors are then a fifth too small and more."""


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


def kind_of(controller: Controller, records: Sequence[Record]) -> Sampling:
    """How the controller worked: as stated, or as the input is stated to behave.

    Parameters
    ----------
    controller : {"unknown", "sampled", "continuous"} or TransferFunction
    records : sequence of Record
    """
    if isinstance(controller, TransferFunction):
        return "continuous"
    if controller != "unknown":
        return controller
    return "sampled" if all(record.behaviour == "zoh" for record in records) else "continuous"


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
    findings : tuple of Finding
        Where the record does not tell the two apart.
    """

    turned: bool
    told: str
    findings: tuple[Finding, ...] = ()


def compared(mine: Rooted, other: Rooted) -> Compared:
    """What the record says of two kinds.

    Parameters
    ----------
    mine, other : Rooted
        The fit with the kind that was assumed, and with the other.
    """
    kind = other.loops[0].sampling
    words, rival = IN_WORDS[mine.loops[0].sampling], IN_WORDS[kind]
    gain = deviance(mine.loops, mine.estimate) - deviance(other.loops, other.estimate)
    plainly = PLAINLY * sum(int(np.isfinite(one.record.y).sum()) for one in mine.loops)
    if other.still and (gain > plainly or not mine.still):
        told = f"controller taken as {rival}: -2 log L is lower by {gain:.1f} than as {words}"
        return Compared(True, told)
    taken = f"controller taken as {words}"
    if not other.still or gain < -plainly:
        return Compared(False, f"{taken}; the record speaks against a {kind} one")
    told, finding = _left_open(mine.estimate, other.estimate, rival)
    return Compared(False, f"{taken}; {told}", finding)


def _left_open(mine: Estimate, other: Estimate, rival: str) -> tuple[str, tuple[Finding, ...]]:
    """What is said where the record does not tell the kind: the more, the more hangs on it.

    Parameters
    ----------
    mine, other : Estimate
        With the kind that was taken, and with the other.
    rival : str
        The other kind, in words.
    """
    size = np.maximum(mine.std, other.std) + 1e-12 * np.abs(mine.theta) + 1e-300
    moved = np.abs(other.theta - mine.theta) / size
    k = int(np.argmax(moved))
    if moved[k] < ASIDE:
        return "the record does not tell, and the coefficients are the same either way", ()
    told = (
        f"the record does not tell; as {rival}, {mine.names[k]} would be "
        f"{other.theta[k]:.4g} in place of {mine.theta[k]:.4g}"
    )
    finding = Finding(
        "intersample",
        "warning" if moved[k] > APART else "note",
        f"Controller: {told} ({moved[k]:.2g} standard errors).",
        "State how the controller works: controller='sampled' or 'continuous' (--controller).",
    )
    return told, (finding,)


def coarse_findings(best: Rooted) -> tuple[Finding, ...]:
    """What is to be said of a continuous controller in a loop that is fast for its sampling.

    A model of the noise takes up what noise makes of the input between the samples.

    Parameters
    ----------
    best : Rooted
    """
    loops = best.loops
    steps = [float(np.median(np.diff(one.record.t))) for one in loops]
    fastest = max(one.driven.rate * step for one, step in zip(loops, steps, strict=True))
    allowed = any(one.size for one in best.estimate.noise_model)
    if loops[0].sampling == "sampled" or fastest <= COARSE or allowed:
        return ()
    return (
        Finding(
            "intersample",
            "warning",
            f"The controller is continuous and the loop fast for the sampling ({fastest:.2g} "
            "rad a step): what noise makes of the input between the samples is not recorded, "
            "and without a model of the noise the standard errors do not allow for it.",
            "Use noise='auto', or sample faster, by five times if possible.",
        ),
    )
