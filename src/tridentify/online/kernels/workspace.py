"""Room for a block of samples: a row for each column of numbers; nothing is compiled here."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tridentify.numerics.arrays import Array, Indices
from tridentify.online.kernels.slots import COLUMNS, DIRECTIONS, INPUTS, LINE, ORDER, OUTPUTS

LONGEST = 128
"""Samples of the longest block: its rows fit the processor's cache."""
# rows behind those of the filters, the columns and the directions
OWN_ROWS = 9
SINES, COSINES, LEFT, NOW, FIT, LEVERAGE, ERRORS, SCALED_ERRORS, REFERENCE = range(OWN_ROWS)


class Workspace(NamedTuple):
    """What the compiled loops need beside the vector of an estimator.

    Attributes
    ----------
    room : (rows, LONGEST + 1) array
        States of the filters, the columns and the target twice, directions, and what is one row.
    lines : (n_inputs, ...) array
        The inputs of a block behind those of the delay lines.
    zeros : (LONGEST + 1,) array
    kept : array
        A copy of the vector.
    """

    room: Array
    lines: Array
    zeros: Array
    kept: Array

    @classmethod
    def of(cls, ints: Indices, x: Array, longest: int = LONGEST) -> Workspace:
        """Room for blocks of up to so many samples."""
        states = (ints[INPUTS] + ints[OUTPUTS]) * ints[ORDER]
        rows = states + 2 * (ints[COLUMNS] + 1) + ints[DIRECTIONS] + OWN_ROWS + 2
        return cls(
            np.empty((rows, longest + 1)),
            np.empty((ints[INPUTS], longest + ints[LINE])),
            np.zeros(longest + 1),
            np.empty(x.size),
        )
