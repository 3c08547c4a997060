"""The free problem that a search looks at for a constrained one, and the way back from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tridentify.estimation.knowledge.affine import Knowledge
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record
from tridentify.structure import Structure


def seen(
    records: Sequence[Record], structure: Structure, known: Knowledge
) -> tuple[list[Record], Structure] | None:
    """The free problem that a search is to look at; None where there is no pole to be found.

    With ``k`` integrators ``b / (p^k a') u`` is ``b / a'`` driven by the ``k``-fold integral of the
    input, joined by straight lines here: exact for one integrator of a held input, and near enough
    for a start otherwise.
    """
    k = known.integrators
    plain = structure.unconstrained
    if not k:
        return list(records), plain
    n = known.n_poles - k
    if n == 0:
        return None
    zeros = structure.zeros_matrix(records[0].n_outputs, records[0].n_inputs)
    fewer = [[min(m, n) for m in row] for row in zeros]
    integrated = [_integrated(record, k, structure) for record in records]
    trim = structure.initial_state == "equilibrium"
    offset = True if trim else structure.offset
    state = "rest" if trim else structure.initial_state
    return integrated, replace(plain, poles=n, zeros=fewer, offset=offset, initial_state=state)


def _integrated(record: Record, count: int, structure: Structure) -> Record:
    """The record with its inputs integrated over time."""
    u, steps = np.array(record.u), np.diff(record.t)[:, None]
    if structure.initial_state == "equilibrium":
        u = u - u[0]
    held = record.behaviour == "zoh"
    for _ in range(count):
        areas = u[:-1] if held else 0.5 * (u[:-1] + u[1:])
        u = np.vstack([np.zeros(u.shape[1]), np.cumsum(areas * steps, axis=0)])
        held = False
    return record._derive(u=u, intersample="foh")


def widened(
    theta: Array, records: Sequence[Record], structure: Structure, known: Knowledge
) -> Array:
    """Coefficients of the free problem as coefficients of the structure."""
    k = known.integrators
    if not k:
        return theta
    n = known.n_poles - k
    parts, at = [theta[:n], np.zeros(k)], n
    for row in structure.zeros_matrix(records[0].n_outputs, records[0].n_inputs):
        for m in row:
            own = min(m, n) + 1
            parts += [np.zeros(m + 1 - own), theta[at : at + own]]
            at += own
    return np.concatenate(parts)
