"""What the last step learned of the curvature that Gauss and Newton leave out.

Where a direction is poorly determined, Gauss-Newton steps on a large residual (a real record is in
no model set) go to and fro across the minimum, each a constant share of the one before: the cost
bends more than ``S'S`` says, ``S`` the scores. The last step ``d`` knows by how much. With the
slopes ``s_0`` and ``s_1`` of the cost along it before and after, and ``q = d'S'S d``, the true
curvature is ``(1 + c) q``,

    c = (s_1 - s_0) / (2 q) - 1,

and the Hessian with it ``M + c M d d'M / (d'M d)``, ``M = S'S``: a structured secant update of rank
one (Dennis, Gay & Welsch 1981). Its step is the Gauss-Newton step ``p`` less ``c / (1 + c)`` of its
part along ``d``, ``(p'M d / d'M d) d``. Only one step is remembered, so nothing has to be carried
from the coordinates of one denominator to those of the next but that step itself: ``a_old / a_new =
1 - d X`` on the new bank gives it without approximation (`row_of`).
"""

from __future__ import annotations

import numpy as np

from tridentify.estimation.likelihood.cost import Point
from tridentify.estimation.likelihood.step import Bend
from tridentify.numerics.arrays import Array
from tridentify.numerics.realization import row_of

LEAST_BEND, MOST_BEND = -0.6, 9.0
"""Bounds of ``c``: a step is stretched 2.5 times or cut to a tenth, no more, on the word of one
other."""


def bend_of(old: Point, change: Array, new: Point) -> Bend | None:
    """What a step tells; None where it tells nothing.

    Parameters
    ----------
    old, new : Point
    change : (n_scores,) array
        The step at the old point, which led to the new one without being cut.

    Returns
    -------
    Bend or None
    """
    if old.held != new.held or new.is_far:
        return None
    rows = [
        row_of(after, before.poles)
        for before, after in zip(old.triangles.bank.inners, new.triangles.bank.inners, strict=True)
    ]
    if any(row is None for row in rows):
        return None
    n = new.problem.n_poles
    back = np.concatenate([row for row in rows if row is not None])
    direction = np.concatenate([-back, change[n:]])
    across = new.along(direction)
    length = float(across @ across)
    if not length > 0:
        return None
    excess = (new.slope(direction) - old.slope(change)) / (2.0 * length) - 1.0
    if not np.isfinite(excess):
        return None
    return Bend(direction, float(np.clip(excess, LEAST_BEND, MOST_BEND)))
