"""Which order, where the input reacts to the output and no reference says what else moved it.

Open loop every candidate is biased: the larger ones explain the controller along with the plant,
and of a plant that is held the best model by simulation may be the controller, backwards. How well
a record is repeated then says little, of samples that were left out as of any others.

So every candidate is estimated by the direct route, as `identify` does (`judgement.direct`), and
candidates are compared by what that route minimises, the error one sample ahead: the innovations
are independent of past inputs whether or not a controller acts, if plant and noise are right. Each
candidate has a noise model of its own, whose order it pays for (AICc). The rule is that of
`rule.choose` among candidates that nothing speaks against.

Enough samples refute all but the largest candidate, of a measured record. A record has a true order
where the likelihood ends before the largest candidate; where it does not, further coefficients have
to lower the error one sample ahead by `POINT`, as of fits elsewhere.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.likelihood.thresholds import CLEARLY, RIVAL
from tridentify.estimation.methods.three_model import ThreeModel
from tridentify.judgement.direct import (
    by_direct_route,
    held_by_a_controller,
    why_directly,
    widened,
)
from tridentify.judgement.selection.criteria import (
    Criteria,
    free_coefficients,
    largest_relative_std,
    own_criteria,
)
from tridentify.judgement.selection.integrators import at_zero
from tridentify.judgement.selection.result import AHEAD, Selection, SelectionRow
from tridentify.judgement.selection.rule import POINT, Contender, adequate, choose, levels_off
from tridentify.judgement.selection.soundness import doubts
from tridentify.judgement.selection.words import reason_ahead
from tridentify.numerics.threads import one_blas_thread
from tridentify.record.record import Record
from tridentify.structure import Structure

UNSEEN = 2.0
"""Standard errors up to which a constant term ``a0`` may be zero."""

IN_TURN = (
    "of plant and noise in turn where a row was far from being recommended, or something spoke "
    "against it there"
)

Runner = Callable[[Callable[["LoopTask"], SelectionRow], Sequence["LoopTask"], str], list[Any]]

COMPARED_AHEAD = (
    "each row is estimated by the direct route, with a noise model of its own, and they are "
    "compared by their error one sample ahead (AICc); fit is that of a simulation"
)


@dataclass(frozen=True, eq=False)
class Loop:
    """Records of which the input reacts to the output.

    Attributes
    ----------
    records : tuple of Record
        With the behaviour of their inputs settled.
    why : str
        What shows that the input reacts.
    left_open : bool
        Whether nobody stated that behaviour.
    """

    records: tuple[Record, ...]
    why: str
    left_open: bool


@dataclass(frozen=True, eq=False)
class LoopTask:
    """One candidate, to be estimated by the direct route with the options of a method."""

    loop: Loop
    structure: Structure
    method: ThreeModel


def loop_of(
    records: tuple[Record, ...],
    structure: Structure,
    estimate: Estimate,
    method: ThreeModel,
    *,
    left_open: bool,
) -> Loop | None:
    """What an estimate shows of a loop.

    Where the behaviour of the input was left open and open loop took it for one that moves between
    its samples, a held one is tried as well: of what moves there the past of an output may tell
    more than its own samples do, so that feedback is not looked for. It is a loop if the direct
    route then explains the record far better than the open loop did.

    Parameters
    ----------
    records : tuple of Record
        With the behaviour of their inputs settled.
    structure : Structure
    estimate : Estimate
        Of them, with that structure.
    method : ThreeModel
    left_open : bool
        Whether nobody stated that behaviour.

    Returns
    -------
    Loop or None
        None where nothing calls for the direct route.
    """
    why = why_directly(method, estimate, records)
    if why:
        seen = held_by_a_controller(estimate, records) if left_open else records
        return Loop(tuple(seen), why, left_open)
    if not left_open or records[0].behaviour == "zoh":
        return None
    held = tuple(one.between("zoh") for one in records)
    try:
        open_ = method.estimate(list(held), structure)
        why = why_directly(method, open_, held)
        if not why:
            return None
        ends = [by_direct_route(method, one, structure, None, why).aicc for one in (held, records)]
    except (TridentifyError, np.linalg.LinAlgError, ValueError):
        return None
    if min(ends) > min(open_.aicc, estimate.aicc) - RIVAL:
        return None
    likelier = held if ends[0] < ends[1] + CLEARLY else records
    return Loop(likelier, why, left_open)


def run_loop_task(task: LoopTask) -> SelectionRow:
    """The candidate's row; an exception is a row, too."""
    loop = task.loop
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"), one_blas_thread():
            warnings.simplefilter("ignore")
            found = by_direct_route(task.method, loop.records, task.structure, None, loop.why)
    except (TridentifyError, np.linalg.LinAlgError, ValueError) as error:
        reason = str(error).partition("\n")[0] or type(error).__name__
        return SelectionRow(task.structure, None, reason)
    return _row(task.structure, found, loop.records)


def _whole(row: SelectionRow, loop: Loop) -> SelectionRow:
    """The row as `identify` gives it: plant and noise found together, with what hangs on it."""
    assert row.estimate is not None
    found = widened(row.estimate, loop.records, stated=not loop.left_open)
    return replace(_row(row.structure, found, loop.records), identified=True)


def _row(structure: Structure, estimate: Estimate, records: Sequence[Record]) -> SelectionRow:
    widest_std, widest = largest_relative_std(estimate)
    criteria = own_criteria(estimate, records)
    return SelectionRow(
        structure=structure,
        estimate=estimate,
        fit=estimate.fit,
        held_out_reason=AHEAD,
        doubts=doubts(estimate, records),
        condition=estimate.condition,
        relative_std=widest_std,
        widest=widest,
        n_coefficients=free_coefficients(estimate),
        ok=estimate.status.ok,
        aic=criteria.aic,
        aicc=criteria.aicc,
        bic=criteria.bic,
        n_unknowns=criteria.n_unknowns,
        deviance=criteria.deviance,
    )


def with_integrators(rows: Sequence[SelectionRow], place: int | None) -> list[Structure]:
    """Structures with a pole at zero that are worth a row: of the rows up to the likeliest.

    Parameters
    ----------
    rows : sequence of SelectionRow
    place : int or None
        The likeliest.

    Returns
    -------
    list of Structure
        Those of the rows that are no larger than it, and do not tell ``a0`` from zero.
    """
    if place is None:
        return []
    found = []
    for row in rows:
        one = row.structure
        if row.estimate is None or row.n_coefficients > rows[place].n_coefficients:
            continue
        a0 = row.estimate.parameters.get("a0")
        if a0 is None or not one.shared or one.constrained or abs(a0.value) > UNSEEN * a0.std:
            continue
        held = at_zero(one)
        found += [] if held is None else [held]
    return found


def contenders_of(rows: Sequence[SelectionRow], records: Sequence[Record]) -> list[Contender]:
    """What the rule sees of the rows."""
    count = sum(int(np.isfinite(record.y).sum()) for record in records)
    shape = records[0].n_outputs, records[0].n_inputs
    return [
        Contender(
            Criteria(row.n_unknowns, count, row.deviance),
            max(map(max, row.structure.poles_matrix(*shape))),
            row.ok and math.isfinite(row.deviance),
            not row.doubts,
        )
        for row in rows
    ]


def recommended(contenders: Sequence[Contender]) -> int | None:
    """Which row is recommended: among those that nothing speaks against, if there are any.

    Parameters
    ----------
    contenders : sequence of Contender

    Examples
    --------
    >>> rows = [Contender(Criteria(k, 500, d), n, True)
    ...         for k, d, n in ((3, 90.0, 1), (5, 10.0, 2), (7, 2.0, 3))]
    >>> recommended(rows), recommended(rows[:2]), recommended([])
    (1, 1, None)
    """
    sound = [replace(one, usable=one.usable and one.known) for one in contenders]
    judged = sound if any(one.usable for one in sound) else list(contenders)
    place = choose(judged)
    if place is None or (adequate(contenders)[place] and levels_off(contenders, place)):
        return place
    near = [
        k for k, one in enumerate(judged) if one.usable and _points(one, judged[place]) <= POINT
    ]
    return min(near, key=lambda k: (judged[k].criteria.n_unknowns, judged[k].criteria.deviance))


def _points(one: Contender, best: Contender) -> float:
    """By how much the error one sample ahead is larger [percent of it]."""
    fall = one.criteria.deviance - best.criteria.deviance
    return 100.0 * math.expm1(fall / (2.0 * best.criteria.n_samples))


def select_in_loop(
    loop: Loop,
    structures: Sequence[Structure],
    method: ThreeModel,
    run: Runner,
    *,
    free: bool,
    unseen: bool = False,
) -> Selection | None:
    """Compare structures by the direct route.

    Parameters
    ----------
    loop : Loop
    structures : sequence of Structure
    method : ThreeModel
    run : callable
        Gives what became of tasks, in their order.
    free : bool
        Whether rows with a pole at zero may join.
    unseen : bool
        Whether there are validation records, which have no part in it.

    Returns
    -------
    Selection or None
        None where the route leads nowhere for any of them.
    """

    def rows_of(asked: Sequence[Structure], said: str) -> list[SelectionRow]:
        return run(run_loop_task, [LoopTask(loop, one, method) for one in asked], said)

    rows = rows_of(structures, "the input reacts to the output: the direct route for each")
    place = _settle(rows, loop)
    if free:
        more = with_integrators(rows, place)
        rows += [one for one in rows_of(more, "candidates with a pole at zero") if one.ok]
        place = _settle(rows, loop)
    if place is None:
        return None
    reason = reason_ahead(rows, contenders_of(rows, loop.records), place)
    told = [f"{loop.why}: {COMPARED_AHEAD}"]
    left = any(row.ok > row.identified for row in rows)
    told += [f"AICc and errors are those {IN_TURN}"] if left else []
    told += ["validation records have no part in that"] if unseen else []
    return Selection(tuple(rows), rows[place], reason, None, tuple(told))


def _settle(rows: list[SelectionRow], loop: Loop) -> int | None:
    """Which row is recommended, with all that `identify` does for it and for its rivals.

    Finding plant and noise together costs as much as all else. Of a plant that is held the steps in
    turn may not tell what speaks against a row, and the error one sample ahead falls by what has no
    need to be alike: rows up to the likeliest that are nearly as likely get it. Those against which
    something speaks already get it only where that holds of all that could be recommended: of a
    plant that is not stable the steps in turn may come to nothing else.
    """
    rivals = _rivals(rows, choose(contenders_of(rows, loop.records)))
    for k in [k for k in rivals if not rows[k].doubts]:
        rows[k] = _whole(rows[k], loop)
    while True:
        place = recommended(contenders_of(rows, loop.records))
        if place is None:
            return None
        left = [k for k in rivals if not rows[k].identified] if rows[place].doubts else []
        if rows[place].identified and not left:
            return place
        for k in left or [place]:
            rows[k] = _whole(rows[k], loop)


def _rivals(rows: Sequence[SelectionRow], likeliest: int | None) -> list[int]:
    """Rows up to the likeliest that are nearly as likely, and not yet as `identify` gives them."""
    if likeliest is None:
        return []
    size, near = rows[likeliest].n_coefficients, rows[likeliest].aicc + RIVAL
    return [
        k
        for k, row in enumerate(rows)
        if row.ok and not row.identified and row.n_coefficients <= size and row.aicc <= near
    ]
