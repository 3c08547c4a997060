"""The sample loop in machine code: `numerics.propagate`."""

from __future__ import annotations

import numba
import numpy as np
from numba import void

from tridentify.numerics.arrays import Array
from tridentify.numerics.compiled import compiled, read_only

read, one, whole = read_only(2), read_only(1), numba.int64
state, out = numba.float64[:, ::1], numba.float64[:, :]


@compiled(void(read, one, one, whole, read, state, whole, whole, out, whole))
def recursion(
    transition: Array,
    from_current: Array,
    from_next: Array,
    upper: int,
    u: Array,
    state: Array,
    start: int,
    stop: int,
    out: Array,
    column: int,
) -> None:
    """Write the states at samples start..stop-1 into ``out[:, column:]`` and carry ``state`` on."""
    q = transition.shape[0]
    channels = state.shape[0]
    last = u.shape[0] - 1
    new = np.empty(q)
    for j in range(channels):
        for k in range(start, stop):
            position = column + k - start
            for i in range(q):
                out[j * q + i, position] = state[j, i]
            now = u[k, j]
            after = u[min(k + 1, last), j]
            for i in range(q):
                total = from_current[i] * now + from_next[i] * after
                for m in range(min(i + 1 + upper, q)):
                    total += transition[i, m] * state[j, m]
                new[i] = total
            for i in range(q):
                state[j, i] = new[i]
