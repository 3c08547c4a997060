"""Triangles of many denominators in machine code: what `posterior.surface` derives.

For uniform time and an input that is held or ramps between the samples: discretisation, states,
whitening and triangles of four denominators at a time, in arrays that stay in near memory. The
state recursions of the four take turns, sample by sample: each by itself would wait for its own
last result.
"""

from __future__ import annotations

import numpy as np

from tridentify.models.compiled_regression import die_away
from tridentify.numerics.arrays import Array, Flags
from tridentify.numerics.compiled import compiled
from tridentify.numerics.kernels.cascades import fill_basis, fill_map
from tridentify.numerics.kernels.exponentials import discrete
from tridentify.numerics.kernels.triangles import add_scaled, triangularise
from tridentify.numerics.kernels.whitening import innovate

ABREAST = 4
"""Denominators whose recursions take turns: a step takes eight cycles until its result is there,
and two of work."""


@compiled(
    "void(float64[:,:,::1], float64[:,::1], float64[:,::1], float64[::1], int64, float64[:,:,::1],"
    " float64[:,:,::1])",
    wide=True,
    inner=True,
)
def drive_abreast(
    step: Array, now: Array, after: Array, w: Array, at: int, forced: Array, rows: Array
) -> None:
    """States from rest into ``rows[:, at : at + q]``, of `ABREAST` banks with the same pairs.

    As `models.compiled_regression.drive`: ``x_{k+1} = F x_k + G0 w_k + G1 w_{k+1}``, section by
    section. ``forced`` (ABREAST, 2, n) is room to work in.
    """
    q, n, i = now.shape[1], w.size, 0
    while i < q:
        width = 2 if i + 1 < q and step[0, i, i + 1] != 0.0 else 1
        for s in range(ABREAST):
            for r in range(width):
                own, first, second = forced[s, r], now[s, i + r], after[s, i + r]
                for k in range(n):
                    own[k] = first * w[k]
                if second != 0.0:
                    for k in range(n - 1):
                        own[k] += second * w[k + 1]
                for m in range(i):
                    weight = step[s, i + r, m]
                    if weight != 0.0:
                        add_scaled(own, weight, rows[s, at + m])
        j = i + width - 1
        a00, a01, a10, a11 = step[0, i, i], step[0, i, j], step[0, j, i], step[0, j, j]
        b00, b01, b10, b11 = step[1, i, i], step[1, i, j], step[1, j, i], step[1, j, j]
        c00, c01, c10, c11 = step[2, i, i], step[2, i, j], step[2, j, i], step[2, j, j]
        d00, d01, d10, d11 = step[3, i, i], step[3, i, j], step[3, j, i], step[3, j, j]
        a0, b0, c0, d0, a1, b1, c1, d1 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        if width == 1:
            for k in range(n):
                rows[0, at + i, k], rows[1, at + i, k] = a0, b0
                rows[2, at + i, k], rows[3, at + i, k] = c0, d0
                a0, b0 = a00 * a0 + forced[0, 0, k], b00 * b0 + forced[1, 0, k]
                c0, d0 = c00 * c0 + forced[2, 0, k], d00 * d0 + forced[3, 0, k]
        else:
            for k in range(n):
                rows[0, at + i, k], rows[0, at + j, k] = a0, a1
                rows[1, at + i, k], rows[1, at + j, k] = b0, b1
                rows[2, at + i, k], rows[2, at + j, k] = c0, c1
                rows[3, at + i, k], rows[3, at + j, k] = d0, d1
                a2 = a11 * a1 + (a10 * a0 + forced[0, 1, k])
                b2 = b11 * b1 + (b10 * b0 + forced[1, 1, k])
                c2 = c11 * c1 + (c10 * c0 + forced[2, 1, k])
                d2 = d11 * d1 + (d10 * d0 + forced[3, 1, k])
                a0 = a00 * a0 + (a01 * a1 + forced[0, 0, k])
                b0 = b00 * b0 + (b01 * b1 + forced[1, 0, k])
                c0 = c00 * c0 + (c01 * c1 + forced[2, 0, k])
                d0 = d00 * d0 + (d01 * d1 + forced[3, 0, k])
                a1, b1, c1, d1 = a2, b2, c2, d2
        i += width


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
    tail, count, length = width - after.shape[0], bank_b.shape[0], np.full(ABREAST, n)
    rows, forced = np.empty((ABREAST, width, n)), np.empty((ABREAST, 2, n))
    step, now, following = np.empty((ABREAST, q, q)), np.empty((ABREAST, q)), np.empty((ABREAST, q))
    white, past = np.empty((width if p else 0, n)), np.empty((width, p))
    inner, begin = np.empty((impulse, impulse)), np.empty(impulse)
    all_there = True
    for t in range(n):
        all_there = all_there and seen[t]
    for first in range(0, count, ABREAST):
        for s in range(ABREAST):
            own = min(first + s, count - 1)
            whole, held, ramp = discrete(bank_a[own], bank_b[own], dt, ramps)
            for i in range(q):
                now[s, i], following[s, i] = held[i], ramp[i]
                for m in range(q):
                    step[s, i, m] = whole[i, m]
            for i in range(impulse):
                begin[i] = bank_b[own, i]
                for m in range(impulse):
                    inner[i, m] = whole[i, m]
                for t in range(n):
                    rows[s, i, t] = 0.0
            if impulse:
                length[s] = die_away(inner, begin, 0, rows[s, :impulse])
            for i in range(before.shape[0]):
                for t in range(n):
                    rows[s, impulse + i, t] = before[i, t]
            for i in range(after.shape[0]):
                for t in range(n):
                    rows[s, tail + i, t] = after[i, t]
        for j in range(w.shape[0]):
            drive_abreast(step, now, following, w[j], states + j * q, forced, rows)
        for s in range(min(ABREAST, count - first)):
            if p:
                for i in range(width):
                    for k in range(p):
                        past[i, k] = 0.0
                innovate(a, seen, gain, scale, rows[s], past, white)
                triangularise(white, n, 0, n, found[first + s])
                continue
            if not all_there:
                for i in range(width):
                    for t in range(n):
                        if not seen[t]:
                            rows[s, i, t] = 0.0
            triangularise(rows[s], n, impulse, length[s], found[first + s])


@compiled("void(float64[:,:,:], float64[:,:], float64[:,:,:], float64[:,:,:], float64[:,:,:,::1])")
def fill_maps(a: Array, b: Array, bank_a: Array, rows: Array, found: Array) -> None:
    """`numerics.kernels.cascades.fill_map` for many banks, lower triangular with pairs."""
    for s in range(b.shape[0]):
        fill_map(a[s], b[s], bank_a[s], rows[s], found[s])


@compiled("void(float64[:,:,:], float64[:,:], float64[:,:,::1])")
def fill_bases(a: Array, b: Array, found: Array) -> None:
    """`numerics.kernels.cascades.fill_basis` for many cascades, vector by vector in columns."""
    n = b.shape[1]
    rows, leading = np.empty((n, n)), np.empty(n)
    for s in range(b.shape[0]):
        fill_basis(a[s], b[s], rows, leading)
        for k in range(n):
            for i in range(n):
                found[s, i, k] = rows[n - 1 - k, i]
