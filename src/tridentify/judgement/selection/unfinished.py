"""Which candidates have to be finished before one is recommended.

What takes longest of a candidate is often not needed to pass it over. Of larger ones that explain
no more, a search that stops at the likelihood's maximum (`halfway`), or one from the starts that
all candidates share, says as much; the table says that such a row is not finished.

Finished are all rows up to the one that is recommended, by coefficients or by poles, and all that
might be the likeliest. A larger row has a say in one way only: where it is sound and predicts
held-out samples best, it is what the others are compared with. So the recommendation is made once
for each such row as if it were: one that would change anything is finished, and the
recommendation is that of a table in which all rows are.

*Orders beyond.* Where candidates with one pole more than some others explain nothing more, and the
likeliest of all explains the record, those with still more poles begin from the shared starts
alone. They are searched as a whole where that shows that they explain more after all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from tridentify.judgement.selection.criteria import own_criteria
from tridentify.judgement.selection.decide import (
    Decision,
    OrderEvidence,
    decide,
    follows_input,
    misleads,
)
from tridentify.judgement.selection.finish_candidates import Entry
from tridentify.judgement.selection.rule import Contender, choose, stand_ins
from tridentify.judgement.selection.table import SelectionTable
from tridentify.record.record import Record


def wanted(known: OrderEvidence, found: Decision, least: int = 0) -> list[int]:
    """Rows to be finished before the recommendation holds; none where it does.

    Parameters
    ----------
    known : OrderEvidence
    found : Decision
        What follows from it, no unfinished row taken as sound.
    least : int
        As of `decide`.
    """
    left = [k for k, entry in enumerate(known.whole) if entry.unfinished]
    place, best = found.verdict.place, found.verdict.best
    if place is None or best is None or not left:
        return left
    rows, contenders = found.rows, found.contenders
    alike = stand_ins(contenders)
    likely = alike if alike and not contenders[alike[0]].known else alike[:1]
    asked = [
        k
        for k in left
        if k in likely
        or rows[k].n_coefficients <= rows[place].n_coefficients
        or contenders[k].n_poles <= contenders[place].n_poles
    ]
    if asked:
        return asked
    for k in sorted(left, key=lambda k: known.unseen[k].loss):
        if not known.unseen[k].loss < known.unseen[best].loss:
            break
        other = decide(known, least, (k,)).verdict
        if (other.place, other.by) != (place, found.verdict.by):
            return [k]
    return []


def levels_off_at(
    entries: Mapping[int, Entry], poles: Mapping[int, int], records: Sequence[Record]
) -> bool:
    """Whether those with most poles of some candidates explain no more than others do.

    Parameters
    ----------
    entries : mapping of int to Entry
        What a whole search gives for each.
    poles : mapping of int to int
        Of these.
    records : sequence of Record
    """
    places, rows = list(entries), []
    for k in places:
        estimate = entries[k].estimate
        if estimate is None or not estimate.status.ok:
            return False
        rows.append(Contender(own_criteria(estimate, records), poles[k], True))
    place = choose(rows)
    if place is None or rows[place].n_poles >= max(row.n_poles for row in rows):
        return False
    likeliest = entries[places[place]]
    assert likeliest.estimate is not None
    noise = likeliest.estimate.noise_model
    return not (follows_input(likeliest, noise, records) or misleads(likeliest, records))


def explain_more(table: SelectionTable, places: Sequence[int]) -> bool:
    """Whether one of some candidates explains more than the others after all.

    Parameters
    ----------
    table : SelectionTable
    places : sequence of int
        Of those that were not searched as a whole.
    """
    return choose(table.contenders) in places or table.best("bic") in places
