"""Candidates with a delay that is estimated along, where one is missing.

Dead time is in most plants of process engineering, and a candidate without it makes do with poles:
each is a little of a delay (a Pade approximation). Then a larger candidate is adequate, sound, and
not what the plant is. So every candidate that is smaller than the recommended one is fitted with
a delay, as a cause is that is looked for (`causes.delay`); where that explains the record better
than the recommended one does, or clearly better than any other candidate with as many coefficients,
it joins the rows with its delay free. The second holds on measured records, in which something
smaller than the delay is left for more poles to explain. A delay beside as many coefficients is no
other order: `identify` and `validate` find it, and say what it would gain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.judgement.causes.explain import explain, settle
from tridentify.judgement.causes.explanation import CLEARLY
from tridentify.judgement.causes.present import Present
from tridentify.judgement.causes.revisit import poles_of_estimate, problem_of, stated
from tridentify.judgement.selection.result import SelectionRow
from tridentify.judgement.selection.rule import USELESS
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record
from tridentify.structure import Structure

MOST = 2
"""Rows that are added: each costs a search over delays of its own."""


class _Late(NamedTuple):
    """A structure that gets a delay, and its AICc with it on the recommended one's terms.

    ``left`` is the share of the outputs' variance that it leaves; ``size_with`` counts the delays.
    """

    size: int
    criterion: float
    structure: Structure
    left: float
    size_with: int


class _Plain(NamedTuple):
    """A row as it is, on the same terms."""

    place: int
    size: int
    criterion: float
    left: float


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
        Those whose AICc, the delay counted, is lower than that of the recommended one, or by
        `CLEARLY` than that of every row that has as many coefficients: a delay is then worth more
        than a pole or a zero is.
    """
    if place is None or not _is_able(rows[place]):
        return []
    best = rows[place].estimate
    assert best is not None
    try:
        plain = _settled(rows, place, records)
        found = [
            late
            for row in rows
            if _is_able(row) and row.n_coefficients < rows[place].n_coefficients
            for late in [_fitted(row, records, best.noise_model)]
            if late is not None
        ]
    except (TridentifyError, np.linalg.LinAlgError, FloatingPointError):
        return []
    ended = next((one for one in plain if one.place == place), None)
    if ended is None:
        return []
    kept = [
        late
        for late in found
        if late.left < ended.left + USELESS
        and (late.criterion < ended.criterion or _is_worth_more(late, plain))
    ]
    return [one.structure for one in sorted(kept)[:MOST]]


def _settled(rows: Sequence[SelectionRow], place: int, records: Sequence[Record]) -> list[_Plain]:
    """The rows as they are up to the size of the recommended one, on its terms."""
    best = rows[place].estimate
    assert best is not None
    found = []
    for k, row in enumerate(rows):
        if not _is_able(row) or row.n_coefficients > rows[place].n_coefficients:
            continue
        assert row.estimate is not None
        end = settle(_present(row.estimate, records, best.noise_model))
        if end is not None:
            found.append(_Plain(k, row.n_coefficients, end.criterion, _left(end.fits)))
    return found


def _left(fits: Array) -> float:
    """Share of the outputs' variance that is not explained."""
    return float(np.mean((1.0 - fits / 100.0) ** 2))


def _is_worth_more(late: _Late, plain: Sequence[_Plain]) -> bool:
    """Whether no row with as many coefficients comes near a candidate with a delay."""
    beside = [one.criterion for one in plain if late.size < one.size <= late.size_with]
    return bool(beside) and late.criterion < min(beside) - CLEARLY


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
    criterion = explained.present.criterion - first.gain
    delays = records[0].n_outputs * records[0].n_inputs
    size = row.n_coefficients
    return _Late(size, criterion, late, _left(first.fits(explained.present)), size + delays)
