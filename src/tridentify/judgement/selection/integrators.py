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
from typing import NamedTuple

from tridentify.errors import TridentifyError
from tridentify.judgement.selection.orders import INTEGRATOR
from tridentify.judgement.selection.result import SelectionRow
from tridentify.judgement.selection.rule import USELESS
from tridentify.judgement.selection.soundness import slowest_decay
from tridentify.record.record import Record
from tridentify.structure import Structure

FIRST = 2
"""The smallest rows, which are always added: each costs a search of its own."""
CLEARLY = 10.0
"""Fall of BIC from which a larger row is worth a search as well."""
NEARLY = 1.1
"""Of what the likeliest of the larger rows leaves, the part at which a smaller one will do."""
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
        held = at_zero(row.structure)
        if held is not None and slowest_decay(row.estimate, longest) < LENGTHS:
            found.append(_Slow(held, row.bic, 100.0 - _held_out(row)))
    return _few(sorted(found, key=lambda one: (one.held.common_poles, str(one.held.zeros))))


class _Slow(NamedTuple):
    """A row with its pole held at zero, its BIC and what it leaves of held-out samples [%]."""

    held: Structure
    bic: float
    left: float


def _few(found: Sequence[_Slow]) -> list[Structure]:
    """The smallest ones, and larger ones that explain clearly more.

    Examples
    --------
    >>> sizes, bic, left = [(1, 0), (2, 0), (3, 0), (4, 1)], (90, 70, 31, 30), (9.0, 6.0, 1.0, 1.0)
    >>> rows = [_Slow(Structure(*n), b, e) for n, b, e in zip(sizes, bic, left, strict=True)]
    >>> [(one.poles, one.zeros) for one in _few(rows)]
    [(1, 0), (2, 0), (3, 0), (4, 1)]
    """
    kept, rest = list(found[:FIRST]), list(found[FIRST:])
    likeliest = min(rest, key=lambda one: one.bic, default=None)
    if likeliest is not None and likeliest.bic < min(one.bic for one in kept) - CLEARLY:
        enough = next(one for one in rest if one.left <= NEARLY * likeliest.left)
        kept += [enough, likeliest] if enough is not likeliest else [likeliest]
    return [one.held for one in kept]


def _of_use(rows: Sequence[SelectionRow]) -> float:
    """Held-out fit [percent] of a candidate that is of use beside the best one."""
    best = max((_held_out(row) for row in rows if row.estimate is not None), default=-math.inf)
    if not math.isfinite(best):
        return -math.inf
    return 100.0 - 100.0 * math.sqrt((1.0 - best / 100.0) ** 2 + USELESS)


def _held_out(row: SelectionRow) -> float:
    return float(row.cross_fit.min(initial=math.inf)) if row.cross_fit.size else -math.inf


def at_zero(structure: Structure) -> Structure | None:
    """The same orders with a pole held at zero; None where that cannot be asked for."""
    # a constant error of the input makes a ramp behind an integrator: the default drift is asked
    drift = structure.drift or None
    try:
        return replace(structure, drift=drift, fixed=dict(INTEGRATOR))
    except TridentifyError:
        return None
