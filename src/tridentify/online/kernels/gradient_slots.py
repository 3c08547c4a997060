"""Where the gradient rule keeps what is its own; nothing is compiled here."""

from __future__ import annotations

from tridentify.numerics.arrays import Indices
from tridentify.online.kernels.slots import COLUMNS

# places in ints
(
    SERIES, PARALLEL_UNKNOWNS, SERIES_UNKNOWNS, POLES, ANSWERS, KEPT, OWN, C_FITS, C_SECOND, X_FITS,
    X_SECOND, X_MOMENTS, X_ROOM,
) = range(56, 69)  # fmt: skip

# places in c
RATE, KNOWN, READY, GRADIENT_PACE = range(4, 8)

# slots of x
FROM, MOMENTS, SUMMED = 13, 14, 15

MEMORY = 6.0
"""Time constants of the weights over which the innovations are averaged."""
WHITE = 0.25
"""Leverage of a sample from which the weights follow every sample, so that none can be far off."""
DOUBTS, TELLS = 0.5, 1.0  # of READY: a sample may be doubted; a change may be told


def fits_stride(ints: Indices) -> int:
    """Numbers in ``c`` for the fits of one output."""
    n = ints[COLUMNS]
    k1, k3 = ints[PARALLEL_UNKNOWNS], ints[SERIES_UNKNOWNS]
    return int(k1 * (n + k1) + n + k3 * (n + k3) + ints[OWN] * n + 1)
