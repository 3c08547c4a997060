"""The sample loop: a state recursion over a record, or a chunk of it with the state carried on.

    x_{k+1} = F x_k + G0 u_k + G1 u_{k+1}

is the only recursion in the package that runs over samples. Its loops are machine code
(`numerics.kernels.recursions`). The same bank ``(F, G0, G1)`` is run for every input channel: the
states of channel ``j`` fill the rows ``j q .. (j + 1) q`` of the output, which is stored *state by
state* so that the block can be handed to LAPACK without a copy.

``F`` of a cascade is lower triangular but for the pairs on its diagonal, so a long record is run
over four states at a time: what the states before them contribute is known for the whole block and
is added up along time, where the processor takes several samples at once; only the four themselves
are recursive, and they fit its registers. The sums are the same, in another order.
"""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array

LONG_INPUT = 5_000
MOST_BY_FOURS = 32


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
    few = upper is not None and upper <= 1 and q <= MOST_BY_FOURS
    if few and u.shape[0] > LONG_INPUT and out.flags.c_contiguous:
        from tridentify.numerics.kernels.long_recursions import by_fours

        by_fours(
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
    from tridentify.numerics.kernels.recursions import recursion

    recursion(
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
    )
