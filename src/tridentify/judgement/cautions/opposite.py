"""Experiments that show no response together, as one of them has a channel of the opposite sign."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.judgement.causes.attempts.rivals import DISAGREEING
from tridentify.judgement.validation.assess import own_look
from tridentify.judgement.validation.explained import LITTLE, explanations, finding_of
from tridentify.record.record import Record


def opposite_findings(
    estimate: Estimate, records: Sequence[Record], found: Sequence[Finding]
) -> list[Finding]:
    """That one of several experiments has the opposite sign, where they seem silent together.

    With white weights: a model of the noise has taken for noise what each of them answers.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
        Those that were identified.
    found : sequence of Finding
        Of the same records.
    """
    codes = {one.code for one in found}
    hardly = "not-determined" in codes and float(np.max(estimate.fit)) < LITTLE
    silent = "no-response" in codes or hardly
    if len(records) < 2 or not silent or DISAGREEING in codes:
        return []
    view = own_look(estimate, records)
    if view is None:
        return []
    white = [np.zeros(0) for _ in view.outputs]
    explained = explanations(view, estimate, white, only=DISAGREEING)
    best = None if explained is None else explained.best
    if explained is None or best is None or best.rival.kind != "opposite":
        return []
    where = "The experiments together show no response" + " to speak of" * hardly
    return [finding_of(best, explained, estimate, (), where)]
