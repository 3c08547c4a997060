"""The output-error cost at one denominator, with everything that can be said about it there.

For a denominator ``a`` the output ``y_0 = sum (b / a) u + (c_0 / a) delta + offset + drift`` is
linear in all else, so ``b`` and the nuisance terms are eliminated by least squares (variable
projection; Golub & Pereyra 1973). With the orthonormal functions ``X`` on the poles of ``a``,
moving ``a -> a (1 + alpha X)`` changes the output by ``- X y_0`` per unit of ``alpha``.
Projecting these scores off the columns of ``b`` and the nuisance terms gives the Jacobian of
the reduced cost (Kaufman 1975), whose Gauss-Newton step is that of the full problem.

Where channels have denominators of their own, ``y_0 = sum_g y_g`` with the part ``y_g`` of the
channels (and of the free response) of denominator ``g``. Each has scores of its own, ``- X_g y_g``,
and its own branch of the bank; all else is as with one.

A delay ``tau_j`` of an input that is estimated along has the score ``dy_0 / dtau_j = - dy_j / dt``
with ``y_j`` what that input makes of the output. With ``x' = A x + B u_j`` and ``y_j = C x`` this
is ``- C A x - C B u_j``, a combination of columns that are there: one more column of the Jacobian.
Where the input jumps and ``C B`` is not zero the derivative jumps too: the cost has a kink where a
jump meets a sample, for a held input at every whole number of steps.

The bank holds the poles of ``a`` several times over: twice is enough for ``y_0`` and all its
scores, since both are polynomials of degree below ``2 n`` over ``a^2``; a third time lets Step
2 filter the parallel model's output once more.

Several outputs are weighted by their own noise levels: for independent Gaussian noise of
unknown variance the concentrated likelihood is ``sum_i N_i log RSS_i``, whose gradient is that
of ``sum_i (N_i / RSS_i) RSS_i`` with the weights held. Where the noise has a model, the samples
are those of its innovations (`regression`), and so are ``RSS`` and everything made of it.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tridentify.estimation.likelihood.charted import fitted
from tridentify.estimation.likelihood.fitted_point import FittedPoint
from tridentify.estimation.likelihood.held_poles import at_slow_limit, conditions, left_by
from tridentify.estimation.likelihood.linear_fit import Linear
from tridentify.estimation.likelihood.setup.bank import Bank
from tridentify.estimation.likelihood.setup.problem import LEAST_DAMPED, TOO_SLOW, Problem, Variant
from tridentify.estimation.likelihood.setup.triangles import Triangles
from tridentify.estimation.likelihood.step import (
    Bend,
    Decomposition,
    Proposal,
    decomposition_of,
)
from tridentify.models.regression import Regression, regress
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.kept import cached_property, varied
from tridentify.numerics.realization import roots_of

FAR = 0.1
"""Fall of ``-2 log L`` a sample that a step promises, above which the quadratic it rests on is not
that of the end: 5 % of the residual. What is poor now may lead elsewhere, so no pole is held."""


CARRIED = frozenset(
    {
        *("variance", "objective", "weights", "seen", "_decomposition", "_undamped"),
        *("aicc", "exact", "samples", "_by_output"),
    }
)
"""What `Point.carried_to` need not work out again."""


class Point(FittedPoint):
    """A fit with the slopes of its cost, and the steps that they ask for."""

    @cached_property
    def seen(self) -> tuple[Array, Array, Decomposition]:
        """Scores, residual and decomposition, with nothing held."""
        from tridentify.estimation.likelihood.compiled.cost import scores_at

        triangles, linear, pattern = self.triangles, self.linear, self.problem.pattern
        bank = triangles.bank
        scores, residual, s, vt, scale, projection, total = scores_at(
            triangles.stack,
            triangles.which,
            int(triangles.layout.free),
            triangles.free,
            pattern.orders,
            pattern.firsts,
            pattern.group,
            bank.repeats,
            bank.cascade.a,
            bank.cascade.b,
            bank.maps,
            linear.rows,
            linear.direct,
            linear.started,
            linear.bases,
            linear.ranks,
            linear.residuals,
            self.weights,
            self.problem.n_delays,
        )
        found = Decomposition(None, s, vt, scale, projection, total, "")
        return scores, residual, found

    def carried_to(self, problem: Problem) -> Point:
        """The same place in a problem of the same samples, orders and nuisance terms."""
        if problem is self.problem:
            return self
        return varied(self, CARRIED, problem=problem)

    @property
    def _scores(self) -> tuple[Array, Array]:
        """Minus the derivatives by ``alpha`` and the delays, projected, and the residual."""
        return self.seen[:2]

    @cached_property
    def _decomposition(self) -> Decomposition:
        """Of all scores, but along nothing that a limit forbids.

        Delays that lie at an end of their range and pull outward stay there, and so do poles at a
        slow limit (`held_poles`).
        """
        scores, residual, found = self.seen
        n = scores.shape[1]
        slowest = self.problem.slowest
        # a pole is not slow where its decay is above both of the limits
        near = any(
            -z.real <= 1.001 * max(slowest, LEAST_DAMPED * abs(z)) for z in self.poles.tolist()
        )
        is_slow = near and at_slow_limit(self.poles, slowest).any()
        if self.problem.limits is None and not is_slow:
            return found
        rows: Array = np.zeros((0, n))
        if self._promised(found, 0.0) < FAR * self.samples:
            rows = conditions(self.branches, self.problem.slowest, n)
        kept, pulled = np.arange(n), np.zeros(len(rows), dtype=bool)
        while True:
            change = found.step(0.0)
            outward = self._outward(change[self.problem.n_poles :]) + self.problem.n_poles
            new = ~pulled & (rows @ change > 0.0)
            if not (new.any() or np.isin(outward, kept).any()):
                return found
            kept, pulled = np.setdiff1d(kept, outward), pulled | new
            basis = left_by(rows[pulled], kept)
            if basis.shape[1] == 0:
                return found
            found = decomposition_of(scores, residual, basis, TOO_SLOW if pulled.any() else "")

    @property
    def held(self) -> str:
        """What is to be said of poles that a step would have to leave at a limit; "" without."""
        return self._decomposition.held

    def _outward(self, change: Array) -> NDArray[np.intp]:
        """Delays that are pinned, or that a change would take beyond an end of their range."""
        if self.problem.limits is None:
            return np.arange(0)
        if self.problem.pinned is not None:
            change = np.where(self.problem.pinned, np.inf, change)
        delays = self.problem.delays
        floors = 0.0 if self.problem.floors is None else self.problem.floors
        low = (delays <= floors) & (change < 0)
        high = (delays >= self.problem.limits) & (change > 0)
        return np.flatnonzero(low | high | np.isinf(change))

    @property
    def delay_slopes(self) -> Array:
        """(n_delays,) derivatives of `objective`, all else eliminated or at its best [1/s]."""
        scores, residual = self._scores
        return np.asarray(2.0 * residual @ scores[:, self.problem.n_poles :])

    @cached_property
    def gradient(self) -> float:
        """The residual's share along the scores: 0 at a stationary point, at most 1."""
        found = self._decomposition
        s = found.s.tolist()
        pairs = zip(found.projection.tolist(), s, strict=True)
        kept = math.fsum(part * part for part, size in pairs if size > 1e-13 * s[0])
        return math.sqrt(kept) / found.total if found.total else 0.0

    def along(self, change: Array) -> Array:
        """(rows,) minus what a step changes of the outputs, to first order."""
        return np.asarray(self._scores[0] @ change)

    def slope(self, change: Array) -> float:
        """Derivative of `objective` along a step, all else eliminated."""
        return float(2.0 * self._scores[1] @ self.along(change))

    def step(self, damping: float, bend: Bend | None = None) -> Proposal:
        """A Levenberg-Marquardt step.

        Parameters
        ----------
        damping : float
            Relative to the squared length of each score.
        bend : Bend, optional
            What the step before has told of the curvature.

        Returns
        -------
        Proposal
        """
        change, decrease = self._decomposition.step(damping), self.decrease(damping)
        if bend is not None:
            change, decrease = self._bent(change, bend)
        alpha = change[: self.problem.n_poles]
        own = zip(self.triangles.bank.inners, self.problem.groups, strict=True)
        found = [roots_of(inner, alpha[group.poles]) for inner, group in own]
        roots = found[0] if len(found) == 1 else np.concatenate(found)
        # close to the end a real pole that a step takes across the axis is left at the limit;
        # before, it is mirrored, and may find another place
        if any(z.imag == 0 and z.real > 0 for z in roots.tolist()) and not self.is_far:
            crossed = (roots.imag == 0) & (roots.real > 0)
            roots = np.where(crossed, -0.5 * self.problem.slowest, roots)
        delays = None
        if self.problem.limits is not None:
            moved = self.problem.delays + change[self.problem.n_poles :]
            floors = 0.0 if self.problem.floors is None else self.problem.floors
            delays = np.clip(moved, floors, self.problem.limits)
        return Proposal(roots, decrease, delays, change)

    def _bent(self, change: Array, bend: Bend) -> tuple[Array, float]:
        """A step less what the bend takes of its part along it, and what it promises then."""
        across = self.along(bend.direction)
        length = float(across @ across)
        part = float(self.along(change) @ across) / length
        change = change - bend.excess / (1.0 + bend.excess) * part * bend.direction
        moved, total = self.along(change), self._decomposition.total
        bent = bend.excess * float(moved @ across) ** 2 / length
        share = -(2.0 * float(self._scores[1] @ moved) + float(moved @ moved) + bent)
        return change, self._fall(share / total**2 if total else 0.0)

    def _fall(self, fraction: float) -> float:
        """Fall of `objective` where the residual's square falls by a fraction of itself."""
        return -self.samples * float(np.log1p(-min(fraction, 1.0 - 1e-15)))

    def decrease(self, damping: float = 0.0) -> float:
        """The fall of `objective` that a step promises, for less than the step itself costs."""
        return self._promised(self._decomposition, damping) if damping else self._undamped

    @cached_property
    def _undamped(self) -> float:
        return self._promised(self._decomposition, 0.0)

    @property
    def is_far(self) -> bool:
        """Whether a step promises so much that the end cannot be seen from here."""
        return self.decrease() > FAR * self.samples

    def _promised(self, found: Decomposition, damping: float) -> float:
        # one by one: they are few
        shrink, share = (found.s * found.gain(damping)).tolist(), 0.0
        for part, s in zip(found.projection.tolist(), shrink, strict=True):
            share += part * part * s * (2.0 - s)
        return self._fall(share / found.total**2 if found.total else 0.0)

    @property
    def looseness(self) -> float:
        """The largest standard error of a pole over the pole's own decay rate.

        With ``X = N(p) / a(p)`` the root ``z`` of ``a (1 + alpha X)`` moves by ``- alpha N(z) /
        a'(z)``. Poles that nearly meet are loose, and those that only follow the noise.
        """
        found = self._decomposition
        if not found.s[-1] > 0:
            return float("inf")
        from tridentify.estimation.likelihood.compiled.cost import loosest

        root = found.vt.T / found.s / found.scale[:, None]
        root = root if found.basis is None else found.basis @ root
        orders, firsts, _, _ = self.problem.pattern
        poles = self.triangles.bank.poles
        return loosest(poles, orders, firsts, np.ascontiguousarray(root[: poles.size]))


def bank_of(problem: Problem, poles: Complex, repeats: int) -> Bank:
    """The poles repeated, a branch for each denominator.

    Parameters
    ----------
    problem : Problem
    poles : (n,) complex array
        Admissible poles.
    repeats : int
    """
    return Bank.of(problem.pattern, poles, repeats)


def evaluate(
    problem: Problem,
    poles: Complex,
    repeats: int = 2,
    regressions: tuple[Regression, ...] | None = None,
    delays: Array | None = None,
    pinned: NDArray[np.bool_] | None = None,
) -> Point:
    """Filter the records on the poles (repeated) and fit all that is linear.

    Parameters
    ----------
    problem : Problem
    poles : (n,) complex array
        Admissible poles.
    repeats : int
        2 for the cost and its derivatives, 3 when Step 2 follows.
    regressions : tuple of Regression, optional
        The triangles, where they are known already.
    delays : (n_inputs,) array, optional
        Of the inputs [s], in place of the problem's.
    pinned : (n_inputs,) bool array, optional
        Delays that are to stay there.

    Returns
    -------
    Point
    """
    if delays is not None:
        problem = replace(problem.delayed(delays), pinned=pinned)
    elif regressions is None:
        found = fitted(problem, None, poles, repeats)
        if found is not None:
            return Point(problem, found[0].bank.poles, *found)
    bank = bank_of(problem, poles, repeats)
    if regressions is None:
        regressions = tuple(regress(e, bank.cascade) for e in problem.experiments)
    return point_at(problem, Triangles.of(regressions, bank))


def evaluate_variant(
    base: Problem,
    variant: Variant,
    poles: Complex,
    repeats: int = 2,
    delays: Array | None = None,
) -> Point:
    """As `evaluate`, for a choice of nuisance terms of a problem that has more of them."""
    if delays is not None:
        base = base.delayed(delays)
    else:
        found = fitted(base, variant, poles, repeats)
        if found is not None:
            return Point(variant.problem(base), found[0].bank.poles, *found)
    bank = bank_of(base, poles, repeats)
    whole = tuple(regress(e, bank.cascade) for e in base.experiments)
    return point_at(variant.problem(base), Triangles.of(whole, bank, variant))


def point_at(problem: Problem, triangles: Triangles) -> Point:
    """The best fit of all that is linear, where the triangles were made."""
    from tridentify.estimation.likelihood.compiled.cost import fit_outputs

    bank = triangles.bank
    found = fit_outputs(
        triangles.stack,
        triangles.which,
        triangles.targets,
        int(triangles.layout.free),
        triangles.free,
        triangles.nuisance,
        *problem.pattern,
        bank.repeats,
        bank.basis,
    )
    return Point(problem, bank.poles, triangles, Linear(*found))
