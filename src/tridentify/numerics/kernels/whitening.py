"""Innovations of many series in machine code: what `numerics.autoregression` derives."""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array, Flags
from tridentify.numerics.compiled import compiled


@compiled(
    "void(float64[::1], boolean[::1], float64[:,::1], float64[::1], float64[:,:], float64[:,::1],"
    " float64[:,:])",
    any_order=True,
)
def innovate(
    a: Array, seen: Flags, gain: Array, scale: Array, rows: Array, past: Array, out: Array
) -> None:
    """Innovations of every row over a block; ``past`` (n_rows, p), oldest first, is carried on."""
    p, count = a.size, seen.size
    line, total = np.empty(p + count), np.empty(count)
    steady = gain[:, 0] == -1.0
    for c in range(rows.shape[0]):
        # part by part, as numba compiles seconds of code for a part that is set as a whole
        for i in range(p):
            line[i] = past[c, i]
        for i in range(count):
            line[p + i] = rows[c, i]
        t = 0
        while t < count:
            stop = t
            while stop < count and steady[stop]:
                stop += 1
            # views from zero on: no index can be negative, so that several samples go at once
            own = total[t:stop]
            first = line[p + t : p + stop]
            for i in range(own.size):
                own[i] = first[i]
            k = 1
            # four coefficients at a time: the sums are the same, each is loaded and stored once
            while k + 3 <= p:
                a0, a1, a2, a3 = a[k - 1], a[k], a[k + 1], a[k + 2]
                l0, l1 = line[p + t - k :], line[p + t - k - 1 :]
                l2, l3 = line[p + t - k - 2 :], line[p + t - k - 3 :]
                for i in range(own.size):
                    own[i] = (((own[i] + a0 * l0[i]) + a1 * l1[i]) + a2 * l2[i]) + a3 * l3[i]
                k += 4
            while k <= p:
                a0, l0 = a[k - 1], line[p + t - k :]
                for i in range(own.size):
                    own[i] += a0 * l0[i]
                k += 1
            t = stop
            if t == count:
                break
            expected = 0.0
            for k in range(1, p + 1):
                expected -= a[k - 1] * line[p + t - k]
            if seen[t]:
                surprise = line[p + t] - expected
                total[t] = surprise / np.sqrt(scale[t])
                line[p + t] = expected
                for k in range(p):
                    line[p + t - k] += gain[t, k] * surprise
            else:
                total[t] = 0.0
                line[p + t] = expected
            t += 1
        for i in range(count):
            out[c, i] = total[i]
        for i in range(p):
            past[c, i] = line[count + i]
