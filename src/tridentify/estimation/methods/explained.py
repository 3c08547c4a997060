"""What an estimate is a fit to: the records themselves or, of a loop, what the reference drives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tridentify.errors import UnsupportedError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.loop_taken import LoopTaken
from tridentify.estimation.closed_loop.between_samples import Loop, Sampling
from tridentify.estimation.closed_loop.driven import driven
from tridentify.estimation.closed_loop.known_controller import known_loop
from tridentify.estimation.methods.by_reference.passes import without_rest
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


def explained_or_refused(estimate: Estimate, records: Sequence[Record]) -> list[Record]:
    """The same, where there has to be one.

    Raises
    ------
    UnsupportedError
        There is no such pair.
    """
    found = explained_records(estimate, records)
    if found is not None:
        return found
    if estimate.route == "reference" and any(one.reference is None for one in records):
        raise UnsupportedError(
            "found an estimate by the reference route and a record without a reference; expected "
            "what drove its loop from outside; give it: Record(..., reference=r)"
        )
    slowest = float(np.max(np.roots(estimate.model.den[0][0]).real))
    raise UnsupportedError(
        f"found a plant in a loop with a pole at {slowest:.3g} rad/s, not stable or nearly so; "
        "expected a stable model, whose response can be laid beside the record; compare the "
        "coefficients of two records, or of the halves of one, in place of it"
    )


def _loop(taken: LoopTaken, estimate: Estimate, record: Record) -> Loop:
    kind: Sampling = "continuous" if taken.sampling == "continuous" else "sampled"
    part = driven(record, between=kind == "continuous")
    if taken.controller is None:
        return Loop(part, kind)
    return known_loop(part, estimate.model, taken.controller, kind)
