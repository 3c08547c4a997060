"""A signal through triangular responses in machine code, by running sums: `statistics.columns`."""

from __future__ import annotations

from numba import float64, int64, void

from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.compiled import compiled, read_only


@compiled(void(read_only(1), read_only(2, int64), float64[:, :]), wide=True)
def through_hats(u: Array, knots: Indices, out: Array) -> None:
    """Write the responses, a row each, in time that does not depend on how wide they are.

    Parameters
    ----------
    u : (n,) array
        Zero before its start.
    knots : (k, 3) int array
        Lags from which a response rises, of its peak, and from which it is zero.
    out : (k, n) array
    """
    n = u.size
    for row in range(knots.shape[0]):
        low, peak, high = knots[row]
        if high - low == 2:
            # one tap: the signal itself, later
            for t in range(n):
                out[row, t] = u[t - peak] if t >= peak else 0.0
            continue
        up, down, rise, fall, total = 1.0 / (peak - low), 1.0 / (high - peak), 0.0, 0.0, 0.0
        for t in range(n):
            if t > low:
                rise += u[t - low - 1]
            if t > peak:
                rise -= u[t - peak - 1]
                fall += u[t - peak - 1]
            if t > high:
                fall -= u[t - high - 1]
            total += up * rise - down * fall
            out[row, t] = total
