"""From all that was found about the candidates to the rows and the one that is recommended."""

from __future__ import annotations

import math
from collections.abc import Container, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tridentify.estimation.answer.cancelling import CANCELS
from tridentify.estimation.answer.estimate import Estimate, Status
from tridentify.estimation.likelihood.setup.raster import are_even
from tridentify.judgement.causes.signals.surprises import moved
from tridentify.judgement.selection.criteria import (
    Criteria,
    free_coefficients,
    largest_relative_std,
    young,
)
from tridentify.judgement.selection.finish_candidates import Entry
from tridentify.judgement.selection.held_out import HeldOut
from tridentify.judgement.selection.paired import Unseen
from tridentify.judgement.selection.result import SelectionRow
from tridentify.judgement.selection.rule import (
    Contender,
    Trial,
    Verdict,
    choose,
    levels_off,
    needed,
    recommend,
    refuted,
)
from tridentify.judgement.selection.soundness import apart_from_vagueness, doubts
from tridentify.judgement.selection.table import SelectionTable
from tridentify.numerics.arrays import Array
from tridentify.numerics.kept import Beside, cached_property
from tridentify.numerics.whiteness import is_white
from tridentify.record.record import Record
from tridentify.structure import Structure

_UNSEEN = Beside[Unseen]("unseen")

SURE = 1e-3
"""Probability that a right model's residual is taken for one that follows the input, or that is
not white."""


@dataclass(frozen=True, eq=False)
class OrderEvidence:
    """All that is known of the candidates before one is recommended.

    Attributes
    ----------
    records, judges : tuple of Record
        Those that were fitted, and those that the held-out errors belong to.
    structures : tuple of Structure
        As asked for.
    table : SelectionTable
        Every candidate on the maximum of one likelihood, on the same terms.
    whole : tuple of Entry
        What `identify` gives for each.
    held : tuple of HeldOut
        What became of these on samples that they have not seen.
    lags : bool
        Whether a delay beside the poles of the likeliest one explains nothing more.
    """

    records: tuple[Record, ...]
    judges: tuple[Record, ...]
    structures: tuple[Structure, ...]
    table: SelectionTable
    whole: tuple[Entry, ...]
    held: tuple[HeldOut, ...]
    lags: bool = False
    under: dict[int | None, tuple[Unseen, ...]] = field(default_factory=dict, init=False)

    @cached_property
    def unseen(self) -> tuple[Unseen, ...]:
        """The held-out errors of each row."""
        return tuple(
            _UNSEEN.find(one, self.judges)
            or _UNSEEN.keep(_unseen(one, self.judges), one, self.judges)
            for one in self.held
        )

    def whitened(self, place: int | None) -> tuple[Unseen, ...]:
        """The same, under the noise model of one candidate."""
        if place not in self.under:
            noise = () if place is None else tuple(self.table.noise[place])
            self.under[place] = tuple(replace(one, noise=noise) for one in self.unseen)
        return self.under[place]

    @cached_property
    def rows(self) -> tuple[SelectionRow, ...]:
        """What is shown of each candidate: all of its own estimate, but the criteria."""
        return tuple(
            _row(self.records, asked, entry, criteria, fit, compared.estimate)
            for asked, entry, criteria, fit, compared in zip(
                self.structures,
                self.whole,
                self.table.criteria,
                self.held,
                self.table.entries,
                strict=True,
            )
        )


@dataclass(frozen=True, eq=False)
class Decision:
    """The rows, what the likelihood says of them and which it prefers, and the verdict."""

    rows: tuple[SelectionRow, ...]
    contenders: tuple[Contender, ...]
    likeliest: int | None
    verdict: Verdict


def decide(known: OrderEvidence, least: int = 0, assumed: Container[int] = frozenset()) -> Decision:
    """The recommendation.

    Parameters
    ----------
    known : OrderEvidence
    least : int
        Poles that are known to rise above the noise.
    assumed : container of int
        Rows that are not finished and taken as sound; others that are not finished are not.
    """
    rows, table = list(known.rows), known.table
    objections = _objections(table.contenders, rows)
    contenders = [
        replace(one, known=one.known and not against)
        for one, against in zip(table.contenders, objections, strict=True)
    ]
    likeliest = choose(contenders)
    found = levels_off(contenders, likeliest)
    against = () if likeliest is None else objections[likeliest]
    explains = (
        likeliest is not None
        and not (apart_from_vagueness(against) if found else against)
        and not follows_input(table.entries[likeliest], table.noise[likeliest], known.records)
        and not misleads(table.entries[likeliest], known.records)
    )
    pairs = zip(rows, known.held, known.unseen, known.whitened(likeliest), strict=True)
    trials = [replace(_trial(*one), misses=_misses_late(known, k)) for k, one in enumerate(pairs)]
    for k, entry in enumerate(known.whole):
        if entry.unfinished:
            trials[k] = replace(trials[k], sound=k in assumed, vague=False)
    verdict = recommend(
        trials,
        likeliest,
        explains=explains,
        sharp=likeliest is not None and (found or _is_sharp(rows[likeliest])),
        ends=found,
        least=least,
        lags=known.lags,
    )
    place = _with_more(rows, contenders, verdict.place)
    verdict = replace(verdict, place=place)
    if place is not None and verdict.by == "likelihood":
        rows[place] = replace(rows[place], doubts=objections[place])
    return Decision(tuple(rows), tuple(contenders), likeliest, verdict)


def _misses_late(known: OrderEvidence, k: int) -> bool:
    """Whether a row has a delay of its own, and its residual follows the input all the same."""
    entry, noise = known.table.entries[k], known.table.noise[k]
    late = known.structures[k].delay == "free" and entry.estimate is not None
    return late and follows_input(entry, noise, known.records)


def _with_more(
    rows: Sequence[SelectionRow], contenders: Sequence[Contender], place: int | None
) -> int | None:
    """The same orders with a delay or a drift, where the likelihood asks for it: no other order."""
    if place is None:
        return None

    def is_likelier(k: int) -> bool:
        plain, other = rows[place].structure, rows[k].structure
        more = other.delay == "free" or other.drift not in (False, "auto")
        alike = more and replace(other, delay=plain.delay, drift=plain.drift) == plain
        if not alike or rows[k].doubts or not (contenders[k].usable and contenders[place].usable):
            return False
        fall = contenders[place].criteria.deviance - contenders[k].criteria.deviance
        return fall > needed(contenders[place], contenders[k])

    return next((k for k in range(len(rows)) if k != place and is_likelier(k)), place)


def _row(
    records: Sequence[Record],
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
        doubts=doubts(estimate, records),
        condition=max(conditions, default=math.nan),
        relative_std=widest_std,
        widest=widest,
        n_coefficients=free_coefficients(estimate),
        identified=not entry.unfinished,
        ok=estimate.status.ok,
    )
    if criteria is None or maximum is None:
        return row
    return replace(
        row,
        aic=criteria.aic,
        aicc=criteria.aicc,
        bic=criteria.bic,
        yic=young(maximum, _spread(records)),
        n_unknowns=criteria.n_unknowns,
        deviance=criteria.deviance,
    )


def _objections(
    contenders: Sequence[Contender], rows: Sequence[SelectionRow]
) -> list[tuple[str, ...]]:
    """What speaks against each row where the likelihood has its say."""
    orders = [_order(row) for row in rows]
    return [
        tuple(one for one in row.doubts if not (against and one == CANCELS))
        for row, against in zip(rows, refuted(contenders, orders), strict=True)
    ]


def _order(row: SelectionRow) -> tuple[int, int] | None:
    n, m = row.structure.poles, row.structure.zeros
    return (n, m) if isinstance(n, int) and isinstance(m, int) else None


def _is_sharp(row: SelectionRow) -> bool:
    """Whether the likelihood is as good as Gaussian about an estimate."""
    return row.estimate is not None and row.estimate.status is Status.CONVERGED


def _trial(row: SelectionRow, held: HeldOut, unseen: Unseen, whitened: Unseen) -> Trial:
    """A candidate on samples that it has not seen."""
    if row.estimate is None:
        return Trial(0, Unseen(), Unseen(), False, False)
    size, order = _sizes(row)
    return Trial(
        size,
        unseen,
        whitened,
        not row.doubts and not held.reason,
        row.ok,
        order,
        not apart_from_vagueness(row.doubts) and not held.reason,
        row.structure.delay == "free",
    )


def _sizes(row: SelectionRow) -> tuple[int, tuple[int, int]]:
    """Coefficients of the channel that has most; poles and zeros together, and poles."""
    asked, estimate = row.structure, row.estimate
    assert estimate is not None
    shape = len(estimate.output_names), len(estimate.input_names)
    poles = max(max(one) for one in asked.poles_matrix(*shape))
    zeros = max(max(one) for one in asked.zeros_matrix(*shape))
    channels = shape[0] * shape[1]
    size = row.n_coefficients
    if asked.shared and not asked.constrained and channels > 1:
        size = poles + zeros + 1 + (asked.delay == "free")
    return size, (poles + zeros, poles)


def _unseen(held: HeldOut, records: Sequence[Record]) -> Unseen:
    """The errors, each output over its spread and over their number; none where they grow."""
    if not held.errors:
        return Unseen()
    centred = [np.asarray(r.y) - np.nanmean(np.asarray(r.y), axis=0) for r in records]
    spread = np.sum([np.nansum(one**2, axis=0) for one in centred], axis=0)
    size = np.sqrt(np.where(spread > 0, spread, 1.0) * spread.size)
    found = Unseen(tuple(one / size for one in held.errors), held.terms)
    return found if math.isfinite(found.loss) else Unseen()


def _spread(records: Sequence[Record]) -> Array:
    return np.asarray(np.mean([np.nanvar(np.asarray(r.y), axis=0) for r in records], axis=0))


def follows_input(entry: Entry, noise: tuple[Array, ...], records: Sequence[Record]) -> bool:
    """Whether the whitened residual knows the input (a chi-square test at 0.1 %).

    An input that is held acts on a strictly proper candidate from the next sample on: what goes
    along with it in the same one made the input (a controller, by the noise at its sensor), and no
    candidate explains that.
    """
    from scipy.special import chdtri

    from tridentify.numerics.whiteness import input_share

    if not are_even(records):
        return False
    held = all(record.behaviour == "zoh" for record in records)
    late = int(held and is_strictly_proper(entry.structure, records[0]))
    for i, a in enumerate(noise):
        for one, record in zip(entry.residuals, records, strict=True):
            u = moved(np.asarray(record.u), [late])
            _, statistic, dimension = input_share(one[:, i], u, a)
            if statistic > chdtri(dimension, SURE):
                return True
    return False


def is_strictly_proper(structure: Structure, record: Record) -> bool:
    """Whether no output answers an input in the same sample."""
    shape = record.n_outputs, record.n_inputs
    pairs = zip(structure.poles_matrix(*shape), structure.zeros_matrix(*shape), strict=True)
    return all(m < n for rows in pairs for n, m in zip(*rows, strict=True))


def misleads(entry: Entry, records: Sequence[Record]) -> bool:
    """Whether likelihoods rest on white noise that the residual is not.

    Where time is not even no noise model is fitted, and a slow disturbance or a coarse converter
    makes every further pole look sure. Neighbours are independent in white noise however far apart
    they were taken, so the usual test over samples holds (at 0.1 %).
    """
    if are_even(records):
        return False
    outputs = range(records[0].y.shape[1])
    return not all(is_white([one[:, i] for one in entry.residuals], SURE) for i in outputs)
