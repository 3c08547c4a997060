"""The fall of the likelihood on both sides of a root of the reference route."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.closed_loop.between_samples import Loop
from tridentify.estimation.closed_loop.fall import farther
from tridentify.estimation.methods.by_reference.passes import Rooted, model_like, residuals
from tridentify.estimation.methods.by_reference.returned_errors import weighted
from tridentify.models.simulate import simulate
from tridentify.numerics.arrays import Array, Indices

LONGEST = 5000
"""Samples beyond which it is not looked at: what is not told by so many is told as such."""


@dataclass(frozen=True, eq=False)
class _Place:
    """Weighted errors of the pair that the last pass fitted, at other coefficients.

    Attributes
    ----------
    loops : sequence of Loop
    estimate : Estimate
        At the root.
    left : sequence of (n_samples, n_outputs) arrays
        Residuals there.
    driven : sequence of (n_samples, n_outputs) arrays
        What the root's model makes of the driven inputs.
    free : (n,) int array
    theta : array
    """

    loops: Sequence[Loop]
    estimate: Estimate
    left: Sequence[Array]
    driven: Sequence[Array]
    free: Indices
    theta: Array

    @property
    def size(self) -> float:
        """Sum of squares."""
        return float(self.innovations @ self.innovations)

    @cached_property
    def _outputs(self) -> list[Array]:
        model = model_like(self.estimate, self.theta)
        return [simulate(model, loop.instrument) for loop in self.loops]

    @cached_property
    def innovations(self) -> Array:
        """Less what start and offset may add."""
        pairs = zip(self.left, self.driven, self._outputs, strict=True)
        return self._weighted([[left + at - now] for left, at, now in pairs])[:, 0]

    @cached_property
    def columns(self) -> Array:
        """By differences over a tenth of a standard error."""
        steps = 0.1 * self.estimate.std
        there = [
            replace(self, theta=self.theta + steps * (np.arange(self.theta.size) == j))._outputs
            for j in self.free
        ]
        tables = [
            [(other[e] - now) / steps[j] for j, other in zip(self.free, there, strict=True)]
            for e, now in enumerate(self._outputs)
        ]
        return self._weighted(tables)

    def moved(self, change: Array) -> _Place | None:
        """Elsewhere; None where the plant is not stable."""
        theta = self.theta.copy()
        theta[self.free] += change
        return replace(self, theta=theta) if model_like(self.estimate, theta).is_stable else None

    def _weighted(self, tables: Sequence[Sequence[Array]]) -> Array:
        at = replace(self.estimate, model=model_like(self.estimate, self.theta))
        return np.vstack(
            [
                weighted(loop, at, e, i, self.left[e], tables[e])
                for e, loop in enumerate(self.loops)
                for i in range(loop.record.n_outputs)
            ]
        )


def with_fall(found: Rooted) -> Rooted:
    """The root with a covariance that grows where its likelihood falls less (`closed_loop.fall`).

    Parameters
    ----------
    found : Rooted
    """
    estimate = found.estimate
    free = np.flatnonzero(estimate.std > 0)
    samples = sum(one.record.n_samples for one in found.loops)
    if not found.still or not free.size or samples > LONGEST:
        return found
    try:
        left = residuals(found.loops, estimate)
        driven = [simulate(estimate.model, one.instrument) for one in found.loops]
        here = _Place(found.loops, estimate, left, driven, free, estimate.theta)
        added = farther(here, estimate.cov[np.ix_(free, free)], free.size)
    except (TridentifyError, np.linalg.LinAlgError):
        return found
    cov = np.array(estimate.cov)
    cov[np.ix_(free, free)] += added
    return replace(found, estimate=replace(estimate, cov=cov))
