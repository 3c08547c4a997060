"""The sample loop: a state recursion over a record, or a chunk of it with the state carried on.

    x_{k+1} = F x_k + G0 u_k + G1 u_{k+1}

is the only recursion in the package that runs over samples. It is compiled by numba, once, and the
machine code is kept on disk. The same bank ``(F, G0, G1)`` is run for every input channel: the
states of channel ``j`` fill the rows ``j q .. (j + 1) q`` of the output, which is stored *state
by state* so that the block can be handed to LAPACK without a copy.

``F`` of a cascade is lower triangular but for the pairs on its diagonal, so a long record is run
over four states at a time: what the states before them contribute is known for the whole block and
is added up along time, where the processor takes several samples at once; only the four themselves
are recursive, and they fit its registers. The sums are the same, in another order.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from tridentify.numerics.arrays import Array

LONG_INPUT = 5_000
MOST_BY_FOURS = 32
PART = 512


def _recursion(
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


def _branched(
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
    trunk: int,
    width: int,
) -> None:
    """The same for branches of ``width`` states that share the first ``trunk`` states."""
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
                begin, end = 0, min(i + 1 + upper, q)
                if i >= trunk:
                    for m in range(trunk):
                        total += transition[i, m] * state[j, m]
                    begin = i - (i - trunk) % width
                    end = min(end, begin + width)
                for m in range(begin, end):
                    total += transition[i, m] * state[j, m]
                new[i] = total
            for i in range(q):
                state[j, i] = new[i]


def _by_fours(
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
                f[:], x[:], known[width:] = 0.0, 0.0, 0.0
                for i in range(width):
                    own, forced = first + i, known[i]
                    now, after = from_current[own], from_next[own]
                    x[i] = state[j, own]
                    f[i, :width] = transition[own, first : first + width]
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
                    out[j * q + first + i, place : place + count] = known[i]
                first += width


@cache
def _compiled_by_fours() -> Callable[..., None]:
    """`_by_fours` as machine code."""
    import numba

    read = numba.types.Array(numba.float64, 2, "C", readonly=True)
    one = numba.types.Array(numba.float64, 1, "C", readonly=True)
    state, out, whole = numba.float64[:, ::1], numba.float64[:, ::1], numba.int64
    signature = numba.void(read, one, one, read, state, whole, whole, out, whole)
    try:
        compiled: Any = numba.njit(signature, cache=True)(_by_fours)
    except RuntimeError:  # no folder on this machine can hold the cache
        compiled = numba.njit(signature)(_by_fours)
    return compiled  # type: ignore[no-any-return]


@cache
def _compiled(branched: bool) -> Callable[..., None]:
    """The recursion as machine code (compiled at the first call, afterwards read from disk)."""
    import numba

    read = numba.types.Array(numba.float64, 2, "C", readonly=True)
    column = numba.types.Array(numba.float64, 1, "C", readonly=True)
    state, out = numba.float64[:, ::1], numba.float64[:, :]
    whole = numba.int64
    signature = numba.void(read, column, column, whole, read, state, whole, whole, out, whole)
    function: Callable[..., None] = _recursion
    if branched:
        function = _branched
        signature = numba.void(
            read, column, column, whole, read, state, whole, whole, out, whole, whole, whole
        )
    try:
        compiled: Any = numba.njit(signature, cache=True)(function)
    except RuntimeError:  # no folder on this machine can hold the cache
        compiled = numba.njit(signature)(function)
    return compiled  # type: ignore[no-any-return]


def warm_up() -> None:
    """Compile or load the sample loop now, so that a progress display can name the delay."""
    _compiled(False)
    _compiled(True)
    _compiled_by_fours()


def propagate(
    transition: Array,
    from_current: Array,
    from_next: Array,
    u: Array,
    state: Array,
    out: Array,
    *,
    start: int = 0,
    stop: int | None = None,
    column: int = 0,
    upper: int | None = None,
    branches: tuple[int, int] = (0, 0),
) -> None:
    """Run one bank of states over samples ``start .. stop-1`` of every input channel.

    Parameters
    ----------
    transition : (q, q) array
        ``F``.
    from_current, from_next : (q,) array
        ``G0`` and ``G1``.
    u : (n_samples, n_channels) array
        The whole input; the sample after ``stop`` is read for a first-order hold.
    state : (n_channels, q) array
        States at sample ``start``; on return those at sample ``stop``.
    out : (>= n_channels * q, >= column + stop - start) array
        Receives the states, one row a state.
    start, stop : int
        Range of samples.
    column : int
        Where in ``out`` the first sample goes.
    upper : int, optional
        Number of non-zero diagonals of ``transition`` above the main one (default: all).
    """
    q = transition.shape[0]
    end = u.shape[0] if stop is None else stop
    few = upper is not None and upper <= 1 and not branches[1] and q <= MOST_BY_FOURS
    if few and u.shape[0] > LONG_INPUT and out.flags.c_contiguous:
        _compiled_by_fours()(
            np.ascontiguousarray(transition),
            np.ascontiguousarray(from_current),
            np.ascontiguousarray(from_next),
            u,
            state,
            start,
            end,
            out,
            column,
        )
        return
    more = branches if branches[1] else ()
    _compiled(bool(more))(
        np.ascontiguousarray(transition),
        np.ascontiguousarray(from_current),
        np.ascontiguousarray(from_next),
        q if upper is None else upper,
        u,
        state,
        start,
        end,
        out,
        column,
        *more,
    )
