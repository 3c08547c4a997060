"""What arrays are called in annotations, and how one is filled up."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Complex: TypeAlias = NDArray[np.complex128]
Flags: TypeAlias = NDArray[np.bool_]
Indices: TypeAlias = NDArray[np.int64]


def filled(values: Array) -> Array:
    """As `numpy.nan_to_num`, but the array itself where all is finite.

    Examples
    --------
    >>> filled(np.array([1.0, np.nan])).tolist()
    [1.0, 0.0]
    """
    return values if np.isfinite(values).all() else np.nan_to_num(values)
