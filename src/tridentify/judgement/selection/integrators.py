"""Candidates with one pole at zero, where a pole is too slow for the record.

A tank, a servo's angle and a battery's charge integrate. Seen for a while, their slowest pole lies
anywhere from nothing to a fraction of one over the record's length; wherever it ends, nothing of it
is determined, and no candidate that contains it can be recommended. The same structure with that
pole held at zero has one unknown less and says what the record does show.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from tridentify.errors import TridentifyError
from tridentify.judgement.selection.orders import INTEGRATOR
from tridentify.judgement.selection.result import SelectionRow
from tridentify.judgement.selection.rule import USELESS
from tridentify.judgement.selection.soundness import slowest_decay
from tridentify.record.record import Record
from tridentify.structure import Structure

FIRST = 2
"""The smallest rows, which are always added: each costs a search of its own."""
FURTHER = 2
"""Larger rows that are added at most."""
HALF = 0.5
"""Share of what smaller rows leave unexplained below which a larger one is worth a search."""
LENGTHS = 1.0
"""Decay over the record [nepers] of a pole that may stand for an integrator: its time constant is
longer than the record."""


def integrating(rows: Sequence[SelectionRow], records: Sequence[Record]) -> list[Structure]:
    """Structures worth a row of their own, the smallest first.

    Parameters
    ----------
    rows : sequence of SelectionRow
    records : sequence of Record
        Those that were identified.

    Returns
    -------
    list of Structure
        Those of the rows that have a time constant longer than the record and predict held-out
        samples no worse than the best row that nothing speaks against; where there is none, those
        that are of use. At most `MOST` of them.
    """
    longest = max(record.duration for record in records)
    sound = [_held_out(row) for row in rows if row.estimate is not None and not row.doubts]
    enough = max(sound, default=_of_use(rows))
    found = []
    for row in rows:
        able = row.estimate is not None and row.structure.shared and not row.structure.constrained
        if not able or _held_out(row) < enough:
            continue
        assert row.estimate is not None
        if slowest_decay(row.estimate, longest) < LENGTHS:
            found.append((_at_zero(row.structure), _left(row)))
    kept = [(one, left) for one, left in found if one is not None]
    return _few(sorted(kept, key=lambda pair: (pair[0].common_poles, str(pair[0].zeros))))


def _few(found: Sequence[tuple[Structure, float]]) -> list[Structure]:
    """The smallest, and larger ones that explain far more than all before them.

    Examples
    --------
    >>> sizes = [(1, 0), (2, 0), (2, 1), (3, 0)]
    >>> rows = [(Structure(*one), left) for one, left in zip(sizes, (9.0, 6.0, 5.0, 1.0))]
    >>> [(one.poles, one.zeros) for one in _few(rows)]
    [(1, 0), (2, 0), (3, 0)]
    """
    kept = list(found[:FIRST])
    for one, left in found[FIRST:]:
        if len(kept) < FIRST + FURTHER and left < HALF * min(own for _, own in kept):
            kept.append((one, left))
    return [one for one, _ in kept]


def _of_use(rows: Sequence[SelectionRow]) -> float:
    """Held-out fit [percent] of a candidate that is of use beside the best one."""
    best = max((_held_out(row) for row in rows if row.estimate is not None), default=-math.inf)
    if not math.isfinite(best):
        return -math.inf
    return 100.0 - 100.0 * math.sqrt((1.0 - best / 100.0) ** 2 + USELESS)


def _held_out(row: SelectionRow) -> float:
    return float(row.cross_fit.min(initial=math.inf)) if row.cross_fit.size else -math.inf


def _left(row: SelectionRow) -> float:
    """What a row leaves of samples that it has not seen [percent of the output's size]."""
    return 100.0 - _held_out(row)


def _at_zero(structure: Structure) -> Structure | None:
    # a constant error of the input makes a ramp behind an integrator: the default drift is asked
    drift = structure.drift or None
    try:
        return replace(structure, drift=drift, fixed=dict(INTEGRATOR))
    except TridentifyError:
        return None
