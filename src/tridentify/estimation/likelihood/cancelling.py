"""Whether a pole and a zero cancel where the steps on the cost ended.

Then one pole and one zero less explain the record as well. Such a pair can be anywhere in the band:
further starts find it elsewhere, the posterior everywhere, and neither determines it.
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
    "a pole and a zero cancel within their errors at the likelihood's maximum: it was looked for "
    "nowhere else, and the posterior was not weighed"
)


def cancels(point: Point, status: Status) -> bool:
    """Whether a pole and a zero of every channel cancel within their errors.

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
    found, den = [], np.append(1.0, theta[a])
    for b in places.values():
        own = np.r_[a, b]
        without_delay = np.pad(cov[np.ix_(own, own)], (0, 1))
        if np.trim_zeros(theta[b], "f").size < 2:
            return False
        found.append(covered(theta[b], den, without_delay))
    return in_all(found, True)
