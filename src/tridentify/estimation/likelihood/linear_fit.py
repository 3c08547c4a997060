"""What is linear at fixed denominators, fitted: as arrays, and output by output."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tridentify.models.response import ColumnBlocks
from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.least_squares import Solution


class Linear(NamedTuple):
    """The linear fits of all outputs, as `compiled_cost.fit_outputs` gives them."""

    rows: Array
    direct: Array
    started: Array
    costs: Array
    conditions: Array
    matrices: Array
    sizes: Indices
    solutions: Array
    bases: Array
    ranks: Indices
    residuals: Array

    @classmethod
    def given(cls, rows: Array, direct: Array, started: Array) -> Linear:
        """Outputs that were not fitted here."""
        none, whole = np.zeros((0, 0)), np.zeros(0, dtype=np.int64)
        empty, zero = np.zeros((0, 0, 0)), np.zeros(0)
        return cls(rows, direct, started, zero, zero, empty, whole, none, empty, whole, none)


@dataclass(frozen=True, eq=False)
class OutputFit:
    """One output's linear fit at a fixed denominator."""

    columns: ColumnBlocks
    matrix: Array
    solution: Solution
    residual: Array
