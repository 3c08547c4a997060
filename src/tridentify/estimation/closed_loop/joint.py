"""Plant and noise found together: the prediction error of a loop whose reference is not recorded.

The errors ``e`` of the mirrored predictor (`predictor`) with an autoregression behind it,

    w  =  A(q) e(theta),        e  =  (y - G u) a / c,                                         (1)

are the innovations of ``y = G u + (c / a) w / A``: that of a plant which is not stable and is
held by a controller (Forssell & Ljung 2000), and of a stable one output error in coloured noise.
White noise of a sensor is the case ``A = 1``: with feedback what is left of its past in ``y`` and
``u`` is a causal function of past ``e``, as the poles of the plant are zeros of the sensitivity.
Least squares of ``w`` over plant, noise and start *together* is therefore consistent whatever the
controller, if the input is held between the samples and (1) is rich enough.

*Errors.* With feedback the inputs hold past noise, so that ``theta`` and ``A`` share information.
Steps in turn creep, and errors of the one as if the other were known are too small; the steps here
are those of Gauss and Newton on all unknowns, and the covariance is the block of ``theta`` in the
inverse of their whole information. What else is nearly as likely is `settled`.

*What is known.* Equalities leave directions of the coefficients (`sought`), and the steps, the
information and the count of unknowns are those of these.

*Start.* Free, with an offset of the output and a level of every input: of a plant that integrates
no offset makes up for the input at which it rests.

References: L. Ljung, *System Identification*, 2nd ed., sections 9.3 and 13.4 (1999). U. Forssell &
L. Ljung, IEEE Transactions on Automatic Control 45 (2000) 137-141. D. Anderson, Journal of the ACM
12 (1965) 547-560. H. Walker & P. Ni, SIAM Journal on Numerical Analysis 49 (2011) 1715-1735.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tridentify.estimation.closed_loop.between_samples import Loop
from tridentify.estimation.closed_loop.linear_errors import Foreseen, slowest, stacked
from tridentify.estimation.closed_loop.predictor import (
    Plant,
    Predictor,
    recorded,
    slopes,
)
from tridentify.estimation.closed_loop.unstable import FLOOR, STILL
from tridentify.estimation.likelihood.setup.problem import FASTEST
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.autoregression import Whitener
from tridentify.numerics.extrapolation import extrapolated
from tridentify.numerics.information import aicc_price
from tridentify.numerics.innovation_slopes import innovations_by

MOST_STEPS = 40
HOLDS = 2
"""Times that the predictor is held to get around a kink."""
REMEMBERED = 4
"""Steps before that tell how the next one creeps."""
HALVINGS = 10
"""Of a step that does not lower the errors."""
FARTHEST = 0.999
"""Largest root of the noise's filter, which has to be one of stationary noise."""
NEARLY = 0.05
"""Standard errors that the last step may move by."""
TOLD_APART = 1e-6
"""Part of a start, offset or level that the others do not make, from which it counts: of a plant
that hardly integrates, level and offset do the same."""
CUTOFF = 1e-13
"""Of the information, below which a direction is told by rounding alone."""


@dataclass(frozen=True, eq=False)
class Ahead(Foreseen):
    """One record and a plant: its start is an initial state, an offset and levels of the inputs."""

    @classmethod
    def of(cls, loop: Loop, plant: Plant, edge: float, held: Complex | None) -> Ahead:
        """By a plant, with poles of the predictor that are its own or held."""
        signals = recorded(loop)
        predictor = Predictor(plant, signals.dt, edge, held=held)
        count = len(signals.u)
        rest = np.hstack([predictor.starts(count), predictor.levels(count)])
        seen = np.isfinite(loop.record.y[:, 0])
        return cls(loop, predictor, signals, predictor.errors(signals), rest, seen)

    def slopes(self, start: Array) -> Array:
        """(n_samples, n_free) minus the derivatives of ``e`` along the plant's, the start held."""
        plant = self.predictor.plant
        n = plant.a.size + 1
        there = replace(self.signals, u=self.signals.u + start[n:])
        return slopes(self.predictor, there, start[:n]) @ plant.free

    def white(self, table: Array, noise: Array) -> Array:
        """(n_samples, k) columns whitened by an autoregression; zero where nothing was seen."""
        rows = np.ascontiguousarray(np.where(self.seen, table.T, 0.0))
        found: Array = Whitener(noise, rows.shape[0]).apply(rows, self.seen).T
        return found


@dataclass(frozen=True, eq=False)
class Together:
    """Plant and noise at a place.

    Attributes
    ----------
    plant : Plant
    noise : (p,) array
    ahead : tuple of Ahead
        Per experiment.
    held : (n,) complex array, optional
        Poles of the predictor, where they do not follow the plant [rad/s].
    """

    plant: Plant
    noise: Array
    ahead: tuple[Ahead, ...]
    held: Complex | None = None

    @classmethod
    def at(
        cls, loops: Sequence[Loop], plant: Plant, noise: Array, held: Complex | None = None
    ) -> Together:
        """Of a plant and a noise."""
        edge = slowest(loops)
        with np.errstate(all="ignore"):
            ahead = tuple(Ahead.of(one, plant, edge, held) for one in loops)
        return cls(plant, noise, ahead, held)

    def holding(self) -> Together:
        """The same place, its predictor held from here on."""
        mirrored = Predictor(self.plant, 0.0, slowest(self.loops)).mirrored
        return Together.at(self.loops, self.plant, self.noise, mirrored)

    def following(self) -> Together:
        """The same place, its predictor that of the plant."""
        return Together.at(self.loops, self.plant, self.noise)

    @property
    def loops(self) -> list[Loop]:
        """Per experiment."""
        return [one.loop for one in self.ahead]

    def coloured(self, noise: Array) -> Together:
        """The same plant in other noise."""
        return replace(self, noise=noise)

    @property
    def count(self) -> int:
        """Samples that were seen."""
        return sum(int(one.seen.sum()) for one in self.ahead)

    @cached_property
    def _white(self) -> tuple[Array, Array]:
        tables = [
            one.white(np.column_stack([one.errors, one.rest]), self.noise) for one in self.ahead
        ]
        rest = stacked([one[:, :0] for one in tables], [one[:, 1:] for one in tables])
        return np.concatenate([one[:, 0] for one in tables]), rest

    @cached_property
    def _basis(self) -> tuple[Array, Array]:
        """Orthonormal columns of start, offset and levels, and what these are for each."""
        rest = self._white[1]
        size = np.linalg.norm(rest, axis=0) + 1e-300
        q, r = np.linalg.qr(rest / size)
        u, values, turned = np.linalg.svd(r)
        kept = values > TOLD_APART * values[0]
        return q @ u[:, kept], (turned[kept].T / values[kept]) / size[:, None]

    @property
    def start_basis(self) -> Array:
        """Orthonormal columns of what start, offset and levels make of ``w``."""
        return self._basis[0]

    @cached_property
    def start(self) -> list[Array]:
        """Initial state, offset and levels that suit best, per experiment."""
        basis, back = self._basis
        return np.split(back @ (basis.T @ self._white[0]), len(self.ahead))

    @cached_property
    def innovations(self) -> Array:
        """(n,) ``w`` beside them."""
        basis, errors = self._basis[0], self._white[0]
        return np.asarray(errors - basis @ (basis.T @ errors))

    @cached_property
    def size(self) -> float:
        """Their sum of squares; infinite where something ran away."""
        if not all(np.isfinite(one).all() for one in self._white):
            return np.inf
        found = float(self.innovations @ self.innovations)
        return found if np.isfinite(found) else np.inf

    @cached_property
    def errors(self) -> list[Array]:
        """(n_samples,) ``e`` beside them, per experiment; nan where nothing was seen."""
        return [
            np.where(one.seen, one.errors - one.rest @ start, np.nan)
            for one, start in zip(self.ahead, self.start, strict=True)
        ]

    @cached_property
    def columns(self) -> Array:
        """Minus the derivatives of ``w`` by plant and noise, beside those of the start."""
        tables = []
        for one, start, e in zip(self.ahead, self.start, self.errors, strict=True):
            own = one.white(one.slopes(start), self.noise)
            tables.append(np.hstack([own, -innovations_by(self.noise, np.nan_to_num(e), one.seen)]))
        basis, table = self._basis[0], np.vstack(tables)
        return np.asarray(table - basis @ (basis.T @ table))

    @cached_property
    def triangle(self) -> tuple[Array, Array]:
        """(k, k) that of the columns, and (k,) what of the innovations is along them."""
        both = np.column_stack([self.columns, self.innovations])
        whole: Array = np.asarray(np.linalg.qr(both, mode="r"))
        k = self.columns.shape[1]
        return whole[:k, :k], whole[:k, k]

    @property
    def n_free(self) -> int:
        """Directions in which the plant may move: the first unknowns."""
        return int(self.plant.free.shape[1])

    def at_plant(self, change: Array) -> Array:
        """(n_coefficients,) what a step on all unknowns does to the plant."""
        return np.asarray(self.plant.free @ change[: self.n_free])

    def of_plant(self, cov: Array) -> Array:
        """(n_coefficients, n_coefficients) covariance of the plant, by that of its directions."""
        free, n = self.plant.free, self.n_free
        return np.asarray(free @ cov[:n, :n] @ free.T)

    @property
    def counts(self) -> bool:
        """Whether the innovations tell every direction of the plant."""
        n = self.n_free
        if not np.isfinite(self.columns).all():
            return False
        own = self.triangle[0][:n, :n]
        sizes = np.linalg.norm(own, axis=0)
        if not np.all((sizes > 0.0) & np.isfinite(sizes)):
            return False
        values = np.linalg.svd(own / sizes, compute_uv=False)
        return bool(values[-1] > np.sqrt(CUTOFF) * values[0])

    @property
    def unknowns(self) -> int:
        """Coefficients of plant and noise, and what else was fitted."""
        return int(self.n_free + self.noise.size + self._basis[0].shape[1])

    @property
    def criterion(self) -> float:
        """AICc of the innovations."""
        count = float(self.count)
        return count * float(np.log(self.size / count + 1e-300)) + aicc_price(
            self.unknowns + 1.0, count
        )

    @cached_property
    def cov(self) -> Array:
        """(n_free + p, n_free + p) covariance of plant and noise."""
        r = self.triangle[0]
        scale = np.linalg.norm(r, axis=0) + 1e-300
        r = r / scale
        inverse = np.linalg.pinv(r.T @ r, rcond=CUTOFF, hermitian=True)
        variance = self.size / max(self.count - self.unknowns, 1)
        return np.asarray(variance * inverse / np.outer(scale, scale))

    @property
    def step(self) -> tuple[Array, float]:
        """That of Gauss and Newton, and by how much it moves the plant [standard errors]."""
        change: Array = np.asarray(np.linalg.lstsq(*self.triangle, rcond=1e-12)[0])
        errors = np.sqrt(np.diag(self.of_plant(self.cov))) + FLOOR * self.plant.scale
        return change, float(np.max(np.abs(self.at_plant(change)) / errors))

    def moved(self, change: Array) -> Together | None:
        """Along a step; None where noise or plant run out of bounds."""
        noise = self.noise + change[self.n_free :]
        if noise.size and np.max(np.abs(np.roots(np.append(1.0, noise)))) > FARTHEST:
            return None
        plant = self.plant.with_theta(self.plant.theta + self.at_plant(change))
        if is_too_fast(plant, self.loops):
            return None
        try:
            return Together.at(self.loops, plant, noise, self.held)
        except np.linalg.LinAlgError:  # a plant beyond all bounds
            return None


@dataclass(frozen=True)
class End:
    """Where steps ended.

    Attributes
    ----------
    place : Together
    step : (n,) array
        Of the plant, the last: one that is not short promised to lower the errors and did not.
    moved : float
        By it [standard errors].
    steps : int
    """

    place: Together
    step: Array
    moved: float
    steps: int

    @property
    def still(self) -> bool:
        """Whether it is a minimum."""
        return self.moved <= NEARLY


def descended(here: Together) -> End:
    """The minimum that the steps lead to.

    The mirrored predictor has a kink where a pole is as slow as the record, and steps end there.
    With the predictor held there is none, and the noise makes up for its poles.
    """
    end = _steps(here.following() if here.held is not None else here)
    for _ in range(HOLDS):
        if end.still or not np.isfinite(end.place.size):
            break
        try:
            held = end.place.holding()
            around = _steps(held)
            if around.place is held and not around.still and end.steps < MOST_STEPS:
                break  # no step leads on, held or not, and would not the next time
            again = _steps(around.place.following())
        except np.linalg.LinAlgError:
            break
        end = again if again.still or not around.still else around
    return end


def _steps(here: Together) -> End:
    moved, change = np.inf, np.zeros(here.n_free)
    past: list[tuple[Array, Array]] = []
    for steps in range(1, MOST_STEPS + 1):
        if not here.counts:
            return End(here, np.zeros(here.plant.theta.size), np.inf, steps)
        change, moved = here.step
        taken, other = change, None
        if past:
            taken, other = _lower(here, _mixed(here.triangle[0], change, past), 1)
        if other is None:
            taken, other = _lower(here, change, HALVINGS)
        if other is None:
            break
        past = [*past[1 - REMEMBERED :], (taken, change)]
        here = other
        if moved <= STILL:
            break
    return End(here, here.at_plant(change), moved, steps)


def _lower(here: Together, change: Array, times: int) -> tuple[Array, Together | None]:
    """What is taken of a step, halved so often, and where it does not raise the errors."""
    for _ in range(times):
        other = here.moved(change)
        if other is not None and other.size <= here.size:
            return change, other
        change = 0.5 * change
    return change, None


def _mixed(triangle: Array, change: Array, past: Sequence[tuple[Array, Array]]) -> Array:
    """The step of Gauss and Newton, with what the ones before tell of the curvature it lacks.

    Where the errors at the minimum are large beside what the model explains, these steps creep, by
    a constant factor each. What they would have to be changes from place to place as they did
    before (Anderson 1965; Walker & Ni 2011): the share of these changes is taken out that leaves
    the least of the step, as the errors see it.

    Parameters
    ----------
    triangle : (n_unknowns, n_unknowns) array
        By which the errors see a step.
    change : (n_unknowns,) array
        The step here.
    past : sequence of pairs of (n_unknowns,) arrays
        What was taken at the places before, the last one last, and the steps there.
    """
    moves = np.column_stack([taken for taken, _ in past])
    steps = np.column_stack([*(own for _, own in past), change])
    return extrapolated(moves, steps, triangle)


def is_too_fast(plant: Plant, loops: Sequence[Loop]) -> bool:
    """Whether a mode is over within a sample, so that no sample tells its rate.

    Parameters
    ----------
    plant : Plant
    loops : sequence of Loop
    """
    step = min(float(one.record.t[1] - one.record.t[0]) for one in loops)
    if not np.isfinite(plant.theta).all():
        return True
    with np.errstate(all="ignore"):
        return not bool(np.all(np.abs(plant.poles) * step < FASTEST))
