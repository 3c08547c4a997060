"""The sample loop of long records in machine code: `numerics.propagate`."""

from __future__ import annotations

import numba
import numpy as np
from numba import void

from tridentify.numerics.arrays import Array
from tridentify.numerics.compiled import compiled, read_only

PART = 512
"""Samples for which what is known of four states is worked out at a time: they stay in the nearest
memory."""

read, one, whole = read_only(2), read_only(1), numba.int64
state, out = numba.float64[:, ::1], numba.float64[:, :]


@compiled(void(read, one, one, read, state, whole, whole, state, whole))
def by_fours(
    transition: Array,
    from_current: Array,
    from_next: Array,
    u: Array,
    state: Array,
    start: int,
    stop: int,
    out: Array,
    column: int,
) -> None:
    """The same for up to four states at a time, with no pair torn apart."""
    q, last = transition.shape[0], u.shape[0] - 1
    sources = np.zeros((4, PART))
    f = np.zeros((4, 4))
    x = np.zeros(4)
    for j in range(state.shape[0]):
        for begin in range(start, stop, PART):
            end, place = min(begin + PART, stop), column + begin - start
            count = end - begin
            known = sources[:, :count]
            s0, s1, s2, s3 = known[0], known[1], known[2], known[3]
            here = np.ascontiguousarray(u[begin:end, j])
            there = np.ascontiguousarray(u[begin + 1 : min(end, last) + 1, j])
            first = 0
            while first < q:
                width = min(4, q - first)
                if first + width < q and transition[first + width - 1, first + width] != 0.0:
                    width -= 1
                for i in range(4):
                    x[i] = 0.0
                    for m in range(4):
                        f[i, m] = 0.0
                for i in range(width, 4):
                    for k in range(count):
                        known[i, k] = 0.0
                for i in range(width):
                    own, forced = first + i, known[i]
                    now, after = from_current[own], from_next[own]
                    x[i] = state[j, own]
                    for m in range(width):
                        f[i, m] = transition[own, first + m]
                    for k in range(count):
                        forced[k] = now * here[k]
                    if after:
                        for k in range(there.size):
                            forced[k] += after * there[k]
                        if there.size < count:
                            forced[count - 1] += after * here[count - 1]
                    for m in range(first):
                        weight, before = transition[own, m], out[j * q + m, place : place + count]
                        for k in range(count):
                            forced[k] += weight * before[k]
                f00, f01, f02, f03 = f[0]
                f10, f11, f12, f13 = f[1]
                f20, f21, f22, f23 = f[2]
                f30, f31, f32, f33 = f[3]
                x0, x1, x2, x3 = x
                for k in range(count):
                    n0 = ((s0[k] + f00 * x0) + f01 * x1) + (f02 * x2 + f03 * x3)
                    n1 = ((s1[k] + f10 * x0) + f11 * x1) + (f12 * x2 + f13 * x3)
                    n2 = ((s2[k] + f20 * x0) + f21 * x1) + (f22 * x2 + f23 * x3)
                    n3 = ((s3[k] + f30 * x0) + f31 * x1) + (f32 * x2 + f33 * x3)
                    s0[k], s1[k], s2[k], s3[k] = x0, x1, x2, x3
                    x0, x1, x2, x3 = n0, n1, n2, n3
                x[0], x[1], x[2], x[3] = x0, x1, x2, x3
                for i in range(width):
                    state[j, first + i] = x[i]
                    for k in range(count):
                        out[j * q + first + i, place + k] = known[i, k]
                first += width
