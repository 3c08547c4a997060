"""More poles than are tried unasked, where the record clearly asks for them.

A structure with three resonances or more is not approximated by four poles: the best of them leave
resonances out as a whole, and two poles more explain most of what these leave. What is small is no
reason: enough samples refute every order on a measured record, and poles without end stand for a
delay. That what is left follows the input is none either: what rings on is spread over more delays
than can be looked at.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tridentify.estimation.methods.base import Method
from tridentify.judgement.causes.attempts.direct_part import may_have_direct_part
from tridentify.judgement.selection.finish_candidates import CandidateTask, Entry, run_task
from tridentify.judgement.selection.orders import default_candidates
from tridentify.judgement.selection.rule import TWICE
from tridentify.judgement.selection.table import SelectionTable
from tridentify.numerics.arrays import Complex
from tridentify.record.record import Record
from tridentify.structure import Structure

MOST_UNASKED = 8
"""Poles from which on more have to be asked for: four resonances."""
STEP = 2
"""Poles of a resonance."""
WORTH = 0.01
"""Share of the outputs' variance that is worth two poles: of less, a fit of 90 % is left."""


class Higher(NamedTuple):
    """Candidates with those of two poles more, and poles from which these begin."""

    structures: tuple[Structure, ...]
    poles: Complex


def higher_candidates(
    records: tuple[Record, ...],
    structures: Sequence[Structure],
    table: SelectionTable,
    method: Method,
) -> Higher | None:
    """The candidates with those of more poles, where these are clearly asked for.

    Parameters
    ----------
    records : tuple of Record
    structures : sequence of Structure
        What `default_candidates` gave.
    table : SelectionTable
        What became of them.
    method : Method

    Returns
    -------
    Higher or None
        All of them: where the likeliest candidate has as many poles as were tried, and the fullest
        one with two more leaves less by `WORTH` of the outputs' variance and the factor `TWICE`
        (than with a direct part, where there may be one).
        With two resonances more where one more is worth it, but not by that factor.
    """
    place = table.best("bic")
    most = max((one.common_poles for one in structures), default=0)
    if place is None or not STEP < most < MOST_UNASKED:
        return None
    likeliest = table.entries[place]
    before = _left(likeliest, records)
    if likeliest.structure.common_poles < most or before < WORTH:
        return None
    direct = may_have_direct_part(records)
    if direct:
        full = replace(likeliest.structure, zeros=most)
        fitted = run_task(CandidateTask(records, full, method, shared=False))
        before = min(before, _left(fitted, records))
    for n in range(most + STEP, MOST_UNASKED + 1, STEP):
        found = default_candidates(records, structures[0], n)
        more = tuple(one for one in found if one.common_poles in range(most + STEP, n + 1, STEP))
        if not more or more[-1].common_poles < n:
            return None
        if more[-1].zeros != n and direct:
            more = (*more, replace(more[-1], zeros=n))
        fullest = run_task(CandidateTask(records, more[-1], method, shared=False))
        left = _left(fullest, records)
        if fullest.estimate is None or not left < before - WORTH:
            return None
        if left < before / TWICE:
            poles = np.roots(fullest.estimate.model.den[0][0]).astype(complex)
            return Higher((*structures, *more), poles)
    return None


def _left(entry: Entry, records: Sequence[Record]) -> float:
    """Share of the outputs' variance that a candidate leaves, the mean over the outputs."""
    if entry.estimate is None:
        return np.inf
    spread = np.sum([np.nanvar(one.y, axis=0) * len(one.y) for one in records], axis=0)
    left = np.sum([np.nansum(one**2, axis=0) for one in entry.residuals], axis=0)
    return float(np.mean(left / np.where(spread > 0, spread, 1.0)))
