"""What the input does between its samples, settled for all candidates before they are compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.methods.base import Method, Progress
from tridentify.judgement.causes.attempts.intersample import (
    IN_WORDS,
    Behaviours,
    behaviours,
    better_behaviour,
)
from tridentify.judgement.causes.timing.timed import with_times
from tridentify.judgement.choice import with_behaviour
from tridentify.judgement.selection.orders import order_label
from tridentify.judgement.selection.result import Selection, SelectionRow
from tridentify.judgement.selection.table import SelectionTable
from tridentify.record.checks.samples import Behaviour
from tridentify.record.record import Record
from tridentify.structure import Structure


@dataclass(frozen=True, eq=False)
class SettledRecords:
    """The records with one behaviour of the input for all candidates.

    ``identified`` holds the candidate that was asked, with its estimate: one search less later.
    """

    records: tuple[Record, ...]
    unseen: tuple[Record, ...]
    told: tuple[str, ...] = ()
    identified: tuple[Structure, Estimate] | None = None


def settle(
    records: tuple[Record, ...],
    unseen: tuple[Record, ...],
    structures: Sequence[Structure],
    method: Method,
    say: Progress,
) -> SettledRecords:
    """What the input does between its samples, where that was left open."""
    if all(record.intersample != "auto" for record in (*records, *unseen)):
        return SettledRecords(records, unseen)
    asked = middle(structures)
    say(f"what the input does between its samples, by a model of {order_label(asked)}")
    identified = None
    try:
        estimate, seen, _, _ = with_behaviour(method, list(records), asked, None)
        if all(record.intersample == "auto" for record in records):
            estimate, seen = with_times(method, estimate, seen, asked, None)
        identified = asked, estimate
    except (TridentifyError, np.linalg.LinAlgError, ValueError):
        seen = [record.settled(record.behaviour) for record in records]
    others = tuple(one.settled(seen[0].behaviour) for one in unseen)
    told = [_told(seen[0], asked)]
    if identified is not None:
        told += identified[1].trace.about(DecisionKind.MOVES_TIMED)
    return SettledRecords(tuple(seen), others, tuple(told), identified)


def _told(record: Record, by: Structure) -> str:
    return (
        f"input taken as {IN_WORDS[record.behaviour]} for all candidates, as {order_label(by)} "
        "says: state intersample where you know it"
    )


def resettled(
    records: tuple[Record, ...],
    unseen: tuple[Record, ...],
    settled: SettledRecords,
    table: SelectionTable,
) -> SettledRecords | None:
    """Another behaviour, where the likeliest candidate finds one clearly better.

    The candidate in the middle may explain little of the record (two resonances, three poles): what
    it says of the time between the samples is then worth little. The likeliest is heard when it is
    known, before the whole searches.
    """
    place = table.best("bic") if settled.told else None
    estimate = None if place is None else table.entries[place].estimate
    if place is None or estimate is None:
        return None
    found = behaviours(estimate, settled.records)
    if found is not None and found.advised != found.present:
        return _changed(records, unseen, found.advised, table.entries[place].structure)
    return None


def resettled_again(
    records: tuple[Record, ...],
    unseen: tuple[Record, ...],
    settled: SettledRecords,
    rows: Sequence[SelectionRow],
    row: SelectionRow | None,
    method: Method,
) -> SettledRecords | None:
    """Another behaviour, where the recommended candidate says another one: it may be a smaller one.

    The likeliest may have poles and zeros that make good for what the input is taken for. Whether
    an input is held, half an interval later than one that is not, is heard from the recommended one
    as `identify` hears it of that order, and from rows with fewer zeros that then explain the
    record better: ``1 + s T / 2`` is half an interval earlier. Anything else is heard where it is
    clearly better.
    """
    if not settled.told or row is None or row.estimate is None:
        return None
    found = behaviours(row.estimate, settled.records)
    if found is None:
        return None
    told = any(one.code == "intersample" and one.matters for one in row.estimate.findings)
    to, by = (found.advised if told else found.present), row.structure
    if to == found.present:
        to = _identified(records, found, row, method)
        if to == found.present:
            to, by = _with_fewer_zeros(records, settled, rows, row, method)
        if "zoh" not in (to, found.present):
            return None
    return None if to == found.present else _changed(records, unseen, to, by)


def _with_fewer_zeros(
    records: tuple[Record, ...],
    settled: SettledRecords,
    rows: Sequence[SelectionRow],
    row: SelectionRow,
    method: Method,
) -> tuple[Behaviour, Structure]:
    """What a row of as many poles and fewer zeros says, if it then explains the record better.

    With its structure. By AICc, which counts the zeros: as they stood for the time between the
    samples alone.
    """
    structure, present = row.structure, settled.records[0].behaviour
    for other in rows:
        less = other.structure
        fewer = less.poles == structure.poles and other.n_coefficients < row.n_coefficients
        if not fewer or replace(structure, zeros=less.zeros) != less:
            continue
        found = None if other.estimate is None else behaviours(other.estimate, settled.records)
        if found is None or found.advised == present or row.estimate is None:
            continue
        try:
            again = method.estimate([one.settled(found.advised) for one in records], less)
        except (TridentifyError, np.linalg.LinAlgError, ValueError):
            continue
        if again.aicc < row.estimate.aicc:
            return found.advised, less
    return present, structure


def having_said(
    selection: Selection, records: tuple[Record, ...], used: tuple[Record, ...], method: Method
) -> Selection:
    """The selection, with a word where `identify` takes another behaviour for the recommended row.

    Parameters
    ----------
    selection : Selection
    records, used : tuple of Record
        As given, and with the behaviour of all candidates.
    method : Method
    """
    row = selection.recommended
    if row is None or row.estimate is None or not _are_open(records):
        return selection
    found = behaviours(row.estimate, used)
    to = None if found is None else _identified(records, found, row, method)
    if found is None or to is None or to == found.present:
        return selection
    word = (
        f"of {row.label} alone, identify takes the input as {IN_WORDS[to]}: the record hardly "
        "tells, or not alike for all orders; state intersample"
    )
    return replace(selection, notes=(word, *selection.notes))


def _are_open(records: Sequence[Record]) -> bool:
    return any(record.intersample == "auto" for record in records)


def _identified(
    records: tuple[Record, ...], found: Behaviours, row: SelectionRow, method: Method
) -> Behaviour:
    """What `identify` takes for the structure of a row, asked where another one is near."""
    suggested = records[0].behaviour
    if len(found.attempts) < 2 or not _are_open(records):
        return better_behaviour(found, suggested)
    try:
        _, seen, *_ = with_behaviour(method, list(records), row.structure, None)
    except (TridentifyError, np.linalg.LinAlgError, ValueError):
        return better_behaviour(found, suggested)
    return seen[0].behaviour


def _changed(
    records: tuple[Record, ...], unseen: tuple[Record, ...], to: Behaviour, by: Structure
) -> SettledRecords:
    seen = tuple(record.settled(to) for record in records)
    return SettledRecords(
        seen, tuple(record.settled(to) for record in unseen), (_told(seen[0], by),)
    )


def middle(structures: Sequence[Structure]) -> Structure:
    """The candidate in the middle by its poles, of those the one with most zeros."""

    def sizes(one: Structure) -> tuple[int, int]:
        return tuple(
            v if isinstance(v, int) else max(k for row in v for k in row)
            for v in (one.poles, one.zeros)
        )  # type: ignore[return-value]

    ordered = sorted(structures, key=sizes)
    poles = sizes(ordered[(len(ordered) - 1) // 2])[0]
    return max((one for one in ordered if sizes(one)[0] == poles), key=sizes)
