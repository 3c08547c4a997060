"""Whether a zero is left open where the steps on the cost ended.

A pole that cancels it within their errors makes good for it, or the leading coefficient of the
numerator may be anything: one zero less, and perhaps one pole, explain the record as well. Such a
zero can be anywhere in the band: further starts find it elsewhere, the posterior everywhere, and
neither determines it.
"""

from __future__ import annotations

import numpy as np

from tridentify.errors import UnsupportedOrderError
from tridentify.estimation.answer.cancelling import covered, in_all
from tridentify.estimation.answer.trace import Status
from tridentify.estimation.likelihood.cost import Point
from tridentify.estimation.likelihood.curvature import Curvature
from tridentify.estimation.likelihood.levenberg_marquardt import coefficients

STAYED = (
    "at the likelihood's maximum a zero is not determined (a pole cancels it within their errors, "
    "or the numerator's leading coefficient may be anything): it was looked for nowhere else, and "
    "the posterior was not weighed"
)
HALF = 0.5
"""Standard error of the leading coefficient over its size from which it may be anything: an
interval of 95 % then holds zero and twice the value."""


def leaves_a_zero_open(point: Point, status: Status) -> bool:
    """Whether a zero of every channel is cancelled by a pole, or may as well be none.

    Parameters
    ----------
    point : Point
        With one denominator and known delays; of others nothing is said.
    status : Status
        How it was come by: at the sampling limit a pole may be brought back from there.
    """
    problem = point.problem
    apart = len(problem.groups) > 1 or problem.n_delays
    lean = min(m for row in problem.n_zeros for m in row) < 1
    if apart or lean or status is Status.AT_SAMPLING_LIMIT:
        return False
    curvature = Curvature.at(point)
    try:
        curvature.refuse_undetermined()
    except UnsupportedOrderError:
        return False
    theta, cov = coefficients(point), curvature.covariance
    (a,), places = problem.places()
    std = curvature.std
    if all(std[b.start] > HALF * abs(theta[b.start]) for b in places.values()):
        return True
    found, den = [], np.append(1.0, theta[a])
    for b in places.values():
        own = np.r_[a, b]
        without_delay = np.pad(cov[np.ix_(own, own)], (0, 1))
        if np.trim_zeros(theta[b], "f").size < 2:
            return False
        found.append(covered(theta[b], den, without_delay))
    return in_all(found, True)
