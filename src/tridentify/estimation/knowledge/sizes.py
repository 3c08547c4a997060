"""Of what size the coefficients are that a record can show."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tridentify.estimation.knowledge.affine import Knowledge
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record
from tridentify.structure import Structure


def scale_of(
    records: Sequence[Record],
    structure: Structure,
    theta: Array | None = None,
    known: Knowledge | None = None,
) -> Array:
    """(p,) sizes of the coefficients: powers of a typical rate, and ratios of the signals."""
    n = structure.common_poles
    rate = (_shortest(records) * _longest(records)) ** -0.5
    if theta is not None and known is not None and known.n_poles > known.integrators:
        moving = theta[known.moving]
        rate = abs(float(moving[-1])) ** (1.0 / moving.size) or rate
    parts = [rate ** np.arange(1.0, n + 1.0)]
    zeros = structure.zeros_matrix(records[0].n_outputs, records[0].n_inputs)
    for i, row in enumerate(zeros):
        y = np.concatenate([record.y[:, i] for record in records])
        size = float(np.nanstd(y)) or 1.0
        for j, m in enumerate(row):
            u = float(np.sqrt(np.mean(np.concatenate([r.u[:, j] for r in records]) ** 2))) or 1.0
            parts.append(size / u * rate ** np.arange(n - m, n + 1.0))
    return np.concatenate(parts)


def _shortest(records: Sequence[Record]) -> float:
    return min(float(np.median(np.diff(record.t))) for record in records)


def _longest(records: Sequence[Record]) -> float:
    return max(record.duration for record in records)


def spread_of(records: Sequence[Record], structure: Structure) -> Array:
    """(p,) how far from `scale_of` the slowest and the quickest poles of the records lead."""
    n = structure.common_poles
    factor = (_longest(records) / _shortest(records)) ** 0.5
    zeros = structure.zeros_matrix(records[0].n_outputs, records[0].n_inputs)
    powers = [np.arange(n - m, n + 1.0) for row in zeros for m in row]
    return np.asarray(factor ** np.concatenate([np.arange(1.0, n + 1.0), *powers]))
