"""States over intervals of any length in machine code: `numerics.intervals`."""

from __future__ import annotations

import numpy as np
from numba import float64, void
from numba import int64 as whole

from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.compiled import compiled, read_only


@compiled(
    void(
        read_only(4), read_only(1), whole, read_only(2), read_only(1), whole, read_only(1),
        read_only(1, whole), read_only(2), read_only(2), read_only(1, whole), whole[::1],
        float64[:, ::1], whole, whole, float64[:, :],
    ),
    wide=True,
)  # fmt: skip
def cross(
    tables: Array,
    units: Array,
    terms: int,
    a: Array,
    b: Array,
    upper: int,
    lengths: Array,
    which: Indices,
    value: Array,
    slope: Array,
    reached: Indices,
    done: Indices,
    state: Array,
    start: int,
    stop: int,
    out: Array,
) -> None:
    """Write the states at samples start..stop-1 and carry ``state`` and ``done`` on."""
    levels, entries, q = tables.shape[0], tables.shape[1], tables.shape[2]
    new, term = np.empty(q), np.empty(q)
    for j in range(state.shape[0]):
        for k in range(start, stop):
            for i in range(done[j], reached[k]):
                now, rise, rest = value[j, i], slope[j, i], lengths[i]
                for level in range(levels):
                    if terms == 0:
                        digit, unit = which[i], units[which[i]]
                    else:
                        unit = units[level]
                        digit = min(int(rest / unit), entries - 1)
                        if digit == 0:
                            continue
                    for m in range(q):
                        total = tables[level, digit, m, q] * now
                        total += tables[level, digit, m, q + 1] * (rise * unit)
                        for o in range(min(m + 1 + upper, q)):
                            total += tables[level, digit, m, o] * state[j, o]
                        new[m] = total
                    for m in range(q):
                        state[j, m] = new[m]
                    if terms > 0:
                        now += rise * (digit * unit)
                        rest = max(rest - digit * unit, 0.0)
                if terms > 0 and rest > 0.0:
                    for m in range(q):
                        term[m] = state[j, m]
                    driven = now
                    for p in range(1, terms + 1):
                        for m in range(q):
                            total = b[m] * driven
                            for o in range(min(m + 1 + upper, q)):
                                total += a[m, o] * term[o]
                            new[m] = total * rest / p
                        for m in range(q):
                            term[m] = new[m]
                            state[j, m] += new[m]
                        driven = rise * rest if p == 1 else 0.0
            if reached[k] >= 0:
                done[j] = max(done[j], reached[k])
                for m in range(q):
                    out[j * q + m, k - start] = state[j, m]
            else:
                for m in range(q):
                    out[j * q + m, k - start] = 0.0
