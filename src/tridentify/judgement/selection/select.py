"""From records and candidates to a recommendation.

What is shown belongs to each candidate alone: every row holds the estimate that `identify` gives
for its structure, its fit, and the fit on samples left out in turn. A row does not change with the
company it keeps.

What decides compares them, and a likelihood can only be compared on the same terms. So the
candidates are finished once more on the maximum of one likelihood, with one noise model and the
same nuisance terms (`contest`); there they share their work: the parallel model is fitted once
(`shared`) and gives all of them their starts, and local minima show by comparison with lesser
candidates.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tridentify.errors import DataError, TridentifyError
from tridentify.estimation.answer.estimate import Estimate, Status
from tridentify.estimation.likelihood.raster import are_even
from tridentify.estimation.methods.base import Method, Progress, check_scale, check_signals
from tridentify.estimation.methods.three_model import ThreeModel
from tridentify.estimation.posterior.mean import vagueness
from tridentify.judgement.causes.intersample import IN_WORDS, behaviours
from tridentify.judgement.choice import checked_method, listed, with_behaviour, with_judgement
from tridentify.judgement.selection.criteria import (
    Criteria,
    criteria_of,
    free_coefficients,
    largest_relative_std,
    unknowns_of,
    young,
)
from tridentify.judgement.selection.finish_candidates import (
    MOST_ROUNDS,
    WORSE,
    CandidateTask,
    Entry,
    contained,
    narrowed,
    noise_of_orders,
    noise_orders,
    nuisance_choices,
    raised,
    run_task,
    with_nuisances,
)
from tridentify.judgement.selection.hankel import Hankel, hankel_values
from tridentify.judgement.selection.held_out import HeldEstimate, HeldOut, cross_fit
from tridentify.judgement.selection.orders import (
    checked_candidates,
    default_candidates,
    order_label,
)
from tridentify.judgement.selection.paired import Unseen
from tridentify.judgement.selection.result import Selection, SelectionRow
from tridentify.judgement.selection.rule import (
    Contender,
    Trial,
    choose,
    levels_off,
    recommend,
    refuted,
)
from tridentify.judgement.selection.shared import Shared, shared_models
from tridentify.judgement.selection.soundness import CANCELS, apart_from_vagueness, doubts
from tridentify.judgement.selection.words import in_words
from tridentify.numerics.executor import Executor
from tridentify.numerics.threads import one_blas_thread
from tridentify.record.record import Record
from tridentify.structure import Structure

Array = NDArray[np.float64]
REPEATED = 3
"""How often each pole stands in the basis of the Hankel values: what is near the model is spanned
by twice, and once more is room for what it lacks."""
HALF = 0.5
"""Standard error over natural size of a section's coefficients below which poles are identified."""


def select_structure(
    records: Record | Sequence[Record],
    candidates: Sequence[Structure] | None = None,
    *,
    method: Method | None = None,
    validation: Record | Sequence[Record] | None = None,
    template: Structure | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Selection:
    """Compare structures and recommend one.

    Parameters
    ----------
    records : Record or sequence of Record
        One or several experiments on the same system.
    candidates : sequence of Structure, optional
        Default `default_candidates`: 1 to 4 poles with every relative degree from 1 on.
    method : Method, optional
        Default ``ThreeModel()``. With another method every candidate is identified by it and
        nothing is shared.
    validation : Record or sequence of Record, optional
        Records to judge the fit on; default: blocks of ``records`` that are left out in turn.
    template : Structure, optional
        Where `candidates` are left out: what offset, drift, initial state and delay they have.
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
    given = tuple(listed(records))
    unseen = () if validation is None else tuple(listed(validation))
    if not given:
        raise DataError("found no record; expected at least one; pass a Record or a list of them")
    _check_channels(given, unseen)
    chosen = checked_method(method)
    if candidates is None:
        structures = default_candidates(given, template)
    else:
        structures = checked_candidates(candidates)
    if structures and all(record.n_samples for record in given):
        check_signals(given)
        check_scale(given, min(structures, key=lambda one: np.max(one.poles)))
    say = progress or (lambda _: None)
    with one_blas_thread():
        given, unseen, told = _settled(given, unseen, structures, chosen, say)
        return _Work(given, chosen, executor, say).selection(structures, unseen, told)


def _settled(
    records: tuple[Record, ...],
    unseen: tuple[Record, ...],
    structures: Sequence[Structure],
    method: Method,
    say: Progress,
) -> tuple[tuple[Record, ...], tuple[Record, ...], tuple[str, ...]]:
    """The records with one behaviour of the input for all candidates, where it was left open."""
    if all(record.intersample != "auto" for record in (*records, *unseen)):
        return records, unseen, ()
    middle = _middle(structures)
    say(f"what the input does between its samples, with {order_label(middle)}")
    try:
        seen = with_behaviour(method, list(records), middle, None)[1]
    except (TridentifyError, np.linalg.LinAlgError, ValueError):
        seen = [record.settled(record.behaviour) for record in records]
    behaviour = seen[0].behaviour
    told = (
        f"input taken as {IN_WORDS[behaviour]} for all candidates, as {order_label(middle)} says: "
        "state intersample where you know it"
    )
    return tuple(seen), tuple(one.settled(behaviour) for one in unseen), (told,)


def _middle(structures: Sequence[Structure]) -> Structure:
    """The candidate in the middle by its poles, of those the one with most zeros."""

    def sizes(one: Structure) -> tuple[int, int]:
        return tuple(
            v if isinstance(v, int) else max(k for row in v for k in row)
            for v in (one.poles, one.zeros)
        )  # type: ignore[return-value]

    ordered = sorted(structures, key=sizes)
    poles = sizes(ordered[(len(ordered) - 1) // 2])[0]
    return max((one for one in ordered if sizes(one)[0] == poles), key=sizes)


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
class SelectionTable:
    """The entries with their criteria and models of the noise, of the same orders."""

    entries: tuple[Entry, ...]
    criteria: tuple[Criteria | None, ...]
    noise: tuple[tuple[Array, ...], ...]

    def contenders(self) -> list[Contender]:
        """What the rule sees."""
        return [_contender(e, c) for e, c in zip(self.entries, self.criteria, strict=True)]

    def best(self, criterion: str) -> int | None:
        """The usable entry where a criterion is lowest."""
        rows = self.contenders()
        kept = [k for k, one in enumerate(rows) if one.usable]
        return min(kept, key=lambda k: float(getattr(rows[k].criteria, criterion)), default=None)


@dataclass(frozen=True, eq=False)
class _Work:
    """What all stages need."""

    records: tuple[Record, ...]
    method: Method
    executor: Executor | None
    say: Progress

    def run(self, function: Any, tasks: Iterable[Any], said: str) -> list[Any]:
        """All tasks, in their order."""
        self.say(said)
        mapped = map if self.executor is None else self.executor.map
        return list(mapped(function, list(tasks)))

    def counted(self, function: Any, tasks: Sequence[Any], said: str) -> list[Any]:
        """The same, with a word after each."""
        mapped = map if self.executor is None else self.executor.map
        found = []
        for done, outcome in enumerate(mapped(function, tasks), 1):
            found.append(outcome)
            self.say(f"{said}: {done} of {len(tasks)} done")
        return found

    def selection(
        self, structures: Sequence[Structure], unseen: tuple[Record, ...], told: tuple[str, ...]
    ) -> Selection:
        """All stages."""
        self.say("the parallel model, for all candidates")
        shared = self._shared(structures)
        tasks = self._tasks(structures, shared)
        table = self.contest(tasks, shared)
        whole = self._identified(tasks, table)
        held = self.counted(
            cross_fit,
            [
                HeldEstimate(e.estimate, self.records, unseen, asked)
                for e, asked in zip(whole, structures, strict=True)
            ],
            "fits on samples that were left out",
        )
        rows = [
            self._row(structures[k], entry, criteria, fit, table.entries[k].estimate)
            for k, (entry, criteria, fit) in enumerate(
                zip(whole, table.criteria, held, strict=True)
            )
        ]
        objections = _objections(table.contenders(), rows)
        contenders = [
            replace(one, known=one.known and not against)
            for one, against in zip(table.contenders(), objections, strict=True)
        ]
        likeliest = choose(contenders)
        found = levels_off(contenders, likeliest)
        against = () if likeliest is None else objections[likeliest]
        explains = (
            likeliest is not None
            and not (apart_from_vagueness(against) if found else against)
            and not _follows_input(table.entries[likeliest], table.noise[likeliest], self.records)
        )
        noise = () if likeliest is None else table.noise[likeliest]
        judges = unseen or self.records
        verdict = recommend(
            [_trial(row, fit, noise, judges) for row, fit in zip(rows, held, strict=True)],
            likeliest,
            explains=explains,
            sharp=likeliest is not None and (found or _is_sharp(rows[likeliest])),
        )
        place = verdict.place
        if place is not None:
            if verdict.by == "likelihood":
                rows[place] = replace(rows[place], doubts=objections[place])
            rows[place] = self._judged(rows[place])
        hankel = self._hankel(table, place)
        missed = place is not None and self._missed(whole[place])
        reason = in_words(rows, contenders, verdict, missed)
        notes = (*told, *_notes(table, unseen))
        return Selection(tuple(rows), None if place is None else rows[place], reason, hankel, notes)

    def _judged(self, row: SelectionRow) -> SelectionRow:
        """The row with all that `identify` says of its estimate."""
        assert row.estimate is not None
        self.say(f"what is to be said of {row.label}")
        between = behaviours(row.estimate, list(self.records))
        return replace(
            row, estimate=with_judgement(row.estimate, self.records, self.method, between)
        )

    def _missed(self, entry: Entry) -> bool:
        """Whether the residual, whitened by the estimate's noise model, follows the input."""
        if entry.estimate is None:
            return False
        return _follows_input(entry, entry.estimate.noise_model, self.records)

    def _shared(self, structures: Sequence[Structure]) -> Shared | None:
        able = [s for s in structures if self._can_share(s)]
        try:
            return shared_models(self.records, able)
        except (TridentifyError, np.linalg.LinAlgError, ValueError):
            return None

    def _can_share(self, structure: Structure) -> bool:
        plain = isinstance(self.method, ThreeModel) and self.method.loss == "squared"
        known = structure.delay != "free" and not structure.constrained
        return plain and known and structure.shared

    def _tasks(self, structures: Sequence[Structure], shared: Shared | None) -> list[CandidateTask]:
        found = []
        reach = -math.inf if shared is None else shared.models[0].criterion
        for structure in structures:
            able = shared is not None and self._can_share(structure)
            seeds = shared.seeds(structure.common_poles) if shared is not None and able else ()
            found.append(
                CandidateTask(self.records, structure, self.method, seeds, (), able, reach=reach)
            )
        return found

    def contest(self, tasks: Sequence[CandidateTask], shared: Shared | None) -> SelectionTable:
        """Every candidate on the likelihood's maximum, on the same terms (`contest`)."""
        orders = (0,) * self.records[0].n_outputs
        entries = self.run(run_task, tasks, f"{len(tasks)} candidates from shared starts")
        table = _table(self._improved(tasks, entries, shared, orders), self.records, orders)
        for _ in range(MOST_ROUNDS):
            best = table.best("aicc")
            if best is None:
                return table
            if not (isinstance(self.method, ThreeModel) and self.method.noise == "white"):
                orders = noise_orders(table.entries[best], self.records)
            table = _table(table.entries, self.records, orders)
            pinned = self._same_nuisances(tasks, table, orders)
            own = [
                narrowed(task, (*task.seeds, entry.poles), noise)
                for task, entry, noise in zip(pinned, table.entries, table.noise, strict=True)
                if entry.poles is not None and entry.shared
            ]
            done = iter(self.run(run_task, own, "all candidates on the same terms"))
            entries = []
            for entry in table.entries:
                again = next(done) if entry.poles is not None and entry.shared else entry
                entries.append(entry if again.estimate is None else again)
            entries = self._improved(pinned, entries, shared, orders)
            table = _table(entries, self.records, orders)
            if not any(orders):
                break
        return table

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
            narrowed(with_nuisances(task, terms), (entry.poles,), table.noise[best])
            for terms in open_
        ]
        entries = self.run(run_task, tried, "which nuisance terms")
        chosen = _table(entries, self.records, orders).best("bic")
        if chosen is None:
            return list(tasks)
        return [with_nuisances(task, open_[chosen]) if task.shared else task for task in tasks]

    def _improved(
        self,
        tasks: Sequence[CandidateTask],
        entries: Sequence[Entry],
        shared: Shared | None,
        orders: tuple[int, ...],
    ) -> list[Entry]:
        """Candidates that explain less than one that they contain begin again from there."""
        found = list(entries)
        shape = self.records[0].n_outputs, self.records[0].n_inputs
        table = _table(found, self.records, orders)
        retries: list[tuple[int, CandidateTask]] = []
        for k, (task, entry) in enumerate(zip(tasks, found, strict=True)):
            if not entry.shared or entry.poles is None or shared is None:
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
                    retries.append((k, replace(task, seeds=tuple(seeds), noise=noise)))
        said = "candidates that fell behind lesser ones again"
        outcomes = self.run(run_task, [task for _, task in retries], said) if retries else []
        for (k, _), entry in zip(retries, outcomes, strict=True):
            other = _table([entry], self.records, orders).criteria[0]
            own = _table([found[k]], self.records, orders).criteria[0]
            if other is not None and own is not None and other.deviance < own.deviance:
                found[k] = entry
        return found

    def _identified(self, tasks: Sequence[CandidateTask], table: SelectionTable) -> list[Entry]:
        """What `identify` gives for every candidate."""
        wanted = [k for k, entry in enumerate(table.entries) if entry.shared]
        whole = [replace(tasks[k], shared=False) for k in wanted]
        outcomes = dict(
            zip(wanted, self.counted(run_task, whole, "the whole search for each"), strict=True)
        )
        # one that the whole search refuses is refused, whatever the contest made of it
        return [outcomes.get(k, entry) for k, entry in enumerate(table.entries)]

    def _row(
        self,
        structure: Structure,
        entry: Entry,
        criteria: Criteria | None,
        held: HeldOut,
        maximum: Estimate | None,
    ) -> SelectionRow:
        """A row: all of its own estimate, but the criteria of the contest."""
        estimate = entry.estimate
        if estimate is None:
            return SelectionRow(structure, None, entry.reason or "no estimate")
        widest_std, widest = largest_relative_std(estimate)
        # earlier passes may carry nuisance terms that depend on each other and were left out
        last = estimate.trace.passes[-1].steps if estimate.trace.passes else ()
        steps = [step.condition for step in last]
        conditions = [c for c in (*steps, estimate.condition) if math.isfinite(c)]
        row = SelectionRow(
            structure=structure,
            estimate=estimate,
            fit=estimate.fit,
            cross_fit=held.fit,
            held_out_reason=held.reason,
            doubts=doubts(estimate, self.records),
            condition=max(conditions, default=math.nan),
            relative_std=widest_std,
            widest=widest,
            n_coefficients=free_coefficients(estimate),
            identified=True,
            ok=estimate.status.ok,
        )
        if criteria is None or maximum is None:
            return row
        return replace(
            row,
            aic=criteria.aic,
            aicc=criteria.aicc,
            bic=criteria.bic,
            yic=young(maximum, _spread(self.records)),
            n_unknowns=criteria.n_unknowns,
            deviance=criteria.deviance,
        )

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


def _objections(
    contenders: Sequence[Contender], rows: Sequence[SelectionRow]
) -> list[tuple[str, ...]]:
    """What speaks against each row where the likelihood has its say."""
    orders: list[tuple[int, int] | None] = []
    for row in rows:
        n, m = row.structure.poles, row.structure.zeros
        orders.append((n, m) if isinstance(n, int) and isinstance(m, int) else None)
    return [
        tuple(one for one in row.doubts if not (against and one == CANCELS))
        for row, against in zip(rows, refuted(contenders, orders), strict=True)
    ]


def _is_sharp(row: SelectionRow) -> bool:
    """Whether the likelihood is as good as Gaussian about an estimate."""
    return row.estimate is not None and row.estimate.status is Status.CONVERGED


def _trial(
    row: SelectionRow, held: HeldOut, noise: Sequence[Array], records: Sequence[Record]
) -> Trial:
    """A candidate on samples that it has not seen."""
    if row.estimate is None:
        return Trial(0, Unseen(), Unseen(), False, False)
    unseen = _unseen(held, records)
    return Trial(
        row.n_coefficients,
        unseen,
        replace(unseen, noise=tuple(noise)),
        not row.doubts and not held.reason,
        row.ok,
    )


def _unseen(held: HeldOut, records: Sequence[Record]) -> Unseen:
    """The errors, each output over its spread and over their number; none where they grow."""
    if not held.errors:
        return Unseen()
    centred = [np.asarray(r.y) - np.nanmean(np.asarray(r.y), axis=0) for r in records]
    spread = np.sum([np.nansum(one**2, axis=0) for one in centred], axis=0)
    size = np.sqrt(np.where(spread > 0, spread, 1.0) * spread.size)
    found = Unseen(tuple(one / size for one in held.errors), held.terms)
    return found if math.isfinite(found.loss) else Unseen()


def _table(
    entries: Sequence[Entry], records: Sequence[Record], orders: tuple[int, ...]
) -> SelectionTable:
    """Criteria on the samples that all candidates explain, with noise models of given orders."""
    common = [np.isfinite(np.asarray(record.y)) for record in records]
    for entry in entries:
        for e, residual in enumerate(entry.residuals):
            common[e] &= np.isfinite(residual)
    size = np.mean([np.nanmean(np.asarray(r.y) ** 2, axis=0) for r in records], axis=0)
    found: list[Criteria | None] = []
    noises: list[tuple[Array, ...]] = []
    for entry in entries:
        if entry.estimate is None:
            found.append(None)
            noises.append(())
            continue
        seen = [np.where(c, r, np.nan) for c, r in zip(common, entry.residuals, strict=True)]
        noises.append(noise_of_orders(seen, orders))
        found.append(criteria_of(seen, noises[-1], size, unknowns_of(entry.estimate)))
    return SelectionTable(tuple(entries), tuple(found), tuple(noises))


def _contender(entry: Entry, criteria: Criteria | None) -> Contender:
    estimate = entry.estimate
    if estimate is None or criteria is None:
        return Contender(Criteria(0, 1, math.inf), 0, False)
    structure = entry.structure
    shape = len(estimate.output_names), len(estimate.input_names)
    poles = structure.poles_matrix(*shape)
    count = structure.common_poles if structure.shared else sum(map(sum, poles))
    room = criteria.n_samples > criteria.n_unknowns + 2
    usable = estimate.status.ok and room and math.isfinite(criteria.deviance)
    return Contender(criteria, count, bool(usable), _is_known(entry))


def _is_known(entry: Entry) -> bool:
    """Whether the poles are identified: no coefficient of a section is half unknown."""
    estimate, poles = entry.estimate, entry.poles
    if estimate is None or estimate.status is Status.WEAKLY_IDENTIFIABLE:
        return False
    if poles is None:
        return True
    n = poles.size
    return vagueness(poles, np.asarray(estimate.cov)[:n, :n], entry.longest) < HALF


def _spread(records: Sequence[Record]) -> Array:
    return np.asarray(np.mean([np.nanvar(np.asarray(r.y), axis=0) for r in records], axis=0))


def _follows_input(entry: Entry, noise: tuple[Array, ...], records: Sequence[Record]) -> bool:
    """Whether the whitened residual knows the input (a chi-square test at 0.1 %)."""
    from scipy.special import chdtri

    from tridentify.numerics.whiteness import input_share

    if not are_even(records):
        return False
    for i, a in enumerate(noise):
        for one, record in zip(entry.residuals, records, strict=True):
            _, statistic, dimension = input_share(one[:, i], np.asarray(record.u), a)
            if statistic > chdtri(dimension, 1e-3):
                return True
    return False


def _notes(table: SelectionTable, unseen: Sequence[Record]) -> tuple[str, ...]:
    told = []
    noise = next((noise for noise in table.noise if noise), ())
    if any(a.size for a in noise):
        sizes = ", ".join(str(a.size) for a in noise)
        told.append(
            "the noise is coloured: likelihoods are compared on samples whitened by "
            f"autoregressions, for every candidate of the same order ({sizes})"
        )
    if unseen:
        told.append("held-out: fit of the validation record, offset and initial state fitted to it")
    else:
        told.append(
            "held-out: fit of blocks of the record that were left out in turn, offset and initial "
            "state fitted to the whole record"
        )
    told.append("fit and coefficients of every row are those that identify gives for it alone")
    return tuple(told)
