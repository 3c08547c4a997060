"""What two-stage and projection share: output error with an input that the reference makes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from tridentify.estimation.answer.assemble import Request
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.loop_taken import LoopTaken
from tridentify.estimation.closed_loop.moving import together_findings
from tridentify.estimation.likelihood.question import silently
from tridentify.estimation.methods.base import Progress, check
from tridentify.estimation.methods.capability import Capability
from tridentify.estimation.methods.route import refuse_unreferenced
from tridentify.estimation.methods.three_model import ThreeModel
from tridentify.record.record import Record
from tridentify.structure import Structure

OPEN_LOOP = ThreeModel(noise="white", route="open-loop", finish="likelihood")
"""Output error with a search in front of it: rivals shall not lose by their start."""
IN_NOISE = replace(OPEN_LOOP, noise="auto")
"""The same with a model of the noise, where that is not white."""


def in_two_stages(
    name: str,
    can: Capability,
    records: Sequence[Record],
    structure: Structure,
    progress: Progress | None,
    first_stage: Callable[[Record], tuple[Record, str]],
    second_stage: ThreeModel = OPEN_LOOP,
) -> Estimate:
    """The estimate with inputs in place of the recorded ones.

    Parameters
    ----------
    name : str
        Of the method.
    can : Capability
        What it can do.
    records : sequence of Record
    structure : Structure
    progress : callable or None
    first_stage : callable
        Gives a record with the input that its reference makes, and what is told of it.
    second_stage : ThreeModel
        The fit with that input.

    Raises
    ------
    OptionError
        A record has no reference.
    ConstantReferenceError
        None of them moves.
    """
    say = progress or silently
    check(records, structure, name, can)
    refuse_unreferenced(f"{name}()", records, "use ThreeModel(route='direct')")
    say("the input from the reference")
    asked = Request.of(records, structure, name)
    made = [first_stage(one) for one in records]
    found = second_stage.estimate([one for one, _ in made], structure, say)
    told = f"first stage: {', '.join(words for _, words in made)}"
    return replace(
        found,
        method=asked.method,
        record_fingerprint=asked.fingerprint,
        route="reference",
        loop=LoopTaken("sampled"),
        findings=(*found.findings, *together_findings(records)),
        trace=found.trace.told(told, *asked.told),
    )
