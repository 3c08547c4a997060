"""The contest: the candidates compared on the maximum of one likelihood (`finish_candidates`)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from tridentify.estimation.methods.base import Method
from tridentify.estimation.methods.three_model import ThreeModel
from tridentify.judgement.selection.finish_candidates import (
    MOST_ROUNDS,
    WORSE,
    CandidateTask,
    Entry,
    contained,
    is_on_white,
    narrowed,
    noise_orders,
    nuisance_choices,
    raised,
    run_task,
    with_nuisances,
)
from tridentify.judgement.selection.table import SelectionTable, table_of
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record


@dataclass(frozen=True, eq=False)
class Contest:
    """What the contest needs: ``run`` gives what became of tasks, in their order."""

    records: tuple[Record, ...]
    method: Method
    run: Callable[[Any, Iterable[Any], str], list[Any]]

    def table(
        self, tasks: Sequence[CandidateTask], first: Sequence[CandidateTask | Entry]
    ) -> SelectionTable:
        """Every candidate on the likelihood's maximum, on the same terms.

        Parameters
        ----------
        tasks : sequence of CandidateTask
        first : sequence of CandidateTask or Entry
            The same with their starts, or where they stand.
        """
        orders = (0,) * self.records[0].n_outputs
        said = f"{len(tasks)} candidates on the likelihood's maximum"
        entries = self._ended(first, said)
        pairs = zip(tasks, first, strict=True)
        tasks = [begun if isinstance(begun, CandidateTask) else task for task, begun in pairs]
        table = table_of(self._improved(tasks, entries, orders), self.records, orders)
        for _ in range(MOST_ROUNDS):
            best = table.best("aicc")
            if best is None:
                return table
            if not (isinstance(self.method, ThreeModel) and self.method.noise == "white"):
                orders = noise_orders(table.entries[best], self.records)
            table = table_of(table.entries, self.records, orders)
            pinned = self._same_nuisances(tasks, table, orders)
            own = [
                entry if _is_on(entry, task, noise) else narrowed(task, entry.poles, noise)
                for task, entry, noise in zip(pinned, table.entries, table.noise, strict=True)
            ]
            done = self._ended(own, "all candidates on the same terms")
            entries = [
                entry if again.estimate is None else again
                for entry, again in zip(table.entries, done, strict=True)
            ]
            entries = self._improved(pinned, entries, orders)
            table = table_of(entries, self.records, orders)
            if not any(orders):
                break
        return table

    def _ended(self, begun: Sequence[CandidateTask | Entry], said: str) -> list[Entry]:
        """What became of tasks, and what stands already."""
        tasks = [one for one in begun if isinstance(one, CandidateTask)]
        done = iter(self.run(run_task, tasks, said) if tasks else ())
        return [next(done) if isinstance(one, CandidateTask) else one for one in begun]

    def _same_nuisances(
        self, tasks: Sequence[CandidateTask], table: SelectionTable, orders: tuple[int, ...]
    ) -> list[CandidateTask]:
        """The tasks with the nuisance terms of lowest BIC, of the candidate of lowest BIC."""
        best = table.best("bic")
        if best is None or not table.entries[best].shared:
            return list(tasks)
        task, entry = tasks[best], table.entries[best]
        assert entry.poles is not None
        open_ = nuisance_choices(self.records, task.structure)
        if len(open_) < 2:
            return list(tasks)
        tried = [
            narrowed(with_nuisances(task, terms), entry.poles, table.noise[best]) for terms in open_
        ]
        entries = self.run(run_task, tried, "which nuisance terms")
        chosen = table_of(entries, self.records, orders).best("bic")
        if chosen is None:
            return list(tasks)
        return [with_nuisances(task, open_[chosen]) if task.shared else task for task in tasks]

    def _improved(
        self, tasks: Sequence[CandidateTask], entries: Sequence[Entry], orders: tuple[int, ...]
    ) -> list[Entry]:
        """Candidates that explain less than one that they contain begin again from there."""
        found = list(entries)
        shape = self.records[0].n_outputs, self.records[0].n_inputs
        table = table_of(found, self.records, orders)
        retries: list[tuple[int, CandidateTask]] = []
        for k, (task, entry) in enumerate(zip(tasks, found, strict=True)):
            if not entry.shared or entry.poles is None:
                continue
            own = table.criteria[k]
            for j, small in enumerate(found):
                lesser = table.criteria[j]
                if own is None or lesser is None or small.poles is None:
                    continue
                if not contained(small, entry, shape):
                    continue
                if own.deviance > lesser.deviance + WORSE:
                    seeds = [small.poles]
                    if entry.poles.size > small.poles.size:
                        seeds = raised([*task.seeds, entry.poles], small.poles)
                    noise = table.noise[j] if any(orders) else ()
                    again = replace(task, seeds=tuple(seeds), noise=noise, search=True)
                    retries.append((k, again))
        said = "candidates that fell behind lesser ones again"
        outcomes = self.run(run_task, [task for _, task in retries], said) if retries else []
        for (k, _), entry in zip(retries, outcomes, strict=True):
            other = table_of([entry], self.records, orders).criteria[0]
            own = table_of([found[k]], self.records, orders).criteria[0]
            if other is not None and own is not None and other.deviance < own.deviance:
                found[k] = entry
        return found


def _is_on(entry: Entry, task: CandidateTask, noise: tuple[Array, ...]) -> bool:
    """Whether an entry cannot be finished anew, or stands where it would end."""
    if entry.poles is None or not entry.shared or entry.estimate is None:
        return True
    if any(a.size for a in noise) or not is_on_white(entry.estimate):
        return False
    own, asked = entry.estimate.structure, task.structure
    pairs = (
        (own.offset, asked.offset),
        (own.drift, asked.drift),
        (own.initial_state, asked.initial_state),
    )
    return all(asked in (own, None, "auto") for own, asked in pairs)
