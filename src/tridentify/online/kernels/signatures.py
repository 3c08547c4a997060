"""Types of what the compiled loops are given."""

from __future__ import annotations

from numba import types

INTS, VECTOR, TABLE = types.int64[::1], types.float64[::1], types.float64[:, ::1]
SAMPLES = types.Array(types.float64, 2, "C", readonly=True)  # of a record
WHICH = (INTS, VECTOR, VECTOR, SAMPLES, SAMPLES, types.int64, types.int64)
ROOM = (TABLE, TABLE, VECTOR, VECTOR)  # workspace (`online.kernels.workspace`)
MANY = types.int64(*WHICH, TABLE, INTS, *ROOM)
ONE = types.float64(INTS, VECTOR, VECTOR, types.float64)
