"""Causes beside the order: what takes hold, and what drifts.

Play in a valve, dry friction and a spring that stiffens are each made good for in part by poles and
zeros, as is a line along which an output drifts. On a measured record no criterion tells such poles
from those of the plant: they predict what was left out as well. So the smaller candidates are
fitted together with such a cause. Where one of them then explains the record clearly better than
the recommended one does, and nearly as well as larger ones with such a cause, its order is that of
the plant, and the further poles stood for the cause.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.judgement.causes.attempts.explanation import AS_MUCH, CLEARLY, Explanation
from tridentify.judgement.causes.explain import explain, settle
from tridentify.judgement.selection.late import MOST, is_able, present_of
from tridentify.judgement.selection.result import SelectionRow
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record
from tridentify.structure import Structure


class _Beside(NamedTuple):
    """AICc of a sound row with a cause beside it on the recommended one's terms, and that cause."""

    criterion: float
    size: int
    place: int
    cause: Explanation


def bent(
    rows: Sequence[SelectionRow], place: int | None, records: Sequence[Record]
) -> tuple[int, str] | None:
    """A smaller row that explains the records with a non-linearity, and which one that is.

    Parameters
    ----------
    rows : sequence of SelectionRow
    place : int or None
        The recommended one.
    records : sequence of Record
        Those that were identified.

    Returns
    -------
    (int, str) or None
        The smallest sound one that is clearly better with it than the recommended one without, and
        gains by it `AS_MUCH` of what any with as many poles and such a cause gains on it.
    """
    found = _with_cause("nonlinear", rows, place, records)
    best = min(found, default=None)
    able = [one for one in found if best is not None and _makes_most(one, best)]
    first = min(able, key=lambda one: (one.size, one.criterion), default=None)
    if first is None or place is None or first.size >= rows[place].n_coefficients:
        return None
    return first.place, first.cause.rival.what


def drifting(
    rows: Sequence[SelectionRow], place: int | None, records: Sequence[Record]
) -> list[Structure]:
    """Structures with a drift that are worth a row of their own, the smallest first.

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
        Of sound rows that are clearly better with a line than the recommended one as it is: the
        best of them, and the smallest one that gains as much by it. None has more poles: slow lags
        and a line follow whatever is slow.
    """
    found = [
        one
        for one in _with_cause("drift", rows, place, records)
        if rows[one.place].structure.drift is False
    ]
    best = min(found, default=None)
    near = [one for one in found if best is not None and _makes_most(one, best)]
    few = min(near, key=lambda one: (one.size, one.criterion), default=None)
    wanted = dict.fromkeys(one.place for one in (few, best) if one is not None)
    return [replace(rows[k].structure, drift=True) for k in wanted][:MOST]


def _makes_most(one: _Beside, best: _Beside) -> bool:
    """Whether the cause makes most of the difference between its row and the best with a cause."""
    gain = one.cause.gain
    return gain >= AS_MUCH * (gain + one.criterion - best.criterion)


def _with_cause(
    code: str, rows: Sequence[SelectionRow], place: int | None, records: Sequence[Record]
) -> list[_Beside]:
    """Rows with a cause of one code that are clearly better than the recommended one as it is.

    The sound ones and that itself, with no more poles.
    """
    if place is None or not is_able(rows[place]):
        return []
    best, most = rows[place].estimate, rows[place].structure.common_poles
    assert best is not None
    plain = _tried(rows[place], records, best.noise_model, "")
    found: list[_Beside] = []
    if plain is None:
        return found
    for k, row in enumerate(rows):
        sound = k == place or not row.doubts
        if is_able(row) and sound and row.structure.common_poles <= most:
            one = _tried(row, records, best.noise_model, code)
            if one is not None and one[1] is not None and one[0] < plain[0] - CLEARLY:
                found.append(_Beside(one[0], row.n_coefficients, k, one[1]))
    return found


def _tried(
    row: SelectionRow, records: Sequence[Record], noise: Sequence[Array], code: str
) -> tuple[float, Explanation | None] | None:
    """AICc with the best cause of a code, which has to be clear; without one for no code.

    Of what is slow only a line counts, which a structure can have.
    """
    assert row.estimate is not None
    try:
        present = present_of(row.estimate, records, noise)
        if not code:
            end = settle(present)
            return None if end is None else (end.criterion, None)
        explained = explain(present, only=code)
    except (TridentifyError, np.linalg.LinAlgError, FloatingPointError):
        return None
    named = explained.found if explained else ()
    clear = [one for one in named if one.is_clear and (code != "drift" or one.rival.refits)]
    if explained is None or not clear:
        return None
    return explained.present.criterion - clear[0].gain, clear[0]
