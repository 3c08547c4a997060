"""The candidates with their criteria, on the same samples and models of the noise of one order."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tridentify.estimation.answer.estimate import Status
from tridentify.estimation.posterior.mean import vagueness
from tridentify.judgement.selection.criteria import Criteria, criteria_of, unknowns_of
from tridentify.judgement.selection.finish_candidates import Entry, noise_of_orders
from tridentify.judgement.selection.rule import Contender
from tridentify.judgement.selection.soundness import HALF
from tridentify.numerics.arrays import Array
from tridentify.numerics.kept import cached_property
from tridentify.record.record import Record


@dataclass(frozen=True, eq=False)
class SelectionTable:
    """The entries with their criteria and models of the noise, of the same orders."""

    entries: tuple[Entry, ...]
    criteria: tuple[Criteria | None, ...]
    noise: tuple[tuple[Array, ...], ...]

    @cached_property
    def contenders(self) -> tuple[Contender, ...]:
        """What the rule sees."""
        pairs = zip(self.entries, self.criteria, strict=True)
        return tuple(_contender(entry, criteria) for entry, criteria in pairs)

    def best(self, criterion: str) -> int | None:
        """The usable entry where a criterion is lowest."""
        rows = self.contenders
        kept = [k for k, one in enumerate(rows) if one.usable]
        return min(kept, key=lambda k: float(getattr(rows[k].criteria, criterion)), default=None)


def table_of(
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
