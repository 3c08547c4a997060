"""Triangles of many denominators in machine code: what `posterior.surface` derives.

For uniform time and an input that is held or ramps between the samples: discretisation, states,
whitening and triangle of one denominator after the other, in arrays that stay in near memory.
"""

from __future__ import annotations

import numpy as np

from tridentify.models.compiled_regression import die_away, drive
from tridentify.numerics.arrays import Array, Flags
from tridentify.numerics.compiled import compiled
from tridentify.numerics.kernels.exponentials import discrete
from tridentify.numerics.kernels.triangles import triangularise
from tridentify.numerics.kernels.whitening import innovate


@compiled(
    "void(float64[:,:,::1], float64[:,::1], int64, float64, boolean, float64[:,::1],"
    " float64[:,::1], float64[:,::1], boolean[::1], float64[::1], float64[:,::1], float64[::1],"
    " float64[:,:,::1])",
    free=True,
)
def reduced_banks(
    bank_a: Array,
    bank_b: Array,
    impulse: int,
    dt: float,
    ramps: bool,
    w: Array,
    before: Array,
    after: Array,
    seen: Flags,
    a: Array,
    gain: Array,
    scale: Array,
    found: Array,
) -> None:
    """Triangles of ``[free responses | before | states of every input | after]``.

    Parameters
    ----------
    bank_a : (s, q, q) array
        Lower triangular with pairs.
    bank_b : (s, q) array
    impulse : int
        Of how many states, the first ones, there is a free response: the impulse's at sample 0.
    dt : float
        Sampling interval, in the unit of the rates.
    ramps : bool
        Whether the inputs ramp between the samples, or are held.
    w : (n_inputs, n_samples) array
    before, after : (any number, n_samples) arrays
        Columns that are the same for all, finite also where the output is missing.
    seen : (n_samples,) bool array
        Where the output is there.
    a, gain, scale : (p,), (n_samples, p or 1), (n_samples,) arrays
        The noise (`numerics.autoregression.gains`); ``a`` is empty where it is white.
    found : (s, n_columns, n_columns) array
        Receives the triangles.
    """
    q, n, p = bank_b.shape[1], seen.size, a.size
    width, states = found.shape[1], impulse + before.shape[0]
    rows, white, past = np.empty((width, n)), np.empty((width if p else 0, n)), np.empty((width, p))
    all_there = True
    for t in range(n):
        all_there = all_there and seen[t]
    for s in range(bank_b.shape[0]):
        step, now, following = discrete(bank_a[s], bank_b[s], dt, ramps)
        length = n
        if impulse:
            inner, begin = np.empty((impulse, impulse)), np.empty(impulse)
            for i in range(impulse):
                begin[i] = bank_b[s, i]
                for m in range(impulse):
                    inner[i, m] = step[i, m]
                for t in range(n):
                    rows[i, t] = 0.0
            length = die_away(inner, begin, 0, rows[:impulse])
        for i in range(before.shape[0]):
            for t in range(n):
                rows[impulse + i, t] = before[i, t]
        for j in range(w.shape[0]):
            at = states + j * q
            drive(step, now, following, w[j], np.zeros(q), rows[at : at + q], 0, n)
        for i in range(after.shape[0]):
            for t in range(n):
                rows[width - after.shape[0] + i, t] = after[i, t]
        if p:
            for i in range(width):
                for k in range(p):
                    past[i, k] = 0.0
            innovate(a, seen, gain, scale, rows, past, white)
            triangularise(white, n, 0, n, found[s])
            continue
        if not all_there:
            for i in range(width):
                for t in range(n):
                    if not seen[t]:
                        rows[i, t] = 0.0
        triangularise(rows, n, impulse, length, found[s])
