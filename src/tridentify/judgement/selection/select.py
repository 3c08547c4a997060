"""From records and candidates to a recommendation.

What is shown belongs to each candidate alone: every row holds the estimate that `identify` gives
for its structure, its fit, and the fit on samples left out in turn. A row does not change with the
company it keeps.

What decides compares them, and a likelihood can only be compared on the same terms. So the
candidates are finished once more, from where each ended, on the maximum of one likelihood, with one
noise model and the same nuisance terms (`contest`); there local minima show by comparison with
lesser candidates. Where noise is not white they share the parallel model there, which is fitted
once (`shared`) and gives all of them further starts.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tridentify.errors import DataError, TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.methods.base import Method, Progress, check_scale, check_signals
from tridentify.estimation.methods.three_model import ThreeModel
from tridentify.judgement.causes.attempts.intersample import behaviours, taken_as
from tridentify.judgement.causes.signals.wild_beginning import without_wild_beginning
from tridentify.judgement.choice import checked_method, with_judgement
from tridentify.judgement.selection.beside import bent, drifting
from tridentify.judgement.selection.contest import Contest
from tridentify.judgement.selection.decide import (
    Decision,
    OrderEvidence,
    decide,
    follows_input,
    is_strictly_proper,
    misleads,
)
from tridentify.judgement.selection.finish_candidates import CandidateTask, Entry, begun, run_task
from tridentify.judgement.selection.hankel import Hankel, hankel_values
from tridentify.judgement.selection.held_out import HeldEstimate, HeldOut, cross_fit
from tridentify.judgement.selection.higher import higher_candidates
from tridentify.judgement.selection.in_loop import loop_of, select_in_loop
from tridentify.judgement.selection.integrators import integrating
from tridentify.judgement.selection.late import are_lags, delayed, direct_and_delayed
from tridentify.judgement.selection.orders import (
    checked_candidates,
    default_candidates,
    order_label,
)
from tridentify.judgement.selection.result import Selection, SelectionRow
from tridentify.judgement.selection.settle import (
    having_said,
    middle,
    resettled,
    resettled_again,
    settle,
)
from tridentify.judgement.selection.shared import shared_models
from tridentify.judgement.selection.table import SelectionTable, table_of
from tridentify.judgement.selection.words import in_words, notes
from tridentify.numerics.arrays import Complex
from tridentify.numerics.executor import Executor, check_told, mapping_of
from tridentify.numerics.threads import one_blas_thread
from tridentify.record.listed import listed
from tridentify.record.record import Record
from tridentify.structure import Structure

REPEATED = 3
"""How often each pole stands in the basis of the Hankel values: what is near the model is spanned
by twice, and once more is room for what it lacks."""


def select_structure(
    records: Record | Sequence[Record],
    candidates: Sequence[Structure | Sequence[int]] | None = None,
    *,
    method: Method | None = None,
    validation: Record | Sequence[Record] | None = None,
    template: Structure | None = None,
    integrators: bool | None = None,
    delays: bool | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Selection:
    """Compare structures and recommend one.

    Parameters
    ----------
    records : Record or sequence of Record
        One or several experiments on the same system.
    candidates : sequence of Structure or of pairs of int, optional
        ``(2, 1)`` or ``[2, 1]`` stands for ``Structure(2, 1)``. Default `default_candidates`: 1 to
        4 poles with every relative degree from 1 on.
    method : Method, optional
        Default ``ThreeModel()``. With another method every candidate is identified by it and
        nothing is shared.
    validation : Record or sequence of Record, optional
        Records to judge the fit on; default: blocks of ``records`` that are left out in turn.
    template : Structure, optional
        Where `candidates` are left out: what offset, drift, initial state and delay they have.
    integrators : bool, optional
        Whether a row with a pole at zero joins the candidates where one of them ends with a time
        constant longer than the record. Default: where `candidates` are left out.
    delays : bool, optional
        Whether rows with a delay that is estimated along join the candidates, where a candidate
        smaller than the recommended one then explains the record better. Default: where
        `candidates` are left out.
    executor : executor of concurrent.futures, optional
        Runs the candidates side by side. The result does not depend on it.
    progress : callable, optional
        Told in words what is going on.

    Returns
    -------
    Selection
        A candidate that cannot be estimated is a row with the reason.

    Raises
    ------
    CandidateError
        There is no candidate, or one of them is not a Structure.
    OptionError
        If ``method`` or ``template`` is something else.
    DataError
        If there is no record, or something in place of one.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Record, Structure, TransferFunction, select_structure, simulate
    >>> rng = np.random.default_rng(0)
    >>> u = np.repeat(rng.choice([-1.0, 1.0], 60), 5)
    >>> y = simulate(TransferFunction([9.0], [1.0, 3.0, 9.0]), Record(u, u, dt=0.05))
    >>> record = Record(u, y + 0.05 * rng.standard_normal((300, 1)), dt=0.05)
    >>> selection = select_structure(record, [Structure(1, 0), Structure(2, 0), Structure(2, 1)])
    >>> selection.recommended.label
    '2, 0'
    """
    mapping_of(executor)
    check_told(progress)
    given = tuple(without_wild_beginning(listed(records))[0])
    unseen = () if validation is None else tuple(without_wild_beginning(listed(validation))[0])
    if not given:
        raise DataError("found no record; expected at least one; pass a Record or a list of them")
    _check_channels(given, unseen)
    chosen = checked_method(method)
    if candidates is None:
        structures = default_candidates(given, template)
    else:
        structures = checked_candidates(candidates)
    if structures and all(record.n_samples for record in given):
        sizes = check_signals(given)
        check_scale(given, min(structures, key=lambda one: np.max(one.poles)), *sizes)
    say = progress or (lambda _: None)
    with one_blas_thread():
        settled = settle(given, unseen, structures, chosen, say)
        free = candidates is None if integrators is None else integrators
        late = candidates is None if delays is None else delays
        work = _Work(settled.records, chosen, executor, say, settled.identified, free, late)
        work = replace(work, left_open=bool(settled.told))
        # what answers in the same sample may be the controller
        proper = tuple(one for one in structures if is_strictly_proper(one, given[0]))
        plant = proper if proper and candidates is None else structures
        looped = work.in_loop(plant, work.witness(proper or structures), settled.told, bool(unseen))
        if looped is not None:
            return looped
        opened = work.opened(structures)
        while candidates is None and (
            more := higher_candidates(work.records, structures, opened.table, chosen)
        ):
            structures, work = more.structures, replace(work, found=(*work.found, more.poles))
            opened = work.opened(structures, opened.whole)
        other = resettled(given, unseen, settled, opened.table)
        if other is not None:
            settled, work = other, replace(work, records=other.records, identified=None)
            opened = work.opened(structures)
        found = work.selection(structures, opened, settled.unseen, settled.told)
        other = resettled_again(given, unseen, settled, found.rows, found.recommended, chosen)
        if other is not None:
            work = replace(work, records=other.records, identified=None)
            opened = work.opened(structures)
            found = work.selection(structures, opened, other.unseen, other.told)
        last = found.recommended
        if last is not None and last.estimate is not None:
            by = last.structure, last.estimate
            told = (settled if other is None else other).told
            looped = work.in_loop(plant, by, told, bool(unseen))
            if looped is not None:
                return looped
        return having_said(found, given, work.records, chosen)


def _with_drift(task: CandidateTask, alone: Entry) -> CandidateTask:
    """The candidate with the drift that its own estimate has found; its rivals may have none."""
    degree = 0 if alone.estimate is None else alone.estimate.structure.drift_degree
    if task.structure.drift is not False or not degree:
        return task
    return replace(task, structure=replace(task.structure, drift=degree))


def _check_channels(records: Sequence[Record], unseen: Sequence[Record]) -> None:
    """Refuse a validation record with other channels."""
    first = records[0]
    for record in unseen:
        if (record.n_inputs, record.n_outputs) != (first.n_inputs, first.n_outputs):
            raise DataError(
                f"found a validation record with {record.n_inputs} inputs and {record.n_outputs} "
                f"outputs; expected {first.n_inputs} and {first.n_outputs} as in the records; "
                "select its channels first"
            )


@dataclass(frozen=True, eq=False)
class _Opened:
    """The candidates by themselves, and compared on the maximum of one likelihood.

    ``compared``: with the drift that an estimate of a candidate has found.
    """

    compared: tuple[Structure, ...]
    table: SelectionTable
    whole: tuple[Entry, ...]


@dataclass(frozen=True, eq=False)
class _Work:
    """What all stages need; ``free`` and ``late`` say which rows may join.

    ``found`` holds poles from which candidates of as many begin, too; ``left_open`` says that the
    behaviour of the input was found.
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

    def opened(self, structures: Sequence[Structure], before: Sequence[Entry] = ()) -> _Opened:
        """Each candidate as `identify` gives it, and the contest from there.

        Those of ``before``, of the same records, are not identified again.
        """
        tasks = self._tasks(structures)
        alone = self._identified(tasks, before)
        tasks = [_with_drift(one, alone[k]) if k in alone else one for k, one in enumerate(tasks)]
        first = self._started(tasks, alone)
        table = Contest(self.records, self.method, self.run).table(tasks, first)
        whole = (alone.get(k, entry) for k, entry in enumerate(table.entries))
        return _Opened(tuple(one.structure for one in tasks), table, tuple(whole))

    def witness(self, structures: Sequence[Structure]) -> tuple[Structure, Estimate] | None:
        """The estimate of the candidate in the middle, which tells whether there is a loop."""
        asked = middle(structures)
        if self.identified is not None and self.identified[0] == asked:
            return self.identified
        self.say(f"a model of {order_label(asked)}")
        entry = run_task(CandidateTask(self.records, asked, self.method, shared=False))
        return None if entry.estimate is None else (asked, entry.estimate)

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

    def selection(
        self,
        structures: Sequence[Structure],
        opened: _Opened,
        unseen: tuple[Record, ...],
        told: tuple[str, ...],
    ) -> Selection:
        """What follows the contest: held-out samples, the recommendation."""
        evidence = OrderEvidence(
            self.records,
            unseen or self.records,
            tuple(structures),
            opened.table,
            opened.whole,
            tuple(self._held_out(opened.whole, opened.compared, unseen)),
        )
        if self.free:
            asked = integrating(evidence.rows, self.records)
            evidence = self._with(evidence, asked, "candidates with a pole at zero", unseen)
        found = decide(evidence)
        if self.free:
            asked = drifting(found.rows, found.verdict.place, self.records)
            evidence = self._with(evidence, asked, "candidates with a drift", unseen)
            found = decide(evidence) if asked else found
        if self.late and isinstance(self.method, ThreeModel):
            self.say("whether a delay is missing")
            asked = delayed(found.rows, found.verdict.place, self.records)
            evidence = self._with(evidence, asked, "candidates with a delay", unseen)
            found = decide(evidence) if asked else found
            if found.verdict.by == "slight" and found.likeliest is not None:
                lags = are_lags(found.rows, found.likeliest, self.records)
                evidence = replace(evidence, lags=lags)
                found = decide(evidence)
        rows, found, hankel = self._concluded(evidence, found)
        asked = direct_and_delayed(rows, found.verdict.place, self.records) if self.late else []
        if asked and isinstance(self.method, ThreeModel):
            said = "candidates with a delay and as many zeros as poles"
            evidence = self._with(evidence, asked, said, unseen)
            rows, found, hankel = self._concluded(evidence, decide(evidence))
        place, table = found.verdict.place, evidence.table
        missed = place is not None and self._missed(evidence.whole[place])
        coloured = place is not None and misleads(evidence.whole[place], self.records)
        reason = in_words(rows, found.contenders, found.verdict, missed, coloured)
        told = (*told, *notes(table.noise, bool(unseen)))
        return Selection(tuple(rows), None if place is None else rows[place], reason, hankel, told)

    def _concluded(
        self, evidence: OrderEvidence, found: Decision
    ) -> tuple[list[SelectionRow], Decision, Hankel | None]:
        """Also by poles that rise above the noise and by what bends; the row with all it says."""
        hankel = self._hankel(evidence.table, found.verdict.place)
        if hankel is not None:
            again = decide(evidence, hankel.order)
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
        return rows, found, hankel

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
        known = {id(one.structure): one for one in before}
        ids = [id(task.structure) for task in tasks]
        found = {k: known[own] for k, own in enumerate(ids) if own in known}
        wanted = [k for k, task in enumerate(tasks) if task.shared and k not in found]
        alone = [replace(tasks[k], shared=False) for k in wanted]
        said = "the whole search for each"
        done = self.counted(run_task, alone, said)
        return found | dict(zip(wanted, done, strict=True))

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
