"""The stages of a selection: the candidates by themselves, the contest, what decides."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.methods.base import Method, Progress
from tridentify.estimation.methods.three_model import ThreeModel
from tridentify.judgement.causes.attempts.intersample import behaviours, taken_as
from tridentify.judgement.choice import with_judgement
from tridentify.judgement.selection.beside import bent, drifting
from tridentify.judgement.selection.contest import Contest
from tridentify.judgement.selection.decide import (
    Decision,
    OrderEvidence,
    decide,
    follows_input,
    misleads,
)
from tridentify.judgement.selection.finish_candidates import CandidateTask, Entry, begun, run_task
from tridentify.judgement.selection.halfway import can_stop
from tridentify.judgement.selection.hankel import Hankel, hankel_values
from tridentify.judgement.selection.held_out import HeldEstimate, HeldOut, cross_fit
from tridentify.judgement.selection.in_loop import loop_of, select_in_loop
from tridentify.judgement.selection.integrators import integrating
from tridentify.judgement.selection.late import are_lags, delayed, direct_and_delayed
from tridentify.judgement.selection.orders import (
    order_label,
)
from tridentify.judgement.selection.result import Selection, SelectionRow
from tridentify.judgement.selection.settle import (
    middle,
)
from tridentify.judgement.selection.shared import shared_models
from tridentify.judgement.selection.table import SelectionTable, table_of
from tridentify.judgement.selection.unfinished import explain_more, levels_off_at, wanted
from tridentify.judgement.selection.words import in_words, notes
from tridentify.numerics.arrays import Complex
from tridentify.numerics.executor import Executor, mapping_of
from tridentify.record.record import Record
from tridentify.structure import Structure

REPEATED = 3
"""How often each pole stands in the basis of the Hankel values: what is near the model is spanned
by twice, and once more is room for what it lacks."""


class _SearchAll(Exception):
    """A candidate that was not searched by itself may be the one to be recommended."""


def _with_drift(task: CandidateTask, alone: Entry) -> CandidateTask:
    """The candidate with the drift that its own estimate has found; its rivals may have none."""
    degree = 0 if alone.estimate is None else alone.estimate.structure.drift_degree
    if task.structure.drift is not False or not degree:
        return task
    return replace(task, structure=replace(task.structure, drift=degree))


@dataclass(frozen=True, eq=False)
class Opened:
    """The candidates by themselves, and compared on the maximum of one likelihood.

    ``compared``: with the drift that an estimate of a candidate has found.
    """

    compared: tuple[Structure, ...]
    table: SelectionTable
    whole: tuple[Entry, ...]


@dataclass(frozen=True, eq=False)
class Work:
    """What all stages need; ``free`` and ``late`` say which rows may join.

    ``found`` holds poles from which candidates of as many begin, too; ``left_open`` says that the
    behaviour of the input was found, ``all_searched`` that no order is left to the shared starts,
    ``finish`` that every row is to be what `identify` gives.
    """

    records: tuple[Record, ...]
    method: Method
    executor: Executor | None
    say: Progress
    identified: tuple[Structure, Estimate] | None = None
    free: bool = False
    late: bool = False
    found: tuple[Complex, ...] = ()
    left_open: bool = False
    all_searched: bool = False
    finish: bool = True

    def run(self, function: Any, tasks: Iterable[Any], said: str) -> list[Any]:
        """All tasks, in their order."""
        self.say(said)
        mapped = mapping_of(self.executor)
        return list(mapped(function, list(tasks)))

    def counted(self, function: Any, tasks: Sequence[Any], said: str) -> list[Any]:
        """The same, with a word after each."""
        mapped = mapping_of(self.executor)
        found = []
        for done, outcome in enumerate(mapped(function, tasks), 1):
            found.append(outcome)
            self.say(f"{said}: {done} of {len(tasks)} done")
        return found

    def opened(self, structures: Sequence[Structure], before: Sequence[Entry] = ()) -> Opened:
        """Each candidate as `identify` gives it, and the contest from there.

        Those of ``before``, of the same records, are not identified again.
        """
        tasks = self._tasks(structures)
        alone = self._identified(tasks, before)
        table, asked = self._contest(tasks, alone)
        beyond = [k for k, one in enumerate(tasks) if one.shared and k not in alone]
        if beyond and explain_more(table, beyond):
            alone = replace(self, all_searched=True)._identified(tasks, list(alone.values()))
            table, asked = self._contest(tasks, alone)
        whole = (alone.get(k, entry) for k, entry in enumerate(table.entries))
        return Opened(tuple(one.structure for one in asked), table, tuple(whole))

    def _contest(
        self, tasks: Sequence[CandidateTask], alone: Mapping[int, Entry]
    ) -> tuple[SelectionTable, list[CandidateTask]]:
        """All on the same terms, from where each ended by itself; and what each was asked."""
        asked = [_with_drift(one, alone[k]) if k in alone else one for k, one in enumerate(tasks)]
        contest = Contest(self.records, self.method, self.run)
        return contest.table(asked, self._started(asked, alone)), asked

    def witness(
        self, structures: Sequence[Structure]
    ) -> tuple[tuple[Structure, Estimate] | None, tuple[Entry, ...]]:
        """The estimate of the candidate in the middle, which tells whether there is a loop.

        With the entry of its search.
        """
        asked = middle(structures)
        if self.identified is not None and self.identified[0] == asked:
            return self.identified, ()
        self.say(f"a model of {order_label(asked)}")
        task = self._alone(CandidateTask(self.records, asked, self.method))
        entry = run_task(task)
        whole = run_task(replace(task, reached=entry.left)) if entry.left else entry
        known = None if whole.estimate is None else (asked, whole.estimate)
        return known, (entry,) if self._can_share(asked) else ()

    def in_loop(
        self,
        structures: Sequence[Structure],
        known: tuple[Structure, Estimate] | None,
        told: tuple[str, ...],
        unseen: bool,
    ) -> Selection | None:
        """By the direct route, where an estimate shows that the input reacts to the output."""
        if known is None or not isinstance(self.method, ThreeModel):
            return None
        self.say("whether a controller was running")
        loop = loop_of(self.records, *known, self.method, left_open=self.left_open)
        if loop is None:
            return None
        found = select_in_loop(
            loop, structures, self.method, self.counted, free=self.free, unseen=unseen
        )
        own = None if found is None else found.recommended
        if found is None or own is None or own.estimate is None:
            return None
        self.say(f"what is to be said of {own.label}")
        if self.left_open and loop.records is not self.records:
            told = (taken_as(loop.records[0].behaviour),)
        judged = with_judgement(own.estimate, loop.records, self.method, None, told)
        last = replace(own, estimate=judged)
        rows = tuple(last if row is own else row for row in found.rows)
        return replace(found, rows=rows, recommended=last, notes=(*found.notes, *told))

    def selected(
        self,
        structures: Sequence[Structure],
        opened: Opened,
        unseen: tuple[Record, ...],
        told: tuple[str, ...],
    ) -> Selection:
        """What follows the contest; with all candidates searched where that may decide."""
        try:
            return self.selection(structures, opened, unseen, told)
        except _SearchAll:
            whole = replace(self, all_searched=True)
            opened = whole.opened(structures, opened.whole)
            return whole.selection(structures, opened, unseen, told)

    def selection(
        self,
        structures: Sequence[Structure],
        opened: Opened,
        unseen: tuple[Record, ...],
        told: tuple[str, ...],
    ) -> Selection:
        """Held-out samples, the recommendation."""
        evidence = OrderEvidence(
            self.records,
            unseen or self.records,
            tuple(structures),
            opened.table,
            opened.whole,
            tuple(self._held_out(opened.whole, opened.compared, unseen)),
        )
        evidence, found = self._decided(evidence)
        if self.free:
            if integrating([row for row in found.rows if row.identified], self.records):
                evidence = self._finished(evidence, range(len(evidence.whole)))
            asked = integrating([row for row in evidence.rows if row.identified], self.records)
            evidence = self._with(evidence, asked, "candidates with a pole at zero", unseen)
            evidence, found = self._decided(evidence)
        if self.free:
            asked = drifting(found.rows, found.verdict.place, self.records)
            evidence = self._with(evidence, asked, "candidates with a drift", unseen)
            evidence, found = self._decided(evidence) if asked else (evidence, found)
        if self.late and isinstance(self.method, ThreeModel):
            self.say("whether a delay is missing")
            asked = delayed(found.rows, found.verdict.place, self.records)
            evidence = self._with(evidence, asked, "candidates with a delay", unseen)
            evidence, found = self._decided(evidence) if asked else (evidence, found)
            if found.verdict.by == "slight" and found.likeliest is not None:
                lags = are_lags(found.rows, found.likeliest, self.records)
                evidence, found = self._decided(replace(evidence, lags=lags))
        evidence, rows, found, hankel = self._concluded(evidence, found)
        asked = direct_and_delayed(rows, found.verdict.place, self.records) if self.late else []
        if asked and isinstance(self.method, ThreeModel):
            said = "candidates with a delay and as many zeros as poles"
            evidence = self._with(evidence, asked, said, unseen)
            evidence, rows, found, hankel = self._concluded(*self._decided(evidence))
        place, table = found.verdict.place, evidence.table
        missed = place is not None and self._missed(evidence.whole[place])
        coloured = place is not None and misleads(evidence.whole[place], self.records)
        reason = in_words(rows, found.contenders, found.verdict, missed, coloured)
        finished = all(row.identified for row in rows if row.estimate is not None)
        told = (*told, *notes(table.noise, bool(unseen), finished))
        return Selection(tuple(rows), None if place is None else rows[place], reason, hankel, told)

    def _concluded(
        self, evidence: OrderEvidence, found: Decision
    ) -> tuple[OrderEvidence, list[SelectionRow], Decision, Hankel | None]:
        """Also by poles that rise above the noise and by what bends; the row with all it says."""
        hankel = self._hankel(evidence.table, found.verdict.place)
        if hankel is not None:
            evidence, again = self._decided(evidence, hankel.order)
            if again.verdict.place != found.verdict.place:
                found = again
                hankel = self._hankel(evidence.table, again.verdict.place)
        other = bent(found.rows, found.verdict.place, self.records)
        if other is not None and found.verdict.place is not None:
            smaller, what = other
            instead = found.verdict.place, what
            verdict = replace(found.verdict, place=smaller, by="bent", instead=instead)
            found = replace(found, verdict=verdict)
            hankel = self._hankel(evidence.table, smaller)
        rows, place = list(found.rows), found.verdict.place
        if place is not None:
            rows[place] = self._judged(rows[place])
        return evidence, rows, found, hankel

    def _decided(self, known: OrderEvidence, least: int = 0) -> tuple[OrderEvidence, Decision]:
        """The recommendation, all rows finished that may decide."""
        while True:
            found = decide(known, least)
            asked = wanted(known, found, least)
            if not asked:
                return known, found
            known = self._finished(known, asked)

    def _finished(self, known: OrderEvidence, places: Iterable[int]) -> OrderEvidence:
        """The same with some rows as `identify` gives them."""
        left = [k for k in places if known.whole[k].unfinished]
        if any(known.whole[k].shared for k in left):
            raise _SearchAll
        entries = dict(enumerate(known.whole))
        tasks = [
            CandidateTask(
                self.records, known.structures[k], self.method, shared=False, halfway=True,
                reached=entries[k].left,
            )
            for k in left
        ]  # fmt: skip
        done = self.counted(run_task, tasks, "candidates in all detail") if left else []
        entries |= dict(zip(left, done, strict=True))
        return replace(known, whole=tuple(entries.values()))

    def _held_out(
        self, whole: Sequence[Entry], asked: Sequence[Structure], unseen: tuple[Record, ...]
    ) -> list[HeldOut]:
        tasks = [
            HeldEstimate(e.estimate, self.records, unseen, one)
            for e, one in zip(whole, asked, strict=True)
        ]
        return self.counted(cross_fit, tasks, "fits on samples that were left out")

    def _with(
        self,
        known: OrderEvidence,
        asked: Sequence[Structure],
        said: str,
        unseen: tuple[Record, ...],
    ) -> OrderEvidence:
        """The same with further rows, as far as they can be estimated."""
        tasks = [CandidateTask(self.records, one, self.method, shared=False) for one in asked]
        tried = self.counted(run_task, tasks, said)
        entries = [entry for entry in tried if entry.estimate is not None]
        if not entries:
            return known
        asked = [entry.structure for entry in entries]
        orders = next((tuple(a.size for a in one) for one in known.table.noise if one), ())
        return replace(
            known,
            structures=(*known.structures, *asked),
            table=table_of((*known.table.entries, *entries), self.records, orders),
            whole=(*known.whole, *entries),
            held=(*known.held, *self._held_out(entries, asked, unseen)),
        )

    def _judged(self, row: SelectionRow) -> SelectionRow:
        """The row with all that `identify` says of its estimate."""
        assert row.estimate is not None
        self.say(f"what is to be said of {row.label}")
        between = behaviours(row.estimate, list(self.records))
        told = (taken_as(self.records[0].behaviour),) if self.left_open else ()
        judged = with_judgement(row.estimate, self.records, self.method, between, told)
        return replace(row, estimate=judged)

    def _missed(self, entry: Entry) -> bool:
        """Whether the residual, whitened by the estimate's noise model, follows the input."""
        if entry.estimate is None:
            return False
        return follows_input(entry, entry.estimate.noise_model, self.records)

    def _can_share(self, structure: Structure) -> bool:
        plain = isinstance(self.method, ThreeModel) and self.method.loss == "squared"
        known = structure.delay != "free" and not structure.constrained
        return plain and known and structure.shared

    def _tasks(self, structures: Sequence[Structure]) -> list[CandidateTask]:
        found = []
        asked, estimate = self.identified or (None, None)
        for structure in structures:
            able = self._can_share(structure)
            n = structure.common_poles if able else 0
            seeds = tuple(poles for poles in self.found if poles.size == n)
            task = CandidateTask(self.records, structure, self.method, seeds, (), able)
            found.append(replace(task, found=estimate) if structure is asked else task)
        return found

    def _started(
        self, tasks: Sequence[CandidateTask], alone: Mapping[int, Entry]
    ) -> list[CandidateTask | Entry]:
        """Where the contest begins: at ends on white noise, and with the parallel model's poles."""
        begin = [begun(task, alone[k]) if k in alone else task for k, task in enumerate(tasks)]
        open_ = [isinstance(one, CandidateTask) and one.shared and one.search for one in begin]
        able = [one.structure for one, asked in zip(begin, open_, strict=True) if asked]
        if not able:
            return begin
        self.say("the parallel model, for all candidates")
        try:
            shared = shared_models(self.records, able)
        except (TridentifyError, np.linalg.LinAlgError, ValueError):
            shared = None
        reach = -math.inf if shared is None else shared.models[0].criterion
        orders = {one.common_poles for one in able}
        reduced = {n: () if shared is None else shared.seeds(n) for n in orders}
        return [
            replace(one, seeds=(*one.seeds, *reduced[one.structure.common_poles]), reach=reach)
            if isinstance(one, CandidateTask) and asked
            else one
            for one, asked in zip(begin, open_, strict=True)
        ]

    def _identified(
        self, tasks: Sequence[CandidateTask], before: Sequence[Entry]
    ) -> dict[int, Entry]:
        """What `identify` gives for every candidate of the contest, by its place."""
        known = {id(one.structure): one for one in before if not one.shared}
        ids = [id(task.structure) for task in tasks]
        found = {k: known[own] for k, own in enumerate(ids) if own in known}
        poles = {k: one.structure.common_poles for k, one in enumerate(tasks) if one.shared}
        orders = sorted(set(poles.values()))
        for most in orders[-1:] if self.all_searched else orders:
            wanted = [k for k, n in poles.items() if n <= most and k not in found]
            alone = [self._alone(tasks[k]) for k in wanted]
            said = "the whole search for each"
            said += "" if self.all_searched else f" of {most} poles"
            done = self.counted(run_task, alone, said) if wanted else []
            found |= dict(zip(wanted, done, strict=True))
            searched = {k: found[k] for k, n in poles.items() if n <= most}
            if not self.all_searched and levels_off_at(searched, poles, self.records):
                break
        return found

    def _alone(self, task: CandidateTask) -> CandidateTask:
        halfway = not self.finish and can_stop(self.method, self.records, task.structure)
        return replace(task, shared=False, halfway=halfway)

    def _hankel(self, table: SelectionTable, place: int | None) -> Hankel | None:
        """On operators with the poles of the recommended candidate."""
        if place is None:
            return None
        estimate, poles = table.entries[place].estimate, table.entries[place].poles
        if estimate is None or poles is None:
            return None
        self.say("Hankel singular values of the parallel model")
        known = estimate.structure
        nuisances = Structure(
            1,
            0,
            delay=known.delay,
            offset=known.offset,
            drift=known.drift,
            initial_state=known.initial_state,
        )
        label = order_label(table.entries[place].structure)
        operators = [(f"on the poles of {label}, each {REPEATED} times", np.tile(poles, REPEATED))]
        try:
            return hankel_values(self.records, operators, nuisances, table.noise[place])
        except (TridentifyError, np.linalg.LinAlgError, ValueError):
            return None
