"""What unknowns cost in ``-2 log L``: Akaike's price, corrected for few samples.

References: H. Akaike, IEEE Trans. Automatic Control 19(6) (1974) 716-723. C. M. Hurvich & C.-L.
Tsai, Biometrika 76(2) (1989) 297-307.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from tridentify.numerics.arrays import Array

LEAST_ROOM = 0.5
"""Samples beyond the unknowns that the price is worked out for at the least: it stays finite."""

Unknowns = TypeVar("Unknowns", float, Array)


def aicc_price(unknowns: Unknowns, samples: float) -> Unknowns:
    """``2 k + 2 k (k + 1) / (N - k - 1)``, added to ``-2 log L``.

    Parameters
    ----------
    unknowns : float or array
        k, noise variances counted.
    samples : float
        N.

    Examples
    --------
    >>> aicc_price(3.0, 100.0), aicc_price(3.0, 4.0)
    (6.25, 54.0)
    """
    k = unknowns
    left = samples - k - 1.0
    room = np.maximum(left, LEAST_ROOM) if isinstance(left, np.ndarray) else max(left, LEAST_ROOM)
    price = 2.0 * k + 2.0 * k * (k + 1.0) / room
    found: Unknowns = price if isinstance(price, np.ndarray) else float(price)
    return found
