"""States driven step by step by inputs, in machine code: `numerics.interpolation`."""

from __future__ import annotations

import numpy as np
from numba import float64, int64, void

from tridentify.numerics.arrays import Array
from tridentify.numerics.compiled import compiled, read_only


@compiled(void(read_only(2), int64, read_only(2), float64[::1], float64[:, :]))
def driven(transition: Array, upper: int, drive: Array, state: Array, out: Array) -> None:
    """``x_{k+1} = F x_k + drive_k``, states into ``out``; ``state`` is carried on."""
    q, count = drive.shape
    new = np.empty(q)
    for k in range(count):
        for i in range(q):
            out[i, k] = state[i]
            total = drive[i, k]
            for m in range(min(i + 1 + upper, q)):
                total += transition[i, m] * state[m]
            new[i] = total
        for i in range(q):
            state[i] = new[i]
