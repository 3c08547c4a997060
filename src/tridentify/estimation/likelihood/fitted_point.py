"""The best fit at one denominator: what it leaves, and its outputs and their derivatives over time.

`likelihood.cost` derives what the fit is of, and takes steps from here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from tridentify.estimation.likelihood.linear_fit import Linear, OutputFit
from tridentify.estimation.likelihood.setup.linear_columns import free_states, linear_blocks
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.estimation.likelihood.setup.triangles import Triangles
from tridentify.models.regression import LONG, Regression, response_of
from tridentify.models.response import Branch, ColumnBlocks, FilteredResponse, Response
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.information import aicc_price
from tridentify.numerics.kept import cached_property
from tridentify.numerics.least_squares import Solution
from tridentify.numerics.realization import Cascade, filter_map
from tridentify.numerics.whiteness import is_white

FLOOR = 1e-30
"""Share of the output's power added to a residual's: (1e-15)^2, its rounding. The logarithm of a
residual of nothing is a number then."""
ROUNDING_SQUARED = 1e-22
"""Residual power over the output's below which it is rounding: 1e-11 of its size, some 1e5 times
the rounding of one sample, as filters and solves add theirs."""
TESTED = 200_000
"""Samples of a residual on which whiteness is tested: correlations of 0.005 are seen with so
many."""
LEAST_VARIANCE = 1e-300
"""A residual of nothing counts as this: its logarithm is a number."""


@dataclass(frozen=True, eq=False)
class FittedPoint:
    """A denominator and the best fit there: what it leaves, and what it makes of the outputs.

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

    def answering(self, response: Response) -> Self:
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

    @cached_property
    def samples(self) -> float:
        """Those of all outputs."""
        return float(self.counts.sum())

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

    def aicc_after(self, decrease: float) -> float:
        """AICc after an expected fall of ``-2 log L``; residuals below rounding count as equal."""
        n = self.samples
        share, likelihood = math.exp(-decrease / n), 0.0
        for rss, count, size in self._by_output:
            variance = share * rss / count + ROUNDING_SQUARED * size
            likelihood += count * (math.log(variance) if variance else -math.inf)
        k = self.problem.n_coefficients + self.problem.n_nuisance + self.problem.n_outputs
        return likelihood + aicc_price(float(k), n)

    @cached_property
    def aicc(self) -> float:
        """``sum_i N_i log(RSS_i / N_i) + 2 k + 2 k (k + 1) / (N - k - 1)``."""
        return self.aicc_after(0.0)

    @cached_property
    def exact(self) -> tuple[bool, ...]:
        """Of each output, whether the residual is no more than rounding."""
        return tuple(rss < ROUNDING_SQUARED * size * n for rss, n, size in self._by_output)

    @cached_property
    def _by_output(self) -> list[tuple[float, float, float]]:
        """Residual sum of squares, samples, and mean square of every output: few, one by one."""
        columns = self.rss.tolist(), self.counts.tolist(), self.problem.size.tolist()
        return list(zip(*columns, strict=True))

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

    def residuals(self, most: int | None = None) -> tuple[Array, ...]:
        """Recorded minus fitted outputs over time, (n_samples, n_outputs) per experiment.

        Not whitened; ``nan`` where a sample is missing.
        """
        longest = max(e.n_samples for e in self.problem.experiments)
        short = longest <= LONG and (most is None or most >= longest)
        return self._every_residual if short else self._left(most)

    def standardised(self, most: int | None = None) -> tuple[Array, ...]:
        """Residuals over the noise of each experiment, where these have levels of their own."""
        pairs = zip(self.problem.experiments, self.residuals(most), strict=True)
        return tuple(experiment.standardised(one) for experiment, one in pairs)

    def _left(self, most: int | None) -> tuple[Array, ...]:
        pairs = zip(self.problem.experiments, self.outputs(most), strict=True)
        return tuple(experiment.y[:most] - fitted for experiment, fitted in pairs)

    @cached_property
    def white(self) -> tuple[bool, ...]:
        """Of each output, whether its residual passes for white noise."""
        residuals = self.standardised(TESTED)
        return tuple(is_white([one[:, i] for one in residuals]) for i in range(self.counts.size))

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
            bank, rows = self.bank, self._kept(self._moves[1][e].T).T
            if experiment.n_samples > LONG and len(self.branches) == 1:
                # the outputs use the poles once
                layout, bank = self.triangles.kept, self.branches[0].inner
                again = [k for k in range(layout.states) if k % layout.order >= bank.order]
                rows = np.delete(rows, again, axis=1)
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
        found = []
        for e, experiment in enumerate(self.problem.experiments):
            rows = self._kept(self._moves[0][e, output]) @ combinations
            owners = [output] * rows.shape[1]
            signals = response_of(experiment, self.bank, rows.T, outputs=owners)
            lost = np.isnan(experiment.y[:, [output]])
            found.append(np.where(lost, np.nan, signals) if lost.any() else signals)
        return tuple(found)

    @cached_property
    def _moves(self) -> tuple[Array, Array]:
        """How each unknown of `jacobian` moves the outputs, and these, as columns make them."""
        from tridentify.estimation.likelihood.compiled.cost import moves_at

        triangles, linear, bank = self.triangles, self.linear, self.triangles.bank
        a, b, _ = bank.cascade
        return moves_at(
            triangles.layout.n_signals,
            int(triangles.layout.free),
            triangles.free,
            triangles.nuisance,
            *self.problem.pattern,
            bank.repeats,
            bank.basis,
            a,
            b,
            bank.maps,
            np.ascontiguousarray(linear.rows),
            np.ascontiguousarray(linear.direct),
            np.ascontiguousarray(linear.started),
            linear.solutions,
            self.problem.n_delays,
        )

    def _kept(self, rows: Array) -> Array:
        """Of the columns of a triangle, those that count."""
        columns = self.triangles.columns
        return rows if columns.size == len(rows) else rows[columns]

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

    def jacobian(self) -> tuple[Array, Array]:
        """Derivatives of all outputs by alpha, free delays, b and every nuisance term.

        Returns
        -------
        matrix : (rows, n_unknowns) array
            Which unknown stands where says `width`.
        output : (rows,) int array
            The output that a row belongs to.
        """
        return self._jacobian

    @cached_property
    def _jacobian(self) -> tuple[Array, Array]:
        rows, owner = [], []
        for i in range(self.problem.n_outputs):
            for e in range(len(self.problem.experiments)):
                rows.append(self.changes(e, i))
                owner.append(np.full(len(rows[-1]), i))
        return np.concatenate(rows), np.concatenate(owner)

    def changes(self, experiment: int, output: int) -> Array:
        """The rows of `jacobian` that belong to one output of one experiment."""
        triangles = self.triangles
        rows = triangles.stack[triangles.which[experiment, output]]
        if len(triangles.stack) > 1:  # one is shorter than another
            rows = rows[: triangles.whole[experiment].targets[output].size]
        return np.asarray(rows @ self._moves[0][experiment, output])
