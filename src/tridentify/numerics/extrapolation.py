"""A step of an iteration, with what the ones before tell of where they lead.

An iteration ``x <- x + f(x)`` whose steps shrink by a constant factor each creeps. Where ``f`` is
nearly straight, what it changes by from place to place tells where it vanishes: of the last moves
``dx_k`` and the changes ``df_k`` of the steps beside them the combination is taken that leaves the
least of the last step, and the step goes on from there,

    step  =  f  -  sum_k s_k (dx_k + df_k),      s  =  argmin |f - sum_k s_k df_k|.

References: D. Anderson, J. ACM 12 (1965) 547-560; H. Walker & P. Ni, SIAM J. Numer. Anal. 49 (2011)
1715-1735.
"""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array

ALIKE = 1e-8
"""Relative singular value below which moves count as one: their difference is rounding."""


def extrapolated(moves: Array, steps: Array, seen_by: Array | None = None) -> Array:
    """(n,) the step from the last place.

    Parameters
    ----------
    moves : (n, k) array
        From each of the places before to the next.
    steps : (n, k + 1) array
        What was asked for at each place, the last one last.
    seen_by : (m, n) array, optional
        By which the size of a step counts; the identity by default.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify.numerics.extrapolation import extrapolated
    >>> places = np.array([[0.0, 0.1]])  # of x <- x + 0.1 (1 - x), which ends at 1
    >>> (places[:, -1] + extrapolated(np.diff(places), 0.1 * (1.0 - places))).round(9)
    array([1.])
    """
    last, turns = steps[:, -1], np.diff(steps, axis=1)
    seen = (turns, last) if seen_by is None else (seen_by @ turns, seen_by @ last)
    shares = np.linalg.lstsq(*seen, rcond=ALIKE)[0]
    return np.asarray(last - (moves + turns) @ shares)
