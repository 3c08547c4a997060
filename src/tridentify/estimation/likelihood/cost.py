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
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tridentify.estimation.likelihood.bank import Bank
from tridentify.estimation.likelihood.held_poles import at_slow_limit, conditions, left_by
from tridentify.estimation.likelihood.linear_columns import free_states, linear_blocks
from tridentify.estimation.likelihood.linear_fit import Linear, OutputFit
from tridentify.estimation.likelihood.problem import LEAST_DAMPED, TOO_SLOW, Problem, Variant
from tridentify.estimation.likelihood.step import (
    Bend,
    Decomposition,
    Proposal,
    decomposition_of,
)
from tridentify.estimation.likelihood.triangles import Triangles
from tridentify.models.regression import LONG, Regression, regress, response_of
from tridentify.models.response import Branch, ColumnBlocks, FilteredResponse, Response
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.kept import cached_property
from tridentify.numerics.least_squares import Solution
from tridentify.numerics.realization import Cascade, filter_map, roots_of

FLOOR = 1e-30
"""Share of the output's power added to a residual's: (1e-15)^2, its rounding. The logarithm of a
residual of nothing is a number then."""
LEAST_VARIANCE = 1e-300
"""A residual of nothing counts as this: its logarithm is a number."""
FAR = 0.1
"""Fall of ``-2 log L`` a sample that a step promises, above which the quadratic it rests on is not
that of the end: 5 % of the residual. What is poor now may lead elsewhere, so no pole is held."""


@dataclass(frozen=True, eq=False)
class Point:
    """A denominator and the best fit there.

    Attributes
    ----------
    problem : Problem
    poles : (n,) complex array
    triangles : Triangles
    linear : Linear
    """

    problem: Problem
    poles: Complex
    triangles: Triangles
    linear: Linear

    @property
    def bank(self) -> Cascade:
        """The poles repeated."""
        return self.triangles.bank.cascade

    @property
    def branches(self) -> tuple[Branch, ...]:
        """The part of the bank that belongs to each denominator."""
        return self.triangles.bank.branches

    @property
    def regressions(self) -> tuple[Regression, ...]:
        """The triangle of each experiment."""
        return self.triangles.regressions

    @cached_property
    def response(self) -> Response:
        """``y_0`` on ``bank``, without offset and drift."""
        return Response(self.linear.rows, self.linear.direct, self.linear.started)

    def answering(self, response: Response) -> Point:
        """The same place with outputs that were not fitted to the triangles."""
        own = self.linear._replace(
            rows=response.rows, direct=response.direct, started=response.free
        )
        return replace(self, linear=own)

    @cached_property
    def fits(self) -> tuple[OutputFit, ...]:
        """The fit of each output, with its columns by name."""
        found, linear = [], self.linear
        for i, n in enumerate(linear.sizes.tolist()):
            columns = ColumnBlocks()
            for e, regression in enumerate(self.regressions):
                blocks = linear_blocks(self.problem, self.branches, regression, e, i)
                columns.add(blocks, regression.targets[i])
            rows = self.triangles.unstacked
            solution = Solution(
                linear.solutions[i, :n],
                float(linear.costs[i]),
                float(linear.conditions[i]),
                rows(linear.bases[i, :, : linear.ranks[i]]),
            )
            matrix, residual = rows(linear.matrices[i, :, :n]), rows(linear.residuals[i])
            found.append(OutputFit(columns, matrix, solution, residual))
        return tuple(found)

    @property
    def condition(self) -> float:
        """Of the linear fits, the largest over the outputs."""
        return float(self.linear.conditions.max())

    @property
    def counts(self) -> Array:
        """(n_outputs,) samples used."""
        return self.triangles.counts

    @property
    def rss(self) -> Array:
        """(n_outputs,) residual sums of squares."""
        return self.linear.costs

    @cached_property
    def variance(self) -> Array:
        """(n_outputs,) residual mean squares, kept above rounding."""
        return self.rss / self.counts + FLOOR * self.problem.power

    @cached_property
    def objective(self) -> float:
        """Minus two log likelihood, up to a constant: ``sum_i N_i log variance_i``."""
        return float(self.counts @ np.log(np.maximum(self.variance, LEAST_VARIANCE)))

    @cached_property
    def weights(self) -> Array:
        """(n_outputs,) one over the residual standard deviations."""
        return np.asarray(1.0 / np.sqrt(np.maximum(self.variance, LEAST_VARIANCE)))

    @property
    def inner(self) -> Cascade:
        """The poles once, where all channels share them."""
        (inner,) = self.triangles.bank.inners
        return inner

    @cached_property
    def parts(self) -> tuple[Response, ...]:
        """What each denominator contributes, on the states of its branch."""
        return tuple(self.response.part(one.states, one.channels) for one in self.branches)

    @cached_property
    def score_states(self) -> FilteredResponse:
        """``X y_0`` on the bank: minus the derivatives of the outputs with respect to ``alpha``."""
        found = [
            part.filtered(one.bank, filter_map(one.inner, one.bank)).spread(
                one.states, self.bank.order
            )
            for one, part in zip(self.branches, self.parts, strict=True)
        ]
        return FilteredResponse.joined(found)

    def slopes(self, regression: Regression, output: int) -> Array:
        """(r, n_delays) time derivatives of what each input makes of an output."""
        found = [
            regression.input_signal(output, j, row @ self.bank.a, float(row @ self.bank.b))
            for j, row in enumerate(self.response.rows[output][: self.problem.n_delays])
        ]
        return np.stack(found, axis=1) if found else np.zeros((regression.targets[output].size, 0))

    @cached_property
    def seen(self) -> tuple[Array, Array, Decomposition]:
        """Scores, residual and decomposition, with nothing held."""
        from tridentify.estimation.likelihood.compiled_cost import scores_at

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
        if self._promised(found, 0.0) < FAR * float(self.counts.sum()):
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
        return -float(self.counts.sum()) * float(np.log1p(-min(fraction, 1.0 - 1e-15)))

    def decrease(self, damping: float = 0.0) -> float:
        """The fall of `objective` that a step promises, for less than the step itself costs."""
        return self._promised(self._decomposition, damping) if damping else self._undamped

    @cached_property
    def _undamped(self) -> float:
        return self._promised(self._decomposition, 0.0)

    @property
    def is_far(self) -> bool:
        """Whether a step promises so much that the end cannot be seen from here."""
        return self.decrease() > FAR * float(self.counts.sum())

    def _promised(self, found: Decomposition, damping: float) -> float:
        # one by one: they are few
        shrink, share = (found.s * found.gain(damping)).tolist(), 0.0
        for part, s in zip(found.projection.tolist(), shrink, strict=True):
            share += part * part * s * (2.0 - s)
        return self._fall(share / found.total**2 if found.total else 0.0)

    @property
    def looseness(self) -> float:
        """The largest standard error of a pole over the pole's own decay rate.

        With ``A r = z r``, ``l A = z l`` and ``l r = 1`` a change of ``alpha`` moves the pole ``z``
        by ``- (l B) (alpha r)``. Poles that nearly meet are loose, and those that only follow the
        noise.
        """
        found = self._decomposition
        if not found.s[-1] > 0:
            return float("inf")
        root = found.vt.T / found.s / found.scale[:, None]
        root = root if found.basis is None else found.basis @ root
        worst = 0.0
        for inner, group in zip(self.triangles.bank.inners, self.problem.groups, strict=True):
            z, right = np.linalg.eig(inner.a)
            try:
                drive = np.linalg.solve(right, inner.b.astype(np.complex128))
            except np.linalg.LinAlgError:
                return float("inf")
            moved = drive[:, None] * (right.T @ root[group.poles])
            errors = np.sqrt(np.sum(np.abs(moved) ** 2, axis=1))
            worst = max(worst, float(np.max(errors / np.abs(z.real))))
        return worst

    def residuals(self, most: int | None = None) -> tuple[Array, ...]:
        """Recorded minus fitted outputs over time, (n_samples, n_outputs) per experiment.

        Not whitened; ``nan`` where a sample is missing.
        """
        longest = max(e.n_samples for e in self.problem.experiments)
        short = longest <= LONG and (most is None or most >= longest)
        return self._every_residual if short else self._left(most)

    def _left(self, most: int | None) -> tuple[Array, ...]:
        pairs = zip(self.problem.experiments, self.outputs(most), strict=True)
        return tuple(experiment.y[:most] - fitted for experiment, fitted in pairs)

    @cached_property
    def _every_residual(self) -> tuple[Array, ...]:
        return self._left(None)

    def outputs(self, most: int | None = None) -> tuple[Array, ...]:
        """Fitted outputs over time, nuisance terms along, where samples are missing too.

        Parameters
        ----------
        most : int, optional
            Samples of each experiment; all where it is left out.

        Returns
        -------
        tuple of (n_samples, n_outputs) arrays
        """
        found = []
        for e, experiment in enumerate(self.problem.experiments):
            layout, bank = self.triangles.kept, self.bank
            if experiment.n_samples > LONG and len(self.branches) == 1:
                # the outputs use the poles once
                bank = self.branches[0].inner
                layout = replace(layout, order=bank.order)
            rows = np.zeros((self.problem.n_outputs, layout.n_signals))
            for i in range(len(self.linear.sizes)):
                for j in range(layout.n_inputs):
                    rows[i, layout.input_states(j)] = self.response.rows[i, j, : bank.order]
                    rows[i, layout.direct(j)] = self.response.direct[i, j]
                if layout.free:
                    rows[i, : layout.order] = self.response.free[e, i, : bank.order]
                rows[i, layout.nuisance] = self.terms(("nuisance", e, i), i)
            found.append(response_of(experiment, bank, rows, most))
        return tuple(found)

    def sensitivities(self, combinations: Array, output: int) -> tuple[Array, ...]:
        """Derivatives of one output over time, (n_samples, k) per experiment.

        Parameters
        ----------
        combinations : (n_unknowns, k) array
            Of the unknowns, in the order of `jacobian`.
        output : int
        """
        width, found = self.width, []
        for e, experiment in enumerate(self.problem.experiments):
            layout = self.triangles.kept
            n = layout.n_signals
            unit = Regression(
                layout,
                (np.eye(n),) * self.problem.n_outputs,
                (np.zeros(n),) * self.problem.n_outputs,
                (n,) * self.problem.n_outputs,
            )
            blocks: dict[object, Array] = {"a": -self.score_states.signals(unit, e, output)}
            if self.problem.n_delays:
                blocks["delay"] = -self.slopes(unit, output)
            linear = linear_blocks(self.problem, self.branches, unit, e, output)
            blocks |= {(output, key): block for key, block in linear.items()}
            rows = np.zeros((n, combinations.shape[1]))
            for key, block in blocks.items():
                rows += block @ combinations[width[key]]
            owners = [output] * rows.shape[1]
            signals = response_of(experiment, self.bank, rows.T, outputs=owners)
            found.append(np.where(np.isnan(experiment.y[:, [output]]), np.nan, signals))
        return tuple(found)

    @cached_property
    def width(self) -> dict[object, slice]:
        """Which unknown of `jacobian` stands where."""
        layout, sizes = self.triangles.kept, dict[object, int]()
        sizes["a"] = self.problem.n_poles
        if self.problem.n_delays:
            sizes["delay"] = self.problem.n_delays
        for i, row in enumerate(self.problem.n_zeros):
            sizes |= {(i, ("b", j)): m + 1 for j, m in enumerate(row)}
            started = free_states(self.branches, i).size
            for e in range(len(self.problem.experiments)):
                if layout.free:
                    sizes[i, ("free", e)] = started
                if layout.offset or layout.drift:
                    sizes[i, ("nuisance", e, i)] = layout.offset + layout.drift
        stops = np.cumsum(list(sizes.values())).tolist()
        pairs = zip(sizes.items(), stops, strict=True)
        return {key: slice(stop - size, stop) for (key, size), stop in pairs}

    def terms(self, key: object, output: int) -> Array:
        """What the linear fit of an output found of one block; empty where there is none."""
        first, place = self.width[output, ("b", 0)].start, self.width.get((output, key))
        own = slice(0) if place is None else slice(place.start - first, place.stop - first)
        return np.asarray(self.linear.solutions[output, own])

    def jacobian(self) -> tuple[ColumnBlocks, Array, Array]:
        """Derivatives of all outputs by alpha, free delays, b and every nuisance term.

        Returns
        -------
        columns : ColumnBlocks
            Which unknown stands where.
        matrix : (rows, n_unknowns) array
        output : (rows,) int array
            The output that a row belongs to.
        """
        return self._jacobian

    @cached_property
    def _jacobian(self) -> tuple[ColumnBlocks, Array, Array]:
        columns = ColumnBlocks()
        owner = []
        for i in range(self.problem.n_outputs):
            for e, regression in enumerate(self.regressions):
                blocks: dict[object, Array] = {"a": -self.score_states.signals(regression, e, i)}
                if self.problem.n_delays:
                    blocks["delay"] = -self.slopes(regression, i)
                linear = linear_blocks(self.problem, self.branches, regression, e, i)
                blocks |= {(i, key): block for key, block in linear.items()}
                columns.add(blocks, regression.targets[i])
                owner.append(np.full(regression.targets[i].size, i))
        return columns, columns.assemble()[0], np.concatenate(owner)


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
    bank = bank_of(base, poles, repeats)
    whole = tuple(regress(e, bank.cascade) for e in base.experiments)
    return point_at(variant.problem(base), Triangles.of(whole, bank, variant))


def point_at(problem: Problem, triangles: Triangles) -> Point:
    """The best fit of all that is linear, where the triangles were made."""
    from tridentify.estimation.likelihood.compiled_cost import fit_outputs

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
