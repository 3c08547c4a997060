"""Candidates with a delay that is estimated along, where one is missing.

Dead time is in most plants of process engineering, and a candidate without it makes do with poles:
each is a little of a delay (a Pade approximation). Then a larger candidate is adequate, sound, and
not what the plant is. So every candidate that is smaller than the recommended one is fitted with
a delay, as a cause is that is looked for (`timing.delay`); where that explains the record better
than the recommended one does, or clearly better than any other candidate with as many coefficients,
it joins the rows with its delay free. The second holds on measured records, in which something
smaller than the delay is left for more poles to explain. A delay beside as many coefficients is no
other order: `identify` and `validate` find it, and say what it would gain.

A slow drift as large as the response hides from a likelihood what a delay is worth: noise that
follows a drift was modelled beside poles that stand for the delay, and no step from there leads to
the right ones. There one lag and two join the rows with a delay unasked, as most processes that
drift are described by these.

Behind a delay an output may follow its input in proportion (a loudspeaker and a microphone at some
distance). No candidate with fewer zeros than poles explains that, with a delay or without, and a
direct part shows in no sample at which the input moves. So where the recommended candidate is told
to miss some of the response, every number of poles is fitted with as many zeros and a delay; with
the likeliest such delay, which is held, as none can be estimated beside a direct part, they join
the rows, if the output then follows its input at once. An accelerometer under a sweep is the same
without a delay: of several resonances no operators show it, and these candidates do.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.judgement.causes.attempts.attempt import Attempt
from tridentify.judgement.causes.attempts.direct_part import has_direct_part, may_have_direct_part
from tridentify.judgement.causes.attempts.explanation import CLEARLY, Explanations
from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.attempts.revisit import poles_of_estimate, problem_of, stated
from tridentify.judgement.causes.explain import explain, settle, sharpened
from tridentify.judgement.causes.system.slow import slow_waves
from tridentify.judgement.selection.result import SelectionRow
from tridentify.judgement.selection.rule import USELESS
from tridentify.numerics.arrays import Array
from tridentify.numerics.lagrange import span
from tridentify.record.record import Record
from tridentify.structure import Structure

MOST = 2
"""Rows that are added: each costs a search over delays of its own."""

MISSES = ("delay", "intersample", "order-low", "unmodelled-response", "nonlinear", "noise-changes")
"""Findings that say that part of the response is missing, whatever they take it for: what is missed
of a sweep comes when it passes a resonance."""

DRIFTS = 2.0
"""Of what is left over what is left beside slow waves, from which a slow drift hides the rest."""

LESS = 0.8
"""Share that a direct part may leave of what its candidate leaves with a delay alone."""

ON_SAMPLE = 0.01
"""Samples by which a delay may end after a sample and still end on it."""


class _Late(NamedTuple):
    """A structure that gets a delay, and its AICc with it on the recommended one's terms.

    ``left`` is the share of the outputs' variance that it leaves; ``size_with`` counts the delays.
    """

    size: int
    criterion: float
    structure: Structure
    left: float
    size_with: int


class _Plain(NamedTuple):
    """A row as it is, on the same terms."""

    place: int
    size: int
    criterion: float
    left: float


def delayed(
    rows: Sequence[SelectionRow], place: int | None, records: Sequence[Record]
) -> list[Structure]:
    """Structures worth a row of their own, the smallest first.

    Parameters
    ----------
    rows : sequence of SelectionRow
    place : int or None
        The recommended one.
    records : sequence of Record
        Those that were identified.

    Returns
    -------
    list of Structure
        Of rows that are smaller than the recommended one, with ``delay="free"``; at most `MOST`.
        Those whose AICc, the delay counted, is lower than that of the recommended one, or by
        `CLEARLY` than that of every row that has as many coefficients: a delay is then worth more
        than a pole or a zero is. Where a slow drift hides that, one lag and two.
    """
    place = None if place is None else _free(rows, place)
    if place is None:
        return []
    best = rows[place].estimate
    assert best is not None
    try:
        usual = [row for row in rows if _is_usual(row)]
        if any(_drifts(row.estimate, records) for row in (rows[place], *usual)):
            return [replace(row.structure, delay="free") for row in usual[:MOST]]
        plain = _settled(rows, place, records)
        found = [
            late
            for row in rows
            if is_able(row) and row.n_coefficients < rows[place].n_coefficients
            for late in [_fitted(row, records, best.noise_model)]
            if late is not None
        ]
    except (TridentifyError, np.linalg.LinAlgError, FloatingPointError):
        return []
    ended = next((one for one in plain if one.place == place), None)
    if ended is None:
        return []
    kept = [
        late
        for late in found
        if late.left < ended.left + USELESS
        and (late.criterion < ended.criterion or _is_worth_more(late, plain))
    ]
    return [one.structure for one in sorted(kept)[:MOST]]


def are_lags(rows: Sequence[SelectionRow], place: int, records: Sequence[Record]) -> bool:
    """Whether a delay beside the poles of a row explains nothing more.

    Poles that stand for dead time are never enough: it shows beside any number of them.

    Parameters
    ----------
    rows : sequence of SelectionRow
    place : int
    records : sequence of Record
        Those that were identified.
    """
    row = rows[place]
    if not is_able(row):
        return False
    assert row.estimate is not None
    try:
        explained = _by_delays(present_of(row.estimate, records, row.estimate.noise_model))
    except (TridentifyError, np.linalg.LinAlgError, FloatingPointError):
        return False
    return explained is None or explained.found[0].gain < CLEARLY


def _free(rows: Sequence[SelectionRow], place: int) -> int | None:
    """The row itself, or that with its pole at zero free: a slow drift makes one beside lags."""
    sizes = [(one.structure.poles, one.structure.zeros) for one in rows]
    alike = (k for k, row in enumerate(rows) if sizes[k] == sizes[place] and is_able(row))
    return next(alike, None)


def _settled(rows: Sequence[SelectionRow], place: int, records: Sequence[Record]) -> list[_Plain]:
    """The rows as they are up to the size of the recommended one, on its terms."""
    best = rows[place].estimate
    assert best is not None
    found = []
    for k, row in enumerate(rows):
        if not is_able(row) or row.n_coefficients > rows[place].n_coefficients:
            continue
        assert row.estimate is not None
        end = settle(present_of(row.estimate, records, best.noise_model))
        if end is not None:
            found.append(_Plain(k, row.n_coefficients, end.criterion, _left(end)))
    return found


def _left(end: Attempt) -> float:
    """Share of the outputs' variance that is not explained, what moves slowly left aside.

    Further lags follow a slow disturbance that noise is to stand for beside a delay.
    """
    rest = np.zeros_like(end.spread)
    for residual in end.residuals():
        place = np.linspace(0.0, 1.0, len(residual))
        slow = np.column_stack([np.ones_like(place), slow_waves(place)])
        for i, one in enumerate(residual.T):
            seen = np.isfinite(one)
            basis = span(slow[seen])
            rest[i] += float(np.sum((one[seen] - basis @ (basis.T @ one[seen])) ** 2))
    return float(np.mean(rest / end.spread))


def _drifts(estimate: Estimate | None, records: Sequence[Record]) -> bool:
    """Whether most of what an estimate leaves is slow, and is much."""
    end = estimate and settle(present_of(estimate, records, estimate.noise_model))
    if not end:
        return False
    left = [np.nansum((one - np.nanmean(one, axis=0)) ** 2, axis=0) for one in end.residuals()]
    total = float(np.mean(np.sum(left, axis=0) / end.spread))
    return total > max(DRIFTS * _left(end), USELESS)


def _is_usual(row: SelectionRow) -> bool:
    """Whether it has one lag or two, and a delay is open."""
    return is_able(row) and row.structure.zeros == 0 and row.structure.common_poles <= MOST


def _is_worth_more(late: _Late, plain: Sequence[_Plain]) -> bool:
    """Whether no row with as many coefficients comes near a candidate with a delay."""
    beside = [one.criterion for one in plain if late.size < one.size <= late.size_with]
    return bool(beside) and late.criterion < min(beside) - CLEARLY


def is_able(row: SelectionRow) -> bool:
    """Whether it is of a plain structure without a delay: a cause can be fitted beside it."""
    if row.estimate is None or not row.estimate.status.ok or row.structure.constrained:
        return False
    return row.structure.shared and row.structure.delay == 0.0


def present_of(estimate: Estimate, records: Sequence[Record], noise: Sequence[Array]) -> Present:
    """An estimate as what other explanations are compared with, under a noise model."""
    nuisances = stated(estimate)
    poles = poles_of_estimate(estimate, problem_of(estimate, records, nuisances))
    delay = np.array(estimate.model.delay)
    return Present.of(records, estimate.structure, delay, nuisances, noise, poles)


def _by_delays(present: Present) -> Explanations | None:
    """What delays explain: outputs recorded too early have the same code, and are none."""
    explained = explain(present, only="delay")
    if explained is None:
        return None
    found = tuple(one for one in explained.found if not one.rival.exact)
    return replace(explained, found=found) if found else None


def _fitted(row: SelectionRow, records: Sequence[Record], noise: Sequence[Array]) -> _Late | None:
    assert row.estimate is not None
    present = present_of(row.estimate, records, noise)
    explained = _by_delays(present)
    if explained is None:
        return None
    first = explained.found[0]
    late = replace(row.structure, delay="free")
    criterion = explained.present.criterion - first.gain
    delays = records[0].n_outputs * records[0].n_inputs
    size = row.n_coefficients
    return _Late(size, criterion, late, _left(first.attempts[0]), size + delays)


def direct_and_delayed(
    rows: Sequence[SelectionRow], place: int | None, records: Sequence[Record]
) -> list[Structure]:
    """Structures with as many zeros as poles behind a delay, where that may be what is missing.

    Parameters
    ----------
    rows : sequence of SelectionRow
    place : int or None
        The recommended one, with all that is said of it.
    records : sequence of Record
        Those that were identified; of one input and one output.

    Returns
    -------
    list of Structure
        One for each number of poles, all with the delay that is likeliest beside a direct part;
        none where the recommended row misses nothing, or the output follows no input at once that
        comes as much later.
    """
    if place is None or not _misses(rows[place], records):
        return []
    if records[0].n_inputs * records[0].n_outputs > 1:
        return []
    best = rows[place].estimate
    assert best is not None
    pairs = [
        tuple(_tried(fit, row, records, best.noise_model) for fit in (_direct, _fitted))
        for row in rows
        if is_able(row) and _is_full(row.structure)
    ]
    least = min((one.left for pair in pairs for one in pair if one is not None), default=0.0)
    first = min(
        (direct for direct, proper in pairs if direct is not None and _is_better(direct, proper)),
        key=lambda one: one.criterion,
        default=None,
    )
    if first is None or first.left > least + USELESS:
        return []
    if not _follows_at_once(records, first.structure):
        return []
    wanted = (one.structure for one in rows if _is_full(one.structure))
    late = (replace(one, zeros=one.common_poles, delay=first.structure.delay) for one in wanted)
    return list(dict.fromkeys(late))


def _is_better(direct: _Late, proper: _Late | None) -> bool:
    """Whether a direct part explains clearly more than a delay with as many poles.

    One sample later a strictly proper response is there at once, too.
    """
    if proper is None:
        return True
    likelier = direct.criterion < proper.criterion - CLEARLY
    return likelier and direct.left < LESS * proper.left


def _tried(
    fit: Callable[[SelectionRow, Sequence[Record], Sequence[Array]], _Late | None],
    row: SelectionRow,
    records: Sequence[Record],
    noise: Sequence[Array],
) -> _Late | None:
    try:
        return fit(row, records, noise)
    except (TridentifyError, np.linalg.LinAlgError, FloatingPointError):
        return None


def _misses(row: SelectionRow, records: Sequence[Record]) -> bool:
    """Whether some of the response is missing; of smooth inputs little may be all that shows."""
    smooth = all(record.behaviour != "zoh" for record in records)
    return row.estimate is not None and any(
        (one.matters or smooth) and one.code in MISSES for one in row.estimate.findings
    )


def _is_full(structure: Structure) -> bool:
    """Whether there is one zero less than poles, as many as a strictly proper response has."""
    return structure.shared and structure.zeros == structure.common_poles - 1


def _follows_at_once(records: Sequence[Record], late: Structure) -> bool:
    """Whether the outputs follow inputs at once that come as much later as a structure says."""
    delay = late.delay
    if not isinstance(delay, float) or any(record.dt is None for record in records):
        return False
    if delay == 0.0:
        return may_have_direct_part(records)
    moved = []
    for record in records:
        # a held input acts from the next sample on
        steps = math.ceil(delay / float(record.dt or 1.0) - ON_SAMPLE)
        before = np.repeat(record.u[:1], steps, axis=0)
        moved.append(record._derive(u=np.vstack([before, record.u])[: record.n_samples]))
    return has_direct_part(moved)


def _direct(row: SelectionRow, records: Sequence[Record], noise: Sequence[Array]) -> _Late | None:
    """A row with as many zeros as poles and the delay that is likeliest beside them, if any."""
    n = row.structure.common_poles
    assert row.estimate is not None
    present = replace(present_of(row.estimate, records, noise), zeros=((n,),))
    size = row.n_coefficients + 1
    at_once = settle(present)
    plain = None
    if at_once is not None:
        zeros = replace(row.structure, zeros=n)
        plain = _Late(size, at_once.criterion, zeros, _left(at_once), size)
    explained = _by_delays(present)
    if explained is None:
        return plain
    first = sharpened(present, explained)
    late = replace(row.structure, zeros=n, delay=float(first.rival.parts[0].delay[0, 0]))
    criterion = explained.present.criterion - first.gain
    if plain is not None and plain.criterion < criterion + CLEARLY:
        return plain
    return _Late(size, criterion, late, _left(first.attempts[0]), size + 1)
