"""A delay and another behaviour of the input between its samples, together.

Each explains some of the other: a held input taken for one that moves comes half a sample early,
and a delay that is not stated makes any smoother behaviour look better. Where both are wrong, each
remedy alone leaves what the other would explain. So both are tried together, and are told together
where that explains clearly more than either.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from tridentify.judgement.causes.attempts.intersample import IN_WORDS
from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.attempts.rivals import Rival
from tridentify.judgement.causes.timing.delay import delay_rivals


def both_rivals(present: Present, behaviours: tuple[Rival, ...]) -> Iterator[Rival]:
    """Every other behaviour with the delay that promises most beside it.

    Parameters
    ----------
    present : Present
    behaviours : tuple of Rival
        Those of the input between its samples, which were fitted.
    """
    now = present.records[0].behaviour
    for other in behaviours:
        (part,) = other.parts
        behaviour = part.records[0].behaviour
        if behaviour == now:
            continue
        for late in delay_rivals(part):
            yield replace(
                late,
                code="intersample",
                changes=2,
                what=f"an input that is {IN_WORDS[behaviour]} together with {late.what}",
                advice=f"{other.advice.rstrip('.')}, and with it: "
                f"{late.advice[0].lower()}{late.advice[1:]}",
            )
