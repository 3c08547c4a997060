"""A stored record through an estimator, compiled: quiet samples in blocks, others one by one.

The loop is one for all estimators. It gets their step and their block as function pointers, so
that their code is compiled once, and not again within the loop.
"""

from __future__ import annotations

from collections.abc import Callable

from numba import types

from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.compiled import compiled
from tridentify.online.kernels import slots
from tridentify.online.kernels.signatures import INTS, MANY, ONE, ROOM, TABLE, WHICH

Step = Callable[[Indices, Array, Array, float], float]
Block = Callable[
    [Indices, Array, Array, Array, Array, int, int, Array, Indices, Array, Array, Array, Array], int
]

STEP_POINTER = types.FunctionType(ONE)
BLOCK_POINTER = types.FunctionType(MANY)


@compiled(MANY, value=True)
def no_block(
    ints: Indices, c: Array, x: Array, u: Array, y: Array, start: int, most: int,
    innovations: Array, flags: Indices, room: Array, lines: Array, zeros: Array, kept: Array,
) -> int:  # fmt: skip
    """For an estimator that takes samples one by one."""
    return 0


@compiled(types.int64(*WHICH, TABLE, INTS, STEP_POINTER, BLOCK_POINTER, *ROOM))
def run_samples(
    ints: Indices, c: Array, x: Array, u: Array, y: Array, start: int, stop: int,
    innovations: Array, flags: Indices, step: Step, block: Block, room: Array, lines: Array,
    zeros: Array, kept: Array,
) -> int:  # fmt: skip
    """Samples ``start .. stop - 1`` of a record, up to the first with an event; gives the next.

    The last one is a single step, so that scratch numbers in ``x`` are as after single steps too.
    """
    m, p = ints[slots.INPUTS], ints[slots.OUTPUTS]
    k = start
    while k < stop:
        k += block(ints, c, x, u, y, k, stop - 1 - k, innovations, flags, room, lines, zeros, kept)
        for j in range(m):
            x[slots.INBOX + j] = u[k, j]
        for i in range(p):
            x[slots.INBOX + m + i] = y[k, i]
        step(ints, c, x, c[0])
        for i in range(p):
            innovations[k, i] = x[ints[slots.AT_WATCH] + i * ints[slots.WATCH] + slots.INNOVATION]
        flags[k] = int(x[slots.FLAGS])
        k += 1
        if x[slots.EVENT] != 0.0:
            break
    return k
