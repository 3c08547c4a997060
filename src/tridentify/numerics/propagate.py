"""The sample loop: a state recursion over a record, or a chunk of it with the state carried on.

    x_{k+1} = F x_k + G0 u_k + G1 u_{k+1}

is the only recursion in the package that runs over samples. It is compiled by numba, once, and the
machine code is kept on disk. The same bank ``(F, G0, G1)`` is run for every input channel: the
states of channel ``j`` fill the rows ``j q .. (j + 1) q`` of the output, which is stored *state
by state* so that the block can be handed to LAPACK without a copy.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
    more = branches if branches[1] else ()
    _compiled(bool(more))(
        np.ascontiguousarray(transition),
        np.ascontiguousarray(from_current),
        np.ascontiguousarray(from_next),
        q if upper is None else upper,
        u,
        state,
        start,
        u.shape[0] if stop is None else stop,
        out,
        column,
        *more,
    )
