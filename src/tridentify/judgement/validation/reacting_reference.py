"""Whether a reference reacts to the output: then it is none, and its instruments carry the noise.

The reference route rests on one thing: the noise has no part in the reference. What is recorded
under that name is at times the controller's error, an outer loop's output, or the output itself.
The same test tells as of an input (`feedback`): small moves of the reference, which its own
past does not tell, must not explain what is left of the output at the same sample and before.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.judgement.causes.attempts.feedback import Inputs, Within, coming
from tridentify.judgement.causes.attempts.first_samples import beginning
from tridentify.judgement.validation.assess import LONGEST_LOOK, own_look
from tridentify.record.record import Record

AT_ONCE = Within(0, np.zeros(0))
"""A reference that is right may be followed at the same sample; it does not follow."""


def reference_findings(
    estimate: Estimate, explained: Sequence[Record], records: Sequence[Record]
) -> tuple[Finding, ...]:
    """What is to be said of references that react to outputs.

    Parameters
    ----------
    estimate : Estimate
        By the reference route.
    explained : sequence of Record
        What it is a fit to.
    records : sequence of Record
        The same samples with their references.

    Returns
    -------
    tuple of Finding
        At most one.
    """
    if any(one.dt is None for one in records):
        return ()
    most = max(records, key=lambda one: one.n_references)
    looked = [beginning(one, LONGEST_LOOK) for one in records]
    inputs = Inputs.of([_driven_by(one, most.n_references) for one in looked])
    view = None if inputs.commanded else own_look(estimate, explained)
    if view is None:
        return ()
    for one in view.outputs:
        own = [np.hstack(pair) for pair in zip(one.coefficients, one.nuisance, strict=True)]
        seen = coming(one.residual, own, one.noise, inputs, AT_ONCE, one.scale)
        if seen.is_clear:
            return (_in_words(most.reference_names[seen.input], one.name, seen.share),)
    return ()


def _driven_by(record: Record, count: int) -> Record:
    """A record with its references for inputs, and zeros for those it lacks."""
    reference = np.asarray(record.reference, dtype=np.float64)
    reference = np.pad(reference, ((0, 0), (0, count - record.n_references)))
    between = record.reference_behaviour or "zoh"
    return Record(reference, record.y, dt=record.dt, intersample=between)


def _in_words(reference: str, output: str, share: float) -> Finding:
    return Finding(
        "reference-reacts",
        "warning",
        f"The reference {reference} reacts to the noise of {output}: its small moves explain "
        f"{100.0 * share:.3g} % of the residual. It carries the output, and the coefficients "
        "may be biased.",
        "Give the set point as the controller got it; without one leave the reference out.",
    )
