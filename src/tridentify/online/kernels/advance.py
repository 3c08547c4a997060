"""One sample on: a filter driven by the impulse at the beginning, and by the inputs, compiled."""

from __future__ import annotations

from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.compiled import linked as compiled
from tridentify.online.kernels import slots


@compiled("boolean(int64[::1], float64[::1], float64[::1], int64)", inline=True)
def die_away(ints: Indices, c: Array, x: Array, at: int) -> bool:
    """The states at ``at``, after an impulse at the beginning; whether they are nothing from now.

    The impulse acts once all inputs have arrived; the states are left alone once ``FIRST`` says
    that they are nothing.
    """
    q, upper, f, work = (
        ints[slots.ORDER],
        ints[slots.UPPER],
        ints[slots.C_STEP],
        ints[slots.AT_WORK],
    )
    since = x[slots.SINCE]
    over = False
    if since > ints[slots.BEGIN] and x[slots.FIRST] == 0.0:
        largest = 0.0
        for i in range(q):
            total = 0.0
            for s in range(min(i + 1 + upper, q)):
                total += c[f + i * q + s] * x[at + s]
            x[work + i] = total
            largest = max(largest, abs(total))
        for i in range(q):
            x[at + i] = x[work + i]
        over = largest < c[ints[slots.C_START]]
    elif since == ints[slots.BEGIN]:
        for i in range(q):
            x[at + i] = c[ints[slots.C_START] + 1 + i]
    return over


@compiled("void(int64[::1], float64[::1], float64[::1], int64)", inline=True)
def drive(ints: Indices, c: Array, x: Array, first: int) -> None:
    """The states at ``first``, input after input, at the sample whose inputs were taken in."""
    m, q, upper = ints[slots.INPUTS], ints[slots.ORDER], ints[slots.UPPER]
    f, work = ints[slots.C_STEP], ints[slots.AT_WORK]
    for j in range(m):
        own = first + j * q
        late = ints[slots.AT_LINE] + j * ints[slots.LINE] + int(c[ints[slots.C_EXTRA] + j])
        g = ints[slots.C_TAPS] + 3 * j * q
        now, new = x[own : own + q], x[work : work + q]
        arrived, before, earlier = x[late], x[late + 1], x[late + 2]
        for i in range(q):
            total = c[g + i] * arrived + c[g + q + i] * before + c[g + 2 * q + i] * earlier
            transition = c[f + i * q : f + (i + 1) * q]
            for s in range(min(i + 1 + upper, q)):
                total += transition[s] * now[s]
            new[i] = total
        for i in range(q):
            now[i] = new[i]
