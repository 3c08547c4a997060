"""What is asked of a plant that is not stable, as its predictor is told.

Equalities (fixed coefficients, static gains) leave directions ``N``, so that Step 4 goes along
``theta_0 + N z``: its instruments are those of ``z``, and its covariance is ``N cov_z N'``. It
begins at the free root, moved onto the equalities by the least in its standard errors. A bound that
the root exceeds becomes an equality, and what is at its bound counts as fixed, as of a stable plant
(`knowledge`).

The outputs of the first samples answer to inputs from before the record, where these act late: they
do not count, so that a free start makes up for all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tridentify.estimation.closed_loop.predictor import Plant
from tridentify.estimation.closed_loop.unstable import Found
from tridentify.estimation.knowledge.affine import Knowledge, known_of
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record
from tridentify.structure import Structure

WHOLE = 1e-6
"""Samples by which a delay may miss a whole number: rounding of two times in seconds."""


@dataclass(frozen=True, eq=False)
class Sought:
    """One output, one denominator.

    Attributes
    ----------
    structure : Structure
    poles : int
    zeros : tuple of int
        Of every input.
    late : tuple of float
        Samples after which each input acts; empty for at once.
    drift : bool
    names : tuple of tuples of str
        Of inputs and outputs.
    """

    structure: Structure
    poles: int
    zeros: tuple[int, ...]
    late: tuple[float, ...]
    drift: bool
    names: tuple[tuple[str, ...], tuple[str, ...]]

    @classmethod
    def of(cls, records: Sequence[Record], structure: Structure) -> Sought | None:
        """By a structure; None for what the predictor cannot be told."""
        first = records[0]
        if (
            first.n_outputs != 1
            or not structure.shared
            or structure.priors
            or structure.delay == "free"
            or any(record.dt is None for record in records)
        ):
            return None
        zeros = structure.zeros_matrix(1, first.n_inputs)[0]
        seconds = np.asarray(structure.delay_matrix(1, first.n_inputs), dtype=float)[0]
        samples = seconds / float(first.dt or 1.0)
        whole = np.abs(samples - np.round(samples)) < WHOLE
        samples = np.where(whole, np.round(samples), samples)
        return cls(
            structure,
            structure.common_poles,
            tuple(int(m) for m in zeros),
            tuple(samples.tolist()) if samples.any() else (),
            structure.drift is True,
            (first.input_names, first.output_names),
        )

    @property
    def in_words(self) -> tuple[str, ...]:
        """What is known, as it is told."""
        known = self.structure.known
        return (f"constraints on {', '.join(dict.fromkeys(known))}",) if known else ()

    def known(
        self, scale: Array | None = None, at_bounds: dict[str, float] | None = None
    ) -> Knowledge:
        """Equalities and bounds, some of the latter reached."""
        structure = self.structure
        if at_bounds:
            bounds = {k: v for k, v in (structure.bounds or {}).items() if k not in at_bounds}
            fixed = {**(structure.fixed or {}), **at_bounds}
            structure = replace(structure, bounds=bounds, fixed=fixed)
        return known_of(structure, *self.names, scale, stable=False)

    def within(self, plant: Plant, cov: Array | None, known: Knowledge) -> Plant:
        """The nearest plant that meets the equalities, in standard errors or natural sizes."""
        if known.n_free == known.origin.size:
            return replace(plant, along=None)
        sizes = plant.scale if cov is None else np.sqrt(np.diag(cov)) + 1e-12 * plant.scale
        weight = np.diag(1.0 / sizes)
        if cov is not None:
            values, turned = np.linalg.eigh(weight @ cov @ weight)
            root = turned / np.sqrt(np.maximum(values, 1e-12 * values[-1]))
            weight = root.T @ weight
        z = np.linalg.lstsq(
            weight @ known.directions, weight @ (plant.theta - known.origin), rcond=1e-13
        )[0]
        there = plant.with_theta(known.origin + known.directions @ z)
        return replace(there, along=known.directions)

    def exceeded(self, found: Found) -> dict[str, float]:
        """The bound that a root exceeds by most standard errors; empty where it meets them all."""
        known = self.known(found.plant.scale)
        theta = found.plant.theta
        errors = np.sqrt(np.diag(found.cov)) + 1e-12 * found.plant.scale
        below, above = (known.low - theta) / errors, (theta - known.high) / errors
        k = int(np.argmax(np.maximum(below, above)))
        if max(below[k], above[k]) <= 0.0:
            return {}
        return {known.names[k]: float(known.low[k] if below[k] > above[k] else known.high[k])}
