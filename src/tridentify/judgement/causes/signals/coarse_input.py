"""Smooth inputs through a converter with coarse steps.

Such an input stands and moves by one step at a time, over several levels, so that it looks like a
held one: what acted before a step was recorded is not seen, and an output seems to begin to answer
before its input moves.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tridentify.numerics.arrays import Array
from tridentify.numerics.quantiles import median
from tridentify.record.record import Record

LEVELS = 4
"""Of a converter, at least: two or three are levels that were set."""

BY_ONE = 0.9
"""Share of the moves that are one step."""

ALIKE = 1e-3
"""Difference of two steps over their size, up to which they are one."""


def converter_steps(records: Sequence[Record]) -> Array:
    """(n_inputs,) step by which an input moves, up and down, over several levels; 0 for others.

    Parameters
    ----------
    records : sequence of Record

    Examples
    --------
    >>> u = np.round(2.0 * np.sin(0.1 * np.arange(300)))
    >>> converter_steps([Record(u, u, dt=1.0)]).tolist()
    [1.0]
    """
    found = []
    for j in range(records[0].n_inputs):
        moves = np.concatenate([np.diff(record.u[:, j]) for record in records])
        moves = np.abs(moves[moves != 0.0])
        if not moves.size:
            found.append(0.0)
            continue
        step = median(moves)
        levels = float(np.ptp(np.concatenate([record.u[:, j] for record in records]))) / step + 1.0
        single = float(np.mean(np.abs(moves - step) <= ALIKE * step))
        found.append(step if levels > LEVELS - 0.5 and single >= BY_ONE else 0.0)
    return np.array(found)
