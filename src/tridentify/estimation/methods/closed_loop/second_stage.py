"""What two-stage and projection share: output error with an input that the reference makes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from tridentify.estimation.answer.assemble import Request
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.methods.base import Progress
from tridentify.estimation.methods.three_model import ThreeModel
from tridentify.record.record import Record

OPEN_LOOP = ThreeModel(noise="white", route="open-loop", finish="likelihood")
"""Output error with a search in front of it: rivals shall not lose by their start."""


def second_stage(asked: Request, made: Sequence[Record], told: str, say: Progress) -> Estimate:
    """The estimate with inputs in place of the recorded ones.

    Parameters
    ----------
    asked : Request
    made : sequence of Record
        With the inputs that the references make.
    told : str
        Of the first stage.
    say : callable
    """
    found = OPEN_LOOP.estimate(made, asked.structure, say)
    return replace(
        found,
        method=asked.method,
        record_fingerprint=asked.fingerprint,
        route="reference",
        trace=found.trace.told(told, *asked.told),
    )
