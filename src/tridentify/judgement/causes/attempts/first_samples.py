"""The stretch of a long record that is looked at, and what an estimate says of it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record


def beginning(record: Record, most: int) -> Record:
    """The first samples of a record, or all where an output has none among them.

    Parameters
    ----------
    record : Record
    most : int
        How many.

    Examples
    --------
    >>> beginning(Record(np.ones(5), np.ones(5), dt=1.0), 3).n_samples
    3
    """
    if record.n_samples > most and np.isfinite(record.y[:most]).any(axis=0).all():
        return record.slice(None, float(record.t[most - 1]))
    return record


@dataclass(frozen=True, eq=False)
class Predictions:
    """What an estimate says about the beginnings of its records, computed once for all who ask.

    Attributes
    ----------
    estimate : Estimate
    """

    estimate: Estimate
    _known: dict[int, Array] = field(default_factory=dict)

    def fitted(self, record: Record, experiment: int) -> Array:
        """As `Estimate.predict`, for beginnings of an experiment's record, the longest first."""
        known = self._known.get(experiment)
        if known is None or known.shape[0] < record.n_samples:
            known = self.estimate.predict(record, experiment=experiment)
            self._known[experiment] = known
        return known[: record.n_samples]

    def residual(self, record: Record, experiment: int) -> Array:
        """As `Estimate.residual`, likewise."""
        return np.asarray(record.y - self.fitted(record, experiment))
