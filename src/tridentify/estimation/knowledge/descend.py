"""The constrained maximum: Levenberg-Marquardt steps within equalities, bounds and stability.

The cost is minus two log posterior, ``sum_i N_i log RSS_i(theta) + sum_j ((theta_j - mu_j) /
s_j)^2``, offsets, drifts and free responses eliminated. With ``theta -> theta + N z`` (`known`) a
step solves

    minimise |W (r - J N z)|^2 + |(mu - theta - N z) / s|^2 + damping |D z|^2
    subject to  low <= theta + N z <= high,

a convex problem whose solution is exact (`bounded`): the active bounds and their multipliers come
with it. The step without damping is the Gauss-Newton step of the constrained problem, so where it
promises no further fall, the first-order conditions of Karush, Kuhn and Tucker hold: the gradient
along the free directions is zero, and the multipliers of the active bounds are positive.

Poles stay in the open left half plane: a step that leaves it is shortened, as one that does not
lower the cost is. No step takes a coefficient ``a_k, ..., a_{n-1}`` below a tenth of what it was.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tridentify.estimation.answer.estimate import Status
from tridentify.estimation.knowledge.affine import Knowledge
from tridentify.estimation.knowledge.bounded import bounded_least_squares
from tridentify.estimation.knowledge.fixed_denominator import HeldFit, fit, place, poles_from
from tridentify.estimation.likelihood.fitted_point import ROUNDING_SQUARED
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import Patience
from tridentify.estimation.likelihood.setup.problem import LEAST_DAMPED, TOO_FAST, Problem
from tridentify.estimation.likelihood.thresholds import IDLE, NEARLY_SETTLED, SENSELESS
from tridentify.numerics.arrays import Array, Flags, Indices
from tridentify.numerics.least_squares import column_norms

SHRINK = 0.1
"""Share of a coefficient of the denominator that one step leaves at least, so that no step crosses
zero; any size is within reach, a decade a step."""
STUCK = 1e8
"""Damping, relative to the squared length of each column, from which a step is a hundred-millionth
of the undamped one and cannot help."""


@dataclass(frozen=True)
class Room:
    """Where the poles may be: in the open left half plane, and where the record can see them."""

    slowest: float
    fastest: float

    @classmethod
    def around(cls, problem: Problem, a: Array) -> Room:
        """As for other estimates, and wide enough for the poles of ``a``."""
        poles = poles_from(a)
        slowest, fastest = problem.slowest, problem.fastest
        if poles.size:
            slowest = min(slowest, 0.5 * float(np.min(-poles.real)))
            fastest = max(fastest, 2.0 * float(np.max(np.abs(poles))))
        return cls(slowest, fastest)

    def holds(self, a: Array) -> bool:
        """Whether all poles are inside."""
        if not np.all(np.isfinite(a)):
            return False
        return is_stable(a) and self._inside(a)

    def _inside(self, a: Array) -> bool:
        poles = poles_from(a)
        return bool(np.all(-poles.real >= self.slowest) and np.all(np.abs(poles) <= self.fastest))


def is_stable(a: Array) -> bool:
    """Whether the monic polynomial has all its roots in the open left half plane."""
    if np.any(a <= 0):
        return False
    poles = poles_from(a)
    return bool(np.all(-poles.real > 1e-3 * LEAST_DAMPED * np.abs(poles)))


@dataclass(frozen=True, eq=False)
class DescentStep:
    """A step: where to, what it promises, and the multipliers of the bounds.

    Attributes
    ----------
    theta : (p,) array
    fall : float
        Of the cost.
    multipliers : (p,) array
        Slope of the cost at an active bound, per unit of the coefficient: positive at a lower
        one, negative at an upper one, zero elsewhere.
    """

    theta: Array
    fall: float
    multipliers: Array


@dataclass(frozen=True, eq=False)
class ConstrainedEnd:
    """The end of the steps.

    Attributes
    ----------
    fit : HeldFit
    known : Knowledge
    status : Status
    why : str
    steps : tuple of (Fit, damping)
        Those taken.
    multipliers : (p,) array
        Of the active bounds, see `DescentStep`.
    gradient : float
        The residual's share along the free directions: zero at a stationary point, at most 1.
    """

    fit: HeldFit
    known: Knowledge
    status: Status
    why: str
    steps: tuple[tuple[HeldFit, float], ...]
    multipliers: Array
    gradient: float

    @property
    def cost(self) -> float:
        """Minus two log posterior, up to a constant."""
        return cost(self.fit, self.known)

    @property
    def active(self) -> Flags:
        """(p,) which coefficients lie at a bound that holds them there."""
        return np.asarray(self.multipliers != 0)


def cost(here: HeldFit, known: Knowledge) -> float:
    """Minus two log posterior, up to a constant."""
    return here.likelihood + known.penalty(here.theta)


def fit_at(problem: Problem, known: Knowledge, theta: Array) -> HeldFit:
    """The fit at given coefficients."""
    return fit(place(problem, theta[known.moving], known.integrators), theta)


def is_exact(here: HeldFit) -> bool:
    """Whether the residual is no more than rounding."""
    return bool(np.all(here.rss / here.counts < ROUNDING_SQUARED * here.problem.size))


def descend(problem: Problem, known: Knowledge, theta: Array, patience: Patience) -> ConstrainedEnd:
    """Steps to a stationary point of the constrained cost.

    Parameters
    ----------
    problem : Problem
    known : Knowledge
    theta : (p,) array
        Meets all constraints, and its poles are stable.
    patience : Patience
        How long they go on.
    """
    here = fit_at(problem, known, theta)
    room = Room.around(problem, theta[known.moving])
    most, settled = patience.most, patience.settled(here.counts.sum())
    steps: list[tuple[HeldFit, float]] = [(here, 0.0)]
    damping, growth, exact, idle, outside = 0.0, 2.0, 0, 0, False
    status, why = Status.MAX_PASSES, f"{most} steps on the constrained cost"
    for _ in range(most):
        promised = step(here, known, 0.0)
        left = promised.fall
        if left < settled:
            here = _polished(here, known, room, promised)
            status = Status.CONVERGED
            why = f"the next step would lower the cost by {left:.0e}, less than {settled:.0e}"
            break
        move = step(here, known, damping)
        inside = room.holds(move.theta[known.moving])
        trial = fit_at(problem, known, move.theta) if inside else None
        gain = -np.inf if trial is None else cost(here, known) - cost(trial, known)
        if trial is not None and is_exact(trial):
            exact += 1
            if gain < SENSELESS * here.counts.sum() or exact > 4:
                here = trial if gain > 0 else here
                status, why = Status.CONVERGED, "the residual is down to rounding"
                break
        if trial is None or gain <= 0:
            outside = outside or trial is None
            damping = max(damping * growth, 1e-3)
            growth *= 2.0
            if damping > STUCK:
                break
            continue
        steps.append((trial, damping))
        here, outside = trial, False
        damping *= max(1.0 / 3.0, 1.0 - (2.0 * min(gain / max(move.fall, 1e-300), 2.0) - 1.0) ** 3)
        damping = 0.0 if damping < 1e-6 else damping
        growth = 2.0
        idle = idle + 1 if gain < IDLE else 0
        if idle > 2:
            break
    last = step(here, known, 0.0)
    if status is not Status.CONVERGED:
        outside = outside or not room.holds(last.theta[known.moving])
        status, why = _verdict(problem, known, last, outside, status, why, damping, idle)
    multipliers = np.where(_at_bound(known, here.theta), last.multipliers, 0.0)
    gradient = gradient_share(here, known, multipliers != 0)
    return ConstrainedEnd(here, known, status, why, tuple(steps), multipliers, gradient)


def _polished(here: HeldFit, known: Knowledge, room: Room, last: DescentStep) -> HeldFit:
    """One step more, which Gauss-Newton steps make with many digits, unless it leads uphill."""
    if is_exact(here) or not room.holds(last.theta[known.moving]):
        return here
    trial = fit_at(here.problem, known, last.theta)
    return trial if cost(trial, known) <= cost(here, known) else here


def _verdict(
    problem: Problem,
    known: Knowledge,
    last: DescentStep,
    outside: bool,
    status: Status,
    why: str,
    damping: float,
    idle: int,
) -> tuple[Status, str]:
    """How steps that did not settle ended."""
    if last.fall < NEARLY_SETTLED:
        return Status.CONVERGED, f"a further step would lower the cost by {last.fall:.1e}"
    if (outside and idle > 2) or damping > STUCK:
        poles = poles_from(last.theta[known.moving])
        note = problem.admissible(poles)[1] if poles.size else ""
        if outside and note == TOO_FAST:
            return Status.AT_SAMPLING_LIMIT, note
        if outside:
            return Status.AT_STABILITY_LIMIT, "the cost falls towards a pole that is not stable"
        return Status.STALLED, "no further step lowers the cost"
    if idle > 2:
        return Status.STALLED, "no further step lowers the cost"
    return status, why


def step(here: HeldFit, known: Knowledge, damping: float) -> DescentStep:
    """The best step within the constraints.

    Parameters
    ----------
    here : HeldFit
        Meets the constraints.
    known : Knowledge
    damping : float
        Relative to the squared length of each column.
    """
    matrix, residual = here.weighted()
    return _solved(here.theta, matrix, residual, here, known, damping)


def project(here: HeldFit, known: Knowledge, start: Array) -> Array:
    """The best point on the constraints as seen from a fit that need not meet them.

    ``start`` meets them; the fit's linearisation is used for the way between the two.
    """
    matrix, residual = here.weighted()
    residual = residual + matrix @ (here.theta - start)
    return _solved(start, matrix, residual, here, known, 0.0).theta


def _solved(
    theta: Array, matrix: Array, residual: Array, here: HeldFit, known: Knowledge, damping: float
) -> DescentStep:
    directions = known.directions
    held, pull = known.prior_rows(directions, theta)
    data = matrix @ directions
    whole = np.vstack([data, held])
    target = np.concatenate([residual, pull])
    norms = np.sqrt(np.einsum("ij,ij->j", whole, whole))
    extra = np.diag(np.sqrt(damping) * norms)[: len(norms) if damping else 0]
    rows, least, owner = _inequalities(theta, known)
    answer = bounded_least_squares(
        np.vstack([whole, extra]), np.concatenate([target, np.zeros(extra.shape[0])]), rows, least
    )
    z = np.zeros(directions.shape[1]) if answer is None else answer.x
    multipliers = np.zeros(theta.size)
    new = theta + directions @ z
    if answer is not None:
        new, multipliers = _snapped(new, known, answer.multipliers, owner)
    return DescentStep(new, _fall(residual, data @ z, theta, new, here, known), multipliers)


def _fall(
    residual: Array, change: Array, old: Array, new: Array, here: HeldFit, known: Knowledge
) -> float:
    """What a step promises: of the concentrated likelihood, and of the prior."""
    total = float(residual @ residual)
    after = float(np.sum((residual - change) ** 2))
    n = float(here.counts.sum())
    ratio = max(after / total, 1e-15) if total else 1.0
    return -n * float(np.log(ratio)) + known.penalty(old) - known.penalty(new)


def _inequalities(theta: Array, known: Knowledge) -> tuple[Array, Array, Indices]:
    """Rows, least values and owners (+-(position + 1); 0: stability) for the next ``z``."""
    floor = np.full(theta.size, -np.inf)
    floor[known.moving] = SHRINK * theta[known.moving]
    own = known.low >= floor
    low = np.maximum(known.low, floor)
    rows, least, owner = [], [], []
    for k in np.flatnonzero(~known.determined):
        if np.isfinite(low[k]):
            rows.append(known.directions[k])
            least.append(min(low[k] - theta[k], 0.0))
            owner.append(k + 1 if own[k] else 0)
        if np.isfinite(known.high[k]):
            rows.append(-known.directions[k])
            least.append(min(theta[k] - known.high[k], 0.0))
            owner.append(-k - 1)
    matrix = np.array(rows).reshape(len(rows), known.n_free)
    return matrix, np.array(least), np.array(owner, dtype=np.int64)


def _snapped(
    theta: Array, known: Knowledge, multipliers: Array, owner: Indices
) -> tuple[Array, Array]:
    """Coefficients at active bounds set on them; multipliers per coefficient."""
    theta, slopes = theta.copy(), np.zeros(theta.size)
    for value, who in zip(multipliers, owner, strict=True):
        if value > 0 and who:
            k = abs(int(who)) - 1
            theta[k] = known.low[k] if who > 0 else known.high[k]
            slopes[k] = 2.0 * value * np.sign(who)
    return np.clip(theta, known.low, known.high), slopes


def _at_bound(known: Knowledge, theta: Array) -> Flags:
    return np.asarray((theta == known.low) | (theta == known.high))


def free_directions(known: Knowledge, active: Flags) -> Array:
    """(p, k) directions along equalities and active bounds, each of the size of a coefficient."""
    if not active.any():
        return known.directions
    rows = known.directions[active]
    sizes = np.linalg.norm(rows, axis=1)
    rows = rows[sizes > 0] / sizes[sizes > 0, None]
    if not rows.size:
        return known.directions
    _, s, vt = np.linalg.svd(rows)
    rank = int(np.sum(s > 1e-10 * s[0]))
    found = known.directions @ vt[rank:].T
    found[active] = 0.0
    return np.asarray(found)


def gradient_share(here: HeldFit, known: Knowledge, active: Flags) -> float:
    """Share of the weighted residual (and of the pull of the priors) along the free directions."""
    matrix, residual = here.weighted()
    free = free_directions(known, active)
    held, pull = known.prior_rows(free, here.theta)
    whole = np.vstack([matrix @ free, held])
    target = np.concatenate([residual, pull])
    total = float(np.linalg.norm(target))
    if not whole.shape[1] or not total:
        return 0.0
    u, s, _ = np.linalg.svd(whole / column_norms(whole), full_matrices=False)
    return float(np.linalg.norm(u[:, s > 1e-13 * s[0]].T @ target)) / total
