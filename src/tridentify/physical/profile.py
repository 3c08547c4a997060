"""The output error of coefficients that are held: everything else is eliminated.

For coefficients ``theta`` the output is ``y = G(theta) u + N x + v``, with the columns ``N`` of the
free response, the offset and the drift of each experiment. ``x`` is eliminated by least squares, so
what is left, ``r(theta) = (I - Q Q') W (y - G u)``, is a function of ``theta`` alone whose sum of
squares is the likelihood's reduced cost (variable projection; Golub & Pereyra 1973). ``W`` turns
the samples into innovations where the noise has a model; it is that of the free estimate and held,
which costs nothing asymptotically (see `likelihood.noise.noise_model`).

Only `simulate` is asked for responses, so every model that can be simulated can be held.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.models.columns import drift_columns
from tridentify.models.simulate import distinct, free_responses, simulate
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import Whitener
from tridentify.numerics.least_squares import solve
from tridentify.physical.model import model_of
from tridentify.record.record import Record
from tridentify.transfer_function import TransferFunction


@dataclass(frozen=True, eq=False)
class HeldResidual:
    """What is left of the outputs at held coefficients.

    Attributes
    ----------
    residuals : tuple of (n_i,) arrays
        Innovations of each output, all experiments in a row, nuisance terms eliminated.
    raw : (n_outputs,) array
        Sums of squares of recorded minus fitted output, not whitened.
    """

    residuals: tuple[Array, ...]
    raw: Array

    @property
    def rss(self) -> Array:
        """(n_outputs,) sums of squares of the innovations."""
        return np.array([float(r @ r) for r in self.residuals])


@dataclass(frozen=True, eq=False)
class Profile:
    """Records seen with held coefficients.

    Attributes
    ----------
    records : tuple of Record
        Inputs count from the reference of the estimate.
    estimate : Estimate
        Which nuisance terms there are, and the model of the noise.
    """

    records: tuple[Record, ...]
    estimate: Estimate

    @classmethod
    def of(cls, records: Sequence[Record], estimate: Estimate) -> Profile:
        """The records as the estimate saw them."""
        shifted = []
        places = estimate.outliers[:, :3].astype(int)
        for e, (record, nuisance) in enumerate(zip(records, estimate.nuisance, strict=True)):
            moved = record.u - nuisance.input_reference
            # with delays the first samples are not explained
            early = record.t - record.t[0] < (1.0 - 1e-9) * nuisance.free_after
            y = np.where(early[:, None], np.nan, record.y)
            # what a robust loss holds for outliers does not count here either
            _, outputs, samples = places[places[:, 0] == e].T
            y[samples, outputs] = np.nan
            between = record.behaviour
            shifted.append(Record(moved, y, t=record.t, intersample=between, **record._loop))
        return cls(tuple(shifted), estimate)

    @property
    def counts(self) -> Array:
        """(n_outputs,) samples that are there."""
        found = [np.isfinite(r.y).sum(axis=0) for r in self.records]
        return np.asarray(np.sum(found, axis=0), dtype=np.float64)

    @property
    def spread(self) -> Array:
        """(n_outputs,) sums of squares of the outputs about the mean of each experiment."""
        found = [np.nansum((r.y - np.nanmean(r.y, axis=0)) ** 2, axis=0) for r in self.records]
        return np.asarray(np.sum(found, axis=0))

    @property
    def own_unknowns(self) -> int:
        """Nuisance terms of one output, over all experiments."""
        structure, model = self.estimate.structure, self.estimate.model
        free = sum(den.size - 1 for den in distinct(model.den[0]))
        each = free * (structure.initial_state == "free") + bool(structure.offset)
        return (each + structure.drift_degree) * len(self.records)

    def at(self, theta: Array) -> HeldResidual | None:
        """What is left at coefficients; None where the model's response is not finite.

        Parameters
        ----------
        theta : (n_coefficients,) array

        Returns
        -------
        HeldResidual or None
        """
        if not np.all(np.isfinite(theta)):
            return None
        first = self.records[0]
        structure = self.estimate.structure
        residuals: list[list[Array]] = [[] for _ in range(first.n_outputs)]
        raw = np.zeros(first.n_outputs)
        try:
            model = model_of(structure, theta, first.input_names, first.output_names)
            for record, nuisance in zip(self.records, self.estimate.nuisance, strict=True):
                after = nuisance.free_after
                modes: dict[bytes, Array] = {}
                with np.errstate(all="ignore"):
                    response = simulate(model, record)
                    for i in range(first.n_outputs):
                        left = record.y[:, i] - response[:, i]
                        columns = self._columns(model, record, i, after, modes)
                        one, square = _eliminated(left, columns, self.estimate.noise_model[i])
                        residuals[i].append(one)
                        raw[i] += square
        except (TridentifyError, np.linalg.LinAlgError, ValueError):
            return None
        joined = tuple(np.concatenate(parts) for parts in residuals)
        if not all(np.all(np.isfinite(r)) for r in joined):
            return None
        return HeldResidual(joined, raw)

    def _columns(
        self,
        model: TransferFunction,
        record: Record,
        output: int,
        after: float,
        modes: dict[bytes, Array],
    ) -> Array:
        """(n_samples, k) columns of the nuisance terms of one output; modes are kept for others."""
        structure, found = self.estimate.structure, []
        if structure.initial_state == "free":
            for den in distinct(model.den[output]):
                key = den.tobytes()
                if key not in modes:
                    modes[key] = free_responses(den, record, after)
                found.append(modes[key])
        if structure.offset is True:
            found.append(np.ones((record.n_samples, 1)))
        place = (record.t - record.t[0]) / record.duration
        found.append(drift_columns(place, structure.drift_degree).T)
        return np.hstack(found) if found else np.zeros((record.n_samples, 0))


def _eliminated(left: Array, columns: Array, noise: Array) -> tuple[Array, float]:
    """Innovations of what is left beside the columns, and its plain sum of squares."""
    seen = np.isfinite(left)
    table = np.column_stack([columns, np.where(seen, left, 0.0)])
    if noise.size:
        white = Whitener(noise, table.shape[1]).apply(np.ascontiguousarray(table.T), seen).T
    else:
        white = table
    white = white[seen]
    if columns.shape[1] == 0:
        return white[:, -1], float(np.sum(left[seen] ** 2))
    found = solve(white[:, :-1], white[:, -1])
    plain = left[seen] - columns[seen] @ found.x
    return white[:, -1] - white[:, :-1] @ found.x, float(plain @ plain)
