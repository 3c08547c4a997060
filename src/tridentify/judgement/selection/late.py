"""Candidates with a delay that is estimated along, where one is missing.

Dead time is in most plants of process engineering, and a candidate without it makes do with poles:
each is a little of a delay (a Pade approximation). Then a larger candidate is adequate, sound, and
not what the plant is. So every candidate that is smaller than the recommended one is fitted with
a delay, as a cause is that is looked for (`causes.delay`); where that explains the record better
than the recommended one does, the candidate joins the rows with its delay free. A delay beside as
many coefficients is no other order: `identify` and `validate` find it, and say what it would gain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.judgement.causes.explain import explain, settle
from tridentify.judgement.causes.present import Present
from tridentify.judgement.causes.revisit import poles_of_estimate, problem_of, stated
from tridentify.judgement.selection.result import SelectionRow
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record
from tridentify.structure import Structure

MOST = 2
"""Rows that are added: each costs a search over delays of its own."""


class _Late(NamedTuple):
    """A structure with a delay, and AICc with it on the terms of the recommended candidate."""

    size: int
    criterion: float
    structure: Structure


def delayed(
    rows: Sequence[SelectionRow], place: int | None, records: Sequence[Record]
) -> list[Structure]:
    """Structures worth a row of their own, the smallest first.

    Parameters
    ----------
    rows : sequence of SelectionRow
    place : int or None
        The recommended one.
    records : sequence of Record
        Those that were identified.

    Returns
    -------
    list of Structure
        Of rows that are smaller than the recommended one, with ``delay="free"``; at most `MOST`.
        Those whose AICc is lower, the delay counted.
    """
    if place is None or not _is_able(rows[place]):
        return []
    best = rows[place].estimate
    assert best is not None
    found = []
    try:
        present = _present(best, records, best.noise_model)
        ended = settle(present)
        if ended is None:
            return []
        for row in rows:
            if not _is_able(row) or row.n_coefficients >= rows[place].n_coefficients:
                continue
            late = _fitted(row, records, best.noise_model)
            if late is not None and late.criterion < ended.criterion:
                found.append(late)
    except (TridentifyError, np.linalg.LinAlgError, FloatingPointError):
        return []
    return [one.structure for one in sorted(found)[:MOST]]


def _is_able(row: SelectionRow) -> bool:
    """Whether a delay is open that the structure does not have."""
    if row.estimate is None or not row.estimate.status.ok or row.structure.constrained:
        return False
    return row.structure.shared and row.structure.delay == 0.0


def _present(estimate: Estimate, records: Sequence[Record], noise: Sequence[Array]) -> Present:
    nuisances = stated(estimate)
    poles = poles_of_estimate(estimate, problem_of(estimate, records, nuisances))
    delay = np.array(estimate.model.delay)
    return Present.of(records, estimate.structure, delay, nuisances, noise, poles)


def _fitted(row: SelectionRow, records: Sequence[Record], noise: Sequence[Array]) -> _Late | None:
    assert row.estimate is not None
    present = _present(row.estimate, records, noise)
    explained = explain(present, only="delay")
    if explained is None or not explained.found:
        return None
    first = explained.found[0]
    late = replace(row.structure, delay="free")
    return _Late(row.n_coefficients, explained.present.criterion - first.gain, late)
