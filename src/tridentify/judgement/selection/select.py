"""From records and candidates to a recommendation.

What is shown belongs to each candidate alone: a row holds the estimate that `identify` gives for
its structure, its fit, and the fit on samples left out in turn. A row does not change with the
company it keeps. Who asks for the recommendation alone gets rows that cannot be it, whatever
`identify` gives, left at the likelihood's maximum (`unfinished`); they say so.

What decides compares them, and a likelihood can only be compared on the same terms. So the
candidates are finished once more, from where each ended, on the maximum of one likelihood, with one
noise model and the same nuisance terms (`contest`); there local minima show by comparison with
lesser candidates. Where noise is not white they share the parallel model there, which is fitted
once (`shared`) and gives all of them further starts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tridentify.errors import DataError
from tridentify.estimation.methods.base import Method, Progress, check_scale, check_signals
from tridentify.judgement.causes.signals.wild_beginning import without_wild_beginning
from tridentify.judgement.choice import checked_method
from tridentify.judgement.selection.decide import (
    is_strictly_proper,
)
from tridentify.judgement.selection.higher import higher_candidates
from tridentify.judgement.selection.orders import (
    checked_candidates,
    default_candidates,
)
from tridentify.judgement.selection.result import Selection
from tridentify.judgement.selection.settle import (
    having_said,
    resettled,
    resettled_again,
    settle,
)
from tridentify.judgement.selection.stages import Work
from tridentify.numerics.executor import Executor, check_told, mapping_of
from tridentify.numerics.threads import one_blas_thread
from tridentify.record.listed import listed
from tridentify.record.record import Record
from tridentify.structure import Structure


def select_structure(
    records: Record | Sequence[Record],
    candidates: Sequence[Structure | Sequence[int]] | None = None,
    *,
    method: Method | None = None,
    validation: Record | Sequence[Record] | None = None,
    template: Structure | None = None,
    integrators: bool | None = None,
    delays: bool | None = None,
    finish: bool = True,
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
    finish : bool, optional
        Whether every row is finished, as `identify` gives it. Without, rows that cannot be
        recommended whatever that is are left at the likelihood's maximum, and the recommendation,
        which is the same, takes a half to a quarter of the time.
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
        work = Work(settled.records, chosen, executor, say, settled.identified, free, late)
        work = replace(work, left_open=bool(settled.told), all_searched=finish, finish=finish)
        # what answers in the same sample may be the controller
        proper = tuple(one for one in structures if is_strictly_proper(one, given[0]))
        plant = proper if proper and candidates is None else structures
        known, before = work.witness(proper or structures)
        looped = work.in_loop(plant, known, settled.told, bool(unseen))
        if looped is not None:
            return looped
        opened = work.opened(structures, before)
        while candidates is None and (
            more := higher_candidates(work.records, structures, opened.table, chosen)
        ):
            structures, work = more.structures, replace(work, found=(*work.found, more.poles))
            opened = work.opened(structures, opened.whole)
        other = resettled(given, unseen, settled, opened.table)
        if other is not None:
            settled, work = other, replace(work, records=other.records, identified=None)
            opened = work.opened(structures)
        found = work.selected(structures, opened, settled.unseen, settled.told)
        other = resettled_again(given, unseen, settled, found.rows, found.recommended, chosen)
        if other is not None:
            work = replace(work, records=other.records, identified=None)
            opened = work.opened(structures)
            found = work.selected(structures, opened, other.unseen, other.told)
        last = found.recommended
        if last is not None and last.estimate is not None:
            by = last.structure, last.estimate
            told = (settled if other is None else other).told
            looped = work.in_loop(plant, by, told, bool(unseen))
            if looped is not None:
                return looped
        return having_said(found, given, work.records, chosen)


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
