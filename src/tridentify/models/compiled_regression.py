"""Experiments filtered through banks and reduced to triangles, in machine code.

What `models.regression` derives, for uniform time: discretisation, states and triangle of many
banks in one call. The states follow one another section by section along the whole record: what
the sections before contribute is added up along time, where the processor takes several samples at
once, and only the section itself is a recursion.
"""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array, Complex, Indices
from tridentify.numerics.compiled import compiled
from tridentify.numerics.kernels.cascades import fill_cascade
from tridentify.numerics.kernels.exponentials import discrete, of_powers
from tridentify.numerics.kernels.triangles import add_scaled, triangularise

PIECE = 64
"""Samples of a free response after which is looked whether it has died out."""
NEGLIGIBLE = 1e-30
"""As in `models.regression`."""


@compiled("(complex128[:,::1],)", free=True)
def cascades(poles: Complex) -> tuple[Array, Array]:
    """``A`` (n_banks, q, q) and ``B`` (n_banks, q) of several sets of poles."""
    count, q = poles.shape
    a, b = np.zeros((count, q, q)), np.zeros((count, q))
    for k in range(count):
        fill_cascade(poles[k], 1, a[k], b[k])
    return a, b


@compiled(
    "void(float64[:,::1], float64[:,::1], float64[:,::1], float64[::1], float64[:,::1],"
    " int64, int64)",
    wide=True,
    inner=True,
)
def drive(step: Array, taps: Array, w: Array, x: Array, rows: Array, begin: int, end: int) -> None:
    """States at samples ``begin .. end - 1`` into ``rows`` (q, n); ``x`` is carried on.

    ``x_{k+1} = F x_k + sum_p taps[p] w[p, k]``, without the input where ``w`` is empty.
    """
    q, count = x.size, end - begin
    forced = np.empty((2, count))
    i = 0
    while i < q:
        width = 2 if i + 1 < q and step[i, i + 1] != 0.0 else 1
        for r in range(width):
            own = forced[r]
            for k in range(count):
                own[k] = taps[0, i + r] * w[0, begin + k] if w.shape[0] else 0.0
            for p in range(1, w.shape[0]):
                weight = taps[p, i + r]
                if weight != 0.0:
                    for k in range(count):
                        own[k] += weight * w[p, begin + k]
            for m in range(i):
                weight = step[i + r, m]
                if weight != 0.0:
                    add_scaled(own, weight, rows[m, begin:end])
        if width == 1:
            f, state, own, out = step[i, i], x[i], forced[0], rows[i, begin:end]
            for k in range(count):
                out[k] = state
                state = f * state + own[k]
            x[i] = state
        else:
            f00, f01, f10, f11 = step[i, i], step[i, i + 1], step[i + 1, i], step[i + 1, i + 1]
            s0, s1, o0, o1 = x[i], x[i + 1], forced[0], forced[1]
            r0, r1 = rows[i, begin:end], rows[i + 1, begin:end]
            for k in range(count):
                r0[k], r1[k] = s0, s1
                s0, s1 = f00 * s0 + (f01 * s1 + o0[k]), f11 * s1 + (f10 * s0 + o1[k])
            x[i], x[i + 1] = s0, s1
        i += width


@compiled("int64(float64[:,::1], float64[::1], int64, float64[:,::1])", inner=True)
def die_away(step: Array, b: Array, begin: int, rows: Array) -> int:
    """The response to an impulse at sample ``begin`` into zeros; from where on it is nothing."""
    q, n = rows.shape
    x, nothing, least, at = b.copy(), np.zeros((0, 0)), 0.0, begin
    for i in range(q):
        least = max(least, NEGLIGIBLE * abs(b[i]))
    while at < n:
        end, largest = min(at + PIECE, n), 0.0
        drive(step, nothing, nothing, x, rows, at, end)
        at = end
        for i in range(q):
            largest = max(largest, abs(x[i]))
        if largest < least:
            break
    return at


@compiled(
    "(float64[:,::1], float64[::1], float64, boolean, float64, float64[:,::1], float64[::1])",
    inner=True,
)
def late_taps(
    a: Array, b: Array, dt: float, ramps: bool, part: float, step: Array, begun: Array
) -> tuple[Array, Array, Array]:
    """How an input that comes late by ``part`` of an interval acts (`numerics.sampled`).

    ``begun`` are the input's own first two samples.

    Returns
    -------
    taps : (2, q) array
        Weights of what acts in this step and the next one.
    last : (q,) array
        Weight that is added to the states at the end.
    x : (q,) array
        States, less that, at the first sample that the input reaches.
    """
    q = b.size
    steps, first, second = np.empty((2, q, q)), np.empty((2, q)), np.empty((2, q))
    for s in range(2):
        f, g, h = discrete(a, b, (part if s == 0 else 1.0 - part) * dt, ramps)
        for i in range(q):
            first[s, i], second[s, i] = g[i], h[i]
            for m in range(q):
                steps[s, i, m] = f[i, m]
    taps, last, x = np.zeros((2, q)), np.zeros(q), np.empty(q)
    for i in range(q):
        if ramps:
            last[i] = (1.0 - part) * second[1, i]
    old = part if ramps else 1.0
    arrived = part * begun[0] + (1.0 - part) * begun[1] if ramps else begun[1]
    for i in range(q):
        taps[1, i] = first[1, i] + (part * second[1, i] if ramps else 0.0)
        for m in range(q):
            taps[0, i] += old * steps[1, i, m] * first[0, m]
            if ramps:
                taps[1, i] += steps[1, i, m] * ((1.0 - part) * first[0, m] + second[0, m])
                taps[1, i] += step[i, m] * last[m]
        x[i] = begun[0] * first[1, i] + arrived * second[1, i] - begun[1] * last[i]
    return taps, last, x


@compiled("(float64[:,::1], float64[::1], float64, int64)", inner=True)
def taps_of(a: Array, b: Array, dt: float, degree: int) -> tuple[Array, Array]:
    """``F``, and the weights of what an input is made of that comes in time."""
    if degree > 1:
        return of_powers(a, b, dt, degree)
    step, now, after = discrete(a, b, dt, degree == 1)
    taps = np.empty((2, b.size))
    for i in range(b.size):
        taps[0, i], taps[1, i] = now[i], after[i]
    return step, taps


@compiled(
    "(float64[:,::1], float64[::1], float64, int64, float64, float64[:,::1], float64[::1])",
    inner=True,
)
def late_powers(
    a: Array, b: Array, dt: float, degree: int, part: float, taps: Array, begun: Array
) -> tuple[Array, Array, Array]:
    """As `late_taps` for a band-limited input that began to arrive ``part`` of an interval ago."""
    x = np.zeros(b.size)
    if part:
        _, first = of_powers(a, b, part * dt, degree)
        for p in range(degree + 1):
            for i in range(b.size):
                x[i] += first[p, i] * begun[p]
    return taps, np.zeros(b.size), x


@compiled(
    "int64(float64[:,::1], float64[::1], float64, int64, float64[:,:,::1], int64[::1],"
    " float64[::1], float64[:,::1], boolean, int64, float64[:,::1])",
    inner=True,
)
def fill_states(
    a: Array, b: Array, dt: float, degree: int, w: Array, firsts: Indices, parts: Array,
    begun: Array, free: bool, start: int, columns: Array,
) -> int:  # fmt: skip
    """Impulse states and the states of every input; from where on the impulse is nothing."""
    q, n, length = b.size, columns.shape[1], 0
    step, whole = taps_of(a, b, dt, degree)
    at = q if free else 0
    for i in range(at + q * w.shape[0]):
        for k in range(n):
            columns[i, k] = 0.0
    if free:
        length = die_away(step, b, start, columns[:q])
    for j in range(w.shape[0]):
        taps, last, x, first = whole, np.zeros(q), np.zeros(q), firsts[j]
        if degree > 1:
            taps, last, x = late_powers(a, b, dt, degree, parts[j], whole, begun[j])
        elif first:
            taps, last, x = late_taps(a, b, dt, degree == 1, parts[j], step, begun[j])
        rows = columns[at : at + q]
        if first < n:
            drive(step, taps, w[j], x, rows, first, n)
        for i in range(q):
            if last[i] != 0.0:
                for k in range(first, n):
                    rows[i, k] += last[i] * w[j, 1, k]
        at += q
    return length


@compiled(
    "float64[:,:,::1](float64[:,:,::1], float64[:,::1], float64, int64, float64[:,:,::1],"
    " int64[::1], float64[::1], float64[:,::1], float64[:,::1], float64[:,::1], float64[::1],"
    " boolean, int64)",
    free=True,
)
def triangles_of(
    a: Array,
    b: Array,
    dt: float,
    degree: int,
    w: Array,
    firsts: Indices,
    parts: Array,
    begun: Array,
    known: Array,
    y: Array,
    weight: Array,
    free: bool,
    start: int,
) -> Array:
    """The triangles of some outputs of one experiment on several banks.

    Parameters
    ----------
    a : (n_banks, q, q) array
        Lower triangular with pairs.
    b : (n_banks, q) array
    dt : float
    degree : int
        Of the inputs between samples: 0 where they are held, 1 where they ramp.
    w : (n_inputs, m, n_samples) array
        What acts from sample to sample: the sample itself and the next one, or the coefficients of
        a polynomial.
    firsts : (n_inputs,) int array
        The first sample that a delayed input reaches; 0 without a delay.
    parts : (n_inputs,) array
        The delay's part of an interval; of a polynomial, how long ago it began to arrive.
    begun : (n_inputs, m) array
        First samples of each input, or the coefficients of its first piece.
    known : (n_known, n_samples) array
        Inputs, constant and ramp.
    y : (n_outputs, n_samples) array
        Zero where missing.
    weight : (n_samples,) array
        Of the rows; empty where it is one.
    free : bool
        Whether the impulse states are among the columns.
    start : int
        Where the impulse acts.

    Returns
    -------
    (n_banks, n_columns, n_columns) array
        Impulse states, states of every input, ``known``, outputs. Without outputs it is (n_banks,
        n_columns, n_samples), the columns themselves.
    """
    count, q, n = b.shape[0], b.shape[1], y.shape[1]
    states = q * (w.shape[0] + free)
    width = states + known.shape[0] + y.shape[0]
    height = width if y.shape[0] else n
    found, columns = np.empty((count, width, height)), np.empty((width, n))
    for k in range(count):
        length = fill_states(
            a[k], b[k], dt, degree, w, firsts, parts, begun, free, start, columns
        )  # fmt: skip
        for i in range(known.shape[0]):
            for t in range(n):
                columns[states + i, t] = known[i, t]
        for i in range(y.shape[0]):
            for t in range(n):
                columns[states + known.shape[0] + i, t] = y[i, t]
        if not y.shape[0]:
            for i in range(width):
                for t in range(n):
                    found[k, i, t] = columns[i, t]
            continue
        if weight.size:
            for i in range(width):
                for t in range(n):
                    columns[i, t] *= weight[t]
        triangularise(columns, n, q if free else 0, length, found[k])
    return found
