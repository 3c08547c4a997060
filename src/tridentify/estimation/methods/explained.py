"""What an estimate is a fit to: the records themselves or, of a loop, what the reference drives."""

from __future__ import annotations

from collections.abc import Sequence

from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.loop_taken import LoopTaken
from tridentify.estimation.closed_loop.between_samples import Loop, Sampling
from tridentify.estimation.closed_loop.driven import driven
from tridentify.estimation.closed_loop.known_controller import known_loop
from tridentify.estimation.methods.passes import without_rest
from tridentify.record.record import Record


def explained_records(estimate: Estimate, records: Sequence[Record]) -> list[Record] | None:
    """What an estimate of the reference route is a fit to: the pairs ``(u_M, y')`` at its end.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record

    Returns
    -------
    list of Record or None
        The records themselves where the route is another one; None where there is no such pair, as
        for a plant that is not stable, or a record without a reference.
    """
    taken = estimate.loop or LoopTaken("sampled")
    if taken.mirrored:
        return None
    if estimate.route != "reference":
        return list(records)
    if any(record.reference is None for record in records):
        return None
    return [without_rest(_loop(taken, estimate, one), estimate.model) for one in records]


def _loop(taken: LoopTaken, estimate: Estimate, record: Record) -> Loop:
    kind: Sampling = "continuous" if taken.sampling == "continuous" else "sampled"
    part = driven(record, between=kind == "continuous")
    if taken.controller is None:
        return Loop(part, kind)
    return known_loop(part, estimate.model, taken.controller, kind)
